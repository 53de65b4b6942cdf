"""A motion that is stored at last, after the database was away, is sent only if it is still wanted."""

import asyncio
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from handover.database import connect
from handover_devices.commands.command import CommandState
from handover_devices.commands.dispatcher import Dispatcher
from handover_devices.storage import schema
from handover_devices.storage.history_writer import HistoryWriter
from tests.kit.device_gateways import SENSOR, background


class Link:
    """The connection of the device, which notes what is sent."""

    boot = "run-1"

    def __init__(self) -> None:
        self.sent: list[str] = []

    def send(self, message: Mapping[str, Any]) -> None:
        self.sent.append(str(message["name"]))


@asynccontextmanager
async def a_motion(tmp_path: Path, clock: list[float]) -> AsyncIterator[tuple[Any, ...]]:
    """Yield the dispatcher, the link and the order of a motion while nothing can be stored."""
    engine = connect(f"sqlite:///{tmp_path / 'gateway.db'}")
    schema.prepare(engine)
    writer = HistoryWriter(engine)
    dispatcher = Dispatcher(engine, writer, 2.0, clock=lambda: clock[0])
    link = Link()
    dispatcher.connect("lamp", link)
    order = asyncio.create_task(
        dispatcher.order("lamp", SENSOR, "turn", {}, timeout_s=10.0, identifier="turn-1")
    )
    await asyncio.sleep(0)
    while not dispatcher._open["lamp"]:  # it looks first whether the id is known
        await asyncio.sleep(0.001)
    try:
        yield dispatcher, link, order, writer
    finally:
        engine.dispose()


async def test_a_motion_that_was_cancelled_before_it_was_stored_is_not_sent(tmp_path: Path) -> None:
    async with a_motion(tmp_path, [1000.0]) as (dispatcher, link, order, writer):
        await dispatcher.cancel("lamp", "turn-1")
        async with background(writer.run):
            command = await order
        assert "turn" not in link.sent
        assert command.state is CommandState.CANCELLED


async def test_a_motion_that_was_stored_after_its_deadline_is_not_sent(tmp_path: Path) -> None:
    clock = [1000.0]
    async with a_motion(tmp_path, clock) as (_, link, order, writer):
        clock[0] += 11.0
        async with background(writer.run):
            command = await order
        assert link.sent == []
        assert command.state is CommandState.FAILED
        assert "after its deadline" in command.reason


async def test_a_motion_that_was_stored_in_time_is_sent_once(tmp_path: Path) -> None:
    async with a_motion(tmp_path, [1000.0]) as (_, link, order, writer), background(writer.run):
        await order
        assert link.sent == ["turn"]
