"""TLS to the controller: which authorities are trusted, and why a handshake failed."""

import os
import ssl
from typing import Final

from glove_sdk_bridge.errors import BridgeError

AUTHORITY: Final = "HANDOVER_TLS_AUTHORITY"
"""The environment variable with a file of authorities (PEM), trusted besides those of the system."""


def client_context() -> ssl.SSLContext:
    """Return a TLS context that verifies certificate and host name; raise `BridgeError`."""
    context = ssl.create_default_context()
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    file = os.environ.get(AUTHORITY)
    if file:
        try:
            context.load_verify_locations(file)
        except OSError as error:
            raise BridgeError(
                f"the authorities {file} cannot be read ({error.strerror}); set {AUTHORITY} to a file with "
                "certificates in PEM"
            ) from None
    return context


def reason_of(error: OSError) -> str:
    """Return why a connection failed."""
    if isinstance(error, ssl.SSLCertVerificationError):
        way_out = f"is {AUTHORITY} the file of its authority, and is the certificate for this host?"
        return f"its certificate is not accepted: {error.verify_message}; {way_out}"
    if isinstance(error, ssl.SSLError) and error.reason in {"WRONG_VERSION_NUMBER", "RECORD_LAYER_FAILURE"}:
        return "it does not speak TLS; give --no-tls"
    return error.strerror or str(error) or type(error).__name__
