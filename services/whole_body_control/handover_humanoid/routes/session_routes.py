"""REST: sessions of persons, their reports and progress, and the deletion of what is theirs.

A person needs no grant for the own sessions. Reading those of others is recorded, as each change is.
"""

import asyncio
from contextlib import suppress
from dataclasses import asdict
from datetime import datetime
from typing import Annotated, Any

from fastapi import FastAPI, Query, Request
from sqlalchemy.exc import SQLAlchemyError

from handover.errors import Problem
from handover.messages import text_of
from handover.security.act_recording import lowers
from handover.security.audit_trail import begin_act, current_request
from handover.security.caller import Caller
from handover.security.guard import guard_of, require, require_signed_in
from handover.security.permissions import Permission
from handover_humanoid.routes.access import of_humanoid
from handover_humanoid.routes.bodies import Body
from handover_humanoid.running.sessions.plans import Name, SessionRequest, plan_of
from handover_humanoid.running.sessions.store import StoredSession
from handover_humanoid.running.sessions.training import Training
from handover_humanoid.running.sessions.writer import SessionWriter
from handover_humanoid.sessions.exercise import EndReason, SessionError
from handover_humanoid.sessions.report import progress

SignedIn = Annotated[Caller, require_signed_in()]


class SessionView(Body):
    """A session; `live` is what the live document shows while it runs."""

    id: str
    application: str
    person: str | None
    goal: dict[str, float | None]
    task: str | None
    started_at: datetime
    ended_at: datetime | None
    ended_by: str | None
    throws: int
    caught: int
    score: int
    exercised_s: float
    level: float
    distance_m: float
    live: dict[str, Any] | None = None


class WeekView(Body):
    """The sessions of a week, named as ISO 8601 does."""

    week: str
    sessions: int
    throws: int
    caught: int
    score: int
    exercised_s: float
    best_level: float
    distance_m: float


class DeletedView(Body):
    """How many sessions were deleted."""

    sessions: int


def add_session_routes(app: FastAPI, training: Training, writer: SessionWriter) -> None:
    """Add the routes of sessions."""
    _add_acts(app, training, writer)
    _add_reading(app, training)
    _add_persons(app, training)


def _add_acts(app: FastAPI, training: Training, writer: SessionWriter) -> None:
    perform = [require(Permission.PERFORM_TASKS, of_humanoid)]

    @app.post("/sessions", tags=["sessions"], status_code=201, dependencies=perform)
    async def begin(body: SessionRequest, request: Request) -> SessionView:
        """Begin a session; 409 while another one runs, or while the robot is stopped or does not stand."""
        session = await writer.begin(plan_of(body, guard_of(request).settings))
        return _view(training.row(session), training)

    @app.post("/sessions/{session}/pause", tags=["sessions"], dependencies=perform)
    @lowers()
    async def pause(session: str) -> SessionView:
        """Pause: the robot finishes its step and stands."""
        _require_current(training, session)
        training.pause()
        return await _current(training, writer)

    @app.post("/sessions/{session}/resume", tags=["sessions"], dependencies=perform)
    async def resume(session: str) -> SessionView:
        """Continue; 409 while a cause of the pause is still there."""
        _require_current(training, session)
        try:
            training.resume()
        except SessionError as error:
            raise Problem(409, "Still paused", text_of(error)) from None
        return await _current(training, writer)

    @app.post("/sessions/{session}/end", tags=["sessions"], dependencies=perform)
    @lowers()
    async def end(session: str) -> SessionView:
        """End the session; the robot finishes its step and stands."""
        _require_current(training, session)
        training.end(EndReason.PERSON)
        return await _current(training, writer)


