"""Who gets the control: leases as people ask for them over the WebSocket, and sessions that end for it."""

import asyncio
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Annotated, Final, Protocol

import orjson
from fastapi import FastAPI, WebSocket
from pydantic import BaseModel, ConfigDict, Field
from pydantic.alias_generators import to_camel
from starlette.websockets import WebSocketDisconnect

from handover.control.lease import Lease, Leases
from handover.errors import Problem
from handover.formats.strict_json import StrictModel
from handover.http.api_description import TaggedRoutes
from handover.security.act_recording import lowers
from handover.security.caller import Caller
from handover.security.guard import Guard, in_path, require
from handover.security.permissions import Permission
from handover.telemetry import get_logger

log = get_logger(__name__)

OF_ROBOT = in_path("Device", "robot")
WAITING_EVERY_S: Final = 1.0
REVOKED_CODE, HANDED_OVER_CODE = 4403, 4410
NOTICE: Final = "The dead-man control is software on a network, not a safety-rated enabling device."


class _View(BaseModel):
    model_config = ConfigDict(alias_generator=to_camel, populate_by_name=True)


class WaitingView(_View):
    """A session of a person who waits for the control of a robot."""

    id: str
    name: str


class LeaseView(_View):
    """Who controls a robot, null for nobody, and who waits for the control."""

    robot: str
    holder: str | None
    since: float | None
    waiting: tuple[WaitingView, ...] = ()
    notice: str = NOTICE


class Endable(Protocol):
    """A control session."""

    def end(self) -> None:
        """Bring the robot to rest and end."""


class OpenSessions:
    """The sessions of all robots by id, and why they end."""

    def __init__(self) -> None:
        self._sessions: dict[str, Endable] = {}
        self._endings: dict[str, tuple[int, str]] = {}

    def add(self, session_id: str, session: Endable) -> None:
        """Add a session that begins."""
        self._sessions[session_id] = session

    def end(self, lease: Lease | None, code: int, reason: str) -> None:
        """End the session of a lease that was taken away or handed over; the robot stops."""
        if lease is not None:
            self._endings[lease.session] = code, reason
            if (session := self._sessions.get(lease.session)) is not None:
                session.end()

    def end_all(self, code: int, reason: str) -> None:
        """End all sessions; the robots stop."""
        for session_id, session in tuple(self._sessions.items()):
            self._endings[session_id] = code, reason
            session.end()

    def remove(self, session_id: str) -> tuple[int, str] | None:
        """Remove a session that has ended; return the close code and the reason if others ended it."""
        self._sessions.pop(session_id, None)
        return self._endings.pop(session_id, None)


@dataclass(frozen=True, slots=True)
class Person:
    """A person who wants to control `resource`, the Device of a robot."""

    caller: Caller
    guard: Guard
    resource: str

    def may_move(self) -> bool:
        """Return whether they may (still) move the robot; also false while revocations may be missed."""
        try:
            self.guard.require(self.caller, Permission.MOVE_ROBOTS, self.resource)
        except Problem:
            return False
        return self.guard.is_valid(self.caller)


MODES: Final = ("refuse", "wait", "takeOver")
TOKEN_PARAMETER: Final = "token"  # noqa: S105 - a name


def require_parameters(socket: WebSocket, allowed: Mapping[str, Collection[str] | None]) -> None:
    """Raise `Problem` 400 for a parameter of the address that is not `allowed`, or has another value.

    None allows every value. What is not known is not ignored: a person relies on what they asked for.
    """
    for name, value in socket.query_params.items():
        if name == TOKEN_PARAMETER:
            continue
        if name not in allowed:
            raise Problem(
                400,
                "Unknown parameter",
                f'the control has no parameter "{name[:40]}"; it has {", ".join(allowed)}',
            )
        values = allowed[name]
        if values is not None and value not in values:
            raise Problem(
                400,
                "Unknown value",
                f'{name} cannot be "{value[:40]}"; choose {" or ".join(values)}',
            )


