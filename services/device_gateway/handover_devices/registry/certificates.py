"""Client certificates of devices, made by the authority of `handover secure`.

The gateway keeps the fingerprint only (SHA-256 of the certificate in DER). So a certificate is revoked by
forgetting its fingerprint, and no revocation list has to reach anyone.
"""

import hashlib
from dataclasses import dataclass

from cryptography.hazmat.primitives.serialization import Encoding

from handover.errors import Problem, UsageError
from handover.transport_security.local_authority import AUTHORITY, LocalAuthority
from handover_devices.settings import GatewaySettings


@dataclass(frozen=True, slots=True)
class NewCertificate:
    """A certificate and its private key in PEM, and what the gateway keeps of it."""

    certificate: str
    key: str
    authority: str
    sha256: str
    end_us: int


def new_certificate(settings: GatewaySettings, device: str) -> NewCertificate:
    """Make a certificate for a device; raise `Problem` 409 if it could not connect with it."""
    folder = settings.own_authority
    if not settings.has_device_tls or not (folder / AUTHORITY).is_file():
        raise Problem.translated(
            409,
            "No authority",
            "device.no_authority",
            "certificates need TLS on the port of devices and the authority in {folder}; run `handover "
            "secure` there, or set HANDOVER_AUTHORITY_DIR, and restart the gateway; or use a token",
            folder=str(folder),
        )
    try:
        authority = LocalAuthority(folder)
    except UsageError as error:
        raise Problem.translated(
            409,
            "Authority unusable",
            "device.authority_unusable",
            "no certificate was made: {reason}",
            reason=str(error),
        ) from None
    certificate, key = authority.issue_client(device)
    return NewCertificate(
        certificate.public_bytes(Encoding.PEM).decode(),
        key.decode(),
        authority.path.read_text(encoding="ascii"),
        hashlib.sha256(certificate.public_bytes(Encoding.DER)).hexdigest(),
        int(certificate.not_valid_after_utc.timestamp() * 1e6),
    )
