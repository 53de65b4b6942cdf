"""A device gateway within the test: all but its transports and its routes."""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from typing import Any

from sqlalchemy import Engine

from handover.broker import BrokerClient
from handover_devices.broker_reports import BrokerReports
from handover_devices.commands.dispatcher import Dispatcher
from handover_devices.gateway import DeviceGateway
from handover_devices.model.description import DeviceDescription
from handover_devices.protocol.times import TimeRule
from handover_devices.settings import GatewaySettings
from handover_devices.storage import schema
from handover_devices.storage.history_writer import HistoryWriter

SENSOR = DeviceDescription.model_validate(
    {
        "kind": "sensor",
        "sensors": [{"name": "temperature", "unit": "CEL", "minimum": -20, "maximum": 60}],
        "commands": [
            {"name": "setInterval", "kind": "setting"},
            {"name": "beep", "kind": "action"},
            {"name": "turn", "kind": "motion"},
        ],
    }
)


@asynccontextmanager
async def running_gateway(
    engine: Engine, settings: GatewaySettings, *, is_writing: bool = True, **options: Any
) -> AsyncIterator[DeviceGateway]:
    """Return a gateway; with `is_writing` False its database is never written, as if the disk hung."""
    schema.prepare(engine)
    writer = HistoryWriter(engine)
    dispatcher = Dispatcher(engine, writer)
    reports = BrokerReports(settings, BrokerClient(settings), 1.0, 100.0)
    times = TimeRule(settings.device_max_age_h * 3600, settings.device_max_ahead_s)
    gateway = DeviceGateway(engine, writer, dispatcher, reports, times, **options)
    await gateway.load()
    async with background(*([writer.run] if is_writing else []), dispatcher.run):
        yield gateway


@asynccontextmanager
async def background(*functions: Callable[[], Any]) -> AsyncIterator[None]:
    """Run coroutine functions meanwhile."""
    tasks = [asyncio.ensure_future(function()) for function in functions]
    try:
        yield
    finally:
        for task in tasks:
            task.cancel()
        for task in tasks:
            with suppress(asyncio.CancelledError):
                await task
