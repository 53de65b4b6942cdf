"""Where a gateway relays to, and as whom."""

import ssl
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from handover.errors import UsageError
from handover.network.tls_trust import client_context
from handover_devices.settings import GatewaySettings

DEFAULT_PORT: Final = 54010


@dataclass(frozen=True, slots=True)
class Upstream:
    """The other gateway: `hello` is what the first message has of this one, with its credential.

    `tls_name` is the name in its certificate, if that is not `host`; `tls` is None without TLS.
    """

    host: str
    port: int
    hello: Mapping[str, Any] = field(repr=False)
    tls: ssl.SSLContext | None = None
    tls_name: str | None = None


def upstream_of(settings: GatewaySettings) -> Upstream:
    """Return the centre of an edge; raise `UsageError` if the settings are not complete."""
    host, port = _address(settings)
    hello = {
        "device": settings.edge_name,
        "token": settings.edge_token.get_secret_value() if settings.edge_token else "",
    }
    return Upstream(host, port, hello, _tls_context(settings))


def _address(settings: GatewaySettings) -> tuple[str, int]:
    host, _, port = (settings.edge_upstream or "").rpartition(":")
    if not host or host.endswith(":") or not port.isdigit():
        host, port = settings.edge_upstream or "", str(DEFAULT_PORT)
    if not settings.edge_name:
        raise UsageError(
            "an edge needs its name at the centre: add it there with `handover device add NAME --template "
            "edge`, and set HANDOVER_EDGE_NAME and HANDOVER_EDGE_TOKEN here"
        )
    if settings.edge_token is None and settings.edge_certificate is None:
        raise UsageError(
            "an edge needs HANDOVER_EDGE_TOKEN, which `handover device add` has shown at the centre, or "
            "HANDOVER_EDGE_CERTIFICATE and HANDOVER_EDGE_KEY"
        )
    return host.strip("[]"), int(port)


def _tls_context(settings: GatewaySettings) -> ssl.SSLContext:
    """Return the context that verifies the centre, with the certificate of this edge; raise `UsageError`."""
    if settings.edge_certificate is None:
        return client_context(*settings.ca_files)
    context = ssl.create_default_context()
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    try:
        for file in settings.ca_files:
            context.load_verify_locations(file)
        context.load_cert_chain(settings.edge_certificate, settings.edge_key)
    except OSError as error:
        raise UsageError(
            f"the certificate of this edge cannot be used: {error}; set HANDOVER_EDGE_CERTIFICATE, "
            "HANDOVER_EDGE_KEY and HANDOVER_TLS_AUTHORITY to readable PEM files"
        ) from None
    return context
