"""Reports to the broker: the Device of each device, with its latest values.

The broker gets the latest state and not each value: a device is reported when something changed beyond its
dead bands, at most once in an interval, and all devices together at a limited rate, in batches. Devices that
were reported longest ago come first. While the broker is away, nothing waits but the names of devices.
"""

import asyncio
import time
from collections import OrderedDict
from typing import Final

from handover.broker import BrokerClient, BrokerError, BrokerUnavailable
from handover.runtime.retry import Backoff
from handover.settings import Settings
from handover.telemetry import get_logger
from handover_devices import metrics
from handover_devices.registry.device import Device
from handover_devices.registry.entities import device_entity

log = get_logger(__name__)

BATCH_S: Final = 0.25
"""Time in which changes are collected for a batch."""


class BrokerReports:
    """Writes Devices to the broker; run `run` as a task."""

    def __init__(
        self, settings: Settings, broker: BrokerClient, interval_s: float, reports_per_s: float
    ) -> None:
        self._settings = settings
        self._broker = broker
        self._interval_s = interval_s
        self._batch = max(int(reports_per_s * BATCH_S), 1)
        self._changed: OrderedDict[str, Device] = OrderedDict()
        self._reported_s: dict[str, float] = {}
        self._has_changed = asyncio.Event()

    def put(self, device: Device) -> None:
        """Report `device` soon, if it has news."""
        if device.has_news and device.name not in self._changed:
            self._changed[device.name] = device
            self._has_changed.set()

    def forget(self, name: str) -> None:
        """Stop reporting a device that was deleted."""
        self._changed.pop(name, None)
        self._reported_s.pop(name, None)

    async def run(self) -> None:
        """Report until cancelled."""
        backoff = Backoff()
        while True:
            await self._has_changed.wait()
            await asyncio.sleep(BATCH_S)
            due = self._take_due(time.monotonic())
            if not due:
                continue
            try:
                await self._report(due)
            except BrokerUnavailable as error:
                log.warning("broker unavailable, devices wait", devices=len(due), error=str(error))
                for device in due:
                    device.has_news = True
                    self.put(device)
                await backoff.wait()
            except BrokerError as error:
                log.warning("devices rejected", error=str(error))
                metrics.REPORTS.labels("rejected").inc(len(due))
            else:
                backoff.reset()

    def _take_due(self, now_s: float) -> list[Device]:
        due = [
            device
            for name, device in self._changed.items()
            if now_s - self._reported_s.get(name, float("-inf")) >= self._interval_s
        ]
        due.sort(key=lambda device: self._reported_s.get(device.name, float("-inf")))
        due = due[: self._batch]
        for device in due:
            del self._changed[device.name]
            self._reported_s[device.name] = now_s
        if not self._changed:
            self._has_changed.clear()
        return due

    async def _report(self, due: list[Device]) -> None:
        entities = []
        for device in due:
            device.has_news = False  # what arrives during the request is news again
            for latest in device.latest.values():
                latest.reported = latest.value
            entities.append(device_entity(self._settings, device))
        refused = await self._broker.upsert_batch(entities)
        metrics.REPORTS.labels("accepted").inc(len(due) - len(refused))
        if refused:
            metrics.REPORTS.labels("rejected").inc(len(refused))
            log.error("devices rejected", devices=sorted(refused)[:5])
