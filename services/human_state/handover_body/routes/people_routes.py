"""REST: persons, consents, sensors, robots, state, history, and deletion."""

import asyncio
import time
from typing import Annotated, Any, Final, NamedTuple

from fastapi import Depends, FastAPI, Query, Request, Response

from handover.errors import Problem
from handover.formats.validation import LocalMoment
from handover.security.caller import Caller
from handover.security.guard import guard_of, require_by_handler
from handover.security.permissions import Permission
from handover_body.fusion.baseline import (
    Baseline,
    NoBaseline,
    by_age,
    measured_maximum_bpm,
    measured_rest_bpm,
)
from handover_body.limits.body_limit import RefusedReset
from handover_body.limits.curve import LimitCurve, of_baseline
from handover_body.model.features import FeatureName
from handover_body.routes.access import SignedIn, may_see, require_own_or
from handover_body.routes.bodies import (
    ConsentGiven,
    HistoryDuration,
    HistoryPoint,
    HistoryValue,
    LimitView,
    Name,
    PersonChange,
    PersonView,
    Reset,
    StateView,
)
from handover_body.routes.parts import Parts
from handover_body.routes.views import limit_view, moment, person_view, state_view

Mover = Annotated[Caller, require_by_handler(Permission.MOVE_ROBOTS, "for the robot")]
DAY_S: Final = 86_400.0
MAX_POINTS: Final = 2000


def add_people_routes(app: FastAPI, parts: Parts) -> None:
    """Add all routes of persons."""
    for add in (
        _add_people,
        _add_baselines,
        _add_consents,
        _add_state,
        _add_summaries,
        _add_limits,
    ):
        add(app, parts)


def _add_people(app: FastAPI, parts: Parts) -> None:
    people, monitoring, removal = parts.people, parts.monitoring, parts.removal

    @app.get("/people", tags=["people"])
    async def list_people(caller: SignedIn, request: Request) -> list[PersonView]:
        """Return the persons whose data the caller may see: all, those of grants, or the own."""
        return [
            person_view(person, monitoring)
            for person in people.all()
            if may_see(request, caller, person.name)
        ]

    @app.get("/people/{person}", tags=["people"])
    async def one_person(person: Name, caller: SignedIn, request: Request) -> PersonView:
        """Return a person without values."""
        await require_own_or(request, caller, Permission.READ_HEALTH_DATA, person)
        return person_view(people.person(person), monitoring)

    @app.put("/people/{person}", tags=["people"])
    async def put_person(person: Name, body: PersonChange, caller: SignedIn, request: Request) -> PersonView:
        """Add a person, or change baseline and curve. The pseudonym is drawn here and stays."""
        await require_own_or(request, caller, Permission.CONFIGURE, person)
        stored = people.find(person)
        baseline, curve = _baseline(body, stored.baseline if stored else Baseline())
        changed = await people.put(person, baseline, (curve.free_bpm, curve.strained_bpm, curve.least))
        return person_view(changed, monitoring)

    @app.delete("/people/{person}", tags=["people"], status_code=204)
    async def delete_person(person: Name, caller: SignedIn, request: Request) -> Response:
        """Delete a person everywhere: here with the history, and the entities in the broker."""
        await require_own_or(request, caller, Permission.MANAGE_PEOPLE, person)
        people.person(person)
        await removal.person(person)
        return Response(status_code=204)

    @app.delete("/people/{person}/data", tags=["people"], status_code=204)
    async def delete_data(person: Name, caller: SignedIn, request: Request) -> Response:
        """Delete what is stored about the body of a person; the consent stays."""
        await require_own_or(request, caller, Permission.CONDUCT_STUDIES, person)
        await removal.data(people.person(person))
        return Response(status_code=204)


