"""WebSockets: the limits of all persons for controllers, and the live signals of one person for a page."""

import asyncio
import time
from collections import deque
from contextlib import suppress
from typing import Any, Final

import orjson
from fastapi import FastAPI
from pydantic import ValidationError
from starlette.websockets import WebSocket, WebSocketDisconnect

from handover.formats.validation import fault_text
from handover.security.guard import require
from handover.security.permissions import Permission
from handover_body.drivers.base import NotSimulated
from handover_body.fusion.person_state import FusedValue
from handover_body.model.signals import Samples
from handover_body.monitoring.monitoring import Monitoring
from handover_body.routes.access import of_person
from handover_body.routes.views import state_view

LIVE_EVERY_S: Final = 0.05
STATE_EVERY_S: Final = 0.5
MAX_VALUES: Final = 20_000
"""Samples in one message; a packet with more is thinned out evenly."""


def add_streams(app: FastAPI, monitoring: Monitoring) -> None:
    """Add the WebSockets."""

    @app.websocket("/limits", dependencies=[require(Permission.READ_HEALTH_DATA)])
    async def limits(socket: WebSocket) -> None:
        """Send the limits 20 times a second, a fall at once; a slow reader misses some, see `sequence`.

        With `?robot=` only those of one robot, whose controller follows them by itself.
        """
        await socket.accept()
        robot = socket.query_params.get("robot")
        followed = () if robot is None else (robot,)
        monitoring.followers.update(followed)
        try:
            await _until_left(socket, _send_limits(socket, monitoring, robot))
        finally:
            monitoring.followers.subtract(followed)

    @app.websocket("/people/{person}/values", dependencies=[require(Permission.READ_HEALTH_DATA, of_person)])
    async def values(socket: WebSocket, person: str) -> None:
        """Send the values of a person for a controller, 20 times a second; none without consent."""
        await socket.accept()
        await _until_left(socket, _send_values(socket, monitoring, person))

    @app.websocket("/sensors/{sensor}/simulation", dependencies=[require(Permission.CONFIGURE)])
    async def simulation(socket: WebSocket, sensor: str) -> None:
        """Receive what the person of a simulated sensor does: effort, posture, lean, breathing, movement.

        Each message is a JSON object of the acts that change; it is answered by `{"accepted": …}`.
        """
        await socket.accept()
        with suppress(WebSocketDisconnect, RuntimeError, KeyError):
            while True:
                await socket.send_text(_simulated(monitoring, sensor, await socket.receive_text()))

    @app.websocket("/people/{person}/live", dependencies=[require(Permission.READ_HEALTH_DATA, of_person)])
    async def live(socket: WebSocket, person: str) -> None:
        """Send the state twice a second, and waveforms as they come."""
        await socket.accept()
        await _until_left(socket, _send_live(socket, monitoring, person))


async def _until_left(socket: WebSocket, sending: Any) -> None:
    """Send until the reader leaves. What it sends is ignored."""
    task = asyncio.ensure_future(sending)
    reading = asyncio.ensure_future(_read(socket))
    try:
        await asyncio.wait({task, reading}, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for job in (task, reading):
            job.cancel()
        await asyncio.gather(task, reading, return_exceptions=True)


async def _read(socket: WebSocket) -> None:
    try:
        while True:
            await socket.receive_text()
    except (WebSocketDisconnect, RuntimeError, KeyError):
        return


async def _send_limits(socket: WebSocket, monitoring: Monitoring, robot: str | None) -> None:
    sent = monitoring.sequence
    while True:
        limits = await monitoring.next_limits(sent, robot)
        sent = monitoring.sequence
        await socket.send_text(limits.decode())


async def _send_values(socket: WebSocket, monitoring: Monitoring, person: str) -> None:
    sent = monitoring.sequence
    while True:
        await monitoring.next_limits(sent)
        sent = monitoring.sequence
        monitor, now_s = monitoring.monitors.get(person), time.monotonic()
        shown = [] if monitor is None else [_value(feature, now_s) for feature in monitor.values(now_s)]
        await socket.send_text(orjson.dumps({"sequence": monitoring.sequence, "values": shown}).decode())


def _value(value: FusedValue, now_s: float) -> dict[str, Any]:
    return {
        "name": value.name,
        "value": value.value,
        "quality": round(value.quality, 3),
        "status": value.status,
        "ageS": round(max(now_s - value.at_s, 0.0), 3),
        "disagree": value.disagree,
        "isCalibrated": value.is_calibrated,
        "sensors": [
            {
                "sensor": sensor.source,
                "value": sensor.value,
                "quality": round(sensor.quality, 3),
                "status": sensor.status,
                "ageS": round(max(now_s - sensor.at_s, 0.0), 3),
            }
            for sensor in value.sensors
        ],
    }


def _simulated(monitoring: Monitoring, sensor: str, text: str) -> str:
    """Let the person of a simulated sensor act; return the answer."""
    driver = monitoring.driver_of(sensor)
    reason = f'no body sensor "{sensor}" runs; add it to a person who consents'
    if driver is not None:
        try:
            driver.simulate(orjson.loads(text))
        except ValidationError as error:
            reason = fault_text(error)
        except (NotSimulated, ValueError) as error:
            reason = str(error)
        else:
            return '{"accepted":true}'
    return orjson.dumps({"accepted": False, "reason": reason[:300]}).decode()


async def _send_live(socket: WebSocket, monitoring: Monitoring, person: str) -> None:
    waiting: deque[Samples] | None = None
    listened: Any = None
    state_s = 0.0
    try:
        while True:
            monitor = monitoring.monitors.get(person)
            if monitor is not listened:
                if listened is not None and waiting is not None:
                    listened.end_listening(waiting)
                listened, waiting = monitor, None if monitor is None else monitor.listen()
            if waiting:
                signals = [_signal(waiting.popleft()) for _ in range(len(waiting))]
                await socket.send_text(orjson.dumps({"signals": signals}).decode())
            if time.monotonic() - state_s >= STATE_EVERY_S:
                state_s = time.monotonic()
                state = None if monitor is None else state_view(monitor, monitoring)
                document = None if state is None else state.model_dump(mode="json", by_alias=True)
                await socket.send_text(orjson.dumps({"state": document}).decode())
            await asyncio.sleep(LIVE_EVERY_S)
    finally:
        if listened is not None and waiting is not None:
            listened.end_listening(waiting)


def _signal(samples: Samples) -> dict[str, Any]:
    """Return a packet: values by channel, NaN as null; `startS` in s since 1970."""
    step = -(-len(samples.values) * len(samples.info.channels) // MAX_VALUES) or 1
    rate_hz = samples.info.rate_hz
    return {
        "sensor": samples.source,
        "kind": samples.info.kind,
        "unit": samples.info.unit,
        "rateHz": None if rate_hz is None else rate_hz / step,
        "startS": samples.start_s,
        "endS": samples.end_s,
        "channels": samples.info.channels,
        "values": [column.tolist() for column in samples.values[::step].T],
    }
