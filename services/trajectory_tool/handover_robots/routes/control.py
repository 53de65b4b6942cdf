"""Control over a WebSocket: inputs of a person in, the state of the robot out; and the leases over REST."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Final
from uuid import uuid4

from fastapi import FastAPI, WebSocket
from starlette.websockets import WebSocketDisconnect

from handover.control.lease import Leases
from handover.control.leasing import (
    MODES,
    OF_ROBOT,
    OpenSessions,
    Person,
    acquire,
    add_lease_routes,
    require_parameters,
)
from handover.control.session import InputRefused, receive_input, send_error, serve
from handover.errors import Problem
from handover.http.websocket_closing import close_websocket
from handover.runtime.background_tasks import BackgroundTasks
from handover.security.caller import Caller
from handover.security.guard import guard_of, require
from handover.security.permissions import Permission
from handover.telemetry import get_logger
from handover_datamodels.entities import DeviceState
from handover_robots.cell.robot_unit import RobotUnit
from handover_robots.control.recording import Recording
from handover_robots.control.session import ControlSession, RobotBusy
from handover_robots.metrics import CONTROL_INPUTS
from handover_robots.model.faults import RobotFault
from handover_robots.routes.recordings import add_recording_routes

log = get_logger(__name__)

ACQUIRE_TIMEOUT_S: Final = 0.5
HAND_OVER_TIMEOUT_S: Final = 10.0
"""How long a new session waits until the robot of the earlier one rests."""
MAX_GAMMA: Final = 2.0

Find = Callable[[str], tuple[RobotUnit, tuple[RobotUnit, ...], Callable[[DeviceState], None]]]
"""Returns a robot, the others of its cell, and how its Device's state is written. Raises `Problem`."""


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
            require_parameters(socket, {"mode": MODES, "gamma": None, "record": ("true", "false")})
            unit, others, set_state = find(robot)
            gamma = _gamma(socket.query_params.get("gamma"))
            is_first = await acquire(socket, leases, sessions, unit.name, session_id, person)
        except Problem as problem:
            await close_websocket(socket, 4000 + problem.status, problem.detail)
            return
        except WebSocketDisconnect:
            return
        patience_s = ACQUIRE_TIMEOUT_S if is_first else HAND_OVER_TIMEOUT_S

        def may_continue() -> bool:
            return leases.holds(unit.name, session_id) and person.may_move()

        ending: tuple[int, str] | None = None
        try:
            recording = _recording_of(socket, data_dir, unit, caller)
            session = ControlSession(unit, others, gamma=gamma, patience_s=patience_s, recording=recording)
            async with BackgroundTasks("recording") as tasks, session:
                if recording is not None:
                    tasks.start(recording.run)
                sessions.add(session_id, session)
                set_state(DeviceState.BUSY)
                log.info("control begins", robot=unit.name, holder=caller.name)
                receiving = _receive(socket, session, caller.subject)
                ending = await serve(socket, session, receiving, may_continue)
        except RobotBusy as busy:
            ending = 4409, str(busy)
        except OSError as error:
            ending = 4507, f"the recording cannot be stored: {error.strerror}; free disk space"
        else:
            set_state(DeviceState.IDLE)
            log.info("control ends", robot=unit.name, holder=caller.name)
        finally:
            ended_by_others = sessions.remove(session_id)
            leases.release(unit.name, session_id)
        ending = ended_by_others or ending
        if ending is not None:
            await close_websocket(socket, *ending)


async def _receive(socket: WebSocket, session: ControlSession, subject: str) -> None:
    gripper_seq = -1
    async with BackgroundTasks("gripper") as acts:
        while True:
            try:
                human_input = await receive_input(socket)
                if human_input is None:
                    return
                session.receive(human_input)
            except (InputRefused, RobotFault) as refused:
                CONTROL_INPUTS.labels("refused").inc()
                await send_error(socket, str(refused))
                continue
            CONTROL_INPUTS.labels("accepted").inc()
            if human_input.gripper is not None and human_input.seq != gripper_seq and not session.acting:
                gripper_seq = human_input.seq
                # Inputs are read while the gripper acts; otherwise old ones would wait.
                session.acting = True
                acts.start(_act, socket, session, human_input.gripper, subject)


async def _act(socket: WebSocket, session: ControlSession, gripper: str, subject: str) -> None:
    try:
        await session.act(gripper, subject)
    except (RobotFault, OSError) as error:
        await send_error(socket, str(error))


def _gamma(written: str | None) -> float:
    try:
        gamma = 1.0 if written is None else float(written)
    except ValueError:
        gamma = -1.0
    if not 0 < gamma <= MAX_GAMMA:
        raise Problem.translated(
            400,
            "No such scale",
            "robot.no_such_gamma",
            "gamma, the scale of the input, must be a number above 0 and at most {limit}",
            limit=f"{MAX_GAMMA:g}",
        )
    return gamma


def _recording_of(socket: WebSocket, data_dir: Path, unit: RobotUnit, caller: Caller) -> Recording | None:
    """Begin a recording if the parameter `record` asks for it; raise `OSError`."""
    if socket.query_params.get("record") != "true":
        return None
    return Recording.begin(data_dir, unit.name, caller.name, unit.model.joint_names)