async def acquire(  # noqa: PLR0917 - called by `routes` only
    socket: WebSocket, leases: Leases, sessions: OpenSessions, robot: str, session_id: str, person: Person
) -> bool:
    """Get the lease of `robot` as the parameter `mode` asks; return whether nobody had it before.

    Raises `Problem` if another person has it, `WebSocketDisconnect` if the person stops to wait.
    """
    mode, caller = socket.query_params.get("mode", "refuse"), person.caller
    mine = (robot, session_id, caller.subject, caller.name)
    if mode == "takeOver":
        person.guard.require(caller, Permission.MANAGE_SETTINGS, person.resource)
        ended = leases.take_over(*mine)
        sessions.end(ended, REVOKED_CODE, f"{caller.name} took the control over")
        return ended is None
    if leases.acquire(*mine) is not None:
        return True
    if mode != "wait":
        raise _taken(robot, leases.of(robot))
    waiting = leases.wait(*mine)
    reading = asyncio.create_task(_read_to_end(socket))
    try:
        while not leases.holds(robot, session_id):
            holder = leases.of(robot)
            state = {"type": "waiting", "holder": None if holder is None else holder.name}
            await socket.send_text(orjson.dumps(state).decode())
            waiting.changed.clear()
            changed = asyncio.create_task(waiting.changed.wait())
            await asyncio.wait(
                {reading, changed}, timeout=WAITING_EVERY_S, return_when=asyncio.FIRST_COMPLETED
            )
            changed.cancel()
            _require_waiting(reading, person)
    except BaseException:
        leases.release(robot, session_id)
        raise
    finally:
        reading.cancel()
        await asyncio.gather(reading, return_exceptions=True)
    return False


def _require_waiting(reading: asyncio.Task[None], person: Person) -> None:
    if reading.done() or not person.may_move():
        raise WebSocketDisconnect(1006)


async def _read_to_end(socket: WebSocket) -> None:
    """Read and drop the inputs of a person who waits."""
    with suppress(WebSocketDisconnect, RuntimeError, KeyError):
        while True:
            await socket.receive_text()


def view_of(robot: str, leases: Leases) -> LeaseView:
    """Return who controls a robot and who waits."""
    lease = leases.of(robot)
    waiting = tuple(WaitingView(id=session.session, name=session.name) for session in leases.waiting(robot))
    if lease is None:
        return LeaseView(robot=robot, holder=None, since=None, waiting=waiting)
    return LeaseView(robot=robot, holder=lease.name, since=lease.since_s, waiting=waiting)


def _taken(robot: str, lease: Lease | None) -> Problem:
    return Problem.translated(
        409,
        "Controlled by another person",
        "robot.control_taken",
        "{name} controls {robot}; wait for the end, or ask an admin to take the control away",
        name=lease.name if lease is not None else "somebody",
        robot=robot,
    )


class HandOver(StrictModel):
    """The session that gets the control: the id of one that waits."""

    model_config = ConfigDict(extra="forbid")

    to: Annotated[str, Field(min_length=1, max_length=64)]


def add_lease_routes(
    app: FastAPI, require_robot: Callable[[str], object], leases: Leases, sessions: OpenSessions
) -> None:
    """Add the routes of leases; `require_robot` raises `Problem` for a robot that is unknown."""
    routes = TaggedRoutes(app, "control")

    @routes.get("/robots/{robot}/control", dependencies=[require(Permission.READ, OF_ROBOT)])
    async def control_of(robot: str) -> LeaseView:
        """Return who controls a robot, and who waits for the control."""
        require_robot(robot)
        return view_of(robot, leases)

    @routes.delete("/robots/{robot}/control", dependencies=[require(Permission.MANAGE_SETTINGS, OF_ROBOT)])
    @lowers()
    async def revoke(robot: str) -> LeaseView:
        """Take the control of a robot away from the person who has it; the robot stops."""
        require_robot(robot)
        ended = leases.revoke(robot)
        sessions.end(ended, REVOKED_CODE, "an admin took the control away")
        if ended is not None:
            log.info("control taken away", robot=robot, holder=ended.name)
        return view_of(robot, leases)

    @routes.post("/robots/{robot}/control/hand-over")
    async def hand_over(
        robot: str, body: HandOver, caller: Annotated[Caller, require(Permission.MOVE_ROBOTS, OF_ROBOT)]
    ) -> LeaseView:
        """Hand the control over to a person who waits for it; 409 unless the caller has it."""
        require_robot(robot)
        lease = leases.of(robot)
        if lease is None or lease.subject != caller.subject:
            raise _problem_without_control(robot)
        ended = leases.hand_over(robot, body.to)
        if ended is None:
            raise Problem.translated(
                404,
                "Nobody waits",
                "robot.control_not_waiting",
                "this person waits for the control of {robot} no longer",
                robot=robot,
            )
        receiver = leases.of(robot)
        sessions.end(
            ended, HANDED_OVER_CODE, f"handed over to {receiver.name if receiver else 'nobody'}"[:120]
        )
        return view_of(robot, leases)


def _problem_without_control(robot: str) -> Problem:
    return Problem.translated(
        409,
        "Not in control",
        "robot.control_not_yours",
        "you do not control {robot}, so you cannot hand it over; take the control first",
        robot=robot,
    )
