"""Lookahead: the activities that a process may reach next, so that people can prepare for them.

The model is followed from the waiting tokens through gateways, events and scripts to the next activities.
Conditions that depend only on known variables are evaluated. Of several open branches, one that leads to an
end of the process comes first.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from handover_bpmn.execution.graph import Graph
from handover_bpmn.languages.base import ExpressionError
from handover_bpmn.model import EVENTS, Activity, Definition, ErrorEvent, Flow, Kind, LinkEvent, Node, Scope

MAX_UPCOMING = 8
"""A longer list of possible activities is of no use to a person."""


def upcoming_activities(
    definition: Definition, waiting: tuple[str, ...], variables: Mapping[str, Any]
) -> tuple[Activity, ...]:
    """Return the activities that may follow the elements `waiting`, the most likely first.

    `variables` are the present process variables; those that the waiting activities set count as unknown.
    Boundary events come last: they are modelled for exceptions.
    """
    graph = _Graph(definition)
    here = [graph.nodes[name] for name in waiting if name in graph.nodes]
    settled = _settled(graph, here, variables)
    upcoming: dict[str, Activity] = {}
    exceptions = [node for node in here if node.kind is Kind.BOUNDARY_EVENT]
    for node in here:
        exceptions += [event for event in graph.boundary_events.get(node.id, ()) if event not in here]
    regular = [
        waiting_node
        for waiting_node in here
        if waiting_node.kind is not Kind.BOUNDARY_EVENT and waiting_node.scope is None
    ]
    for node in [*regular, *exceptions]:
        host = node.attached_to or node.id
        for name in _Walk(graph, host, dict(settled)).activities_after(node.id):
            upcoming.setdefault(name, graph.activities[name])
    return tuple(upcoming.values())[:MAX_UPCOMING]


def activities_after_next(
    definition: Definition, waiting: tuple[str, ...], variables: Mapping[str, Any]
) -> tuple[Activity, ...]:
    """Return the activities that may follow the most likely of `upcoming_activities`, the most likely first.

    Scripts on the way may change variables, so with a script task in the model none counts as known.
    """
    upcoming = upcoming_activities(definition, waiting, variables)
    if not upcoming:
        return ()
    graph = _Graph(definition)
    has_script = any(node.kind is Kind.SCRIPT_TASK for node in graph.nodes.values())
    here = [graph.nodes[name] for name in waiting if name in graph.nodes]
    settled = {} if has_script else _settled(graph, here, variables)
    return upcoming_activities(definition, (upcoming[0].id,), settled)


def _settled(graph: "_Graph", here: list[Node], variables: Mapping[str, Any]) -> dict[str, Any]:
    """Return the variables that keep their values until the next gateway, for every token.

    With parallel tokens only the variables that no element of the model sets are certain.
    """
    setting = here
    if sum(node.kind is not Kind.BOUNDARY_EVENT for node in here) > 1:
        setting = list(graph.nodes.values())
        if any(node.kind is Kind.SCRIPT_TASK for node in setting):
            return {}
    changing: set[str] = set()
    for node in setting:
        names = _set_by(node)
        if names is None:
            return {}
        changing.update(names)
    return {name: value for name, value in variables.items() if name not in changing}


def _set_by(node: Node) -> tuple[str, ...] | None:
    """Return the variables that change when the token leaves `node`; None if they cannot be known."""
    if node.kind is Kind.BOUNDARY_EVENT:
        return ("error",)
    if node.outputs:
        return tuple(output.target for output in node.outputs)
    if node.activity is None:
        return None if node.event is not None and node.kind in EVENTS else ()
    if node.activity.outputs:
        return tuple(node.activity.outputs)
    return None if node.activity.spreads_outputs else (node.activity.variable,)


@dataclass
class _Graph:
    """The nodes of all scopes as one graph: a subprocess leads to its start, the ends within it behind it."""

    definition: Definition

    @cached_property
    def nodes(self) -> dict[str, Node]:
        """Return all nodes by id."""
        return {node.id: node for node in self.definition.nodes()}

    @cached_property
    def activities(self) -> dict[str, Activity]:
        """Return the activities that create Tasks."""
        return self.definition.activities()

    @cached_property
    def leaving(self) -> dict[str, list[Flow]]:
        """Return the outgoing flows of each node, in the order of the model."""
        leaving: dict[str, list[Flow]] = {name: [] for name in self.nodes}
        for scope in self.definition.scopes():
            for flow in scope.flows.values():
                leaving[flow.source].append(flow)
            _add_links(scope, leaving)
        for node in self.nodes.values():
            if node.scope is not None:
                _enclose(node, node.scope, leaving)
        return leaving

    @cached_property
    def boundary_events(self) -> dict[str, list[Node]]:
        """Return the boundary events of each activity."""
        boundary_events: dict[str, list[Node]] = {}
        for node in self.nodes.values():
            if node.attached_to is not None:
                boundary_events.setdefault(node.attached_to, []).append(node)
        return boundary_events

    def ends_without(self, avoided: str, first: str) -> bool:
        """Return whether a token at `first` can reach a regular end without passing `avoided`."""
        seen = {avoided}
        stack = [first]
        while stack:
            name = stack.pop()
            if name in seen:
                continue
            seen.add(name)
            node = self.nodes[name]
            flows = self.leaving[name]
            if not flows and not isinstance(node.event, ErrorEvent):
                return True
            stack += [flow.target for flow in flows]
        return False


def _add_links(scope: Scope, leaving: dict[str, list[Flow]]) -> None:
    """Add a flow from each throwing link event to the catching one."""
    catching = {
        node.event.name: node.id
        for node in scope.nodes.values()
        if node.kind is Kind.CATCH_EVENT and isinstance(node.event, LinkEvent)
    }
    for node in scope.nodes.values():
        if (
            node.kind is Kind.THROW_EVENT
            and isinstance(node.event, LinkEvent)
            and node.event.name in catching
        ):
            leaving[node.id].append(Flow("", node.id, catching[node.event.name]))


def _enclose(host: Node, scope: Scope, leaving: dict[str, list[Flow]]) -> None:
    """Lead the flows of a subprocess through its content."""
    behind = leaving[host.id]
    for node in scope.nodes.values():
        if not leaving[node.id] and not isinstance(node.event, ErrorEvent):
            leaving[node.id] = [Flow(flow.id, node.id, flow.target, flow.condition) for flow in behind]
    starts = Graph(scope, {}).starts
    if starts:
        leaving[host.id] = [Flow("", host.id, start.id) for start in starts]


@dataclass
class _Walk:
    """A traversal of the graph from the element `host`, with the `settled` variables."""

    graph: _Graph
    host: str
    settled: dict[str, Any]
    _passed: set[str] = field(default_factory=set)

    def activities_after(self, name: str) -> Iterator[str]:
        """Yield the ids of the first activities after `name`."""
        node = self.graph.nodes[name]
        for flow in self._outgoing(node):
            target = flow.target
            if target in self.graph.activities:
                yield target
            elif target not in self._passed:
                self._passed.add(target)
                yield from self.activities_after(target)

    def _outgoing(self, node: Node) -> list[Flow]:
        if node.kind is Kind.SCRIPT_TASK:
            self._forget_variables()
        flows = self.graph.leaving[node.id]
        if node.kind is Kind.EXCLUSIVE:
            flows = self._possible(flows, node.default)
        elif node.kind is Kind.INCLUSIVE:
            flows = [flow for flow in flows if self._holds(flow) is not False]
        if len(flows) < 2:
            return list(flows)
        return sorted(
            flows,
            key=lambda flow: (
                not self.graph.ends_without(self.host, flow.target),
                flow.id != node.default,
            ),
        )

    def _possible(self, flows: list[Flow], default: str | None) -> list[Flow]:
        """Return the flows that an exclusive gateway may take: up to the first whose condition is true."""
        possible = []
        for flow in (flow for flow in flows if flow.id != default):
            holds = self._holds(flow)
            if holds is not False:
                possible.append(flow)
            if holds:
                return possible
        return possible + [flow for flow in flows if flow.id == default]

    def _holds(self, flow: Flow) -> bool | None:
        """Return whether the condition of `flow` is true; None if that is unknown."""
        if flow.condition is None:
            return None
        try:
            return bool(flow.condition.value(self.settled))
        except ExpressionError:
            return None

    def _forget_variables(self) -> None:
        """A script on the path changes variables and is not executed here, so none is known afterwards."""
        self.settled.clear()
