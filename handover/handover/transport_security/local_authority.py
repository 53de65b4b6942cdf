"""The local certificate authority: makes server certificates for machines of one site.

Its files are in a folder that only their owner opens:

- `authority.pem` and `authority.key`: the authority; only `authority.pem` goes to clients.
- `servers.json`: the certificates that it made, with folder and names, so that they can be renewed.

A server has a folder of its own with `certificate.pem`, `key.pem` and a copy of `authority.pem`. Keys are
ECDSA P-256, because browsers do not accept Ed25519. All files are written durably, the certificate last; a
server that sees the key before the certificate waits for the other.
"""

import ipaddress
import json
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Final

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from handover.errors import UsageError
from handover.files.durable_files import replace_durably

AUTHORITY_LIFETIME: Final = timedelta(days=3650)
SERVER_LIFETIME: Final = timedelta(days=397)
"""What browsers accept of public authorities; some apply it to local ones, too."""
RENEWED_BEFORE: Final = timedelta(days=30)
CLOCK_TOLERANCE: Final = timedelta(hours=1)
"""Certificates are valid from so long before now, for clients whose clocks are behind."""
LOOPBACK_NAMES: Final = ("localhost", "127.0.0.1", "::1")
PRIVATE_MODE: Final = 0o600
PUBLIC_MODE: Final = 0o644
MAX_NAME_CHARACTERS: Final = 253

CERTIFICATE, KEY, AUTHORITY = "certificate.pem", "key.pem", "authority.pem"


@dataclass(frozen=True, slots=True)
class ServerFiles:
    """The files of a server's certificate; `is_new` if they were written now."""

    folder: Path
    names: tuple[str, ...]
    expires: datetime
    is_new: bool

    @property
    def certificate(self) -> Path:
        """The certificate in PEM."""
        return self.folder / CERTIFICATE

    @property
    def key(self) -> Path:
        """The private key in PEM."""
        return self.folder / KEY

    @property
    def authority(self) -> Path:
        """The certificate of the authority in PEM."""
        return self.folder / AUTHORITY


