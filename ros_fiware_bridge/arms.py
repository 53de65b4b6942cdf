"""The WebSocket `/arm`: a trajectory tool commands an arm of the graph. One client an arm."""

import asyncio
from collections.abc import Callable
from contextlib import suppress

from fastapi import FastAPI
from pydantic import BaseModel, ValidationError
from starlette.websockets import WebSocket, WebSocketDisconnect

from datamodels.arm_stream import ARM_COMMANDS, ArmJoints, ArmRefusal, ArmSetup
from handover.security.guard import require
from handover.security.permissions import Permission
from handover.telemetry import get_logger
from ros_fiware_bridge.errors import GraphError
from ros_fiware_bridge.graph.port import RosGraph
from ros_fiware_bridge.running.arm_stream import ArmStream

log = get_logger(__name__)

SETUP_TIMEOUT_S = 10.0
MAX_MESSAGE_BYTES = 2**20
MAX_WAITING = 256
"""Reports that may wait for a slow client; then joints are left out."""


def add_routes(app: FastAPI, graph: Callable[[], RosGraph]) -> None:
    """Add the WebSocket. `graph` raises `Problem` while the bridge starts."""
    in_use: set[str] = set()

    @app.websocket("/arm", dependencies=[require(Permission.MOVE_ROBOTS)])
    async def arm(client: WebSocket) -> None:
        await client.accept()
        try:
            async with asyncio.timeout(SETUP_TIMEOUT_S):
                setup = ArmSetup.model_validate_json(await _text(client))
        except (TimeoutError, ValueError) as error:
            await _refuse(client, f"the first message is the setup of the arm: {_words(error)}")
            return
        except WebSocketDisconnect:
            return
        if setup.trajectory_action in in_use:
            await _refuse(client, f"another client commands {setup.trajectory_action}; end that one first")
            return
        in_use.add(setup.trajectory_action)
        try:
            await _serve(client, graph(), setup)
        except GraphError as error:
            await _refuse(client, str(error))
        finally:
            in_use.discard(setup.trajectory_action)


async def _serve(client: WebSocket, graph: RosGraph, setup: ArmSetup) -> None:
    reports: asyncio.Queue[BaseModel] = asyncio.Queue()

    def send(report: BaseModel) -> None:
        if not isinstance(report, ArmJoints) or reports.qsize() < MAX_WAITING:
            reports.put_nowait(report)

    async def write() -> None:
        while True:
            await client.send_text((await reports.get()).model_dump_json(by_alias=True))

    async with ArmStream(graph, setup, send) as stream:
        log.info("arm commanded", action=setup.trajectory_action)
        writing = asyncio.create_task(write())
        try:
            while True:
                stream.take(ARM_COMMANDS.validate_json(await _text(client)))
        except ValueError as error:
            await _refuse(client, _words(error))
        except WebSocketDisconnect:
            log.info("arm released", action=setup.trajectory_action)
        finally:
            writing.cancel()
            with suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
                await writing


async def _text(client: WebSocket) -> str:
    """Return the next message. Raises `ValueError` for one that is no text or too long."""
    message = await client.receive()
    if message["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(message.get("code", 1000))
    text = message.get("text")
    if not isinstance(text, str) or len(text) > MAX_MESSAGE_BYTES:
        raise ValueError(f"a message is JSON text of {MAX_MESSAGE_BYTES} bytes at most")
    return text


async def _refuse(client: WebSocket, reason: str) -> None:
    log.warning("arm stream refused", reason=reason)
    with suppress(WebSocketDisconnect, RuntimeError):
        await client.send_text(ArmRefusal(reason=reason).model_dump_json())
        await client.close(4400, reason[:100])


def _words(error: Exception) -> str:
    if isinstance(error, ValidationError):
        fault = error.errors()[0]
        return f"{'.'.join(map(str, fault['loc']))}: {fault['msg']}"
    return str(error) or "no message in time"
