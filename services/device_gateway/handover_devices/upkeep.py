"""Upkeep: entities of the registry in the broker, and the retention of the history."""

import asyncio
import time
from collections.abc import Collection, Mapping
from functools import partial
from typing import Any, Final

import orjson
from sqlalchemy import Connection

from handover.broker import BrokerClient, BrokerError, BrokerUnavailable
from handover.broker.latest_value_writer import LatestValueWriter
from handover.errors import Problem
from handover.telemetry import get_logger
from handover_devices.registry.device import Device
from handover_devices.registry.entities import (
    device_entity,
    device_id,
    specification_entity,
    specification_id,
)
from handover_devices.settings import GatewaySettings
from handover_devices.storage import partitions
from handover_devices.storage.history_writer import HistoryWriter
from handover_devices.storage.retention import (
    RetentionRule,
    all_series,
    delete_messages,
    old_partitions,
    summarize,
)

log = get_logger(__name__)

RETENTION_INTERVAL_S: Final = 300.0
MAX_BATCH_DEVICES: Final = 50
"""Devices in a batch of entities: making and sending it keeps the event loop busy for some 10 ms."""
MAX_BATCH_BYTES: Final = 1024 * 1024
"""Size of a request, well below what brokers accept; a single larger entity is sent alone."""
_WRITER_KEY: Final = "devices"


class RegistryEntities:
    """Writes the Device and ResourceSpecification of devices that were added, changed or deleted.

    What waits is written in batches: many devices are registered at once, and all are written at the start.
    A request for each would take most of the CPU for seconds, while devices wait for acknowledgements. While
    one batch is being written, the next one collects; of each device only the latest change is written.
    """

    def __init__(self, settings: GatewaySettings, broker: BrokerClient, writer: LatestValueWriter) -> None:
        self._settings = settings
        self._broker = broker
        self._writer = writer
        self._waiting: dict[str, Device | None] = {}
        """The devices to write; None for a deleted one."""

    def write(self, device: Device) -> None:
        """Write both entities in the background."""
        self._put(device.name, device)

    def delete(self, name: str) -> None:
        """Delete both entities in the background."""
        self._put(name, None)

    def _put(self, name: str, device: Device | None) -> None:
        self._waiting[name] = device
        self._writer.put(_WRITER_KEY, self._write_batch)

    async def _write_batch(self) -> None:
        """Write what waits first; the names return to the queue if the broker is unavailable."""
        batch = {name: self._waiting.pop(name) for name in list(self._waiting)[:MAX_BATCH_DEVICES]}
        try:
            await self._write_all(batch)
        except BrokerUnavailable:
            self._waiting = batch | self._waiting  # a newer change of a device replaces the older one
            raise
        finally:
            if self._waiting:
                self._writer.put(_WRITER_KEY, self._write_batch)

    async def _write_all(self, batch: Mapping[str, Device | None]) -> None:
        deleted = [name for name, device in batch.items() if device is None]
        if deleted:
            try:
                await self._broker.delete_batch([entity for name in deleted for entity in self._ids(name)])
            except BrokerUnavailable:
                raise
            except BrokerError as error:
                log.warning("entities of devices not deleted", devices=deleted[:5], error=str(error))
        chunk: list[dict[str, Any]] = []
        size = 0
        for device in batch.values():
            if device is None:
                continue
            entities = self._entities(device)
            length = len(orjson.dumps(entities))
            if chunk and size + length > MAX_BATCH_BYTES:
                await self._upsert(chunk)
                chunk, size = [], 0
            chunk += entities
            size += length
        if chunk:
            await self._upsert(chunk)

    async def _upsert(self, entities: list[dict[str, Any]]) -> None:
        try:
            refused: Collection[str] = await self._broker.upsert_batch(entities)
        except BrokerUnavailable:
            raise
        except BrokerError as error:
            if len(entities) > 1:  # one entity must not keep those of other devices out of the broker
                for entity in entities:
                    await self._upsert([entity])
                return
            log.warning("entity of a device rejected", entity=entities[0]["id"], error=str(error))
            return
        if refused:
            log.warning("entities of devices rejected", entities=sorted(refused)[:5], count=len(refused))

    def _entities(self, device: Device) -> list[dict[str, Any]]:
        url = f"{self._settings.device_gateway}/devices/{device.name}"
        specification = specification_entity(self._settings, device.name, device.stored.description, url)
        return [specification, device_entity(self._settings, device)]

    def _ids(self, name: str) -> list[str]:
        return [device_id(self._settings, name), specification_id(self._settings, name)]


async def keep_retention(writer: HistoryWriter, rule: RetentionRule) -> None:
    """Apply `rule` until cancelled; each transaction is short, so that messages do not wait."""
    while True:
        await asyncio.sleep(RETENTION_INTERVAL_S)
        try:
            await apply_retention(writer, rule, int(time.time() * 1e6))
        except Problem as problem:
            log.warning("retention not applied", reason=str(problem))


async def apply_retention(writer: HistoryWriter, rule: RetentionRule, now_us: int) -> None:
    """Apply `rule` to the history once, and create the partitions of the next days."""
    await writer.call(lambda connection: partitions.create_ahead(connection, now_us))
    for partition in await writer.call(lambda connection: old_partitions(connection, rule, now_us)):
        await writer.call_beside(partial(partitions.drop_summarized, partition=partition))
    for series in await writer.call(all_series):

        def act(connection: Connection, series: int = series) -> None:
            summarize(connection, series, rule, now_us)

        await writer.call(act)
    while await writer.call(lambda connection: delete_messages(connection, rule, now_us)):
        pass
