"""REST: the machines with their state, chart and trial; start, stop and reset."""

import math
import time
from typing import Annotated, Any, Final

from fastapi import FastAPI, Query
from pydantic import ConfigDict, Field, FiniteFloat
from pydantic.alias_generators import to_camel

from handover.errors import Problem
from handover.formats.strict_json import StrictModel
from handover.http.api_description import TaggedRoutes
from handover.messages import with_code
from handover.security.act_recording import lowers
from handover.security.guard import require
from handover.security.permissions import Permission
from handover_cases.running.machine_runner import MachineRunner
from handover_cases.trial import Trial

SHOWN_MESSAGES: Final = 50


class JsonObject(StrictModel):
    """A JSON object in camelCase without unknown members."""

    model_config = ConfigDict(extra="forbid", frozen=True, alias_generator=to_camel, populate_by_name=True)


class TrialStart(JsonObject):
    """How long the machine is used, in s; that of the paper if absent."""

    duration_s: Annotated[FiniteFloat, Field(ge=5, le=7200)] | None = None
    consents_to_model: bool = False
    """The simulated person consents that a language model words what the treadmill says."""


class MachineStart(JsonObject):
    """What the person chooses; which options there are depends on the machine."""

    options: Annotated[dict[str, Any], Field(max_length=16)] = Field(default_factory=dict)


class FigureView(JsonObject):
    """A figure of the paper beside ours; `passed` is null where there is nothing to decide."""

    name: str
    name_code: str | None = None
    name_parameters: dict[str, Any] | None = None
    paper: str
    paper_code: str | None = None
    paper_parameters: dict[str, Any] | None = None
    ours: str
    ours_code: str | None = None
    ours_parameters: dict[str, Any] | None = None
    passed: bool | None


class MessageView(JsonObject):
    """What happened, `atS` after the beginning."""

    at_s: float
    text: str
    text_code: str | None = None
    text_parameters: dict[str, Any] | None = None


class TrialView(JsonObject):
    """The last trial; `passed` once it has ended."""

    is_running: bool
    passed: bool
    failure: str
    failure_code: str | None = None
    failure_parameters: dict[str, Any] | None = None
    elapsed_s: float
    messages: list[MessageView]
    figures: list[FigureView]


class NumberView(JsonObject):
    """A number of the machine with its UN/CEFACT code, "" for none."""

    name: str
    value: float
    unit: str


class VitalView(JsonObject):
    """A value of the body of the person, with its age in s, quality and status."""

    name: str
    value: float | str | None
    quality: float
    status: str
    age_s: float
    is_calibrated: bool


class MachineLimitView(JsonObject):
    """The limit of the body: a fraction of the speed, and why."""

    fraction: float
    reason: str
    needs_reset: bool


class MachineView(JsonObject):
    """A machine as it is now. `problem` says why nothing is received from human state, "" while it is."""

    case: str
    robot: str
    person: str
    state: str
    reason: str
    is_moving: bool
    limit: MachineLimitView
    values: list[NumberView]
    vitals: list[VitalView]
    problem: str
    details: dict[str, Any]
    trial: TrialView | None


class HistoryView(JsonObject):
    """The points of the chart after a time: `atS` in s since 1970, and a column for each name."""

    at_s: list[float]
    columns: dict[str, list[float | None]]


def add_routes(app: FastAPI, runners: dict[str, MachineRunner]) -> None:
    """Add the routes of machines."""
    routes = TaggedRoutes(app, "machines")

    def runner_of(case: str) -> MachineRunner:
        runner = runners.get(case)
        if runner is None:
            raise Problem.translated(
                404,
                "Unknown case",
                "case.unknown",
                'no machine of the case "{case}" runs; those that run are: {known}',
                case=case,
                known=", ".join(runners) or "none",
            )
        return runner

    @routes.get("/machines", dependencies=[require(Permission.READ_HEALTH_DATA)])
    async def machines() -> list[MachineView]:
        """Return all machines that run."""
        return [_view(runner) for runner in runners.values()]

    @routes.get("/machines/{case}", dependencies=[require(Permission.READ_HEALTH_DATA)])
    async def machine(case: str) -> MachineView:
        """Return one machine."""
        return _view(runner_of(case))

    @routes.get("/machines/{case}/history", dependencies=[require(Permission.READ_HEALTH_DATA)])
    async def history(case: str, after_s: Annotated[float, Query()] = 0.0) -> HistoryView:
        """Return the chart of the last ten minutes, two points a second, after a time in s since 1970."""
        points = [point for point in runner_of(case).points if point.at_s > after_s]
        names = dict.fromkeys(name for point in points for name in point.values)
        return HistoryView(
            at_s=[point.at_s for point in points],
            columns={name: [_number(point.values.get(name)) for point in points] for name in names},
        )

    @routes.post("/machines/{case}/start", dependencies=[require(Permission.PERFORM_TASKS)])
    async def start(case: str, body: MachineStart | None = None) -> MachineView:
        """Let the machine move, by its person or by who is in charge."""
        runner = runner_of(case)
        await runner.start({} if body is None else body.options)
        return _view(runner)

    @routes.post("/machines/{case}/stop", dependencies=[require(Permission.PERFORM_TASKS)])
    @lowers()
    async def stop(case: str) -> MachineView:
        """Stop the machine within its comfortable deceleration. This is no emergency stop."""
        runner = runner_of(case)
        runner.stop()
        return _view(runner)

    @routes.post("/machines/{case}/reset", dependencies=[require(Permission.PERFORM_TASKS)])
    async def reset(case: str) -> MachineView:
        """Release a stop by the limit; 409 while the limit still stops the machine."""
        runner = runner_of(case)
        await runner.reset()
        return _view(runner)

    @routes.post("/machines/{case}/trial", dependencies=[require(Permission.MOVE_ROBOTS)])
    async def trial(case: str, body: TrialStart) -> MachineView:
        """Begin the trial of the case with its simulated person."""
        runner = runner_of(case)
        runner.begin_trial(body.duration_s, consents_to_model=body.consents_to_model)
        return _view(runner)


def _view(runner: MachineRunner) -> MachineView:
    state, allowed, trial = runner.machine.state(), runner.allowed, runner.trial
    return MachineView(
        case=runner.case.name,
        robot=runner.case.robot,
        person=runner.case.person,
        state=state.state,
        reason=state.reason,
        is_moving=state.is_moving,
        limit=MachineLimitView(
            fraction=allowed.fraction, reason=str(allowed.reason), needs_reset=allowed.needs_reset
        ),
        values=[
            NumberView(name=name, value=value, unit=unit) for name, (value, unit) in state.values.items()
        ],
        vitals=[VitalView(**vital) for vital in runner.link.body.shown(time.monotonic())],
        problem=runner.link.problem,
        details=dict(runner.machine.describe()),
        trial=None if trial is None else _trial_view(trial),
    )


def _trial_view(trial: Trial) -> TrialView:
    return TrialView.model_validate(
        {
            "isRunning": trial.is_running,
            "passed": trial.passed,
            **with_code("failure", trial.failure),
            "elapsedS": trial.elapsed_s,
            "messages": [
                {"atS": at_s, **with_code("text", text)} for at_s, text in trial.messages[-SHOWN_MESSAGES:]
            ],
            "figures": [
                {
                    **with_code("name", figure.name),
                    **with_code("paper", figure.paper),
                    **with_code("ours", figure.ours),
                    "passed": figure.passed,
                }
                for figure in trial.figures
            ],
        }
    )


def _number(value: float | None) -> float | None:
    return None if value is None or math.isnan(value) else value
