"""Nodes: the flow nodes and sequence flows of scopes, and spans of them."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from handover_bpmn.languages.base import Expression
from handover_bpmn.model.activities import Activity, Call, MultiInstance, StandardLoop
from handover_bpmn.model.events import ConditionalEvent, EntityFilter, Event, MessageEvent, SignalEvent
from handover_bpmn.model.values import Assignment, Value


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

REFUSED: Mapping[str, str] = {
    "transaction": "draw an embedded subprocess with compensation instead",
    "adHocSubProcess": "draw its activities with sequence flows or parallel gateways instead",
    "complexGateway": "draw it with exclusive, inclusive and parallel gateways instead",
}
"""Flow nodes that are no `Kind` yet, and the way out; one that becomes a kind leaves this table."""


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


def entity_filter(node: Node) -> EntityFilter | None:
    """Return the filter of the entities that are the event of a node which waits for it, if it has one."""
    if node.kind in {Kind.END_EVENT, Kind.THROW_EVENT, Kind.SEND_TASK}:
        return None
    event = node.event
    return event.on if isinstance(event, MessageEvent | SignalEvent | ConditionalEvent) else None