def _add_baselines(app: FastAPI, parts: Parts) -> None:
    people, monitoring = parts.people, parts.monitoring

    @app.post("/people/{person}/baseline/rest", tags=["people"])
    async def measure_rest(person: Name, caller: SignedIn, request: Request) -> PersonView:
        """Take the heart rate at rest from the last five minutes, in which the person sat still."""
        await require_own_or(request, caller, Permission.CONFIGURE, person)
        before = people.person(person).baseline
        try:
            rest = measured_rest_bpm(list(parts.monitor_of(person).recent)[-600:])
            baseline = Baseline(rest, before.maximum_bpm, "measured")
        except NoBaseline as error:
            raise Problem(409, "No baseline", str(error)) from None
        return await changed(person, baseline)

    @app.post("/people/{person}/baseline/maximum", tags=["people"])
    async def measure_maximum(person: Name, caller: SignedIn, request: Request) -> PersonView:
        """Take the highest heart rate of the last minutes as the maximum, after a supervised test."""
        await require_own_or(request, caller, Permission.CONFIGURE, person)
        before = people.person(person).baseline
        try:
            maximum_bpm = measured_maximum_bpm(parts.monitor_of(person).recent)
            measured = max(maximum_bpm, before.maximum_bpm) if before.method == "measured" else maximum_bpm
            baseline = Baseline(before.rest_bpm, measured, "measured")
        except NoBaseline as error:
            raise Problem(409, "No baseline", str(error)) from None
        return await changed(person, baseline)

    async def changed(person: str, baseline: Baseline) -> PersonView:
        curve = of_baseline(baseline, people.person(person).limit.least)
        done = await people.put(person, baseline, (curve.free_bpm, curve.strained_bpm, curve.least))
        return person_view(done, monitoring)


def _add_consents(app: FastAPI, parts: Parts) -> None:
    people, monitoring, removal = parts.people, parts.monitoring, parts.removal

    @app.put("/people/{person}/consent", tags=["consent"])
    async def give_consent(
        person: Name, body: ConsentGiven, caller: SignedIn, request: Request
    ) -> PersonView:
        """Store the consent of a person: by the person, or by somebody who conducts studies with them."""
        await require_own_or(request, caller, Permission.CONDUCT_STUDIES, person)
        ends_us = int(body.ends.timestamp() * 1e6)
        given_by = caller.acting_name(body.given_by)
        return person_view(await people.consent(person, body.purposes, ends_us, given_by), monitoring)

    @app.delete("/people/{person}/consent", tags=["consent"])
    async def withdraw_consent(
        person: Name, caller: SignedIn, request: Request, delete: bool = False
    ) -> PersonView:
        """Withdraw the consent: sensors stop at once. With `delete`, what is stored is deleted as well."""
        await require_own_or(request, caller, Permission.PERFORM_TASKS, person)
        withdrawn = await people.withdraw(person)
        if delete:
            await removal.data(withdrawn)
        return person_view(withdrawn, monitoring)


def _add_state(app: FastAPI, parts: Parts) -> None:
    monitoring, store = parts.monitoring, parts.store

    @app.get("/people/{person}/state", tags=["state"])
    async def state(person: Name, caller: SignedIn, request: Request) -> StateView:
        """Return the values of a person now, with age, quality and status; 409 without consent."""
        await require_own_or(request, caller, Permission.READ_HEALTH_DATA, person)
        return state_view(parts.monitor_of(person), monitoring)

    @app.get("/people/{person}/history/{feature}", tags=["state"])
    async def history(asked: Annotated[History, _history_of(parts)]) -> list[HistoryValue]:
        """Return the values of a feature, oldest first: the last day, or from `start` to `end`."""
        return [
            HistoryValue(
                at=moment(row.at_us),
                value=row.text if row.number is None else row.number,
                quality=row.quality,
                status=row.status,
            )
            for row in await asyncio.to_thread(store.values, *asked)
        ]


def _add_summaries(app: FastAPI, parts: Parts) -> None:
    store = parts.store

    @app.get("/people/{person}/history/{feature}/points", tags=["state"])
    async def points(
        asked: Annotated[History, _history_of(parts)],
        count: Annotated[int, Query(ge=1, le=MAX_POINTS)] = 600,
    ) -> list[HistoryPoint]:
        """Return the valid numbers of a time in `count` equal parts: least, mean and most of each."""
        return [
            HistoryPoint(
                at=moment(row.at_us), least=row.least, mean=row.mean, most=row.most, values=row.values
            )
            for row in await asyncio.to_thread(store.points, *asked, count)
        ]

    @app.get("/people/{person}/history/{feature}/durations", tags=["state"])
    async def durations(asked: Annotated[History, _history_of(parts)]) -> list[HistoryDuration]:
        """Return how long each text of a feature held, such as an activity or a sleep position."""
        rows = await asyncio.to_thread(store.durations, *asked)
        return [HistoryDuration(value=value, seconds=round(seconds, 3)) for value, seconds in rows]


