"""Ahead: which activities may come next, so that people can get ready for them.

From where the tokens wait, the drawing is followed through gateways, events and scripts to the next
activities. What the variables decide already is decided; of what is open, the way forward comes first.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from services.task_orchestrator.definition import Activity, Definition, Flow, Kind, Node, Trigger, variable_of
from services.task_orchestrator.expressions import ExpressionError, read

MAX_AHEAD = 8
"""More than so many possible next activities help nobody."""


def activities_ahead(
    definition: Definition, waiting: tuple[str, ...], variables: Mapping[str, Any]
) -> tuple[Activity, ...]:
    """Return the activities that may come after the elements `waiting`, the likeliest first.

    `variables` are the process variables as they are now; what the waiting activities will set counts as
    unknown. Events at the border of an activity come last: they are drawn for when things go wrong.
    """
    drawing = _Drawing(definition)
    here = [definition.nodes[name] for name in waiting if name in definition.nodes]
    known = _settled(definition, here, variables)
    found: dict[str, Activity] = {}
    exceptions = [node for node in here if node.kind is Kind.BOUNDARY]
    exceptions += [each for node in here for each in drawing.borders.get(node.id, ()) if each not in here]
    for node in [*(each for each in here if each.kind is not Kind.BOUNDARY), *exceptions]:
        host = node.attached_to or node.id
        for name in _Walk(drawing, host, dict(known)).activities_after(node.id):
            found.setdefault(name, definition.activities[name])
    return tuple(found.values())[:MAX_AHEAD]


def _settled(definition: Definition, here: list[Node], variables: Mapping[str, Any]) -> dict[str, Any]:
    """Return the variables that will still have their values at the next gateway, whichever token gets there.

    Tokens side by side see different values: then only what nothing in the drawing ever sets is certain.
    """
    setting = here
    if sum(node.kind is not Kind.BOUNDARY for node in here) > 1:
        setting = list(definition.nodes.values())
        if any(node.kind is Kind.SCRIPT for node in setting):
            return {}
    changing = {name for node in setting for name in _set_by(definition, node)}
    return {name: value for name, value in variables.items() if name not in changing}


def _set_by(definition: Definition, node: Node) -> tuple[str, ...]:
    """Return the variables that will be different once the token leaves `node`."""
    if node.kind is Kind.BOUNDARY:
        return ("error",)
    activity = definition.activities.get(node.id)
    if activity is None:
        return ()
    return tuple(activity.outputs) or (variable_of(node.id),)


@dataclass
class _Drawing:
    """The drawing as somebody who follows it with a finger sees it."""

    definition: Definition

    @cached_property
    def leaving(self) -> dict[str, list[Flow]]:
        """Return the flows that leave each node, in the order they were drawn."""
        leaving: dict[str, list[Flow]] = {name: [] for name in self.definition.nodes}
        for flow in self.definition.flows.values():
            leaving[flow.source].append(flow)
        return leaving

    @cached_property
    def borders(self) -> dict[str, list[Node]]:
        """Return the boundary events of each activity."""
        borders: dict[str, list[Node]] = {}
        for node in self.definition.nodes.values():
            if node.attached_to is not None:
                borders.setdefault(node.attached_to, []).append(node)
        return borders

    def ends_without(self, avoided: str, first: str) -> bool:
        """Say whether a token at `first` can get to an end, not by an error, without coming to `avoided`."""
        seen = {avoided}
        ahead = [first]
        while ahead:
            name = ahead.pop()
            if name in seen:
                continue
            seen.add(name)
            node = self.definition.nodes[name]
            if node.kind is Kind.END and node.trigger is not Trigger.ERROR:
                return True
            ahead += [flow.target for flow in self.leaving[name]]
        return False


@dataclass
class _Walk:
    """One way through the drawing from the element `host`, with the variables that are `known`."""

    drawing: _Drawing
    host: str
    known: dict[str, Any]
    _passed: set[str] = field(default_factory=set)

    def activities_after(self, name: str) -> Iterator[str]:
        """Yield the ids of the activities that are reached first after `name`."""
        node = self.drawing.definition.nodes[name]
        for flow in self._ways(node):
            target = flow.target
            if target in self.drawing.definition.activities:
                yield target
            elif target not in self._passed:
                self._passed.add(target)
                yield from self.activities_after(target)

    def _ways(self, node: Node) -> list[Flow]:
        if node.kind is Kind.SCRIPT:
            self._forget_what_scripts_set()
        flows = self.drawing.leaving[node.id]
        if node.kind is Kind.EXCLUSIVE:
            flows = self._possible(flows, node.default)
        elif node.kind is Kind.INCLUSIVE:
            flows = [flow for flow in flows if self._holds(flow) is not False]
        if len(flows) < 2:
            return list(flows)
        return sorted(
            flows,
            key=lambda flow: (
                not self.drawing.ends_without(self.host, flow.target),
                flow.id != node.default,
            ),
        )

    def _possible(self, flows: list[Flow], default: str | None) -> list[Flow]:
        """Return the flows that an exclusive gateway may still choose: the first that holds is taken."""
        possible = []
        for flow in (flow for flow in flows if flow.id != default):
            holds = self._holds(flow)
            if holds is not False:
                possible.append(flow)
            if holds:
                return possible
        return possible + [flow for flow in flows if flow.id == default]

    def _holds(self, flow: Flow) -> bool | None:
        """Say whether the condition of `flow` holds; None if that is not known yet."""
        if flow.condition is None:
            return None
        try:
            return bool(read(flow.condition).value(self.known))
        except ExpressionError:
            return None

    def _forget_what_scripts_set(self) -> None:
        """A script on the way changes variables: decide nothing by them, it is not run here."""
        self.known.clear()
