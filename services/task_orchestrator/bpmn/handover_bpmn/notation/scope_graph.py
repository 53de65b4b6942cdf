"""A scope as a graph: what leads to and leaves each node, for the rules."""

from collections.abc import Mapping, Set
from dataclasses import dataclass
from functools import cached_property

from handover_bpmn.model import ErrorEvent, EscalationEvent, Fault, Flow, Kind, LinkEvent, Node, Scope


def node_fault(node: Node, text: str) -> Fault:
    """Return a fault of a node."""
    return Fault(node.id, node.line, text, node.name if node.name != node.id else None)


def flow_fault(flow: Flow, text: str) -> Fault:
    """Return a fault of a sequence flow."""
    return Fault(flow.id, flow.line, text, flow.name or None)


@dataclass
class ScopeGraph:
    """The graph of one scope; `host` is its subprocess, None for the process."""

    scope: Scope
    host: Node | None
    line: int
    broken: Set[str]
    everywhere: Set[str]
    """The nodes of all scopes of the process."""

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

    def can_start(self, node: Node) -> bool:
        """Return whether a process may start at a node although nothing leads to it."""
        if self.incoming[node.id] or node.kind is Kind.BOUNDARY_EVENT or node.triggered_by_event:
            return False
        is_link = node.kind is Kind.CATCH_EVENT and isinstance(node.event, LinkEvent)
        return not (node.is_for_compensation or is_link)

    @cached_property
    def has_end_events(self) -> bool:
        """Return whether the scope has end events."""
        return any(node.kind is Kind.END_EVENT for node in self.scope.nodes.values())

    @cached_property
    def catchers(self) -> Mapping[tuple[str | None, type, str | None], Node]:
        """Return the first boundary event that catches an error or escalation of an activity."""
        catchers: dict[tuple[str | None, type, str | None], Node] = {}
        for node in self.scope.nodes.values():
            if node.kind is Kind.BOUNDARY_EVENT and isinstance(node.event, ErrorEvent | EscalationEvent):
                catchers.setdefault((node.attached_to, type(node.event), node.event.code), node)
        return catchers

    def name_of(self, id_: str) -> str:
        """Return the drawn name of a node, or its id."""
        node = self.scope.nodes.get(id_)
        return id_ if node is None else node.name

    def start_nodes(self) -> list[str]:
        """Return the nodes at which a process starts."""
        starts = [node.id for node in self.scope.nodes.values() if node.kind is Kind.START_EVENT]
        return starts or [node.id for node in self.scope.nodes.values() if self.can_start(node)]

    def successors(self, id_: str) -> list[str]:
        """Return the nodes that a token can reach from a node in one step."""
        event = self.scope.nodes[id_].event
        links = self.link_targets.get(event.name, []) if isinstance(event, LinkEvent) else []
        return [*(flow.target for flow in self.outgoing[id_]), *self.attached.get(id_, []), *links]

    def reached(self) -> Set[str]:
        """Return the nodes that a token can reach from the start events."""
        reached: set[str] = set()
        stack = self.start_nodes()
        while stack:
            here = stack.pop()
            if here not in reached:
                reached.add(here)
                stack += self.successors(here)
        return reached

    @cached_property
    def attached(self) -> Mapping[str, list[str]]:
        """Return the boundary events of each activity."""
        attached: dict[str, list[str]] = {}
        for node in self.scope.nodes.values():
            if node.attached_to is not None:
                attached.setdefault(node.attached_to, []).append(node.id)
        return attached

    @cached_property
    def link_targets(self) -> Mapping[str, list[str]]:
        """Return the catching link events by name."""
        targets: dict[str, list[str]] = {}
        for node in self.scope.nodes.values():
            if isinstance(node.event, LinkEvent) and node.kind is Kind.CATCH_EVENT:
                targets.setdefault(node.event.name, []).append(node.id)
        return targets
