"""Definition: what a BPMN file says, once it has been read and found right.

The drawing becomes activities with what our extension elements say about them: which TaskDefinition, who
and what is involved, where, with which parameters, and what becomes of the result.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Any

from datamodels.states import Outcome
from handover.durations import Duration
from handover.errors import Problem
from handover.messages import Message, message, with_code
from handover.outcomes import reason_of
from services.task_orchestrator.expressions import Expression

MAX_FAULTS_LISTED = 100


@dataclass(frozen=True, slots=True)
class Fault:
    """One thing wrong with a BPMN file: at which element (or none), in which line, and the rule."""

    element: str | None
    line: int | None
    message: str

    def __str__(self) -> str:
        where = f'"{self.element}"' if self.element else "the file"
        return f"line {self.line}, {where}: {self.message}" if self.line else f"{where}: {self.message}"


class BadBpmn(Problem):
    """A BPMN file cannot be deployed; `faults` say all that is wrong with it."""

    def __init__(self, faults: list[Fault]) -> None:
        listed = [
            {"element": f.element, "line": f.line, **with_code("message", f.message)}
            for f in faults[:MAX_FAULTS_LISTED]
        ]
        more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
        super().__init__(
            422, "BPMN cannot be deployed", f"{faults[0]}{more}", "urn:handover:bad-bpmn", {"faults": listed}
        )
        self.faults = faults


@dataclass(frozen=True, slots=True)
class Given:
    """A value that stands in the file, or an expression over the process variables that gives it."""

    literal: Any = None
    expression: Expression | None = None

    def value(self, variables: Mapping[str, Any]) -> Any:
        """Return the value; raise `ExpressionError` if a variable it needs is missing or does not fit."""
        return self.literal if self.expression is None else self.expression.value(variables)


@dataclass(frozen=True, slots=True)
class Place:
    """Where an activity happens, and what the place is for it (`source`, `target`, …)."""

    location: Given
    function: str | None = None


@dataclass(frozen=True, slots=True)
class Activity:
    """A step of the process that a person or a robot does: it becomes a Task each time it is reached."""

    id: str
    name: str
    description: str | None
    lane: str | None
    definition: str
    deadline: Duration | None
    involves: tuple[Given, ...]
    happens_at: tuple[Place, ...]
    parameters: Mapping[str, Given]
    outputs: Mapping[str, str]
    """Process variable -> name in the Task's outputParameters; if empty, all go to `variable`."""
    handles_outcomes: bool = False
    """Whether the drawing decides what follows from another outcome than `ok`; else the Task fails."""

    def unhandled(self, outputs: Mapping[str, Any]) -> Message | None:
        """Return why a completed Task counts as failed: an outcome that the drawing does not handle."""
        outcome = outputs.get("outcome")
        if self.handles_outcomes or outcome is None or outcome == Outcome.OK:
            return None
        note = outputs.get("note")
        return reason_of(str(outcome), str(note) if note else None)

    @property
    def variable(self) -> str:
        """Return the variable that holds all outputParameters when no outputs are named."""
        return variable_of(self.id)

    def results(self, outputs: Mapping[str, Any]) -> dict[str, Any]:
        """Return the process variables that the Task's `outputs` give; what it did not report is null.

        Where outcomes are handled there is one: a performer that knows of none has answered `ok`.
        """
        if self.handles_outcomes:
            outputs = {"outcome": Outcome.OK.value, **outputs}
        if not self.outputs:
            return {self.variable: dict(outputs)}
        return {variable: outputs.get(source) for variable, source in self.outputs.items()}


@dataclass(frozen=True, slots=True)
class ProcessParameter:
    """A parameter that a process can be started with."""

    name: str
    required: bool
    default: Any = None


class Kind(Enum):
    """What sort of element a node is; the value is its BPMN name."""

    START = "startEvent"
    END = "endEvent"
    USER_TASK = "userTask"
    SERVICE_TASK = "serviceTask"
    MANUAL_TASK = "manualTask"
    TASK = "task"
    SCRIPT = "scriptTask"
    EXCLUSIVE = "exclusiveGateway"
    INCLUSIVE = "inclusiveGateway"
    PARALLEL = "parallelGateway"
    CATCH = "intermediateCatchEvent"
    THROW = "intermediateThrowEvent"
    BOUNDARY = "boundaryEvent"


HANDED_OVER = frozenset({Kind.USER_TASK, Kind.SERVICE_TASK, Kind.MANUAL_TASK, Kind.TASK})
CHOICES = frozenset({Kind.EXCLUSIVE, Kind.INCLUSIVE})
GATEWAYS = CHOICES | {Kind.PARALLEL}


class Trigger(Enum):
    """What an event waits for or does; the value is its BPMN name."""

    NONE = "none"
    TIMER = "timerEventDefinition"
    ERROR = "errorEventDefinition"
    TERMINATE = "terminateEventDefinition"


@dataclass(frozen=True, slots=True)
class Node:
    """A flow node as drawn."""

    id: str
    line: int
    kind: Kind
    name: str
    trigger: Trigger = Trigger.NONE
    error_code: str | None = None
    attached_to: str | None = None
    interrupting: bool = True
    default: str | None = None


@dataclass(frozen=True, slots=True)
class Flow:
    """A sequence flow as drawn."""

    id: str
    line: int
    source: str
    target: str
    condition: str | None = None


@dataclass(frozen=True, slots=True)
class Definition:
    """A process that can be started."""

    name: str
    title: str
    label: str | None
    """The version its author gave it, if any."""
    description: str | None
    parameters: Mapping[str, ProcessParameter]
    activities: Mapping[str, Activity]
    nodes: Mapping[str, Node]
    flows: Mapping[str, Flow]
    xml: bytes

    def arguments(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Return the variables that a process starts with, defaults filled in.

        Raises `Problem` 422 when one is missing or unknown.
        """
        unknown = sorted(set(given) - set(self.parameters)) if self.parameters else []
        missing = sorted(p.name for p in self.parameters.values() if p.required and p.name not in given)
        if unknown:
            known = ", ".join(sorted(self.parameters))
            raise Problem(
                422,
                "Unknown parameter",
                message(
                    "process.unknown_parameter",
                    '"{unknown}" is none of those of {definition}: {known}',
                    unknown=unknown[0],
                    definition=self.name,
                    known=known,
                ),
            )
        if missing:
            raise Problem(
                422,
                "Missing parameter",
                message(
                    "process.missing_parameter",
                    '{definition} cannot start without "{missing}"',
                    definition=self.name,
                    missing=missing[0],
                ),
            )
        return {**{p.name: p.default for p in self.parameters.values()}, **given}


def variable_of(element: str) -> str:
    """Return the name of the process variable for the element `element`."""
    return element.replace("-", "_").replace(".", "_")
