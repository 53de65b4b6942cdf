"""The application of an edge: local devices as always, no broker, and the connection with the centre."""

import asyncio
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Final

import orjson
from fastapi import FastAPI
from typing_extensions import TypedDict

from handover.database import connect
from handover.runtime.background_tasks import BackgroundTasks
from handover.security.audit_trail import AuditTrail
from handover.security.guard import Guard, require
from handover.security.permissions import Permission
from handover.service_addresses import DEVICE_GATEWAY
from handover.serving.service import create_app
from handover.serving.storage import storage_check
from handover.telemetry import get_logger
from handover_devices import metrics
from handover_devices.adapters.base import configured
from handover_devices.connection.device_server import DeviceServer
from handover_devices.edge.commands import EdgeCommands, EdgeDispatcher
from handover_devices.edge.uplink import Uplink
from handover_devices.edge.upstream import upstream_of
from handover_devices.gateway import DeviceGateway
from handover_devices.protocol.times import TimeRule
from handover_devices.registry.device import Device
from handover_devices.routes.adapter_routes import add_adapter_routes
from handover_devices.routes.device_routes import add_reading_routes
from handover_devices.routes.history_routes import add_history_routes
from handover_devices.settings import GatewaySettings
from handover_devices.storage import schema
from handover_devices.storage.history_writer import HistoryWriter
from handover_devices.storage.outbox import Outbox, RelayRow
from handover_devices.storage.retention import rule_of
from handover_devices.upkeep import keep_retention

log = get_logger(__name__)

REPORT_S: Final = 10.0
"""The edge sends its own values this often, if they are registered."""
MIB: Final = 1024 * 1024


class EdgeView(TypedDict):
    """The state of this edge; times are seconds since 1970.

    `waiting` messages have not been acknowledged by the centre. `dropped` ones were the oldest when the
    buffer was full, `refused` ones were not accepted by the centre.
    """

    name: str
    upstream: str
    connected: bool
    since: float | None
    fault: str | None
    roundTripMs: float | None
    devices: int
    connectedDevices: int
    waiting: int
    waitingBytes: int
    maxBytes: int
    oldest: float | None
    dropped: int
    refused: int


class NoReports:
    """At an edge nothing is written to a broker: the centre does."""

    def put(self, device: Device) -> None:
        """Forget the news."""
        device.has_news = False

    def forget(self, name: str) -> None:
        """Nothing is kept."""


class EdgeState:
    """What an edge shows of itself, and sends to the centre as values of its own device."""

    def __init__(self, gateway: DeviceGateway, uplink: Uplink, outbox: Outbox) -> None:
        self._gateway, self._uplink, self._outbox = gateway, uplink, outbox

    async def view(self) -> EdgeView:
        """Return the present state."""
        uplink, outbox = self._uplink, self._outbox
        oldest_us = await asyncio.to_thread(outbox.oldest_us)
        devices = [device for name, device in self._gateway.devices.items() if name != uplink.name]
        trip_s = uplink.round_trip_s
        return {
            "name": uplink.name,
            "upstream": f"{uplink.upstream.host}:{uplink.upstream.port}",
            "connected": uplink.is_connected,
            "since": uplink.since_s,
            "fault": uplink.fault,
            "roundTripMs": None if trip_s is None else round(1000 * trip_s, 1),
            "devices": len(devices),
            "connectedDevices": sum(device.link is not None for device in devices),
            "waiting": outbox.rows,
            "waitingBytes": outbox.bytes,
            "maxBytes": outbox.max_bytes,
            "oldest": None if oldest_us is None else oldest_us / 1e6,
            "dropped": outbox.dropped,
            "refused": outbox.refused,
        }

    async def report(self) -> None:
        """Send the values of this edge until cancelled; those that its registration has."""
        while True:
            await asyncio.sleep(REPORT_S)
            view = await self.view()
            metrics.OUTBOX_ROWS.set(view["waiting"])
            metrics.OUTBOX_BYTES.set(view["waitingBytes"])
            metrics.OUTBOX_DROPPED.set(view["dropped"])
            own = self._gateway.devices.get(self._uplink.name)
            values = {
                "waiting": view["waiting"],
                "bufferFilled": view["waitingBytes"] / view["maxBytes"],
                "dropped": view["dropped"],
                "refused": view["refused"],
                "connectedDevices": view["connectedDevices"],
                "roundTripMs": view["roundTripMs"],
            }
            known_values = {
                name: value
                for name, value in values.items()
                if own is not None and name in own.values and value is not None
            }
            if known_values and not self._gateway.writer.is_full:
                now_s = time.time()
                body = orjson.dumps({"type": "telemetry", "t": now_s, "values": known_values}).decode()
                row = RelayRow(self._uplink.name, int(now_s * 1e6), body)
                await asyncio.shield(self._gateway.writer.add(relays=[row]))


def make_edge_app(settings: GatewaySettings) -> FastAPI:
    """Return the application of an edge; raise `UsageError` if it cannot work with these settings."""
    engine = connect(settings.database("devices"))
    guard = Guard(settings, DEVICE_GATEWAY)
    outbox = Outbox(engine, settings.edge_buffer_mib * MIB)
    writer = HistoryWriter(engine, outbox=outbox)
    dispatcher = EdgeDispatcher(engine, writer)
    times = TimeRule(settings.device_max_age_h * 3600, settings.device_max_ahead_s)
    gateway = DeviceGateway(engine, writer, dispatcher, NoReports(), times)
    commands = EdgeCommands(gateway, settings.edge_max_motion_delay_s)
    uplink = Uplink(
        upstream_of(settings),
        gateway,
        dispatcher,
        commands,
        outbox,
        cancel_motions_after_s=settings.edge_cancel_motions_after_s,
    )
    server = DeviceServer(settings, gateway)
    adapters = configured(settings, gateway)
    state = EdgeState(gateway, uplink, outbox)

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        schema.prepare(engine)
        outbox.load()
        await gateway.load()
        async with BackgroundTasks("edge") as tasks:
            tasks.start(writer.run)
            tasks.start_restarting(keep_retention, writer, rule_of(settings))
            tasks.start_restarting(state.report)
            tasks.start_restarting(uplink.run)
            for adapter in adapters.values():
                tasks.start_restarting(adapter.run)
            async with server:
                yield
        await writer.close()
        engine.dispose()

    app = create_app(
        "Device gateway (edge)",
        description=__doc__ or "",
        lifespan=lifespan,
        checks={"storage": storage_check(settings.data_dir)},
        guard=guard,
        audit=AuditTrail(settings, DEVICE_GATEWAY, engine),
    )

    @app.get("/edge", tags=["edge"], dependencies=[require(Permission.READ)])
    async def edge() -> EdgeView:
        """Return the state of this edge: its connection with the centre, and what waits for it."""
        return await state.view()

    add_reading_routes(app, settings, gateway, engine)
    add_adapter_routes(app, adapters)
    add_history_routes(app, gateway, engine)
    return app
