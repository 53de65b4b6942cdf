"""Model: an executable process as values, independent of the dialect of the file that it was read from.

`notation` makes it from a file, `execution` runs it. The names are those of BPMN 2.0.2 (ISO/IEC 19510).
Elements without effect on the execution (artifacts, data stores, diagrams) are not part of it.
"""

import hashlib
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Final, TypeAlias

import orjson

from handover.errors import Problem
from handover.formats.durations import Duration
from handover.messages import Message, message
from handover.tasks.outcomes import reason_of
from handover_bpmn.languages.base import Expression, Json, Variables, quote_names
from handover_datamodels.states import Outcome

KEY_LENGTH: Final = 32
"""Characters of the key of an entity filter."""


@dataclass(frozen=True, slots=True)
class Value:
    """A literal, or an expression over the process variables."""

    literal: Json = None
    expression: Expression | None = None

    def value(self, variables: Variables) -> Json:
        """Return the value; raise `ExpressionError` if a variable is missing or has the wrong type."""
        return self.literal if self.expression is None else self.expression.value(variables)


@dataclass(frozen=True, slots=True)
class Assignment:
    """`target` (a variable, or a parameter of a Task) gets `value`."""

    target: str
    value: Value


# Events


class TimerType(StrEnum):
    """The three kinds of timers; the value is the name of the BPMN element."""

    DATE = "timeDate"
    DURATION = "timeDuration"
    CYCLE = "timeCycle"


@dataclass(frozen=True, slots=True)
class TimerEvent:
    """Due at a moment, after a duration, or repeatedly (`R3/PT1M`, or cron)."""

    type: TimerType
    value: Value


@dataclass(frozen=True, slots=True)
class EntityFilter:
    """The NGSI-LD entities whose creation or change is the message, signal or condition (`handover:on`)."""

    type: str
    id_pattern: str | None = None
    q: str | None = None
    variable: str = "entity"
    """The variable that gets the entity, in simplified (keyValues) form."""
    correlation: Expression | None = None
    """Its value for an entity must equal the key of the event or, without one, that of the process."""

    @property
    def key(self) -> str:
        """Return the id of what is selected: filters that select the same entities have the same."""
        selected = orjson.dumps([self.type, self.id_pattern, self.q])
        return hashlib.sha256(selected).hexdigest()[:KEY_LENGTH]

    def correlated(self, entity: Mapping[str, Any]) -> Json:
        """Return the key that `entity` is for; None if it has none.

        Raises `ExpressionError` if the correlation cannot be evaluated for this entity.
        """
        return None if self.correlation is None else self.correlation.value({self.variable: entity})


@dataclass(frozen=True, slots=True)
class MessageEvent:
    """A message; `correlation` is the key that sender and receiver must agree on (None: any)."""

    name: Value
    correlation: Value | None = None
    on: EntityFilter | None = None


@dataclass(frozen=True, slots=True)
class SignalEvent:
    """A signal: everyone who waits for its name gets it."""

    name: Value
    on: EntityFilter | None = None


@dataclass(frozen=True, slots=True)
class ErrorEvent:
    """An error; without `code` it catches every error. The variables get code and reason of a caught one."""

    code: str | None = None
    code_variable: str | None = None
    message_variable: str | None = None


@dataclass(frozen=True, slots=True)
class EscalationEvent:
    """An escalation; without `code` it catches every escalation."""

    code: str | None = None
    code_variable: str | None = None


@dataclass(frozen=True, slots=True)
class ConditionalEvent:
    """Occurs when `condition` becomes true; with `on`, when it becomes true for an entity."""

    condition: Expression
    on: EntityFilter | None = None


@dataclass(frozen=True, slots=True)
class CompensateEvent:
    """Compensation: of `activity`, or of all completed activities of the scope."""

    activity: str | None = None


@dataclass(frozen=True, slots=True)
class LinkEvent:
    """A link: the throwing event continues at the catching one of the same name and scope."""

    name: str


@dataclass(frozen=True, slots=True)
class TerminateEvent:
    """Ends its scope with all its tokens."""


