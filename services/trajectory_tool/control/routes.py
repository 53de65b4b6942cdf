"""Control over a WebSocket: inputs of a person in, the state of the robot out; and the leases over REST."""

import asyncio
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Final
from uuid import uuid4

import orjson
from fastapi import FastAPI, WebSocket
from pydantic import ValidationError
from starlette.websockets import WebSocketDisconnect

from datamodels.entities import DeviceState
from datamodels.streams import HumanInput
from handover.background_tasks import BackgroundTasks
from handover.control.lease import Leases
from handover.control_leasing import OF_ROBOT, REVOKED_CODE, OpenSessions, Person, acquire, add_lease_routes
from handover.errors import Problem
from handover.messages import message
from handover.security.caller import Caller
from handover.security.guard import guard_of, require
from handover.security.permissions import Permission
from handover.telemetry import get_logger
from services.trajectory_tool.cell import Cell
from services.trajectory_tool.control.recording import Recording
from services.trajectory_tool.control.recording_routes import add_recording_routes
from services.trajectory_tool.control.session import ControlSession, RobotBusy
from services.trajectory_tool.metrics import CONTROL_INPUTS
from services.trajectory_tool.robot import RobotFault

log = get_logger(__name__)

STATE_EVERY_S: Final = 0.05
VALID_EVERY_S: Final = 0.1
MAX_SILENCE_S: Final = 30.0
"""Time without any input after which the control ends; the robot has stopped long before."""
ACQUIRE_TIMEOUT_S: Final = 0.5
HAND_OVER_TIMEOUT_S: Final = 10.0
"""How long a new session waits until the robot of the earlier one rests."""
IDLE_CODE: Final = 4408
MAX_MESSAGE_BYTES: Final = 4096
MAX_GAMMA: Final = 2.0

Find = Callable[[str], tuple[Cell, tuple[Cell, ...], Callable[[DeviceState], None]]]
"""Returns the cell of a robot, those of the others, and how its Device's state is written. Raises `Problem`.
"""


def add_routes(app: FastAPI, find: Find, leases: Leases, data_dir: Path) -> None:
    """Add the routes of control."""
    sessions = OpenSessions()
    add_lease_routes(app, find, leases, sessions)
    _add_socket(app, find, leases, sessions, data_dir)
    add_recording_routes(app, data_dir)


def _add_socket(app: FastAPI, find: Find, leases: Leases, sessions: OpenSessions, data_dir: Path) -> None:
    @app.websocket("/robots/{robot}/control")
    async def control(
        socket: WebSocket, robot: str, caller: Annotated[Caller, require(Permission.MOVE_ROBOTS, OF_ROBOT)]
    ) -> None:
        await socket.accept()
        session_id, person = uuid4().hex, Person(caller, guard_of(socket), OF_ROBOT(socket))
        try:
            cell, others, set_state = find(robot)
            gamma = _gamma(socket.query_params.get("gamma"))
            is_first = await acquire(socket, leases, sessions, cell.name, session_id, person)
        except Problem as problem:
            await _close(socket, 4000 + problem.status, problem.detail)
            return
        except WebSocketDisconnect:
            return
        patience_s = ACQUIRE_TIMEOUT_S if is_first else HAND_OVER_TIMEOUT_S

        def may_continue() -> bool:
            return leases.holds(cell.name, session_id) and person.may_move()

        ending: tuple[int, str] | None = None
        try:
            recording = _recording_of(socket, data_dir, cell, caller)
            session = ControlSession(cell, others, gamma=gamma, patience_s=patience_s, recording=recording)
            async with BackgroundTasks("recording") as tasks, session:
                if recording is not None:
                    tasks.start(recording.run)
                sessions.add(session_id, session)
                set_state(DeviceState.BUSY)
                log.info("control begins", robot=cell.name, holder=caller.name)
                ending = await _serve(socket, session, caller.subject, may_continue)
        except RobotBusy as busy:
            ending = 4409, str(busy)
        except OSError as error:
            ending = 4507, f"the recording cannot be stored: {error.strerror}; free disk space"
        else:
            set_state(DeviceState.IDLE)
            log.info("control ends", robot=cell.name, holder=caller.name)
        finally:
            ended_by_others = sessions.remove(session_id)
            leases.release(cell.name, session_id)
        ending = ended_by_others or ending
        if ending is not None:
            await _close(socket, *ending)