class LocalAuthority:
    """The authority in `folder`, made if there is none; raises `UsageError` for files that it cannot use."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.is_new = not self.path.exists()
        try:
            if self.is_new:
                self._make()
            self._key = _private_key(self._key_path.read_bytes())
            self.certificate = x509.load_pem_x509_certificate(self.path.read_bytes())
        except OSError as error:
            raise _unusable(self.folder, error.strerror or str(error)) from None
        except (ValueError, TypeError) as error:
            raise _unusable(self.folder, str(error)) from None
        if self.certificate.public_key() != self._key.public_key():
            raise _unusable(self.folder, "certificate and key do not belong together")
        if self.certificate.not_valid_after_utc <= datetime.now(UTC):
            raise _unusable(self.folder, f"it expired on {self.certificate.not_valid_after_utc:%Y-%m-%d}")

    @property
    def path(self) -> Path:
        """The certificate of the authority, for clients."""
        return self.folder / AUTHORITY

    @property
    def _key_path(self) -> Path:
        return self.folder / "authority.key"

    @property
    def _servers_path(self) -> Path:
        return self.folder / "servers.json"

    def secure(self, folder: Path, names: Iterable[str], *, renew: bool = False) -> ServerFiles:
        """Make the certificate of a server for `names` and loopback, unless there is a valid one.

        It is made again within `RENEWED_BEFORE` of its end, for other names, or to `renew` it.
        """
        wanted = tuple(dict.fromkeys((*map(checked_name, names), *LOOPBACK_NAMES)))
        folder = folder.absolute()
        try:
            current = None if renew else self._current(folder, wanted)
            is_new = current is None
            certificate = current or self._issue(folder, wanted)
            self._remember(folder, wanted)
        except OSError as error:
            raise UsageError(
                f"the certificate in {folder} cannot be written: {error.strerror}; make the folder writable"
            ) from None
        return ServerFiles(folder, wanted, certificate.not_valid_after_utc, is_new)

    def issue_client(self, name: str) -> tuple[x509.Certificate, bytes]:
        """Return a new certificate for a client with this name, and its private key as PEM.

        The authority keeps neither: a server recognizes a client by the fingerprint of its certificate.
        """
        key = ec.generate_private_key(ec.SECP256R1())
        return self._sign(key, name, ExtendedKeyUsageOID.CLIENT_AUTH), _pem(key)

    def issue_server(self, names: Iterable[str]) -> tuple[bytes, bytes]:
        """Return a new certificate of a server for `names` and loopback, and its private key, both as PEM.

        The authority keeps neither, so `renew` does not make it again.
        """
        return self._new_server(tuple(dict.fromkeys((*map(checked_name, names), *LOOPBACK_NAMES))))[1:]

    def trust(self, folder: Path) -> None:
        """Write the certificate of the authority into a folder of clients, unless it is there."""
        file = folder / AUTHORITY
        try:
            if not file.exists() or file.read_bytes() != self.path.read_bytes():
                replace_durably(file, self.path.read_bytes(), mode=PUBLIC_MODE)
        except OSError as error:
            raise UsageError(
                f"{file} cannot be written: {error.strerror}; make the folder writable"
            ) from None

    def names_of(self, folder: Path) -> list[str]:
        """Return the names in the certificate of a known server; none for another."""
        return self._servers().get(str(folder.absolute()), [])

    def renew(self) -> list[ServerFiles]:
        """Make all known server certificates again."""
        return [
            self.secure(Path(folder), names, renew=True) for folder, names in sorted(self._servers().items())
        ]

    def _make(self) -> None:
        key = ec.generate_private_key(ec.SECP256R1())
        name = _name(f"Handover local authority {datetime.now(UTC):%Y-%m-%d %H:%M:%S}")
        builder = (
            _builder(name, name, key.public_key(), AUTHORITY_LIFETIME)
            .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
            .add_extension(_key_usage(key_cert_sign=True, crl_sign=True), critical=True)
            .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
        )
        certificate = builder.sign(key, hashes.SHA256())
        self.folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        replace_durably(self._key_path, _pem(key), mode=PRIVATE_MODE)
        replace_durably(self.path, certificate.public_bytes(serialization.Encoding.PEM), mode=PUBLIC_MODE)

    def _current(self, folder: Path, wanted: tuple[str, ...]) -> x509.Certificate | None:
        """Return the certificate in `folder` if it is as it must be."""
        try:
            certificate = x509.load_pem_x509_certificate((folder / CERTIFICATE).read_bytes())
            key = _private_key((folder / KEY).read_bytes())
            certificate.verify_directly_issued_by(self.certificate)
            names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
            authority = (folder / AUTHORITY).read_bytes()
        except (FileNotFoundError, ValueError, TypeError, InvalidSignature, x509.ExtensionNotFound):
            return None
        is_current = (
            certificate.not_valid_after_utc - datetime.now(UTC) > RENEWED_BEFORE
            and certificate.public_key() == key.public_key()
            and list(names) == _alternative_names(wanted)
            and authority == self.path.read_bytes()
        )
        return certificate if is_current else None

    def _issue(self, folder: Path, names: tuple[str, ...]) -> x509.Certificate:
        certificate, pem, key = self._new_server(names)
        if not folder.exists():
            folder.mkdir(parents=True, mode=0o700)
        replace_durably(folder / AUTHORITY, self.path.read_bytes(), mode=PUBLIC_MODE)
        replace_durably(folder / KEY, key, mode=PRIVATE_MODE)
        replace_durably(folder / CERTIFICATE, pem, mode=PUBLIC_MODE)
        return certificate

    def _new_server(self, names: tuple[str, ...]) -> tuple[x509.Certificate, bytes, bytes]:
        """Return a certificate for `names`, and it and its private key as PEM."""
        key = ec.generate_private_key(ec.SECP256R1())
        alternative = x509.SubjectAlternativeName(_alternative_names(names))
        certificate = self._sign(key, names[0], ExtendedKeyUsageOID.SERVER_AUTH, alternative)
        return certificate, certificate.public_bytes(serialization.Encoding.PEM), _pem(key)

    def _sign(
        self,
        key: ec.EllipticCurvePrivateKey,
        name: str,
        usage: x509.ObjectIdentifier,
        alternative: x509.SubjectAlternativeName | None = None,
    ) -> x509.Certificate:
        authority_key_id = x509.AuthorityKeyIdentifier.from_issuer_public_key(self._key.public_key())
        builder = _builder(
            _name(name[:64]),
            self.certificate.subject,
            key.public_key(),
            min(SERVER_LIFETIME, self.certificate.not_valid_after_utc - datetime.now(UTC)),
        )
        if alternative is not None:
            builder = builder.add_extension(alternative, critical=False)
        builder = (
            builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(_key_usage(digital_signature=True), critical=True)
            .add_extension(x509.ExtendedKeyUsage([usage]), critical=False)
            .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
            .add_extension(authority_key_id, critical=False)
        )
        return builder.sign(self._key, hashes.SHA256())

    def _servers(self) -> dict[str, list[str]]:
        try:
            servers: dict[str, list[str]] = json.loads(self._servers_path.read_bytes())
        except FileNotFoundError:
            return {}
        except (OSError, ValueError) as error:
            raise UsageError(
                f"{self._servers_path} cannot be read ({error}); remove it and name the servers again"
            ) from None
        return servers

    def _remember(self, folder: Path, names: tuple[str, ...]) -> None:
        servers = self._servers()
        if servers.get(str(folder)) != list(names):
            content = json.dumps({**servers, str(folder): names}, indent=1)
            replace_durably(self._servers_path, content.encode(), mode=PRIVATE_MODE)


def checked_name(name: str) -> str:
    """Return a host name or address as in certificates; raise `UsageError` if it is neither."""
    name = name.strip().strip("[]").rstrip(".").lower()
    try:
        return str(ipaddress.ip_address(name))
    except ValueError:
        pass
    labels = name.removeprefix("*.").split(".")
    is_name = all(label.replace("-", "").replace("_", "").isalnum() and label.isascii() for label in labels)
    if not is_name or len(name) > MAX_NAME_CHARACTERS:
        raise UsageError(
            f'"{name}" is neither a host name nor an address; write it as cell-3.factory.example or '
            "192.168.1.20, without a scheme and a port"
        )
    return name


def _alternative_names(names: Iterable[str]) -> list[x509.GeneralName]:
    general_names: list[x509.GeneralName] = []
    for name in names:
        try:
            general_names.append(x509.IPAddress(ipaddress.ip_address(name)))
        except ValueError:
            general_names.append(x509.DNSName(name))
    return general_names


def _builder(subject: x509.Name, issuer: x509.Name, key: Any, lifetime: timedelta) -> x509.CertificateBuilder:
    now = datetime.now(UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - CLOCK_TOLERANCE)
        .not_valid_after(now + lifetime)
    )


def _key_usage(**used: bool) -> x509.KeyUsage:
    usages = (
        "digital_signature", "content_commitment", "key_encipherment", "data_encipherment", "key_agreement",
        "key_cert_sign", "crl_sign", "encipher_only", "decipher_only",
    )  # fmt: skip
    return x509.KeyUsage(**{usage: used.get(usage, False) for usage in usages})


def _name(text: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, text)])


def _private_key(pem: bytes) -> ec.EllipticCurvePrivateKey:
    key = serialization.load_pem_private_key(pem, None)
    if not isinstance(key, ec.EllipticCurvePrivateKey):
        raise TypeError("the key is no ECDSA key")
    return key


def _pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )


def _unusable(folder: Path, reason: str) -> UsageError:
    return UsageError(
        f"the authority in {folder} cannot be used: {reason}; repair it from a backup, or remove the folder, "
        "run `handover secure` again and give the new authority to all clients"
    )
