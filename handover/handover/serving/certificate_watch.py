"""The certificate watch: raises Alerts for a certificate that expires soon or that cannot be loaded."""

import asyncio
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from typing import Final

from handover.alerts import clear_alert, raise_alert
from handover.alerts.catalogue import CERTIFICATE_EXPIRES, CERTIFICATE_NOT_LOADED, AlertType
from handover.broker import BrokerClient, BrokerError
from handover.security.service_access import ServiceAccess
from handover.settings import Settings
from handover.telemetry import get_logger
from handover.transport_security.server_certificate import (
    EXPIRES_SOON,
    CertificateInvalid,
    ServerCertificate,
)

log = get_logger(__name__)

LOOK_EVERY_S: Final = 2.0
MIN_FAULTY_LOOKS: Final = 2
"""After so many looks a file counts as broken; at the first one it may be half written."""
LOG_EXPIRY_EVERY: Final = timedelta(hours=12)


class CertificateWatch:
    """Watches the `certificate` of `service`; `look` does it once."""

    def __init__(
        self,
        certificate: ServerCertificate,
        settings: Settings,
        service: str,
        broker: BrokerClient | None = None,
    ) -> None:
        self._certificate = certificate
        self._settings = settings
        self._service = service
        self._access = ServiceAccess(settings, service)
        self._broker = broker or BrokerClient(settings, credentials=self._access)
        self._reported: dict[AlertType, str | None] = {}
        self._fault: str | None = None
        self._faulty_looks = 0
        self._expiry_logged = datetime.min.replace(tzinfo=UTC)

    async def run(self) -> None:
        """Look every few seconds until cancelled."""
        async with self._access, self._broker:
            while True:
                await self.look()
                await asyncio.sleep(LOOK_EVERY_S)

    async def look(self) -> None:
        """Load a changed certificate, and raise or clear the Alerts."""
        self._reload()
        await self._report(self._conditions(datetime.now(UTC)))

    def _reload(self) -> None:
        try:
            self._certificate.reload()
        except CertificateInvalid as fault:
            self._faulty_looks += 1
            if self._faulty_looks == MIN_FAULTY_LOOKS:
                log.warning("new certificate not loaded; the former one stays in use", reason=str(fault))
                self._fault = str(fault)
        else:
            self._fault, self._faulty_looks = None, 0

    @property
    def _expires(self) -> str:
        return f"{self._certificate.expires:%Y-%m-%d %H:%M} UTC"

    def _conditions(self, now: datetime) -> Mapping[AlertType, str | None]:
        """Return the description of each Alert that is active now; None for the others."""
        left = self._certificate.expires - now
        expiry = None
        if left <= EXPIRES_SOON:
            verb = "expires" if left > timedelta(0) else "expired"
            remedy = "renew it with `handover secure renew`, or replace the file"
            if self._access.is_component():
                remedy = f"make its file again: handover component add {self._service} …"
            expiry = (
                f"the certificate {self._certificate.path} of {self._service} {verb} on {self._expires}; "
                f"{remedy}"
            )
            if now - self._expiry_logged > LOG_EXPIRY_EVERY:
                self._expiry_logged = now
                log.warning("certificate expires", reason=expiry)
        return {CERTIFICATE_EXPIRES: expiry, CERTIFICATE_NOT_LOADED: self._fault}

    async def _report(self, conditions: Mapping[AlertType, str | None]) -> None:
        if self._access.is_component():  # its rights include no Alerts; the log has both
            return
        for alert, description in conditions.items():
            if alert in self._reported and self._reported[alert] == description:
                continue
            key = f"{alert.sub_category} {self._service}"
            try:
                if description is None:
                    await clear_alert(self._broker, self._settings, key=key)
                else:
                    source = self._settings.entity_id("Device", self._service)
                    await raise_alert(
                        self._broker,
                        self._settings,
                        alert,
                        key=key,
                        source=source,
                        description=description,
                    )
            except BrokerError as error:  # the next look tries again
                log.debug("alert not written", alert=alert.sub_category, error=str(error))
            else:
                self._reported[alert] = description
