"""Graph: the scopes of a definition, prepared for execution."""

from collections import defaultdict
from collections.abc import Mapping
from functools import cached_property

from handover_bpmn.model import CompensateEvent, Definition, Flow, Kind, LinkEvent, Node, Scope
from handover_bpmn.spans import SpanUnion, find_unions, predecessors


class Graph:
    """A scope with the lookups that its execution needs; immutable."""

    def __init__(self, scope: Scope, unions: Mapping[str, tuple[SpanUnion, ...]]) -> None:
        self.scope = scope
        self.unions = unions.get(scope.id, ())
        """The spans of this scope during which resources are reserved."""
        self.nodes: Mapping[str, Node] = scope.nodes
        self.outgoing: dict[str, list[Flow]] = {name: [] for name in scope.nodes}
        self.incoming: dict[str, list[Flow]] = {name: [] for name in scope.nodes}
        for flow in scope.flows.values():
            self.outgoing[flow.source].append(flow)
            self.incoming[flow.target].append(flow)
        self.inclusive_joins = tuple(
            node.id
            for node in scope.nodes.values()
            if node.kind is Kind.INCLUSIVE and len(self.incoming[node.id]) > 1
        )
        self.boundaries: dict[str, list[Node]] = defaultdict(list)
        self.event_subprocesses: list[tuple[Node, Node]] = []
        """Event subprocesses of this scope, each with its start event."""
        self.handlers: dict[str, str] = {}
        """Activity -> the activity that compensates it."""
        self.links: dict[str, Node] = {}
        self.inner: dict[str, Graph] = {}
        for node in scope.nodes.values():
            self._add(node, unions)

    def _add(self, node: Node, unions: Mapping[str, tuple[SpanUnion, ...]]) -> None:
        if node.scope is not None:
            self.inner[node.id] = Graph(node.scope, unions)
        if node.kind is Kind.BOUNDARY_EVENT and node.attached_to is not None:
            if isinstance(node.event, CompensateEvent):
                handler = self.scope.handlers.get(node.id)
                if handler is not None:
                    self.handlers[node.attached_to] = handler
            else:
                self.boundaries[node.attached_to].append(node)
        elif node.triggered_by_event and node.scope is not None:
            starts = [inner for inner in node.scope.nodes.values() if inner.kind is Kind.START_EVENT]
            self.event_subprocesses += [(node, start) for start in starts]
        elif node.kind is Kind.CATCH_EVENT and isinstance(node.event, LinkEvent):
            self.links[node.event.name] = node

    @cached_property
    def starts(self) -> list[Node]:
        """Return where tokens start: at the none start event, else at the nodes without incoming flow."""
        events = [node for node in self.nodes.values() if node.kind is Kind.START_EVENT]
        if events:
            return [node for node in events if node.event is None][:1]
        return [node for node in self.nodes.values() if self._is_implicit_start(node)]

    def _is_implicit_start(self, node: Node) -> bool:
        if self.incoming[node.id] or node.kind is Kind.BOUNDARY_EVENT:
            return False
        is_link = node.kind is Kind.CATCH_EVENT and isinstance(node.event, LinkEvent)
        return not (node.triggered_by_event or node.is_for_compensation or is_link)

    @property
    def needs_event(self) -> bool:
        """Return whether tokens can start here only by an event."""
        return not self.starts and any(node.kind is Kind.START_EVENT for node in self.nodes.values())

    @cached_property
    def compensation_subprocess(self) -> Node | None:
        """Return the event subprocess that compensates this scope as a whole, if it has one."""
        for node, start in self.event_subprocesses:
            if isinstance(start.event, CompensateEvent):
                return node
        return None

    @cached_property
    def upstream(self) -> dict[str, dict[str, frozenset[str]]]:
        """Return the nodes from which a token can still reach each incoming flow of each inclusive join.

        The paths do not pass the join itself (BPMN 2.0.2, 13.4.3).
        """
        sources = predecessors(self.scope)
        return {
            join: {flow.id: _reaching(flow.source, join, sources) for flow in self.incoming[join]}
            for join in self.inclusive_joins
        }


def _reaching(target: str, join: str, sources: Mapping[str, list[str]]) -> frozenset[str]:
    names: set[str] = set()
    stack = [target]
    while stack:
        name = stack.pop()
        if name in names or name == join:
            continue
        names.add(name)
        stack += sources.get(name, [])
    return frozenset(names)


class Plan:
    """A definition and its version, prepared for execution."""

    def __init__(self, definition: Definition, version: int = 1) -> None:
        self.definition = definition
        self.version = version
        unions = find_unions(definition.scope)
        self.graph = Graph(definition.scope, unions)
        self.may_reserve = bool(unions) or any(node.call is not None for node in definition.nodes())
        """Whether resources are reserved for parts of it, or may be for a process that it calls."""
