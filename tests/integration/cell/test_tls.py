"""A cell with TLS: services, page and glove reach each other with the certificates of the local authority."""

import json
import socket
import ssl
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path

import httpx
import pytest

from glove_sdk_bridge.frame_sender import FrameSender
from glove_sdk_bridge.frames import Hello
from handover import health
from handover.alerts.catalogue import CERTIFICATE_EXPIRES
from handover.broker import BrokerClient
from handover.network.tls_trust import client_context
from handover.serving.certificate_watch import CertificateWatch
from handover.settings import Settings
from handover.transport_security.local_authority import ServerFiles
from handover.transport_security.server_certificate import ServerCertificate
from tests.kit.cell import Cell, new_cell
from tests.kit.certificates import Certificates, wait_ready_over_tls
from tests.kit.other_broker.running import ready_path
from tests.kit.waiting import until, wait_for

pytestmark = pytest.mark.slow

SERVICES = ("context_broker", "gesture_controller", "webui")


@dataclass
class TlsCell(Cell):
    """A cell whose servers have a certificate."""

    files: ServerFiles | None = None

    def url(self, service: str) -> str:
        return super().url(service).replace("http:", "https:")

    def wait_ready(self, service: str, within_s: float = 30.0) -> None:
        assert self.files is not None
        path = ready_path(service)
        wait_ready_over_tls(self.url(service), self.files, lambda: self.log(service), within_s, path)


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Certificates:
    return Certificates(tmp_path_factory.mktemp("certificates"))


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory, certificates: Certificates) -> Iterator[TlsCell]:
    files = certificates.make(expires_in=timedelta(days=6))
    with new_cell(tmp_path_factory.mktemp("cell")) as plain:
        made = TlsCell(plain.data_dir, plain.ports, files=files)
        made.extra |= {
            "HANDOVER_TLS_CERTIFICATE": str(files.certificate),
            "HANDOVER_TLS_KEY": str(files.key),
            "HANDOVER_TLS_AUTHORITY": str(files.authority),
        }
        plain.processes = made.processes
        made.start(*SERVICES, within_s=90.0)
        yield made


def files_of(cell: TlsCell) -> ServerFiles:
    assert cell.files is not None
    return cell.files


def settings_of(cell: TlsCell) -> Settings:
    return Settings.load(broker_url=cell.url("context_broker"), tls_authority=files_of(cell).authority)


def test_the_page_reaches_services_over_tls(cell: TlsCell) -> None:
    context = client_context(files_of(cell).authority)
    with httpx.Client(verify=context, trust_env=False, base_url=cell.url("webui")) as client:
        assert client.get("/").headers["content-type"].startswith("text/html")
        (glove,) = client.get("/api/gesture-controller/gloves").json()
        assert glove["glove"] == "glove-1"
        assert client.get("/api/gesture-controller/gloves", headers={"Origin": cell.url("webui")}).is_success
        foreign = client.get("/api/gesture-controller/gloves", headers={"Origin": "https://evil.example"})
        assert foreign.status_code == 403


def test_a_plain_request_to_a_server_with_tls_gets_no_answer(cell: TlsCell) -> None:
    with pytest.raises(httpx.TransportError):
        httpx.get(cell.url("webui").replace("https:", "http:"), trust_env=False)


