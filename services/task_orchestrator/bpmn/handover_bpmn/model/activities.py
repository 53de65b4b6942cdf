"""Activities: the Tasks that they create, loops, calls and forms."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from handover.formats.durations import Duration
from handover.messages import Message
from handover.tasks.outcomes import reason_of
from handover_bpmn.languages.base import Expression, Json
from handover_bpmn.model.values import Assignment, Value
from handover_datamodels.states import Outcome


@dataclass(frozen=True, slots=True)
class StandardLoop:
    """Repeats an activity while `condition` holds, at most `maximum` times."""

    condition: Expression | None
    test_before: bool = False
    maximum: int | None = None


@dataclass(frozen=True, slots=True)
class MultiInstance:
    """Runs an activity once an item of `collection`, or `cardinality` times.

    Each instance has the variables `loopCounter` (from `first`) and `item_variable`; the body has
    `nrOfInstances`, `nrOfActiveInstances` and `nrOfCompletedInstances`. When `completion` becomes true after
    an instance, the others are cancelled. `output_collection` gets `output_item` of each instance, in their
    order.
    """

    sequential: bool
    cardinality: Value | None = None
    collection: Value | None = None
    item_variable: str | None = None
    completion: Expression | None = None
    output_collection: str | None = None
    output_item: Value | None = None
    first: int = 0


@dataclass(frozen=True, slots=True)
class Call:
    """The process that a call activity runs: its latest version, a fixed one, or one with a version tag.

    Without `inputs` the process starts with no variables, or with all visible ones if `all_inputs`;
    likewise at its end. With `in_order` each of `inputs` and `outputs` sees what those before it yield. `key`
    is its business key.
    """

    process: Value
    version: Value | None = None
    tag: Value | None = None
    inputs: tuple[Assignment, ...] = ()
    outputs: tuple[Assignment, ...] = ()
    all_inputs: bool = False
    all_outputs: bool = False
    key: Value | None = None
    in_order: bool = False


@dataclass(frozen=True, slots=True)
class Place:
    """A place of an activity and its function (`source`, `target`, …)."""

    location: Value
    function: str | None = None


class FormBinding(StrEnum):
    """The version of a form: the latest at the post of the Task or at the deployment, or a number."""

    LATEST = "latest"
    DEPLOYMENT = "deployment"
    VERSION = "version"


@dataclass(frozen=True, slots=True)
class FormReference:
    """A deployed form: its id, or the name of its file if `is_file`."""

    name: str
    binding: FormBinding = FormBinding.LATEST
    version: int | None = None
    is_file: bool = False


@dataclass(frozen=True, slots=True)
class StartForm:
    """The form of the variables that a process is started with: written in the file, or a deployed one."""

    written: Value | None = None
    reference: FormReference | None = None

    def __bool__(self) -> bool:
        return self.written is not None or self.reference is not None


@dataclass(frozen=True, slots=True)
class RetryPolicy:
    """How often a failed Task is posted again.

    The delay before the next attempt is that of its number, and from the last one on multiplied by `factor`.
    """

    attempts: Value
    """How often the activity is tried in all."""
    delays: tuple[Duration, ...] = ()
    factor: float = 1.0
    max_delay: Duration | None = None
    codes: frozenset[str] | None = None
    """The error codes and outcomes that are retried; None: all failures but those that an event catches."""


@dataclass(frozen=True, slots=True)
class Escalation:
    """What happens `after` the due date of a Task that has not ended, or after it was posted without one."""

    after: Duration
    code: str | None = None
    """The BPMN escalation that the activity throws."""
    group: str | None = None
    """A group whose people may claim the Task as well."""


class PerformerLost(StrEnum):
    """What happens with a Task in progress whose performer is lost."""

    ASK = "ask"
    """An incident: a person decides."""
    RETRY = "retry"
    """The Task is posted again."""
    WAIT = "wait"
    """The Task waits for a performer."""


@dataclass(frozen=True, slots=True)
class Activity:
    """The Task that an activity creates each time it is reached."""

    id: str
    name: str
    description: str | None
    lane: str | None
    definition: str
    deadline: Duration | None
    involves: tuple[Value, ...]
    happens_at: tuple[Place, ...]
    parameters: Mapping[str, Value]
    outputs: Mapping[str, str]
    """Process variable -> name in the Task's outputParameters; if empty, all go to `variable`."""
    variable: str
    """The variable for all outputParameters when no outputs are named."""
    handles_outcomes: bool = False
    """Whether the model handles other outcomes than `ok`; otherwise the Task fails."""
    require_pin: bool = False
    """Whether the person who answers its Task gives the own PIN."""
    hints: Mapping[str, str] = field(default_factory=dict)
    """What the dialect says of the performer: assignee, candidateGroups, candidateUsers, topic, jobType, …"""
    role: str | None = None
    """The role that the performer has, if `involves` is empty."""
    skills: tuple[str, ...] = ()
    """The skills that the performer has, if `involves` is empty."""
    materials: tuple[Value, ...] = ()
    """The Materials that its Task uses; an expression may be a list of them."""
    assets: tuple[Value, ...] = ()
    """The Assets that its Task uses, likewise."""
    form: FormReference | None = None
    """The form of its Task; a form that the file contains is the parameter `form`."""
    inputs_schema: Json = None
    """The JSON Schema of the parameters of its Task."""
    spreads_outputs: bool = False
    """Whether each outputParameter becomes a variable of its own name, as Camunda has it."""
    retry: RetryPolicy | None = None
    escalations: tuple[Escalation, ...] = ()
    """The earliest first."""
    performer_lost: PerformerLost = PerformerLost.ASK
    specification: Mapping[str, Value] | None = None
    """The row that is written to the specification database before the Task is posted, by field."""
    texts: Mapping[str, Expression] = field(default_factory=dict)
    """The expressions in its drawn `name` and `description`, as far as they have any."""

    def unhandled(self, outputs: Mapping[str, Any]) -> Message | None:
        """Return why a completed Task counts as failed (an unhandled outcome); None if it does not."""
        outcome = outputs.get("outcome")
        if self.handles_outcomes or outcome is None or outcome == Outcome.OK:
            return None
        note = outputs.get("note")
        return reason_of(str(outcome), str(note) if note else None)

    def results(self, outputs: Mapping[str, Any]) -> dict[str, Any]:
        """Return the process variables from the Task's `outputs`; missing ones are null.

        If outcomes are handled and the performer reported none, the outcome is `ok`.
        """
        if self.handles_outcomes:
            outputs = {"outcome": Outcome.OK.value, **outputs}
        if self.outputs:
            return {variable: outputs.get(source) for variable, source in self.outputs.items()}
        return dict(outputs) if self.spreads_outputs else {self.variable: dict(outputs)}