class History(NamedTuple):
    """A feature of a person over a time, in us since 1970."""

    subject: str
    feature: str
    from_us: int
    to_us: int


def _history_of(parts: Parts) -> Any:
    """Return the dependency that reads which history is asked for, and whether the caller may read it.

    The time is from `start` to `end`; the last day if none is given.
    """

    async def asked(  # noqa: PLR0917 - parameters of routes
        person: Name,
        feature: FeatureName,
        caller: SignedIn,
        request: Request,
        start: LocalMoment | None = None,
        end: LocalMoment | None = None,
    ) -> History:
        await require_own_or(request, caller, Permission.READ_HEALTH_DATA, person)
        to_s = time.time() if end is None else end.timestamp()
        from_s = to_s - DAY_S if start is None else start.timestamp()
        subject = parts.people.person(person).pseudonym
        return History(subject, feature, int(from_s * 1e6), int(to_s * 1e6))

    return Depends(asked)


def _add_limits(app: FastAPI, parts: Parts) -> None:
    people, monitoring = parts.people, parts.monitoring

    @app.get("/people/{person}/limit", tags=["limits"])
    async def limit(person: Name, caller: SignedIn, request: Request) -> LimitView:
        """Return the speed limit of a person; 409 without consent to it."""
        await require_own_or(request, caller, Permission.READ_HEALTH_DATA, person)
        return limit_of(person)

    def limit_of(person: str) -> LimitView:
        view = limit_view(parts.monitor_of(person), monitoring)
        if view is None:
            raise Problem.translated(
                409,
                "No consent",
                "health.no_limits",
                "{person} does not consent to speed limits; ask the person",
                person=person,
            )
        return view

    @app.post("/people/{person}/limit/reset", tags=["limits"])
    async def reset(person: Name, body: Reset, caller: SignedIn, request: Request) -> LimitView:  # noqa: ARG001
        """End a stop, by the person or by who is in charge; each robot has a reset of its own as well."""
        await require_own_or(request, caller, Permission.PERFORM_TASKS, person)
        limit_of(person)
        try:
            parts.monitor_of(person).reset()
        except RefusedReset as refused:
            raise Problem(409, "Still stopped", str(refused)) from None
        await people.keep_stop(person, is_stopped=False)
        return limit_of(person)

    @app.put("/people/{person}/robots/{robot}", tags=["limits"])
    async def bind(
        person: Name,
        robot: Name,
        caller: Mover,
        request: Request,
    ) -> PersonView:
        """Let the state of a person limit a robot."""
        guard = guard_of(request)
        guard.require(caller, Permission.MOVE_ROBOTS, guard.settings.entity_id("Device", robot))
        return person_view(await people.bind(person, robot, is_bound=True), monitoring)

    @app.delete("/people/{person}/robots/{robot}", tags=["limits"])
    async def unbind(
        person: Name,
        robot: Name,
        caller: Mover,
        request: Request,
    ) -> PersonView:
        """End that; the robot stops until an engineer removes the source there."""
        guard = guard_of(request)
        guard.require(caller, Permission.MOVE_ROBOTS, guard.settings.entity_id("Device", robot))
        return person_view(await people.bind(person, robot, is_bound=False), monitoring)


def _baseline(body: PersonChange, before: Baseline) -> tuple[Baseline, LimitCurve]:
    try:
        if body.rest_bpm is not None and body.maximum_bpm is not None:
            baseline = Baseline(body.rest_bpm, body.maximum_bpm, "given")
        else:
            baseline = before if body.age is None else by_age(body.age)
        if body.free_bpm is not None and body.strained_bpm is not None:
            return baseline, LimitCurve(body.free_bpm, body.strained_bpm, body.least_fraction)
        return baseline, of_baseline(baseline, body.least_fraction)
    except ValueError as error:
        raise Problem(422, "Bad baseline", str(error)) from None