def _add_reading(app: FastAPI, training: Training) -> None:
    store = training.store

    async def found(session: str, caller: Caller, request: Request) -> StoredSession:
        stored = await asyncio.to_thread(store.find, session)
        if stored is None:
            await _require_seen(request, caller, None)
            raise _unknown(session)
        await _require_seen(request, caller, stored["person"])
        return stored

    @app.get("/sessions", tags=["sessions"])
    async def sessions(
        caller: SignedIn, request: Request, person: Annotated[Name | None, Query()] = None
    ) -> list[SessionView]:
        """Return the newest sessions that the caller may see: all, of one person, or the own ones."""
        guard = guard_of(request)
        wanted = None if person is None else guard.settings.entity_id("Person", person)
        if wanted is not None:
            await _require_seen(request, caller, wanted)
        humanoid = str(of_humanoid(request))
        listed = await asyncio.to_thread(store.newest, humanoid.rpartition(":")[2], wanted)
        return [
            _view(session, training) for session in listed if _may_see(caller, session["person"], humanoid)
        ]

    @app.get("/sessions/{session}", tags=["sessions"])
    async def one_session(session: str, caller: SignedIn, request: Request) -> SessionView:
        """Return a session."""
        return _view(await found(session, caller, request), training)

    @app.get("/sessions/{session}/report", tags=["sessions"])
    async def report(session: str, caller: SignedIn, request: Request) -> dict[str, Any]:
        """Return the figures of a session, with each throw."""
        stored = await found(session, caller, request)
        current = training.current
        is_current = current is not None and current.id == session
        made: dict[str, Any] = current.report() if current is not None and is_current else stored["report"]
        return {**_view(stored, training).model_dump(by_alias=True, exclude={"live"}), **made}


def _add_persons(app: FastAPI, training: Training) -> None:
    store = training.store

    @app.get("/persons/{person}/progress", tags=["sessions"])
    async def weeks(person: Name, caller: SignedIn, request: Request) -> list[WeekView]:
        """Return the weeks in which a person exercised, the oldest first."""
        resource = guard_of(request).settings.entity_id("Person", person)
        await _require_seen(request, caller, resource)
        figures = await asyncio.to_thread(store.figures_of, resource)
        return [WeekView(**asdict(week)) for week in progress(figures)]

    @app.delete("/persons/{person}", tags=["sessions"])
    async def delete(person: Name, caller: SignedIn, request: Request) -> DeletedView:
        """Delete all sessions of a person; one that runs is ended."""
        resource = guard_of(request).settings.entity_id("Person", person)
        await _require_own_or(request, caller, Permission.MANAGE_PEOPLE, resource)
        current = training.current
        if current is not None and current.plan.person == resource:
            training.end(EndReason.PERSON)
            current.is_closed, training.current = True, None
        return DeletedView(sessions=await asyncio.to_thread(store.delete_person, resource))


async def _current(training: Training, writer: SessionWriter) -> SessionView:
    with suppress(SQLAlchemyError):  # a stop counts also on a full disk; it is written every second
        await writer.flush()
    assert training.current is not None  # noqa: S101 - the caller has required it
    return _view(training.row(training.current), training)


def _require_current(training: Training, session: str) -> None:
    current = training.current
    if current is None or current.id != session:
        raise _unknown(session)
    if current.is_ended:
        raise Problem.translated(
            409, "Session ended", "humanoid.session_ended", "the session has ended; start another one"
        )


def _unknown(session: str) -> Problem:
    return Problem.translated(
        404,
        "No such session",
        "humanoid.no_such_session",
        'no session "{session}" is known or runs',
        session=session,
    )


async def _require_seen(request: Request, caller: Caller, person: str | None) -> None:
    """Raise `Problem` 403 unless `caller` may see the sessions of `person`; None is nobody in particular."""
    if person is None:
        guard_of(request).require(caller, Permission.READ, str(of_humanoid(request)))
    else:
        await _require_own_or(request, caller, Permission.READ_HEALTH_DATA, person)


async def _require_own_or(request: Request, caller: Caller, permission: Permission, person: str) -> None:
    act = current_request()
    if act is not None:
        act.caller, act.permission, act.resource = caller, permission, person
    if caller.person != person:
        guard_of(request).require(caller, permission, person)
    await begin_act()


def _may_see(caller: Caller, person: str | None, humanoid: str) -> bool:
    if person is None:
        return caller.may(Permission.READ, humanoid)
    return caller.person == person or caller.may(Permission.READ_HEALTH_DATA, person)


def _view(row: StoredSession, training: Training) -> SessionView:
    fields = {name: row.get(name) for name in SessionView.model_fields if name != "live"}
    current = training.current
    live = current.view() if current is not None and current.id == row["id"] else None
    return SessionView.model_validate({**fields, "live": live})
