"""Devices: what is shown only once stays until it is saved, and values are saved as a file."""

import time
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import expect

from handover_devices.device_client import DeviceClient, tls_context
from tests.e2e.conftest import PANEL, OpenPage
from tests.kit.cell import Cell
from tests.kit.certificates import Certificates
from tests.kit.waiting import wait_for

pytestmark = [pytest.mark.nightly, pytest.mark.slow]


def test_the_key_of_a_certificate_is_there_until_it_is_saved_and_values_are_saved_as_parquet(
    cell: Cell, open_page: OpenPage, tmp_path: Path
) -> None:
    certificates = Certificates(tmp_path)
    files = certificates.make("127.0.0.1")
    cell.extra |= {
        "HANDOVER_DEVICE_TLS_CERTIFICATE": str(files.certificate),
        "HANDOVER_DEVICE_TLS_KEY": str(files.key),
        "HANDOVER_AUTHORITY_DIR": str(certificates.authority.folder),
    }
    cell.run("context_broker")
    cell.run("device_gateway", "webui")
    gateway = cell.url("device_gateway")
    body = {"name": "press-1", "description": {"kind": "sensor", "sensors": [{"name": "temperature"}]}}
    token = httpx.post(f"{gateway}/devices", json=body, timeout=120).json()["token"]
    tls = tls_context(str(files.authority))
    client = DeviceClient("localhost", cell.ports["devices"], "press-1", token, tls=tls)
    client.start()
    client.send({"temperature": 21.5}, time.time())
    wait_for(lambda: client.waiting() == 0)
    client.stop()
    page = open_page("/cell/devices/press-1?part=history", viewport=PANEL, forgives=("WebSocket", "Failed"))
    with page.expect_download(timeout=90_000) as saved:
        page.get_by_role("button", name="Parquet").click()
    assert Path(saved.value.path()).read_bytes().startswith(b"PAR1")

    page.get_by_text("Settings").first.click()
    page.get_by_role("button", name="Make a certificate").click()
    page.get_by_role("dialog").get_by_role("button", name="Make a certificate").click()
    expect(page.get_by_text("This device has a certificate")).to_be_attached()  # the form was read again
    with page.expect_download() as saved:
        page.get_by_role("link", name="press-1.key.pem").click()
    assert "PRIVATE KEY" in Path(saved.value.path()).read_text()
