"""The certificate of a server: loaded from its files, and loaded again when they change.

`context` is the TLS context of a listener and lives as long as it does. OpenSSL asks its callback at each
ClientHello, and the callback selects the context of the newest certificate. So a new certificate takes effect
for new connections at once, open ones keep theirs, and a broken file changes nothing.

A server may have a second certificate, of a public authority. It is for the names that it has; every other
name, an address and the names within the cell are answered with the first one. So a health check and a broker
verify the certificate of the cell, while browsers see that of the public authority.
"""

import ssl
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Final, Self

from handover.errors import UsageError
from handover.network.outbound_policy import is_loopback
from handover.settings import Settings
from handover.telemetry import get_logger

log = get_logger(__name__)

EXPIRES_SOON: Final = timedelta(days=7)
CIPHERS: Final = "ECDHE+AESGCM:ECDHE+CHACHA20"
"""The ciphers of TLS 1.2: forward secrecy and authenticated encryption. Those of TLS 1.3 all have both."""

Signature = tuple[tuple[int, int, int], ...]


class CertificateInvalid(UsageError):
    """A certificate or its key cannot be used; the text names the file, the rule and the way out."""


@dataclass(frozen=True, slots=True)
class _Loaded:
    context: ssl.SSLContext
    expires: datetime
    names: tuple[str, ...]
    signature: Signature

    def has(self, host: str) -> bool:
        """Return whether the certificate is for a host; `*` stands for one label at its beginning."""
        wanted = host.lower().rstrip(".")
        return any(
            wanted == name or (name.startswith("*.") and wanted.partition(".")[2] == name[2:])
            for name in map(str.lower, self.names)
        )


class ServerCertificate:
    """The certificate in `certificate` (PEM, with its chain) and its key; raises `CertificateInvalid`.

    With `client_authority` (PEM) clients may show a certificate of these authorities; another one ends the
    handshake. `public` is the second certificate.
    """

    def __init__(
        self,
        certificate: Path,
        key: Path | None = None,
        client_authority: Path | None = None,
        public: "ServerCertificate | None" = None,
    ) -> None:
        self._public = public
        self.path = certificate
        self._key = key or certificate
        self._client_authority = client_authority
        self._loaded = self._load()
        if self.expires <= datetime.now(UTC):
            raise CertificateInvalid(
                f"the certificate {self.path} expired on {self.expires:%Y-%m-%d}; renew it with "
                "`handover secure renew`, or replace the file"
            )
        self.context = self._loaded.context
        self.context.sni_callback = self._select_newest

    @classmethod
    def of(cls, settings: Settings) -> Self | None:
        """Return the certificate of `settings`; None without one."""
        if settings.tls_certificate is None:
            return None
        public = settings.public_tls_certificate
        second = None if public is None else cls(public, settings.public_tls_key)
        return cls(settings.tls_certificate, settings.tls_key, public=second)

    @property
    def expires(self) -> datetime:
        """When the certificate in use expires, or the public one, if that is earlier."""
        own = self._loaded.expires
        return own if self._public is None else min(own, self._public.expires)

    @property
    def name(self) -> str:
        """A name that the certificate has, for a client that knows the address of this server otherwise."""
        return next(iter(self._loaded.names), "").replace("*", "any")

    @property
    def names(self) -> tuple[str, ...]:
        """The host names and addresses that the certificate has."""
        return self._loaded.names

    def is_for(self, host: str) -> bool:
        """Return whether a client that connects to `host` accepts the names of the certificate."""
        return self._loaded.has(host)

    def reload(self) -> bool:
        """Load changed files; return whether new connections have another certificate from now on.

        Raises `CertificateInvalid` for files that cannot be used; the former certificate stays in use.
        """
        is_public_new = self._public is not None and self._public.reload()
        if self._signature() == self._loaded.signature:
            return is_public_new
        self._loaded = self._load()
        log.info("certificate loaded", file=str(self.path), expires=str(self.expires))
        return True

    def _select_newest(self, connection: Any, host: str | None, _: ssl.SSLContext) -> None:
        public = None if self._public is None else self._public._loaded
        if public is None or host is None or is_loopback(host) or not public.has(host):
            connection.context = self._loaded.context
        else:
            connection.context = public.context

    def _signature(self) -> Signature:
        faults = []
        for path in (self.path, self._key):
            try:
                status = path.stat()
            except OSError as error:
                raise self._unreadable(path, error) from None
            faults.append((status.st_ino, status.st_mtime_ns, status.st_size))
        return tuple(faults)

    def _load(self) -> _Loaded:
        signature = self._signature()
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        context.set_ciphers(CIPHERS)
        context.options |= ssl.OP_NO_RENEGOTIATION | ssl.OP_NO_COMPRESSION
        try:
            context.load_cert_chain(self.path, self._key, password=self._refuse_encrypted_key)
            pem = self.path.read_bytes()
        except ssl.SSLError as error:
            reason = (error.reason or str(error)).replace("_", " ").lower()
            raise CertificateInvalid(
                f"the certificate {self.path} with the key {self._key} cannot be used: {reason}; both must "
                "be PEM and belong together. `handover secure` makes them"
            ) from None
        except OSError as error:
            raise self._unreadable(self.path, error) from None
        self._ask_clients(context)
        if signature != self._signature():
            raise CertificateInvalid(f"the certificate {self.path} changed while it was read; try again")
        return _Loaded(context, *_expiry_and_names(pem), signature)

    def _ask_clients(self, context: ssl.SSLContext) -> None:
        if self._client_authority is None:
            return
        try:
            context.load_verify_locations(self._client_authority)
        except OSError as error:  # an ssl.SSLError is one
            raise CertificateInvalid(
                f"the authority of client certificates {self._client_authority} cannot be used: "
                f"{error.strerror or error}; it must be a PEM file of certificates"
            ) from None
        context.verify_mode = ssl.CERT_OPTIONAL

    def _refuse_encrypted_key(self) -> str:
        raise CertificateInvalid(
            f"the key {self._key} is encrypted; servers start without a person, so store it unencrypted, "
            "readable only by the user of the service"
        )

    @staticmethod
    def _unreadable(path: Path, error: OSError) -> CertificateInvalid:
        return CertificateInvalid(
            f"{path} cannot be read: {error.strerror}; make it readable for the user of this service, or "
            "set HANDOVER_TLS_CERTIFICATE and HANDOVER_TLS_KEY to files of `handover secure`"
        )


def _expiry_and_names(pem: bytes) -> tuple[datetime, tuple[str, ...]]:
    """Return when the first certificate, that of the server, expires, and the names that it has."""
    from cryptography import x509  # noqa: PLC0415 - 30 ms, only with TLS

    certificate = x509.load_pem_x509_certificates(pem)[0]
    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return certificate.not_valid_after_utc, ()
    hosts = names.get_values_for_type(x509.DNSName)
    addresses = [str(address) for address in names.get_values_for_type(x509.IPAddress)]
    return certificate.not_valid_after_utc, (*hosts, *addresses)
