"""Driving a registered robot over a WebSocket, as the trajectory tool has it; and its lease over REST."""

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
from handover.security.caller import Caller
from handover.security.guard import guard_of, require
from handover.security.permissions import Permission
from handover.telemetry import get_logger
from handover_devices.driving import DriveSession, NotDrivable, require_drivable
from handover_devices.gateway import DeviceGateway

log = get_logger(__name__)

AWAY_CODE: Final = 4502
AWAY: Final = (AWAY_CODE, "the robot is not connected any more")


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
            require_parameters(socket, {"mode": MODES, "record": ("false",)})
            device = gateway.device(robot)
            require_drivable(device)
            await acquire(socket, leases, sessions, robot, session_id, person)
        except NotDrivable as why:
            await close_websocket(socket, 4409, str(why))
            return
        except Problem as problem:
            await close_websocket(socket, 4000 + problem.status, problem.detail)
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
            receiving = _receive(socket, session)
            ending = await serve(socket, session, receiving, may_continue, motion_ended=AWAY)
            log.info("control ends", robot=robot, holder=caller.name)
        except NotDrivable as why:
            ending = 4409, str(why)
        finally:
            ended_by_others = sessions.remove(session_id)
            leases.release(robot, session_id)
        ending = ended_by_others or ending
        if ending is not None:
            await close_websocket(socket, *ending)


async def _receive(socket: WebSocket, session: DriveSession) -> None:
    while True:
        try:
            human_input = await receive_input(socket)
            if human_input is None:
                return
            session.receive(human_input)
        except (InputRefused, NotDrivable) as refused:
            await send_error(socket, str(refused))
