"""Joint states: a WebSocket stream of the joints for display and recording.

A slow client gets fewer states, always the latest; the robot never waits for a client.
"""

import asyncio
from collections.abc import Sequence
from typing import Any

import orjson
from starlette.websockets import WebSocket, WebSocketDisconnect

from handover_robots.metrics import DROPPED
from handover_robots.robot import JointState, Robot


def written(state: JointState, names: Sequence[str]) -> dict[str, Any]:
    """Return a joint state as JSON: `stamp` in s since 1970, rad, rad/s and Nm (m, m/s and N)."""
    message: dict[str, Any] = {
        "stamp": round(state.stamp_s, 6),
        "name": names,
        "position": [round(value, 6) for value in state.positions],
        "velocity": [round(value, 6) for value in state.velocities],
    }
    if state.efforts is not None:
        message["effort"] = state.efforts
    return message


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
        await reader.send_text(orjson.dumps(written(robot.state(), names)).decode())
        due_s += period_s
        missed = int((clock() - due_s) / period_s)
        if missed > 0:
            DROPPED.inc(missed)
            due_s += missed * period_s
        await asyncio.sleep(max(due_s - clock(), 0.0))


async def _until_gone(reader: WebSocket) -> None:
    while (await reader.receive())["type"] != "websocket.disconnect":
        pass  # messages of the client are ignored
