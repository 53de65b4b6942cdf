"""Devices connect with TLS, and verify the gateway by its authority."""

import json
import socket
import ssl
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import httpx
import pytest
from cryptography.hazmat.primitives.serialization import Encoding

from handover.errors import UsageError
from handover_devices.connection.device_server import DeviceServer
from handover_devices.device_client import DeviceClient, tls_context
from handover_devices.settings import GatewaySettings
from services.device_gateway.tests.integration.conftest import SENSOR
from tests.kit.cell import Cell
from tests.kit.certificates import Certificates
from tests.kit.waiting import scaled, wait_for


@pytest.mark.nightly
@pytest.mark.slow
def test_a_device_connects_with_tls_and_never_in_clear(tenant_cell: Cell, tmp_path: Path) -> None:
    cell, certificates = tenant_cell, Certificates(tmp_path / "certificates")
    files = certificates.make("127.0.0.1", "localhost")
    cell.extra["HANDOVER_DEVICE_TLS_CERTIFICATE"] = str(files.certificate)
    cell.extra["HANDOVER_DEVICE_TLS_KEY"] = str(files.key)
    cell.extra["HANDOVER_AUTHORITY_DIR"] = str(certificates.authority.folder)
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
    _a_certificate_replaces_the_token(url, port, str(files.authority), tmp_path)


def _a_certificate_replaces_the_token(url: str, port: int, authority: str, folder: Path) -> None:
    with httpx.Client(base_url=url, timeout=60, trust_env=False) as rest:
        rest.post("/devices", json={"name": "hall-2", "description": SENSOR}).raise_for_status()
        rest.delete("/devices/hall-2/token").raise_for_status()
        made = rest.post("/devices/hall-1/certificate").raise_for_status().json()
        old = context_of(made, authority, folder / "old.pem")
        assert greeting_of(port, "hall-1", old)["type"] == "ack"
        assert greeting_of(port, "hall-2", old)["code"] == "wrongCertificate"
        assert greeting_of(port, "hall-1", tls_context(authority))["code"] == "badHello"
        made = rest.post("/devices/hall-1/certificate").raise_for_status().json()
        new = context_of(made, authority, folder / "new.pem")
        client = DeviceClient("localhost", port, "hall-1", tls=new)
        client.start()
        client.send({"temperature": 5.5}, time.time())
        wait_for(lambda: client.waiting() == 0)
        assert greeting_of(port, "hall-1", old)["code"] == "wrongCertificate"
        assert rest.get("/devices/hall-1").json()["certificateEndsAt"] == made["endsAt"]
        rest.delete("/devices/hall-1/certificate").raise_for_status()
        wait_for(lambda: client.refused is not None)
        assert greeting_of(port, "hall-1", new)["code"] == "wrongCertificate"
        assert rest.get("/devices/hall-1").json()["certificateEndsAt"] is None
        client.stop()
    other = Certificates(folder / "other").authority.issue_client("hall-1")
    made = {"certificate": other[0].public_bytes(Encoding.PEM).decode(), "key": other[1].decode()}
    with pytest.raises(OSError, match=r"(?i)unknown.ca|reset|closed|eof"):  # of another authority
        greeting_of(port, "hall-1", context_of(made, authority, folder / "other.pem"))


def context_of(made: dict[str, str], authority: str, file: Path) -> ssl.SSLContext:
    """Return the TLS context of a device with a certificate."""
    file.write_text(made["key"] + made["certificate"])
    return tls_context(authority, str(file))


def greeting_of(port: int, device: str, context: ssl.SSLContext) -> dict[str, Any]:
    """Connect without a token and return the answer to the hello; raise OSError if there is none."""
    with (
        socket.create_connection(("127.0.0.1", port), timeout=scaled(30)) as clear,
        context.wrap_socket(clear, server_hostname="localhost") as tls,
    ):
        tls.sendall(json.dumps({"type": "hello", "version": 1, "device": device}).encode() + b"\n")
        line = tls.makefile("rb").readline()
        if not line:
            raise OSError("closed")
        answer: dict[str, Any] = json.loads(line)
        return answer


def test_tokens_are_not_sent_in_clear_beyond_this_machine() -> None:
    for members in ({"device_host": "0.0.0.0"}, {"device_host": "192.168.7.2"}):
        with pytest.raises(UsageError, match="HANDOVER_DEVICE_TLS_CERTIFICATE"):
            DeviceServer(GatewaySettings.load(**members), None)  # type: ignore[arg-type]
