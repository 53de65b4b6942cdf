"""Driving a registered robot over a WebSocket, as the trajectory tool has it; and its lease over REST."""

import asyncio
from collections.abc import Callable
from contextlib import suppress
from typing import Annotated, Final
from uuid import uuid4

import orjson
from fastapi import FastAPI, WebSocket
from pydantic import ValidationError
from starlette.websockets import WebSocketDisconnect

from datamodels.streams import HumanInput
from handover.control.lease import Leases
from handover.control_leasing import OF_ROBOT, REVOKED_CODE, OpenSessions, Person, acquire, add_lease_routes
from handover.errors import Problem
from handover.security.caller import Caller
from handover.security.guard import guard_of, require
from handover.security.permissions import Permission
from handover.telemetry import get_logger
from services.device_gateway.driving import DriveSession, NotDrivable, require_drivable
from services.device_gateway.gateway import DeviceGateway

log = get_logger(__name__)

STATE_EVERY_S: Final = 0.05
VALID_EVERY_S: Final = 0.1
MAX_SILENCE_S: Final = 30.0
"""Time without any input after which the control ends; the robot has stopped long before."""
MAX_MESSAGE_BYTES: Final = 4096
IDLE_CODE: Final = 4408
AWAY_CODE: Final = 4502


def add_drive_routes(app: FastAPI, gateway: DeviceGateway, sessions: OpenSessions) -> None:
    """Add the routes of driving; `sessions` gets those that are open."""
    leases = Leases()
    add_lease_routes(app, gateway.device, leases, sessions)

    @app.websocket("/robots/{robot}/control")
    async def control(
        socket: WebSocket, robot: str, caller: Annotated[Caller, require(Permission.MOVE_ROBOTS, OF_ROBOT)]
    ) -> None:
        await socket.accept()
        session_id, person = uuid4().hex, Person(caller, guard_of(socket), OF_ROBOT(socket))
        try:
            device = gateway.device(robot)
            require_drivable(device)
            await acquire(socket, leases, sessions, robot, session_id, person)
        except NotDrivable as why:
            await _close(socket, 4409, str(why))
            return
        except Problem as problem:
            await _close(socket, 4000 + problem.status, problem.detail)
            return
        except WebSocketDisconnect:
            return

        def may_continue() -> bool:
            return leases.holds(robot, session_id) and person.may_move()

        ending: tuple[int, str] | None = None
        try:
            require_drivable(device)  # it may have left while the person waited
            session = DriveSession(device)
            sessions.add(session_id, session)
            log.info("control begins", robot=robot, holder=caller.name)
            ending = await _serve(socket, session, may_continue)
            log.info("control ends", robot=robot, holder=caller.name)
        except NotDrivable as why:
            ending = 4409, str(why)
        finally:
            ended_by_others = sessions.remove(session_id)
            leases.release(robot, session_id)
        ending = ended_by_others or ending
        if ending is not None:
            await _close(socket, *ending)


async def _serve(
    socket: WebSocket, session: DriveSession, may_continue: Callable[[], bool]
) -> tuple[int, str] | None:
    """Serve a session until the client leaves, or the control ends; the robot stops then.

    Return the close code and the reason, None if the client has left.
    """
    driving = asyncio.create_task(session.run())
    work = [
        driving,
        asyncio.create_task(_receive(socket, session)),
        asyncio.create_task(_send(socket, session)),
        asyncio.create_task(_watch(session, may_continue)),
    ]
    try:
        await asyncio.wait(work, return_when=asyncio.FIRST_COMPLETED)
        is_away = driving.done()
    finally:
        session.end()
        for task in work:
            task.cancel()
        await asyncio.gather(*work, return_exceptions=True)
    if not may_continue():
        return REVOKED_CODE, "the permission to move this robot was removed, or cannot be verified"
    if session.silence_s() > MAX_SILENCE_S:
        return IDLE_CODE, f"no input arrived for {MAX_SILENCE_S:.0f} s"
    return (AWAY_CODE, "the robot is not connected any more") if is_away else None


async def _receive(socket: WebSocket, session: DriveSession) -> None:
    while True:
        try:
            text = await socket.receive_text()
        except (WebSocketDisconnect, RuntimeError, KeyError):
            return
        try:
            session.receive(_read(text))
        except (ValidationError, NotDrivable) as error:
            await _send_error(socket, _reason(error))


def _read(text: str) -> HumanInput:
    if len(text) > MAX_MESSAGE_BYTES:
        raise NotDrivable(f"a message has at most {MAX_MESSAGE_BYTES} bytes")
    given = HumanInput.model_validate_json(text)
    if given.gripper is not None:
        raise NotDrivable("the gripper of this robot acts by its commands, on the page Devices")
    return given


def _reason(error: Exception) -> str:
    if isinstance(error, ValidationError):
        first = error.errors()[0]
        return f"{'.'.join(map(str, first['loc'])) or 'message'}: {first['msg']}"
    return str(error)


async def _send_error(socket: WebSocket, reason: str) -> None:
    with suppress(RuntimeError, WebSocketDisconnect):
        await socket.send_text(orjson.dumps({"type": "error", "reason": reason}).decode())


async def _send(socket: WebSocket, session: DriveSession) -> None:
    while True:
        try:
            await socket.send_text(orjson.dumps(session.view()).decode())
        except (WebSocketDisconnect, RuntimeError):
            return
        await asyncio.sleep(STATE_EVERY_S)


async def _watch(session: DriveSession, may_continue: Callable[[], bool]) -> None:
    while may_continue() and session.silence_s() <= MAX_SILENCE_S:  # noqa: ASYNC110 - time passes
        await asyncio.sleep(VALID_EVERY_S)


async def _close(socket: WebSocket, code: int, reason: str) -> None:
    with suppress(RuntimeError, WebSocketDisconnect):
        await socket.close(code, reason[:120])