def test_a_glove_connects_over_tls_and_names_a_wrong_authority(
    cell: TlsCell, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    said: list[str] = []
    port = cell.ports["glove"]
    context = client_context(files_of(cell).authority)
    hello = Hello("glove-7", "right", "")
    with FrameSender(hello, "127.0.0.1", port, say=said.append, tls=context) as sender:
        wait_for(lambda: sender.connected, why=lambda: str(said))
    stranger = client_context(Certificates(tmp_path).make().authority)
    with FrameSender(hello, "127.0.0.1", port, say=said.append, tls=stranger):
        wait_for(lambda: any("its certificate is not accepted" in line for line in said))


def test_the_glove_port_sends_no_word_without_tls(cell: TlsCell) -> None:
    with socket.create_connection(("127.0.0.1", cell.ports["glove"]), timeout=120) as plain:
        plain.sendall(json.dumps({"type": "hello", "version": 1, "glove": "glove-8"}).encode() + b"\n")
        assert b"ack" not in plain.recv(1000)


def test_the_health_check_trusts_the_authority(cell: TlsCell, monkeypatch: pytest.MonkeyPatch) -> None:
    url = f"{cell.url('webui')}/readyz"
    with pytest.raises(health.NotReady, match="CERTIFICATE_VERIFY_FAILED"):
        health.require_ready(url)
    monkeypatch.setenv(health.AUTHORITY, str(files_of(cell).authority))
    health.require_ready(url)


async def test_a_certificate_that_expires_soon_raises_an_alert_until_it_is_renewed(
    cell: TlsCell, certificates: Certificates
) -> None:
    async with BrokerClient(settings_of(cell)) as broker:

        async def active() -> set[str]:
            found = await broker.query(type="Alert")
            return {
                alert["alertSource"]["object"].rsplit(":", 1)[-1]
                for alert in found
                if alert["subCategory"]["value"] == CERTIFICATE_EXPIRES.sub_category
                and "validTo" not in alert
            }

        async def all_raised() -> bool:
            return await active() == {"context-broker", "gesture-controller", "webui"}

        await until(all_raised, 60)
        certificates.authority.renew()

        async def all_cleared() -> bool:
            return await active() == set()

        await until(all_cleared, 60)


@pytest.mark.parametrize(
    ("expires_in", "is_raised"),
    [(timedelta(hours=6), True), (timedelta(days=6, hours=23), True), (timedelta(days=7, hours=1), False)],
    ids=["tonight", "in a week", "later"],
)
async def test_an_alert_is_raised_a_week_before_a_certificate_expires(
    shared_cell: Cell, certificates: Certificates, expires_in: timedelta, is_raised: bool
) -> None:
    shared_cell.run("context_broker")
    service = f"lamp-{expires_in.total_seconds():.0f}"
    files = certificates.make(server=service, expires_in=expires_in)
    settings = Settings.load(
        tls_certificate=files.certificate,
        tls_key=files.key,
        broker_url=shared_cell.url("context_broker"),
    )
    certificate = ServerCertificate.of(settings)
    assert certificate is not None
    async with BrokerClient(settings) as broker:
        await CertificateWatch(certificate, settings, service, broker).look()
        found = await broker.query(type="Alert")
        mine = [one for one in found if one["alertSource"]["object"].endswith(f":{service}")]
        assert [one["subCategory"]["value"] for one in mine] == (
            [CERTIFICATE_EXPIRES.sub_category] if is_raised else []
        )


@pytest.mark.nightly
def test_a_server_with_an_expired_certificate_does_not_start(
    cell: TlsCell, certificates: Certificates, tmp_path: Path
) -> None:
    expired = certificates.make(server="expired", expires_in=timedelta(days=-1))
    ended = run_webui(
        cell, HANDOVER_TLS_CERTIFICATE=str(expired.certificate), HANDOVER_TLS_KEY=str(expired.key)
    )
    assert "expired on" in ended
    assert "`handover secure renew`" in ended


def run_webui(cell: TlsCell, **more: str) -> str:
    """Return the one line with which the page's server refuses to start."""
    ended = subprocess.run(
        [sys.executable, "-m", "handover_web"],
        env={**cell.environment, **more},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert ended.returncode == 2
    (line,) = ended.stderr.strip().splitlines()
    return line


def test_tls_of_the_standard_library_accepts_the_certificate(cell: TlsCell) -> None:
    context = ssl.create_default_context(cafile=files_of(cell).authority)
    with (
        socket.create_connection(("127.0.0.1", cell.ports["webui"]), timeout=120) as plain,
        context.wrap_socket(plain, server_hostname="localhost") as connection,
    ):
        assert connection.version() == "TLSv1.3"
