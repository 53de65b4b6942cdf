"""Whether the name of a new device is free in the broker, asked for many devices in one request.

While one request is under way, the names of further devices collect and are asked for together: many devices
that are registered at once take few requests, and a single one waits for nothing.
"""

import asyncio
from typing import Final

from handover.broker import BrokerClient
from handover.errors import Problem
from handover_devices.registry.entities import SOURCE

MAX_NAMES: Final = 50
"""Names in one request, whose address must not become too long."""


class FreeNames:
    """Asks the broker which Devices have a performer."""

    def __init__(self, broker: BrokerClient) -> None:
        self._broker = broker
        self._waiting: dict[str, asyncio.Future[str | None]] = {}
        self._asking: asyncio.Task[None] | None = None

    async def require_free(self, entity: str) -> None:
        """Raise `Problem` 409 if another component performs the Tasks of the Device, `BrokerError`."""
        performer = await asyncio.shield(self._performer_of(entity))
        if performer not in {None, SOURCE}:
            raise Problem.translated(
                409,
                "Name taken",
                "device.entity_taken",
                "{entity} belongs to {performer}, which performs its Tasks; choose another name for this "
                "device",
                entity=entity,
                performer=str(performer)[:100],
            )

    def _performer_of(self, entity: str) -> "asyncio.Future[str | None]":
        loop = asyncio.get_running_loop()
        waiting = self._waiting.get(entity)
        if waiting is None:
            waiting = self._waiting[entity] = loop.create_future()
        if self._asking is None or self._asking.done():
            self._asking = loop.create_task(self._ask())
        return waiting

    async def _ask(self) -> None:
        while self._waiting:
            names = list(self._waiting)[:MAX_NAMES]
            batch = {name: self._waiting.pop(name) for name in names}
            try:
                entities = await self._broker.query(type="Device", id=names)
            except Exception as error:  # noqa: BLE001 - each request answers with it
                for future in batch.values():
                    future.set_exception(error)
                continue
            performers = {entity["id"]: entity.get("performer", {}).get("value") for entity in entities}
            for name, future in batch.items():
                future.set_result(performers.get(name))
