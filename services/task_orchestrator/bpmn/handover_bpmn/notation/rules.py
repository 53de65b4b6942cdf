"""Rules of a scope: nodes, sequence flows, events and gateways.

Each fault names the element and the way out. Elements with faults of their own (`broken`) are skipped. If a
node or sequence flow has a fault, the rules that follow the flows are skipped in its scope.
"""

from collections.abc import Iterator, Mapping, Set
from dataclasses import dataclass, field
from functools import cached_property

from handover.messages import message
from handover_bpmn.model import (
    ACTIVITIES,
    GATEWAYS,
    CompensateEvent,
    ConditionalEvent,
    ErrorEvent,
    EscalationEvent,
    Fault,
    Flow,
    Kind,
    LinkEvent,
    MessageEvent,
    Node,
    Scope,
    SignalEvent,
    TimerEvent,
)
from handover_bpmn.notation.paths import Dominators, dominators

MAX_NODES = 3_000
MAX_FLOWS = 6_000
"""Of a process with all its scopes."""

_CONDITIONAL = ACTIVITIES | {Kind.EXCLUSIVE, Kind.INCLUSIVE}
_AWAITED = (MessageEvent, TimerEvent, SignalEvent, ConditionalEvent)


@dataclass
class Checked:
    """What the rules found."""

    faults: list[Fault] = field(default_factory=list)
    warnings: list[Fault] = field(default_factory=list)


def fault_of_size(process: str, line: int, nodes: int, flows: int) -> Fault | None:
    """Return the fault of a process that has too many nodes or flows to be read."""
    if nodes > MAX_NODES:
        text = message(
            "bpmn.too_many_nodes",
            "a process has at most {limit} nodes, not {nodes}; split it",
            limit=MAX_NODES,
            nodes=nodes,
        )
        return Fault(process, line, text)
    if flows > MAX_FLOWS:
        text = message(
            "bpmn.too_many_flows",
            "a process has at most {limit} sequence flows, not {flows}; split it",
            limit=MAX_FLOWS,
            flows=flows,
        )
        return Fault(process, line, text)
    return None


def check_process(scope: Scope, line: int, broken: Set[str]) -> Checked:
    """Return the faults and warnings of a process, which begins in `line`, with all its scopes."""
    scopes = list(scope.walk())
    checked = Checked()
    everywhere = {node for inner in scopes for node in inner.nodes}
    hosts = {
        node.scope.id: node for inner in scopes for node in inner.nodes.values() if node.scope is not None
    }
    for inner in scopes:
        rules = _Rules(inner, hosts.get(inner.id), line, broken, everywhere, checked.warnings)
        checked.faults += rules.faults()
    return checked


def _fault(node: Node, text: str) -> Fault:
    return Fault(node.id, node.line, text, node.name if node.name != node.id else None)


def _flow_fault(flow: Flow, text: str) -> Fault:
    return Fault(flow.id, flow.line, text, flow.name or None)