async def _serve(
    socket: WebSocket, session: ControlSession, subject: str, may_continue: Callable[[], bool]
) -> tuple[int, str] | None:
    """Serve a session until the client leaves or the control is taken away; the robot rests then.

    Return the close code and the reason, None if the client has left.
    """
    work = [
        asyncio.create_task(_receive(socket, session, subject)),
        asyncio.create_task(_send(socket, session)),
        asyncio.create_task(_watch(may_continue, session)),
    ]
    motion = asyncio.create_task(session.run())
    try:
        await asyncio.wait({*work, motion}, return_when=asyncio.FIRST_COMPLETED)
    finally:
        session.end()
        for task in work:
            task.cancel()
        await asyncio.gather(*work, return_exceptions=True)
        await asyncio.shield(motion)
    if not may_continue():
        return REVOKED_CODE, "the permission to move this robot was removed, or cannot be verified"
    if session.silence_s() > MAX_SILENCE_S:
        return IDLE_CODE, f"no input arrived for {MAX_SILENCE_S:.0f} s"
    return None


async def _receive(socket: WebSocket, session: ControlSession, subject: str) -> None:
    gripper_seq = -1
    async with BackgroundTasks("gripper") as acts:
        while True:
            try:
                text = await socket.receive_text()
            except (WebSocketDisconnect, RuntimeError, KeyError):
                return
            try:
                given = _read(text)
                session.receive(given)
            except (ValidationError, RobotFault) as error:
                CONTROL_INPUTS.labels("refused").inc()
                await _send_error(socket, _reason(error))
                continue
            CONTROL_INPUTS.labels("accepted").inc()
            if given.gripper is not None and given.seq != gripper_seq and not session.acting:
                gripper_seq = given.seq
                # Inputs are read while the gripper acts; otherwise old ones would wait.
                session.acting = True
                acts.start(_act, socket, session, given.gripper, subject)


async def _act(socket: WebSocket, session: ControlSession, gripper: str, subject: str) -> None:
    try:
        await session.act(gripper, subject)
    except (RobotFault, OSError) as error:
        await _send_error(socket, str(error))


async def _send_error(socket: WebSocket, reason: str) -> None:
    with suppress(RuntimeError, WebSocketDisconnect):
        await socket.send_text(orjson.dumps({"type": "error", "reason": reason}).decode())


async def _send(socket: WebSocket, session: ControlSession) -> None:
    while True:
        try:
            await socket.send_text(orjson.dumps(session.view()).decode())
        except (WebSocketDisconnect, RuntimeError):
            return
        await asyncio.sleep(STATE_EVERY_S)


async def _watch(may_continue: Callable[[], bool], session: ControlSession) -> None:
    while may_continue() and session.silence_s() <= MAX_SILENCE_S:  # noqa: ASYNC110 - time passes
        await asyncio.sleep(VALID_EVERY_S)


def _read(text: str) -> HumanInput:
    if len(text) > MAX_MESSAGE_BYTES:
        raise RobotFault(f"a message has at most {MAX_MESSAGE_BYTES} bytes")
    return HumanInput.model_validate_json(text)


def _reason(error: Exception) -> str:
    if isinstance(error, ValidationError):
        faults = (
            f"{'.'.join(map(str, one['loc'])) or 'message'}: {one['msg']}" for one in error.errors()[:5]
        )
        return "; ".join(faults)
    return str(error)


def _gamma(given: str | None) -> float:
    try:
        gamma = 1.0 if given is None else float(given)
    except ValueError:
        gamma = -1.0
    if not 0 < gamma <= MAX_GAMMA:
        raise Problem(
            400,
            "No such scale",
            message(
                "robot.no_such_gamma",
                "gamma, the scale of the input, must be a number above 0 and at most {limit}",
                limit=f"{MAX_GAMMA:g}",
            ),
        )
    return gamma


def _recording_of(socket: WebSocket, data_dir: Path, cell: Cell, caller: Caller) -> Recording | None:
    """Begin a recording if the parameter `record` asks for it; raise `OSError`."""
    if socket.query_params.get("record") != "true":
        return None
    return Recording.begin(data_dir, cell.name, caller.name, cell.model.joint_names)


async def _close(socket: WebSocket, code: int, reason: str) -> None:
    with suppress(RuntimeError, WebSocketDisconnect):
        await socket.close(code, reason[:120])
