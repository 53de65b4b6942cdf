"""Upkeep: entities of the registry in the broker, and the retention of the history."""

import asyncio
import time
from typing import Final

from sqlalchemy import Connection

from handover.broker import BrokerClient, NotFound
from handover.errors import Problem
from handover.latest_value_writer import LatestValueWriter
from handover.telemetry import get_logger
from services.device_gateway.registry.device import Device
from services.device_gateway.registry.entities import (
    device_entity,
    device_id,
    specification_entity,
    specification_id,
)
from services.device_gateway.settings import GatewaySettings
from services.device_gateway.storage.history_writer import HistoryWriter
from services.device_gateway.storage.retention import (
    RetentionRule,
    all_series,
    delete_messages,
    summarize,
)

log = get_logger(__name__)

RETENTION_INTERVAL_S: Final = 300.0


class RegistryEntities:
    """Writes the Device and ResourceSpecification of devices that were added, changed or deleted."""

    def __init__(self, settings: GatewaySettings, broker: BrokerClient, writer: LatestValueWriter) -> None:
        self._settings = settings
        self._broker = broker
        self._writer = writer

    def write(self, device: Device) -> None:
        """Write both entities in the background."""
        settings = self._settings
        url = f"{settings.service_url}/devices/{device.name}"

        async def write() -> None:
            specification = specification_entity(settings, device.name, device.stored.description, url)
            await self._broker.upsert([specification, device_entity(settings, device)])

        self._writer.put(device.name, write)

    def delete(self, name: str) -> None:
        """Delete both entities in the background."""
        entities = [device_id(self._settings, name), specification_id(self._settings, name)]

        async def delete() -> None:
            for entity in entities:
                try:
                    await self._broker.delete(entity)
                except NotFound:
                    continue

        self._writer.put(name, delete)


async def keep_retention(writer: HistoryWriter, rule: RetentionRule) -> None:
    """Apply `rule` until cancelled; each transaction is short, so that messages do not wait."""
    while True:
        await asyncio.sleep(RETENTION_INTERVAL_S)
        try:
            await apply_retention(writer, rule, int(time.time() * 1e6))
        except Problem as problem:
            log.warning("retention not applied", reason=str(problem))


async def apply_retention(writer: HistoryWriter, rule: RetentionRule, now_us: int) -> None:
    """Apply `rule` to the history once."""
    for series in await writer.call(all_series):

        def act(connection: Connection, series: int = series) -> None:
            summarize(connection, series, rule, now_us)

        await writer.call(act)
    while await writer.call(lambda connection: delete_messages(connection, rule, now_us)):
        pass
