"""REST routes of accuracy tests: begin, resume and stop them, and read their reports."""

import csv
import io
from collections.abc import Sequence
from typing import Annotated

from fastapi import FastAPI, Request, Response
from pydantic import Field
from starlette.requests import HTTPConnection

from handover.errors import Problem
from handover.formats.strict_json import RequestBody
from handover.http.api_description import TaggedRoutes, sends
from handover.security.guard import ResourceOf, authenticated, guard_of, require, require_by_handler
from handover.security.permissions import Permission
from handover.security.resource_patterns import ANY_RESOURCE
from handover_gloves.accuracy_tests.accuracy_test_runner import MAX_SEED, AccuracyTestRunner
from handover_gloves.accuracy_tests.report import first_recognized, report_of
from handover_gloves.accuracy_tests.store import AccuracyTest
from handover_gloves.accuracy_tests.trials import Trial
from handover_gloves.accuracy_tests.views import TestReport, TestState, TestSummary, TrialView
from handover_gloves.gloves.known_gloves import KnownGloves

COLUMNS = (
    "test", "glove", "person", "seed", "round", "trial", "asked", "code", "first", "firstStates", "outcome",
    "tries", "recognizedMs", "repeats", "endedAt",
)  # fmt: skip


class NewTest(RequestBody):
    """The gestures of a test (all if none are named), its rounds, and the time limits."""

    glove: str
    gestures: Annotated[list[str], Field(min_length=1, max_length=250)] | None = None
    rounds: int = Field(10, ge=1, le=100)
    seed: Annotated[int, Field(ge=0, lt=MAX_SEED)] | None = None
    holdMs: float = Field(500, ge=100, le=5000)  # noqa: N815 - as it stands in JSON
    limitMs: float = Field(10_000, ge=1000, le=120_000)  # noqa: N815 - as it stands in JSON
    breaks: bool = True


def add_accuracy_tests(app: FastAPI, runner: AccuracyTestRunner, gloves: KnownGloves) -> None:
    """Add the routes of accuracy tests."""
    routes = TaggedRoutes(app, "accuracy tests")
    of_test = _of_glove(runner)

    @routes.post(
        "/tests", status_code=201, dependencies=[require_by_handler(Permission.CONFIGURE, "for the glove")]
    )
    async def begin(test: NewTest, connection: Request) -> TestState:
        """Begin a test; the glove is in testing mode until its end. `seed` repeats an order."""
        guard = guard_of(connection)
        glove = guard.settings.entity_id("Device", test.glove)
        guard.require(await authenticated(connection), Permission.CONFIGURE, glove)
        return await runner.begin(
            gloves.named(test.glove),
            test.gestures,
            test.rounds,
            seed=test.seed,
            hold_ms=test.holdMs,
            limit_ms=test.limitMs,
            breaks=test.breaks,
        )

    @routes.get("/tests", dependencies=[require(Permission.READ)])
    async def all_tests() -> list[TestSummary]:
        """List all tests, the latest first."""
        return await runner.all()

    @routes.get("/tests/{test}", dependencies=[require(Permission.READ, of_test)])
    async def one(test: str) -> TestState:
        """Return a test; `live` is its view while it runs."""
        return await runner.find(test)

    @routes.post("/tests/{test}/continue", dependencies=[require(Permission.CONFIGURE, of_test)])
    async def resume(test: str) -> TestState:
        """Resume after a break or an interruption."""
        return await runner.resume(test)

    @routes.post("/tests/{test}/stop", dependencies=[require(Permission.CONFIGURE, of_test)])
    async def stop(test: str) -> TestState:
        """Stop the test; its trials are kept and reported."""
        return await runner.stop(test)

    @routes.delete("/tests/{test}", status_code=204, dependencies=[require(Permission.CONFIGURE, of_test)])
    async def delete(test: str) -> None:
        """Delete a test with its trials."""
        await runner.delete(test)

    @routes.get("/tests/{test}/report", dependencies=[require(Permission.READ, of_test)])
    async def report(test: str) -> TestReport:
        """Return Table 3, the confusion matrix and the times of the trials so far."""
        stored, trials = await runner.trials(test)
        return {"test": await runner.find(test), **report_of(stored.plan, [trial for trial, _ in trials])}

    @routes.get("/tests/{test}/trials.json", dependencies=[require(Permission.READ, of_test)])
    async def as_json(test: str) -> list[TrialView]:
        """Return every trial as JSON."""
        _, trials = await runner.trials(test)
        return [_as_dict(trial, at) for trial, at in trials]

    @routes.get(
        "/tests/{test}/trials.csv",
        response_class=Response,
        responses=sends("text/csv"),
        dependencies=[require(Permission.READ, of_test)],
    )
    async def as_csv(test: str) -> Response:
        """Return every trial as CSV."""
        stored, trials = await runner.trials(test)
        name = f"accuracy-{stored.began_at[:10]}-{stored.id[:8]}.csv"
        return Response(
            csv_of(stored, trials),
            media_type="text/csv; charset=utf-8",
            headers={"Content-Disposition": f'attachment; filename="{name}"'},
        )


def _of_glove(runner: AccuracyTestRunner) -> ResourceOf:
    async def resource(connection: HTTPConnection) -> str:
        try:
            test = await runner.find(str(connection.path_params["test"]))
        except Problem:
            return ANY_RESOURCE
        return guard_of(connection).settings.entity_id("Device", test["glove"])

    resource.__doc__ = "the glove of the test"
    return resource


def csv_of(test: AccuracyTest, trials: Sequence[tuple[Trial, str]]) -> str:
    """Return the trials as CSV (RFC 4180), one a line, times in ms."""
    file = io.StringIO()
    table = csv.writer(file)
    table.writerow(COLUMNS)
    for trial, at in trials:
        first = trial.first
        table.writerow(
            (
                test.id,
                test.glove,
                test.person or "",
                test.plan.seed,
                trial.round + 1,
                trial.number + 1,
                trial.asked,
                test.plan.codes[trial.asked],
                first_recognized(trial),
                first.states if first else "",
                trial.outcome.value,
                len(trial.tries),
                "" if trial.recognized_ms is None else trial.recognized_ms,
                trial.repeats,
                at,
            )
        )
    return file.getvalue()


def _as_dict(trial: Trial, at: str) -> TrialView:
    return {
        "round": trial.round + 1,
        "trial": trial.number + 1,
        "asked": trial.asked,
        "first": first_recognized(trial),
        "outcome": trial.outcome,
        "recognizedMs": trial.recognized_ms,
        "tries": [
            {"gesture": attempt.gesture, "states": attempt.states, "atMs": attempt.at_ms}
            for attempt in trial.tries
        ],
        "repeats": trial.repeats,
        "endedAt": at,
    }
