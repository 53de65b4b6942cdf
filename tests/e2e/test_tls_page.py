"""The page over https: it loads, its WebSocket connects, and only its own authority counts."""

import base64
import hashlib
import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat
from playwright.sync_api import Error, Page, expect, sync_playwright

from handover.transport_security.local_authority import ServerFiles
from tests.e2e.conftest import SCREENSHOTS
from tests.kit.cell import Cell, new_cell
from tests.kit.certificates import Certificates, wait_ready_over_tls
from tests.kit.chromium import FLAGS, chromium

pytestmark = [pytest.mark.nightly, pytest.mark.slow]


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> ServerFiles:
    return Certificates(tmp_path_factory.mktemp("certificates")).make()


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory, files: ServerFiles) -> Iterator[str]:
    with new_cell(tmp_path_factory.mktemp("cell")) as cell:
        yield start_with_tls(cell, files)


def start_with_tls(cell: Cell, files: ServerFiles) -> str:
    """Start the page's server with the certificate; the other services are away."""
    cell.extra |= {
        "HANDOVER_TLS_CERTIFICATE": str(files.certificate),
        "HANDOVER_TLS_KEY": str(files.key),
        "HANDOVER_TLS_AUTHORITY": str(files.authority),
    }
    cell.spawn("webui")
    url = cell.url("webui").replace("http:", "https:").replace("127.0.0.1", "localhost")
    wait_ready_over_tls(url, files, lambda: cell.log("webui"))
    return url


def trusted_by(home: Path, files: ServerFiles) -> tuple[dict[str, str], list[str]]:
    """Return environment and arguments of a Chromium that trusts the authority of `files`.

    It takes the authorities of a user from a database of NSS. Without the program for that, it accepts the
    key of the server instead.
    """
    environment = {**os.environ, "HOME": str(home)}
    certutil = shutil.which("certutil")
    if certutil is None:
        return environment, [f"--ignore-certificate-errors-spki-list={key_hash(files.certificate)}"]
    database = home / ".pki" / "nssdb"
    database.mkdir(parents=True)
    place = ["-d", f"sql:{database}"]
    subprocess.run([certutil, *place, "-N", "--empty-password"], check=True)
    subprocess.run([certutil, *place, "-A", "-t", "C,,", "-n", "cell", "-i", files.authority], check=True)
    return environment, []


def key_hash(certificate: Path) -> str:
    key = x509.load_pem_x509_certificate(certificate.read_bytes()).public_key()
    der = key.public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)
    return base64.b64encode(hashlib.sha256(der).digest()).decode()


@contextmanager
def opened(home: Path, files: ServerFiles) -> Iterator[Page]:
    """Return a page of a Chromium that trusts the authority of `files` and no other."""
    program = chromium()
    environment, trust = trusted_by(home, files)
    with (
        sync_playwright() as playwright,
        playwright.chromium.launch_persistent_context(
            home / "profile", executable_path=program, args=[*FLAGS, *trust], env=environment
        ) as browser,
    ):
        yield browser.new_page()


def test_the_page_and_its_websocket_open_over_https(url: str, files: ServerFiles, tmp_path: Path) -> None:
    with opened(tmp_path, files) as page:
        sockets: list[str] = []
        page.on("websocket", lambda socket: sockets.append(socket.url))
        response = page.goto(url)
        assert response is not None
        security = response.security_details()
        assert security is not None
        assert security["protocol"] == "TLS 1.3"
        expect(page.locator("main")).to_be_visible()
        assert page.evaluate("window.isSecureContext")
        assert sockets[0].startswith("wss://localhost:")
        SCREENSHOTS.mkdir(parents=True, exist_ok=True)
        page.screenshot(path=SCREENSHOTS / "page_over_https.png")


def test_the_page_does_not_open_with_another_authority(url: str, tmp_path: Path) -> None:
    stranger = Certificates(tmp_path / "stranger").make()
    with opened(tmp_path, stranger) as page, pytest.raises(Error, match="ERR_CERT_AUTHORITY_INVALID"):
        page.goto(url)