Event: TypeAlias = (
    TimerEvent
    | MessageEvent
    | SignalEvent
    | ErrorEvent
    | EscalationEvent
    | ConditionalEvent
    | CompensateEvent
    | LinkEvent
    | TerminateEvent
)
"""The definition of an event; an event without one is a none event."""


# Activities


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


# Nodes and scopes


class Kind(StrEnum):
    """The kind of a flow node; the value is its BPMN name."""

    START_EVENT = "startEvent"
    END_EVENT = "endEvent"
    CATCH_EVENT = "intermediateCatchEvent"
    THROW_EVENT = "intermediateThrowEvent"
    BOUNDARY_EVENT = "boundaryEvent"
    TASK = "task"
    USER_TASK = "userTask"
    MANUAL_TASK = "manualTask"
    SERVICE_TASK = "serviceTask"
    SEND_TASK = "sendTask"
    RECEIVE_TASK = "receiveTask"
    BUSINESS_RULE_TASK = "businessRuleTask"
    SCRIPT_TASK = "scriptTask"
    SUB_PROCESS = "subProcess"
    CALL_ACTIVITY = "callActivity"
    EXCLUSIVE = "exclusiveGateway"
    INCLUSIVE = "inclusiveGateway"
    PARALLEL = "parallelGateway"
    EVENT_BASED = "eventBasedGateway"


EVENTS = frozenset(
    {Kind.START_EVENT, Kind.END_EVENT, Kind.CATCH_EVENT, Kind.THROW_EVENT, Kind.BOUNDARY_EVENT}
)
GATEWAYS = frozenset({Kind.EXCLUSIVE, Kind.INCLUSIVE, Kind.PARALLEL, Kind.EVENT_BASED})
ACTIVITIES = frozenset(Kind) - EVENTS - GATEWAYS


@dataclass(frozen=True, slots=True)
class DataAssociation:
    """Copies a data object to an input of an activity, or an output of it to a data object.

    `data` is the id of the data object, `name` the parameter or the result (None: all results).
    """

    data: str
    name: str | None


@dataclass(frozen=True, slots=True)
class Node:
    """A flow node.

    What an activity does is one of: `activity` creates a Task for a performer; `script` assigns variables;
    `scope` is the content of a subprocess; `call` runs another process; `event` of a receiveTask is waited
    for, of a sendTask without `activity` is thrown. Without any of these the token passes.
    """

    id: str
    kind: Kind
    name: str
    line: int = 0
    event: Event | None = None
    default: str | None = None
    """The sequence flow that is taken if no condition holds."""
    attached_to: str | None = None
    interrupting: bool = True
    """Of a boundary event, or of the start event of an event subprocess."""
    activity: Activity | None = None
    script: tuple[Assignment, ...] | None = None
    scope: "Scope | None" = None
    call: Call | None = None
    triggered_by_event: bool = False
    """Whether it is an event subprocess."""
    is_for_compensation: bool = False
    loop: StandardLoop | MultiInstance | None = None
    inputs: tuple[Assignment, ...] = ()
    """Local variables that the activity gets before it starts."""
    outputs: tuple[Assignment, ...] = ()
    """Variables of the enclosing scope that it sets at its end; if empty, its results go there."""
    data_inputs: tuple[DataAssociation, ...] = ()
    data_outputs: tuple[DataAssociation, ...] = ()


@dataclass(frozen=True, slots=True)
class Flow:
    """A sequence flow."""

    id: str
    source: str
    target: str
    condition: Expression | None = None
    name: str = ""
    line: int = 0


class SpanKind(StrEnum):
    """The kinds of spans."""

    SCOPE = "scope"
    """A process or subprocess: all its nodes."""
    GROUP = "group"
    LANE = "lane"


@dataclass(frozen=True, slots=True)
class Span:
    """Nodes of one scope during which resources are reserved (`handover:reserve`)."""

    id: str
    name: str
    kind: SpanKind
    needs: tuple[Value, ...]
    """Each value is a text that names what is reserved, or a list of such texts."""
    members: frozenset[str]
    line: int = 0