@dataclass
class _Rules:
    """The rules of one scope; `host` is its subprocess, None for the process."""

    scope: Scope
    host: Node | None
    line: int
    broken: Set[str]
    everywhere: Set[str]
    """The nodes of all scopes of the process."""
    warnings: list[Fault]

    @cached_property
    def incoming(self) -> Mapping[str, list[Flow]]:
        """Return the incoming flows of each node."""
        return self._flows_by("target")

    @cached_property
    def outgoing(self) -> Mapping[str, list[Flow]]:
        """Return the outgoing flows of each node."""
        return self._flows_by("source")

    def _flows_by(self, end: str) -> Mapping[str, list[Flow]]:
        flows: dict[str, list[Flow]] = {name: [] for name in self.scope.nodes}
        for flow in self.scope.flows.values():
            flows.setdefault(getattr(flow, end), []).append(flow)
        return flows

    def faults(self) -> Iterator[Fault]:
        """Yield the faults of this scope, and add its warnings."""
        nodes = self.scope.nodes.values()
        dangling = list(self._dangling())
        yield from dangling
        yield from self._starts()
        for node in nodes:
            if node.id not in self.broken:
                yield from self._of_node(node)
        for flow in self.scope.flows.values():
            self._of_flow(flow)
        yield from self._links()
        is_whole = not dangling and not self.broken & {*self.scope.nodes, *self.scope.flows}
        if is_whole:
            self._unreachable()
            yield from self._waiting_for_themselves()

    # Flows

    def _dangling(self) -> Iterator[Fault]:
        for flow in self.scope.flows.values():
            if flow.id in self.broken:
                continue
            for end, name in (("sourceRef", flow.source), ("targetRef", flow.target)):
                if name in self.scope.nodes:
                    continue
                if name in self.everywhere:
                    yield _flow_fault(
                        flow,
                        message(
                            "bpmn.flow_between_scopes",
                            'the sequence flow crosses the border of a subprocess: {end} "{name}" is in '
                            "another scope; end it at the subprocess itself or at a boundary event",
                            end=end,
                            name=name,
                        ),
                    )
                else:
                    yield _flow_fault(
                        flow,
                        message(
                            "bpmn.dangling_flow",
                            'the sequence flow dangles: {end} "{name}" is no node of the process',
                            end=end,
                            name=name,
                        ),
                    )

    def _of_flow(self, flow: Flow) -> None:
        source = self.scope.nodes.get(flow.source)
        if flow.condition is None or source is None or flow.id in self.broken:
            return
        if source.kind not in _CONDITIONAL:
            self.warnings.append(
                _flow_fault(
                    flow,
                    message(
                        "bpmn.condition_without_effect",
                        'the condition has no effect behind the {kind} "{source}"; put it behind an '
                        "exclusive or inclusive gateway",
                        kind=source.kind.value,
                        source=source.name,
                    ),
                )
            )
        elif flow.id == source.default:
            self.warnings.append(
                _flow_fault(
                    flow,
                    message(
                        "bpmn.condition_of_default",
                        "the condition has no effect, since this is the default flow",
                    ),
                )
            )

    # Starts and ends

    def _starts(self) -> Iterator[Fault]:
        starts = [node for node in self.scope.nodes.values() if node.kind is Kind.START_EVENT]
        owner = self.host
        name, line = (self.scope.id, self.line) if owner is None else (owner.id, owner.line)
        drawn = None if owner is None or owner.name == owner.id else owner.name
        if name in self.broken and not self.scope.nodes:
            return
        if owner is not None and owner.triggered_by_event:
            if len(starts) != 1 and name not in self.broken:
                yield Fault(
                    name,
                    line,
                    message(
                        "bpmn.event_subprocess_start",
                        "an event subprocess has one start event, this one has {number}",
                        number=len(starts),
                    ),
                    drawn,
                )
            return
        plain = [start for start in starts if start.event is None and start.id not in self.broken]
        for start in plain[1:]:
            yield _fault(
                start,
                message(
                    "bpmn.second_none_start",
                    "a process or subprocess has one start event without event definition, this is another; "
                    "start with one and a parallel gateway",
                ),
            )
        if owner is not None:
            for start in starts:
                if start.event is not None:
                    yield _fault(
                        start,
                        message(
                            "bpmn.triggered_subprocess_start",
                            "the start event of a subprocess has no event definition; "
                            'make it an event subprocess (triggeredByEvent="true") or remove the definition',
                        ),
                    )
        if owner is not None and not self.scope.nodes:
            text = message(
                "bpmn.empty_subprocess", "the subprocess is empty; draw its content, or make it a task"
            )
            yield Fault(name, line, text, drawn)
        elif not starts and not any(self._can_start(node) for node in self.scope.nodes.values()):
            yield Fault(
                name,
                line,
                message(
                    "bpmn.no_start",
                    "it has no start event and no other node where it could start; draw a start event",
                ),
                drawn,
            )

    def _can_start(self, node: Node) -> bool:
        if self.incoming[node.id] or node.kind is Kind.BOUNDARY_EVENT or node.triggered_by_event:
            return False
        is_link = node.kind is Kind.CATCH_EVENT and isinstance(node.event, LinkEvent)
        return not (node.is_for_compensation or is_link)

    # Nodes

    def _of_node(self, node: Node) -> Iterator[Fault]:
        incoming, outgoing = self.incoming[node.id], self.outgoing[node.id]
        kind = node.kind.value
        if node.kind in {Kind.START_EVENT, Kind.BOUNDARY_EVENT} and incoming:
            yield _fault(
                node,
                message(
                    "bpmn.incoming_flow_forbidden",
                    "no sequence flow may lead to a {kind}",
                    kind=kind,
                ),
            )
        if node.kind is Kind.END_EVENT and outgoing:
            yield _fault(
                node, message("bpmn.outgoing_flow_forbidden", "no sequence flow may leave an endEvent")
            )
        if (node.triggered_by_event or node.is_for_compensation) and (incoming or outgoing):
            yield _fault(
                node,
                message(
                    "bpmn.flows_forbidden",
                    "no sequence flow may lead to or leave {what}",
                    what="an event subprocess" if node.triggered_by_event else "a compensation activity",
                ),
            )
        is_join = node.kind in GATEWAYS - {Kind.EVENT_BASED} and len(incoming) > 1
        if node.kind in GATEWAYS and not outgoing and not is_join:
            yield _fault(
                node,
                message(
                    "bpmn.no_outgoing_flow",
                    "no sequence flow leaves this {kind}, and only a join of several flows may be an end; "
                    "connect it with what follows, or draw an end event in its place",
                    kind=kind,
                ),
            )
        if node.default is not None and node.default not in {flow.id for flow in outgoing}:
            yield _fault(
                node,
                message(
                    "bpmn.wrong_default_flow",
                    'its default flow "{default}" does not leave it',
                    default=node.default,
                ),
            )
        if node.kind is Kind.BOUNDARY_EVENT:
            yield from self._of_boundary(node)
        if node.kind is Kind.EXCLUSIVE:
            yield from self._of_choice(node, outgoing)
        if node.kind is Kind.EVENT_BASED:
            yield from self._of_event_gateway(node, outgoing)
        if isinstance(node.event, CompensateEvent) and node.event.activity is not None:
            yield from self._of_compensation(node, node.event.activity)
        if self._is_unintended_end(node):
            self.warnings.append(
                _fault(
                    node,
                    message("bpmn.implicit_end", "no sequence flow leaves it, so this path ends here"),
                )
            )

    def _is_unintended_end(self, node: Node) -> bool:
        """Return whether a path ends without an end event, in a scope that has end events."""
        if self.outgoing[node.id] or node.kind is Kind.END_EVENT:
            return False
        if node.kind in GATEWAYS and len(self.incoming[node.id]) < 2:
            return False  # a fault
        if node.triggered_by_event or node.is_for_compensation:
            return False
        if node.kind is Kind.SEND_TASK and node.activity is not None:
            return False  # it may be a message end event
        if isinstance(node.event, CompensateEvent | LinkEvent):
            return False
        return self._has_end_events

    @cached_property
    def _has_end_events(self) -> bool:
        return any(node.kind is Kind.END_EVENT for node in self.scope.nodes.values())

    def _of_boundary(self, node: Node) -> Iterator[Fault]:
        host = self.scope.nodes.get(node.attached_to or "")
        if host is None or host.kind not in ACTIVITIES:
            yield _fault(
                node,
                message(
                    "bpmn.unknown_attached_task",
                    'attachedToRef "{attached_to}" names no task that can be interrupted',
                    attached_to=node.attached_to,
                ),
            )
            return
        if isinstance(node.event, ErrorEvent) and not node.interrupting:
            yield _fault(
                node,
                message(
                    "bpmn.error_event_not_interrupting",
                    'an error boundary event interrupts; set cancelActivity="true"',
                ),
            )
        if isinstance(node.event, CompensateEvent):
            yield from self._of_compensation_boundary(node)
        elif isinstance(node.event, ErrorEvent | EscalationEvent):
            first = self._catchers[node.attached_to, type(node.event), node.event.code]
            if first is not node:
                yield _fault(
                    node,
                    message(
                        "bpmn.error_caught_twice",
                        '"{name}" catches the same error of the same task already',
                        name=first.name,
                    ),
                )

    @cached_property
    def _catchers(self) -> Mapping[tuple[str | None, type, str | None], Node]:
        """Return the first boundary event that catches an error or escalation of an activity."""
        catchers: dict[tuple[str | None, type, str | None], Node] = {}
        for node in self.scope.nodes.values():
            if node.kind is Kind.BOUNDARY_EVENT and isinstance(node.event, ErrorEvent | EscalationEvent):
                catchers.setdefault((node.attached_to, type(node.event), node.event.code), node)
        return catchers

    def _of_compensation_boundary(self, node: Node) -> Iterator[Fault]:
        handler = self.scope.nodes.get(self.scope.handlers.get(node.id, ""))
        if handler is None or not handler.is_for_compensation:
            yield _fault(
                node,
                message(
                    "bpmn.no_compensation_handler",
                    "the compensation boundary event has no handler; connect it by an association with an "
                    'activity that has isForCompensation="true"',
                ),
            )
        if self.outgoing[node.id]:
            yield _fault(
                node,
                message(
                    "bpmn.compensation_by_flow",
                    "no sequence flow leaves a compensation boundary event; "
                    "connect the compensation activity by an association",
                ),
            )

    def _of_compensation(self, node: Node, activity: str) -> Iterator[Fault]:
        if activity not in self.everywhere:
            yield _fault(
                node,
                message(
                    "bpmn.unknown_compensated",
                    'activityRef "{activity}" names no activity of the process',
                    activity=activity,
                ),
            )

    def _of_choice(self, node: Node, outgoing: list[Flow]) -> Iterator[Fault]:
        if len(outgoing) < 2:
            return
        for flow in outgoing:
            if flow.condition is None and flow.id != node.default and flow.id not in self.broken:
                rule = "has no condition and is not the gateway's default"
                yield _fault(
                    node,
                    message(
                        "bpmn.flow_without_condition",
                        'its flow "{flow}" to "{target}" {rule}; give it one',
                        flow=flow.name or flow.id,
                        target=self._name(flow.target),
                        rule=rule,
                    ),
                )

    def _name(self, id_: str) -> str:
        node = self.scope.nodes.get(id_)
        return id_ if node is None else node.name

    def _of_event_gateway(self, node: Node, outgoing: list[Flow]) -> Iterator[Fault]:
        for flow in outgoing:
            target = self.scope.nodes.get(flow.target)
            if target is None or target.id in self.broken:
                continue
            is_event = target.kind is Kind.CATCH_EVENT and isinstance(target.event, _AWAITED)
            is_receiver = target.kind is Kind.RECEIVE_TASK and isinstance(target.event, MessageEvent)
            if not is_event and not is_receiver:
                yield _fault(
                    node,
                    message(
                        "bpmn.event_gateway_target",
                        'its flow leads to "{target}"; behind an eventBasedGateway stand catching message, '
                        "timer, signal and conditional events, and receive tasks",
                        target=target.name,
                    ),
                )

    # Links

    def _links(self) -> Iterator[Fault]:
        throwing: dict[str, list[Node]] = {}
        catching: dict[str, list[Node]] = {}
        for node in self.scope.nodes.values():
            if isinstance(node.event, LinkEvent):
                ends = throwing if node.kind is Kind.THROW_EVENT else catching
                ends.setdefault(node.event.name, []).append(node)
        for name, nodes in throwing.items():
            if name not in catching:
                for node in nodes:
                    yield _fault(
                        node,
                        message(
                            "bpmn.link_without_target",
                            'no catching link event is called "{name}" in this scope; draw it or name it so',
                            name=name,
                        ),
                    )
                    if self.outgoing[node.id]:
                        break
        for name, nodes in catching.items():
            for node in nodes[1:]:
                yield _fault(
                    node,
                    message(
                        "bpmn.link_target_twice",
                        'another catching link event is called "{name}" already; give one another name',
                        name=name,
                    ),
                )

    # Paths

    def _unreachable(self) -> None:
        reached = self._reached()
        led_to = {flow.target for flow in self.scope.flows.values()}
        for node in self.scope.nodes.values():
            if node.id in reached or node.triggered_by_event or node.is_for_compensation:
                continue
            if node.kind is Kind.BOUNDARY_EVENT:
                continue
            if node.id in led_to:
                text = message("bpmn.unreachable", "it cannot be reached from the start event")
            else:
                text = message(
                    "bpmn.no_incoming_flow", "no sequence flow leads to this {kind}", kind=node.kind.value
                )
            self.warnings.append(_fault(node, text))

    def _waiting_for_themselves(self) -> Iterator[Fault]:
        """Yield the parallel joins that wait for a token that only comes after them."""
        joins = [
            node
            for node in self.scope.nodes.values()
            if node.kind is Kind.PARALLEL and len(self.incoming[node.id]) > 1
        ]
        dominated = dominators(self._successors, self._start_nodes()) if joins else Dominators({}, {})
        for node in joins:
            for flow in self.incoming[node.id]:
                if dominated.dominates(node.id, flow.source):
                    rule = "comes only after the gateway itself, so the gateway would never continue"
                    way_out = "put an exclusive gateway before it, where the loop returns"
                    yield _fault(
                        node,
                        message(
                            "bpmn.wrong_flow",
                            'its flow "{flow}" {rule}; {way_out}',
                            flow=flow.id,
                            rule=rule,
                            way_out=way_out,
                        ),
                    )

    def _start_nodes(self) -> list[str]:
        starts = [node.id for node in self.scope.nodes.values() if node.kind is Kind.START_EVENT]
        return starts or [node.id for node in self.scope.nodes.values() if self._can_start(node)]

    def _successors(self, id_: str) -> list[str]:
        """Return the nodes that a token can reach from a node in one step."""
        event = self.scope.nodes[id_].event
        links = self._link_targets.get(event.name, []) if isinstance(event, LinkEvent) else []
        return [*(flow.target for flow in self.outgoing[id_]), *self._attached.get(id_, []), *links]

    def _reached(self) -> Set[str]:
        """Return the nodes that a token can reach from the start events."""
        reached: set[str] = set()
        stack = self._start_nodes()
        while stack:
            here = stack.pop()
            if here not in reached:
                reached.add(here)
                stack += self._successors(here)
        return reached

    @cached_property
    def _attached(self) -> Mapping[str, list[str]]:
        attached: dict[str, list[str]] = {}
        for node in self.scope.nodes.values():
            if node.attached_to is not None:
                attached.setdefault(node.attached_to, []).append(node.id)
        return attached

    @cached_property
    def _link_targets(self) -> Mapping[str, list[str]]:
        targets: dict[str, list[str]] = {}
        for node in self.scope.nodes.values():
            if isinstance(node.event, LinkEvent) and node.kind is Kind.CATCH_EVENT:
                targets.setdefault(node.event.name, []).append(node.id)
        return targets
