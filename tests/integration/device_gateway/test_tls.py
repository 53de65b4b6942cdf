"""Devices connect with TLS, and verify the gateway by its authority."""

import socket
import ssl
import time
from contextlib import suppress
from pathlib import Path

import httpx
import pytest

from handover.errors import UsageError
from services.device_gateway.connection.device_server import DeviceServer
from services.device_gateway.device_client import DeviceClient, tls_context
from services.device_gateway.settings import GatewaySettings
from tests.integration.device_gateway.conftest import SENSOR
from tests.kit.cell import Cell
from tests.kit.certificates import Certificates
from tests.kit.waiting import scaled, wait_for


@pytest.mark.slow
def test_a_device_connects_with_tls_and_never_in_clear(tenant_cell: Cell, tmp_path: Path) -> None:
    cell, certificates = tenant_cell, Certificates(tmp_path / "certificates")
    files = certificates.make("127.0.0.1", "localhost")
    cell.extra["HANDOVER_DEVICE_TLS_CERTIFICATE"] = str(files.certificate)
    cell.extra["HANDOVER_DEVICE_TLS_KEY"] = str(files.key)
    cell.run("device_gateway")
    url = cell.url("device_gateway")
    body = {"name": "hall-1", "description": SENSOR}
    token = httpx.post(f"{url}/devices", json=body, timeout=60, trust_env=False).json()["token"]
    port = cell.ports["devices"]
    with socket.create_connection(("127.0.0.1", port), timeout=scaled(30)) as clear:
        clear.sendall(b'{"type":"hello","version":1,"device":"hall-1","token":"x"}\n')
        with suppress(ConnectionError):
            assert not clear.recv(1000).startswith(b"{")  # an alert of TLS, or the end
    client = DeviceClient("localhost", port, "hall-1", token, tls=tls_context(str(files.authority)))
    client.start()
    client.send({"temperature": 3.5}, time.time())
    wait_for(lambda: client.waiting() == 0)
    stranger = DeviceClient("localhost", port, "hall-1", token, tls=ssl.create_default_context())
    stranger.start()
    stranger.send({"temperature": 4.5}, time.time())
    found = httpx.get(f"{url}/devices/hall-1", timeout=60, trust_env=False).json()
    assert (found["connected"], found["values"]["temperature"]["value"]) == (True, 3.5)
    assert stranger.waiting() == 1
    client.stop()
    stranger.stop()


def test_tokens_are_not_sent_in_clear_beyond_this_machine() -> None:
    for members in ({"device_host": "0.0.0.0"}, {"device_host": "192.168.7.2"}):
        with pytest.raises(UsageError, match="HANDOVER_DEVICE_TLS_CERTIFICATE"):
            DeviceServer(GatewaySettings.load(**members), None)  # type: ignore[arg-type]
