"""Trust of TLS clients: the authorities that a client accepts, and the reasons of failed handshakes.

All clients verify the certificate and the host name. Besides the authorities of the system they trust those
of HANDOVER_TLS_AUTHORITY, for example the one that `handover secure` makes.
"""

import socket
import ssl
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

PROBE_TIMEOUT_S: Final = 5.0
SETTING: Final = "HANDOVER_TLS_AUTHORITY"

_UNKNOWN_AUTHORITY: Final = (
    f"is from an authority that is not trusted here; set {SETTING} to the file of its authority "
    "(authority.pem of `handover secure`)"
)
_OTHER_NAME: Final = (
    "is for other names; use a name that it has, or make one that has this name: handover secure --name NAME"
)
_CERTIFICATE_FAULTS: Final = {
    **dict.fromkeys((2, 7, 18, 19, 20, 21), _UNKNOWN_AUTHORITY),
    **dict.fromkeys((62, 64), _OTHER_NAME),
    9: "is not valid yet; compare the clocks of the two machines",
    10: "has expired; renew it there: handover secure renew",
}
"""By the X509_V_ERR_… code of OpenSSL."""
_PLAIN_HTTP: Final = frozenset({"WRONG_VERSION_NUMBER", "HTTP_REQUEST", "RECORD_LAYER_FAILURE"})


class AuthorityUnreadable(OSError):
    """The file of the authorities is missing or invalid; the text names the file and the setting."""


def client_context(*ca_files: Path | None) -> ssl.SSLContext:
    """Return a TLS context for clients, with the system's authorities and those of `ca_files` (PEM).

    It is shared: do not change it. Raises `AuthorityUnreadable`.
    """
    return _context(tuple(file for file in ca_files if file is not None))


def tls_of(url: str, ca_files: Sequence[Path]) -> ssl.SSLContext | None:
    """Return the context for a client of `url`; None if its scheme has no TLS."""
    return client_context(*ca_files) if url.startswith(("https:", "wss:")) else None


@lru_cache(maxsize=8)
def _context(files: tuple[Path, ...]) -> ssl.SSLContext:
    context = ssl.create_default_context()
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    for file in files:
        try:
            context.load_verify_locations(file)
        except OSError as error:  # an ssl.SSLError is one
            reason = "it has no certificate in PEM" if isinstance(error, ssl.SSLError) else error.strerror
            raise AuthorityUnreadable(
                f"the authorities {file} cannot be read: {reason}; set {SETTING} to a readable file with "
                "certificates in PEM, for example authority.pem of `handover secure`"
            ) from None
    return context


def handshake_fault(error: BaseException, where: str) -> str | None:
    """Return why the TLS handshake with the server `where` failed, and the way out; None for other errors.

    `error` may be wrapped by the error of a library.
    """
    ssl_error = _ssl_error_in(error)
    if ssl_error is None:
        return None
    if isinstance(ssl_error, ssl.SSLCertVerificationError):
        fault = _CERTIFICATE_FAULTS.get(ssl_error.verify_code, f"is not accepted: {ssl_error.verify_message}")
        return f"the certificate of {where} {fault}"
    if ssl_error.reason in _PLAIN_HTTP:
        return (
            f"{where} does not speak TLS; use http:// instead of https://, or give that server a certificate"
        )
    reason = (ssl_error.reason or str(ssl_error)).replace("_", " ").lower()
    return f"the TLS handshake with {where} failed: {reason}"


def speaks_tls(url: str) -> bool:
    """Return whether the server of a plain `url` is there and speaks TLS; nothing is sent to it."""
    parts = urlsplit(url)
    if parts.scheme not in {"http", "ws"} or parts.hostname is None:
        return False
    anyone = ssl.create_default_context()
    anyone.check_hostname = False
    anyone.verify_mode = ssl.CERT_NONE  # the question is the protocol, not who it is
    try:
        with (
            socket.create_connection((parts.hostname, parts.port or 80), PROBE_TIMEOUT_S) as connection,
            anyone.wrap_socket(connection, server_hostname=parts.hostname),
        ):
            return True
    except OSError:  # an ssl.SSLError is one
        return False


def _ssl_error_in(error: BaseException) -> ssl.SSLError | None:
    seen: set[int] = set()
    current: BaseException | None = error
    while current is not None and id(current) not in seen:
        if isinstance(current, ssl.SSLError):
            return current
        seen.add(id(current))
        current = current.__cause__ or current.__context__
    return None


def postgresql_remedy(reason: str) -> str:
    """Return how to correct a PostgreSQL URL after `reason`; "" unless the certificate was refused."""
    if "certificate verify failed" in reason:
        return " (name the authority that has signed the certificate of the server with sslrootcert)"
    return ""
