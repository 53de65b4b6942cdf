"""Rules of a scope: nodes, sequence flows, events and gateways.

Each fault names the element and the way out. Elements with faults of their own (`broken`) are skipped. If a
node or sequence flow has a fault, the rules that follow the flows are skipped in its scope.
"""

from collections.abc import Iterator, Set
from dataclasses import dataclass, field

from handover.messages import message
from handover_bpmn.model import (
    GATEWAYS,
    CompensateEvent,
    Fault,
    Flow,
    Kind,
    LinkEvent,
    Node,
    Scope,
)
from handover_bpmn.notation.nodes.table import NODE_TYPES
from handover_bpmn.notation.paths import Dominators, dominators
from handover_bpmn.notation.scope_graph import ScopeGraph, flow_fault, node_fault

MAX_NODES = 3_000
MAX_FLOWS = 6_000
"""Of a process with all its scopes."""


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
        rules = _Rules(ScopeGraph(inner, hosts.get(inner.id), line, broken, everywhere), checked.warnings)
        checked.faults += rules.faults()
    return checked


@dataclass
class _Rules:
    """The rules of one scope."""

    graph: ScopeGraph
    warnings: list[Fault]

    @property
    def scope(self) -> Scope:
        return self.graph.scope

    @property
    def broken(self) -> Set[str]:
        return self.graph.broken

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
                if name in self.graph.everywhere:
                    yield flow_fault(
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
                    yield flow_fault(
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
        if not NODE_TYPES[source.kind].has_conditions:
            self.warnings.append(
                flow_fault(
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
                flow_fault(
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
        owner = self.graph.host
        name, line = (self.scope.id, self.graph.line) if owner is None else (owner.id, owner.line)
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
            yield node_fault(
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
                    yield node_fault(
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
        elif not starts and not any(self.graph.can_start(node) for node in self.scope.nodes.values()):
            yield Fault(
                name,
                line,
                message(
                    "bpmn.no_start",
                    "it has no start event and no other node where it could start; draw a start event",
                ),
                drawn,
            )

    # Nodes

    def _of_node(self, node: Node) -> Iterator[Fault]:
        incoming, outgoing = self.graph.incoming[node.id], self.graph.outgoing[node.id]
        kind, type_ = node.kind.value, NODE_TYPES[node.kind]
        if not type_.has_incoming and incoming:
            yield node_fault(
                node,
                message(
                    "bpmn.incoming_flow_forbidden",
                    "no sequence flow may lead to a {kind}",
                    kind=kind,
                ),
            )
        if not type_.has_outgoing and outgoing:
            yield node_fault(
                node, message("bpmn.outgoing_flow_forbidden", "no sequence flow may leave an endEvent")
            )
        if (node.triggered_by_event or node.is_for_compensation) and (incoming or outgoing):
            yield node_fault(
                node,
                message(
                    "bpmn.flows_forbidden",
                    "no sequence flow may lead to or leave {what}",
                    what="an event subprocess" if node.triggered_by_event else "a compensation activity",
                ),
            )
        is_join = type_.joins and len(incoming) > 1
        if node.kind in GATEWAYS and not outgoing and not is_join:
            yield node_fault(
                node,
                message(
                    "bpmn.no_outgoing_flow",
                    "no sequence flow leaves this {kind}, and only a join of several flows may be an end; "
                    "connect it with what follows, or draw an end event in its place",
                    kind=kind,
                ),
            )
        if node.default is not None and node.default not in {flow.id for flow in outgoing}:
            yield node_fault(
                node,
                message(
                    "bpmn.wrong_default_flow",
                    'its default flow "{default}" does not leave it',
                    default=node.default,
                ),
            )
        yield from type_.check(node, self.graph)
        if isinstance(node.event, CompensateEvent) and node.event.activity is not None:
            yield from self._of_compensation(node, node.event.activity)
        if self._is_unintended_end(node):
            self.warnings.append(
                node_fault(
                    node,
                    message("bpmn.implicit_end", "no sequence flow leaves it, so this path ends here"),
                )
            )

    def _is_unintended_end(self, node: Node) -> bool:
        """Return whether a path ends without an end event, in a scope that has end events."""
        if self.graph.outgoing[node.id] or node.kind is Kind.END_EVENT:
            return False
        if node.kind in GATEWAYS and len(self.graph.incoming[node.id]) < 2:
            return False  # a fault
        if node.triggered_by_event or node.is_for_compensation:
            return False
        if node.kind is Kind.SEND_TASK and node.activity is not None:
            return False  # it may be a message end event
        if isinstance(node.event, CompensateEvent | LinkEvent):
            return False
        return self.graph.has_end_events

    def _of_compensation(self, node: Node, activity: str) -> Iterator[Fault]:
        if activity not in self.graph.everywhere:
            yield node_fault(
                node,
                message(
                    "bpmn.unknown_compensated",
                    'activityRef "{activity}" names no activity of the process',
                    activity=activity,
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
                    yield node_fault(
                        node,
                        message(
                            "bpmn.link_without_target",
                            'no catching link event is called "{name}" in this scope; draw it or name it so',
                            name=name,
                        ),
                    )
                    if self.graph.outgoing[node.id]:
                        break
        for name, nodes in catching.items():
            for node in nodes[1:]:
                yield node_fault(
                    node,
                    message(
                        "bpmn.link_target_twice",
                        'another catching link event is called "{name}" already; give one another name',
                        name=name,
                    ),
                )

    # Paths

    def _unreachable(self) -> None:
        reached = self.graph.reached()
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
            self.warnings.append(node_fault(node, text))

    def _waiting_for_themselves(self) -> Iterator[Fault]:
        """Yield the parallel joins that wait for a token that only comes after them."""
        joins = [
            node
            for node in self.scope.nodes.values()
            if node.kind is Kind.PARALLEL and len(self.graph.incoming[node.id]) > 1
        ]
        dominated = (
            dominators(self.graph.successors, self.graph.start_nodes()) if joins else Dominators({}, {})
        )
        for node in joins:
            for flow in self.graph.incoming[node.id]:
                if dominated.dominates(node.id, flow.source):
                    rule = "comes only after the gateway itself, so the gateway would never continue"
                    way_out = "put an exclusive gateway before it, where the loop returns"
                    yield node_fault(
                        node,
                        message(
                            "bpmn.wrong_flow",
                            'its flow "{flow}" {rule}; {way_out}',
                            flow=flow.id,
                            rule=rule,
                            way_out=way_out,
                        ),
                    )
