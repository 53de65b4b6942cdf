"""Joint states: a WebSocket stream of the joints for display and recording.

A slow client gets fewer states, always the latest; the robot never waits for a client.
"""

import asyncio
import math
from collections.abc import Callable, Sequence

import orjson
from fastapi import FastAPI
from starlette.websockets import WebSocket, WebSocketDisconnect

from handover.errors import Problem
from handover.http.websocket_closing import close_websocket
from handover.security.guard import in_path, require
from handover.security.permissions import Permission
from handover_robots.driver_base.robot import Robot
from handover_robots.metrics import DROPPED
from handover_robots.tasks.controller import Controller

of_robot = in_path("Device", "robot")

STREAM_HZ = 30.0
MAX_HZ = 125.0

Find = Callable[[str], Controller]
"""Returns the controller of a robot by name. Raises `Problem` for an unknown one."""


def add_joint_state_route(app: FastAPI, find: Find) -> None:
    """Add the stream of the joints of each robot."""

    @app.websocket("/robots/{robot}/joint_states", dependencies=[require(Permission.READ, of_robot)])
    async def joint_states(reader: WebSocket, robot: str) -> None:
        try:
            controller = find(robot)
            hz = _rate(reader.query_params.get("hz"))
        except Problem as problem:
            await reader.accept()
            await close_websocket(reader, 4000 + problem.status, problem.detail)
            return
        await stream(controller.unit.robot, controller.unit.model.joint_names, reader, hz)


async def stream(robot: Robot, names: Sequence[str], reader: WebSocket, hz: float) -> None:
    """Send the joints `hz` times a second until the client disconnects."""
    await reader.accept()
    sending = asyncio.create_task(_send(robot, names, reader, 1 / hz))
    leaving = asyncio.create_task(_until_gone(reader))
    try:
        await asyncio.wait({sending, leaving}, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in (sending, leaving):
            task.cancel()
        ends = await asyncio.gather(sending, leaving, return_exceptions=True)
    for end in ends:
        if isinstance(end, Exception) and not isinstance(end, WebSocketDisconnect):
            raise end


async def _send(robot: Robot, names: Sequence[str], reader: WebSocket, period_s: float) -> None:
    clock = asyncio.get_running_loop().time
    due_s = clock()
    while True:
        await reader.send_text(orjson.dumps(robot.state().written(names)).decode())
        due_s += period_s
        missed = int((clock() - due_s) / period_s)
        if missed > 0:
            DROPPED.inc(missed)
            due_s += missed * period_s
        await asyncio.sleep(max(due_s - clock(), 0.0))


async def _until_gone(reader: WebSocket) -> None:
    while (await reader.receive())["type"] != "websocket.disconnect":
        pass  # messages of the client are ignored


def _rate(rate: str | None) -> float:
    if rate is None:
        return STREAM_HZ
    try:
        hz = float(rate)
    except ValueError:
        hz = math.nan
    if not 0 < hz <= MAX_HZ:
        raise Problem.translated(
            400,
            "No such rate",
            "robot.no_such_rate",
            "hz must be a number above 0 and at most {limit}",
            limit=f"{MAX_HZ:.0f}",
        )
    return hz
