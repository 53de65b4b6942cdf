"""The motions of a process, performed dry: activities in the order of the flow, each with its parameters."""

import asyncio
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import orjson

from handover.errors import HandoverError, UsageError
from handover_bpmn.model import Activity, Definition, Node, Scope, Value
from handover_bpmn.notation.faults import BadBpmn
from handover_bpmn.notation.file import read_bpmn
from handover_robots.settings import TrajectorySettings
from handover_robots.tasks.dry_run import DryRun, NearestPair
from handover_robots.tasks.operations import OPERATIONS


@dataclass(frozen=True)
class CheckedActivity:
    """An activity of a robot: its duration, its smallest distance, its faults, or why it was not checked."""

    element: str
    name: str
    robot: str
    operation: str
    duration_s: float = 0.0
    faults: tuple[str, ...] = ()
    skipped: str | None = None
    nearest: NearestPair | None = None


def check_process(
    file: Path, settings: TrajectorySettings, parameters: Mapping[str, Any]
) -> list[CheckedActivity]:
    """Return the checked activities of robots, in the order of the flow. Raises `UsageError`."""
    try:
        definitions = read_bpmn(file.read_bytes()).definitions
    except OSError as error:
        raise UsageError(f"{file} cannot be read: {error.strerror}") from None
    except BadBpmn as error:
        raise UsageError(f"{file}: {error}") from None
    with tempfile.TemporaryDirectory(prefix="handover-check-") as folder:
        return [
            checked
            for number, definition in enumerate(definitions)
            for checked in asyncio.run(
                _check(definition, DryRun(settings, Path(folder, str(number))), dict(parameters))
            )
        ]


async def _check(definition: Definition, run: DryRun, parameters: dict[str, Any]) -> list[CheckedActivity]:
    variables = {name: parameter.default for name, parameter in definition.parameters.items()} | parameters
    activities = []
    async with run:
        for activity in _activities(definition.scope):
            checked = await _perform(run, activity, variables)
            if checked is not None:
                activities.append(checked)
    return activities


def _activities(scope: Scope) -> Iterator[Activity]:
    """Yield the activities breadth first along the flows, then those that no flow reaches, each once."""
    targets = {flow.target for flow in scope.flows.values()}
    waiting = [node for node in scope.nodes.values() if node.id not in targets and node.attached_to is None]
    waiting += [node for node in scope.nodes.values() if node not in waiting]
    seen: set[str] = set()

    def follow(node: Node) -> Iterator[Activity]:
        queue = [node]
        while queue:
            here = queue.pop(0)
            if here.id in seen:
                continue
            seen.add(here.id)
            if here.activity is not None:
                yield here.activity
            if here.scope is not None:
                yield from _activities(here.scope)
            queue += [scope.nodes[flow.target] for flow in scope.flows.values() if flow.source == here.id]

    for node in waiting:
        yield from follow(node)


async def _perform(run: DryRun, activity: Activity, variables: dict[str, Any]) -> CheckedActivity | None:
    """Perform the activity of a robot; None for one of a person, which is done as well as possible."""
    robot = _robot_of(run, activity, variables)
    operation = _read(activity.parameters.get("operation"), variables) or activity.definition
    if robot is None or not isinstance(operation, str) or operation not in OPERATIONS:
        variables.setdefault(activity.variable, {"outcome": "ok"})
        if robot is None:
            return None
    name = activity.name or activity.id
    try:
        values = {
            key: value.literal if value.expression is None else value.expression.value(variables)
            for key, value in activity.parameters.items()
        }
    except HandoverError as why:
        return CheckedActivity(
            activity.id, name, robot, str(operation), skipped=f"its parameters are not known: {why}"
        )
    missing = [key for key, value in values.items() if value is None]
    if missing:
        skipped = f"{', '.join(missing)} would come from an activity without a result"
        return CheckedActivity(activity.id, name, robot, str(operation), skipped=skipped)
    step = await run.perform(robot, str(operation), values)
    if step.result or activity.variable not in variables:
        variables[activity.variable] = dict(step.result)
    return CheckedActivity(
        activity.id, name, robot, str(operation), step.duration_s, step.faults, nearest=step.nearest
    )


def _robot_of(run: DryRun, activity: Activity, variables: dict[str, Any]) -> str | None:
    named = [str(_read(value, variables) or "").rsplit(":", 1)[-1] for value in activity.involves]
    for name in named:
        if name in run.robots:
            return name
    operation = _read(activity.parameters.get("operation"), variables)
    if not any(named) and operation in OPERATIONS and len(run.robots) == 1:
        return run.robots[0]
    return None


def _read(value: Value | None, variables: dict[str, Any]) -> Any:
    if value is None or value.expression is None:
        return None if value is None else value.literal
    try:
        return value.expression.value(variables)
    except HandoverError:
        return None


def as_json(checked: list[CheckedActivity]) -> str:
    """Return the report as JSON."""
    return orjson.dumps(checked, option=orjson.OPT_INDENT_2).decode()
