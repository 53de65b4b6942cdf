"""The device server: devices on TCP or TLS, one JSON object a line; `device_connection` has the bounds."""

import asyncio
from typing import Final, Self

from handover.errors import UsageError
from handover.network.outbound_policy import is_loopback
from handover.security.protection import require_protection
from handover.telemetry import get_logger
from handover.transport_security.server_certificate import ServerCertificate
from handover.transport_security.tls_listener import Listener, listen
from handover_devices.connection.device_connection import DeviceConnection, DeviceConnections
from handover_devices.gateway import DeviceGateway
from handover_devices.relaying import EdgeRelays
from handover_devices.settings import GatewaySettings

log = get_logger(__name__)

CHECK_S: Final = 1.0
"""Period of the check for idle connections."""


class DeviceServer:
    """Listens for devices; an asynchronous context manager. Without `relays` no edge may connect."""

    def __init__(
        self, settings: GatewaySettings, gateway: DeviceGateway, relays: EdgeRelays | None = None
    ) -> None:
        self.connections = DeviceConnections(settings, gateway, relays)
        self._settings = settings
        self._certificate = _certificate_of(settings)
        require_protection(settings, settings.device_host, "HANDOVER_DEVICE_HOST", has_tls=True)
        self._server: Listener | None = None
        self._checker: asyncio.TimerHandle | None = None

    @property
    def tls_name(self) -> str:
        """A name in the certificate of the port; empty without TLS."""
        return "" if self._certificate is None else self._certificate.name

    async def __aenter__(self) -> Self:
        settings = self._settings
        await self.connections.lookups.__aenter__()
        try:
            self._server = await listen(
                lambda: DeviceConnection(self.connections),
                settings.device_host,
                settings.device_port,
                self._certificate,
                handshake_timeout_s=settings.tls_handshake_timeout_s,
            )
        except OSError as error:
            raise UsageError(
                f"the device server cannot listen on {settings.device_host}:{settings.device_port} "
                f"({error.strerror or error}); set HANDOVER_DEVICE_HOST and HANDOVER_DEVICE_PORT to an "
                "address and port that are free"
            ) from None
        log.info(
            "device server listens",
            host=settings.device_host,
            port=settings.device_port,
            tls=self._certificate is not None,
        )
        self.connections.gateway.writer.on_room = self._read_on
        self._check_idle()
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._checker is not None:
            self._checker.cancel()
        if self._server is not None:
            self._server.close()
        await self.connections.lookups.__aexit__()
        for connection in tuple(self.connections.open):
            connection.end("stopping", "the gateway stops; connect again in a moment", retry=True)

    def _read_on(self) -> None:
        for connection in tuple(self.connections.open):
            connection.read_on()

    def _check_idle(self) -> None:
        loop = asyncio.get_running_loop()
        now_s = loop.time()
        for connection in tuple(self.connections.open):
            connection.check(now_s)
        self._checker = loop.call_later(CHECK_S, self._check_idle)


def _certificate_of(settings: GatewaySettings) -> ServerCertificate | None:
    """Return the certificate of the port: its own, else that of the service; raise `UsageError`."""
    if settings.device_tls_certificate is not None:
        certificate, key = settings.device_tls_certificate, settings.device_tls_key
        return ServerCertificate(certificate, key, settings.client_authority)
    if settings.tls_certificate is not None and not settings.device_plain:
        return ServerCertificate(settings.tls_certificate, settings.tls_key, settings.client_authority)
    _require_plain_allowed(settings)
    return None


def _require_plain_allowed(settings: GatewaySettings) -> None:
    host = settings.device_host
    if settings.device_plain or is_loopback(host):
        return
    raise UsageError(
        f"devices would send their tokens in clear to {host}:{settings.device_port}; set "
        "HANDOVER_DEVICE_TLS_CERTIFICATE and HANDOVER_DEVICE_TLS_KEY, or HANDOVER_DEVICE_PLAIN=true behind a "
        "proxy that ends TLS"
    )
