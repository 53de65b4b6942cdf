"""Certificates for tests: of a local authority, also expired ones and those that expire soon."""

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import httpx
import pytest

from handover.network.tls_trust import client_context
from handover.transport_security import local_authority
from handover.transport_security.local_authority import CLOCK_TOLERANCE, LocalAuthority, ServerFiles
from tests.kit.processes import is_up
from tests.kit.waiting import wait_for


@dataclass
class Certificates:
    """Makes the certificates of servers in folders of `folder`."""

    folder: Path

    @property
    def authority(self) -> LocalAuthority:
        return LocalAuthority(self.folder / "authority")

    def make(
        self, *names: str, server: str = "server", expires_in: timedelta = timedelta(days=90)
    ) -> ServerFiles:
        """Make a certificate that expires from now on after `expires_in`, which may be negative."""
        with pytest.MonkeyPatch.context() as patch:
            if expires_in < timedelta(0):
                patch.setattr(local_authority, "CLOCK_TOLERANCE", CLOCK_TOLERANCE - expires_in)
            patch.setattr(local_authority, "SERVER_LIFETIME", expires_in)
            return self.authority.secure(self.folder / server, names, renew=True)


def wait_ready_over_tls(
    url: str, files: ServerFiles, log: Callable[[], str], within_s: float = 60, path: str = "/readyz"
) -> None:
    """Wait until the service at `url` is ready, with the authority of `files`."""
    context = client_context(files.authority)

    def is_ready() -> bool:
        try:
            return is_up(httpx.get(f"{url}{path}", verify=context, trust_env=False))
        except httpx.TransportError:
            return False

    wait_for(is_ready, within_s, log)


def serial_of(der: bytes | None) -> int:
    """Return the serial number of a certificate that a server has shown."""
    from cryptography.x509 import load_der_x509_certificate

    assert der is not None
    return load_der_x509_certificate(der).serial_number


def serial_in(file: Path) -> int:
    """Return the serial number of the certificate in a file."""
    from cryptography.x509 import load_pem_x509_certificate

    certificate = load_pem_x509_certificate(file.read_bytes())
    assert certificate.not_valid_before_utc < datetime.now(UTC)
    return certificate.serial_number