@dataclass(frozen=True, slots=True)
class Scope:
    """The content of a process or of a subprocess; `id` is that of the process or subprocess."""

    id: str
    nodes: Mapping[str, Node]
    flows: Mapping[str, Flow]
    handlers: Mapping[str, str] = field(default_factory=dict)
    """Compensation boundary event -> the activity that compensates (by association)."""
    data_objects: Mapping[str, str] = field(default_factory=dict)
    """Data object -> its name."""
    spans: tuple[Span, ...] = ()

    def walk(self) -> Iterator["Scope"]:
        """Yield this scope and all scopes within it."""
        yield self
        for node in self.nodes.values():
            if node.scope is not None:
                yield from node.scope.walk()


@dataclass(frozen=True, slots=True)
class ProcessParameter:
    """A parameter of a process."""

    name: str
    required: bool
    default: Any = None


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault of a BPMN file, or a warning: element (if any) with its drawn name, line, and rule."""

    element: str | None
    line: int | None
    message: str
    name: str | None = None

    def __str__(self) -> str:
        drawn = f' ("{self.name}")' if self.name and self.name != self.element else ""
        where = f'"{self.element}"{drawn}' if self.element else drawn[2:-1] or "the file"
        return f"line {self.line}, {where}: {self.message}" if self.line else f"{where}: {self.message}"


@dataclass(frozen=True, slots=True)
class Definition:
    """A process that can be started."""

    name: str
    """The id of the process in the file."""
    title: str
    label: str | None
    """The version label (version tag) of the author, if any."""
    description: str | None
    parameters: Mapping[str, ProcessParameter]
    scope: Scope
    xml: bytes = field(repr=False)
    warnings: tuple[Fault, ...] = ()
    source: str | None = None
    """The ProcessDefinition of another system that it was deployed from."""
    start_form: StartForm = StartForm()
    """That of the none start event."""
    naming: Expression | None = None
    """Yields the title of a process."""
    translations: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    """The texts of the file in other languages: by language (BCP 47), then by the text of the file."""

    def scopes(self) -> Iterator[Scope]:
        """Yield all scopes, the process first."""
        return self.scope.walk()

    def nodes(self) -> Iterator[Node]:
        """Yield the nodes of all scopes."""
        for scope in self.scopes():
            yield from scope.nodes.values()

    def entity_events(self) -> tuple[Node, ...]:
        """Return the nodes whose event is the creation or change of an entity."""
        return tuple(node for node in self.nodes() if entity_filter(node) is not None)

    @property
    def is_event_driven(self) -> bool:
        """Return whether messages, signals or entities can start a process or change a running one.

        Only such a definition has to be known before somebody starts a process of it.
        """
        events = [node.event for node in self.scope.nodes.values() if node.kind is Kind.START_EVENT]
        return bool(self.entity_events()) or any(
            isinstance(event, MessageEvent | SignalEvent | ConditionalEvent) for event in events
        )

    def activities(self) -> dict[str, Activity]:
        """Return the activities that create Tasks, by the id of their node."""
        return {node.id: node.activity for node in self.nodes() if node.activity is not None}

    def arguments(self, given: Mapping[str, Any], form: Collection[str] = ()) -> dict[str, Any]:
        """Return the initial variables of a process, including defaults.

        `form` are the names of the variables of its start form. Raises `Problem` 422 when one is missing or
        unknown.
        """
        unknown = sorted(set(given) - set(self.parameters) - set(form)) if self.parameters else []
        missing = sorted(p.name for p in self.parameters.values() if p.required and p.name not in given)
        if unknown:
            known = quote_names(self.parameters)
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


def entity_filter(node: Node) -> EntityFilter | None:
    """Return the filter of the entities that are the event of a node which waits for it, if it has one."""
    if node.kind in {Kind.END_EVENT, Kind.THROW_EVENT, Kind.SEND_TASK}:
        return None
    event = node.event
    return event.on if isinstance(event, MessageEvent | SignalEvent | ConditionalEvent) else None
