"""Definition: the content of a valid BPMN file.

An activity has the attributes of our extension elements: TaskDefinition, involved resources, places,
parameters and the use of its results.
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
from services.task_orchestrator.languages.native import Expression

MAX_FAULTS_LISTED = 100


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault of a BPMN file: element (if any), line and rule."""

    element: str | None
    line: int | None
    message: str

    def __str__(self) -> str:
        where = f'"{self.element}"' if self.element else "the file"
        return f"line {self.line}, {where}: {self.message}" if self.line else f"{where}: {self.message}"


class BadBpmn(Problem):
    """A BPMN file cannot be deployed; `faults` are all its faults."""

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
    """A literal value, or an expression over the process variables."""

    literal: Any = None
    expression: Expression | None = None

    def value(self, variables: Mapping[str, Any]) -> Any:
        """Return the value; raise `ExpressionError` if a variable is missing or has the wrong type."""
        return self.literal if self.expression is None else self.expression.value(variables)


@dataclass(frozen=True, slots=True)
class Place:
    """A place of an activity and its function (`source`, `target`, …)."""

    location: Given
    function: str | None = None


@dataclass(frozen=True, slots=True)
class Activity:
    """A step of the process for a person or a robot; it creates a Task each time it is reached."""

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
    """Whether the model handles other outcomes than `ok`; otherwise the Task fails."""

    def unhandled(self, outputs: Mapping[str, Any]) -> Message | None:
        """Return why a completed Task counts as failed (an unhandled outcome); None if it does not."""
        outcome = outputs.get("outcome")
        if self.handles_outcomes or outcome is None or outcome == Outcome.OK:
            return None
        note = outputs.get("note")
        return reason_of(str(outcome), str(note) if note else None)

    @property
    def variable(self) -> str:
        """Return the variable for all outputParameters when no outputs are named."""
        return variable_of(self.id)

    def results(self, outputs: Mapping[str, Any]) -> dict[str, Any]:
        """Return the process variables from the Task's `outputs`; missing ones are null.

        If outcomes are handled and the performer reported none, the outcome is `ok`.
        """
        if self.handles_outcomes:
            outputs = {"outcome": Outcome.OK.value, **outputs}
        if not self.outputs:
            return {self.variable: dict(outputs)}
        return {variable: outputs.get(source) for variable, source in self.outputs.items()}


@dataclass(frozen=True, slots=True)
class ProcessParameter:
    """A parameter of a process."""

    name: str
    required: bool
    default: Any = None


class Kind(Enum):
    """The kind of a node; the value is its BPMN name."""

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
    """The trigger of an event; the value is its BPMN name."""

    NONE = "none"
    TIMER = "timerEventDefinition"
    ERROR = "errorEventDefinition"
    TERMINATE = "terminateEventDefinition"


@dataclass(frozen=True, slots=True)
class Node:
    """A flow node."""

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
    """A sequence flow."""

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
    """The version label of the author, if any."""
    description: str | None
    parameters: Mapping[str, ProcessParameter]
    activities: Mapping[str, Activity]
    nodes: Mapping[str, Node]
    flows: Mapping[str, Flow]
    xml: bytes

    def arguments(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Return the initial variables of a process, including defaults.

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
                    '"{unknown}" is no parameter of {definition}; its parameters are: {known}',
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
