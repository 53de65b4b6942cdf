"""Alerts about client certificates of devices that expire soon.

A device gets no certificate by itself, so a person needs time to make one and to copy it. The Alert is raised
a week before the end, and cleared by a new certificate, by its revocation and by deletion of the device.
Which Alerts are active is read from the broker once, because the gateway may have been down meanwhile.
"""

import asyncio
import time
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import Final

from handover.alerts import clear_alert, raise_alert
from handover.alerts.catalogue import DEVICE_CERTIFICATE_EXPIRES
from handover.broker import BrokerClient, BrokerError
from handover.messages import Message
from handover.runtime.retry import Backoff
from handover.settings import Settings
from handover.telemetry import get_logger
from handover.transport_security.server_certificate import EXPIRES_SOON
from handover_devices.registry.device import Device
from handover_devices.registry.entities import device_id

log = get_logger(__name__)

LOOK_EVERY_S: Final = 60.0
COLLECT_S: Final = 0.5
"""Time in which changes of devices are collected for one look at all of them."""


class CertificateAlerts:
    """Raises and clears the Alerts of `devices`; run `run` as a task. `clock` is the time since 1970."""

    def __init__(
        self,
        settings: Settings,
        broker: BrokerClient,
        devices: Mapping[str, Device],
        clock: Callable[[], float] = time.time,
    ) -> None:
        self._settings = settings
        self._broker = broker
        self._devices = devices
        self._clock = clock
        self._active: set[str] | None = None
        """The devices with an active Alert; None until the broker was asked."""
        self._changed = asyncio.Event()

    def request(self) -> None:
        """Look soon, because a device was changed or deleted."""
        self._changed.set()

    async def run(self) -> None:
        """Look every minute and after changes, until cancelled."""
        backoff = Backoff()
        self._active = None
        while True:
            self._changed.clear()
            try:
                await self.look()
            except BrokerError as error:
                log.debug("alerts about certificates wait", error=str(error))
                await backoff.wait()
                continue
            backoff.reset()
            try:
                async with asyncio.timeout(LOOK_EVERY_S):
                    await self._changed.wait()
            except TimeoutError:
                continue
            await asyncio.sleep(COLLECT_S)

    async def look(self) -> None:
        """Raise and clear what is due now; raise `BrokerError`."""
        if self._active is None:
            self._active = await self._find_active()
        due = self._due()
        for name in self._active - due.keys():
            await clear_alert(self._broker, self._settings, key=_key(name))
            self._active.discard(name)
        for name in due.keys() - self._active:
            await raise_alert(
                self._broker,
                self._settings,
                DEVICE_CERTIFICATE_EXPIRES,
                key=_key(name),
                source=device_id(self._settings, name),
                description=due[name],
            )
            self._active.add(name)

    def _due(self) -> dict[str, Message]:
        limit_us = (self._clock() + EXPIRES_SOON.total_seconds()) * 1e6
        return {
            name: _description(name, device.stored.certificate_end_us)
            for name, device in self._devices.items()
            if device.stored.certificate_end_us is not None and device.stored.certificate_end_us <= limit_us
        }

    async def _find_active(self) -> set[str]:
        sub_category = DEVICE_CERTIFICATE_EXPIRES.sub_category
        alerts = await self._broker.query(type="Alert", q=f'subCategory=="{sub_category}"')
        prefix = device_id(self._settings, "")
        sources = {str(alert["alertSource"]["object"]) for alert in alerts if "validTo" not in alert}
        return {source.removeprefix(prefix) for source in sources if source.startswith(prefix)}


def _key(name: str) -> str:
    return f"{name} {DEVICE_CERTIFICATE_EXPIRES.sub_category}"


def _description(name: str, end_us: int) -> Message:
    return DEVICE_CERTIFICATE_EXPIRES.describe(
        "device.certificate_expires",
        device=name,
        end=f"{datetime.fromtimestamp(end_us / 1e6, UTC):%Y-%m-%d %H:%M}",
    )
