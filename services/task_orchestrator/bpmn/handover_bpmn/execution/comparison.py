"""Comparison: what differs between two versions of a node, and which variables a node reads and sets."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

from handover.messages import Message, message
from handover_bpmn.execution.graph import Graph
from handover_bpmn.model import Flow, LinkEvent, MultiInstance, Node, Scope


def difference(old: Node, new: Node) -> Message | None:
    """Return why a token at `old` cannot continue at `new`; None if it can."""
    if old.kind is not new.kind:
        return message(
            "migration.other_kind",
            "it is a {old}, but a {new} in the new version; map it to another element, or move it first",
            old=old.kind.value,
            new=new.kind.value,
        )
    if _role(old) != _role(new):
        return message(
            "migration.other_role",
            "it does something else in the new version; map it to another element, or move it first",
        )
    return None


def _role(node: Node) -> tuple[Any, ...]:
    """Return what a token does at a node, without its details."""
    return (
        node.activity is None,
        node.scope is None,
        node.call is None,
        node.script is None,
        node.triggered_by_event,
        node.is_for_compensation,
        type(node.event),
        type(node.loop),
        isinstance(node.loop, MultiInstance) and (node.loop.sequential, node.loop.output_collection is None),
    )


def comparable(value: Any, *, but: frozenset[str] = frozenset()) -> Any:
    """Return a part of the model in a form in which equal parts are equal; an expression is its text."""
    if hasattr(value, "names") and hasattr(value, "text") and not hasattr(value, "members"):
        return type(value).__name__, value.text
    if is_dataclass(value) and not isinstance(value, type):
        parts = [(field.name, comparable(getattr(value, field.name))) for field in fields(value)
                 if field.name not in but]  # fmt: skip
        return type(value).__name__, parts
    if isinstance(value, Mapping):
        return {name: comparable(part) for name, part in value.items()}
    if isinstance(value, tuple | list):
        return [comparable(part) for part in value]
    return value


def nodes_ahead(graph: Graph, nodes: Iterable[str]) -> list[tuple[Node, list[Flow]]]:
    """Return the nodes that tokens at `nodes` can reach in a scope, with their outgoing flows."""
    stack, reached = list(nodes), dict[str, tuple[Node, list[Flow]]]()
    while stack:
        name = stack.pop()
        if name in reached:
            continue
        node = graph.nodes[name]
        reached[name] = node, graph.outgoing[name]
        stack += [flow.target for flow in graph.outgoing[name]]
        stack += [boundary.id for boundary in graph.boundaries.get(name, [])]
        if isinstance(node.event, LinkEvent) and node.event.name in graph.links:
            stack.append(graph.links[node.event.name].id)
    return list(reached.values())


def read_by(value: Any) -> Iterator[str]:
    """Yield the variables that the expressions in a part of the model read."""
    if isinstance(value, Scope):
        for node in value.nodes.values():
            yield from read_by(node)
        for flow in value.flows.values():
            yield from read_by(flow.condition)
    elif hasattr(value, "names") and hasattr(value, "text"):
        yield from value.names()
    elif is_dataclass(value) and not isinstance(value, type):
        for field in fields(value):
            yield from read_by(getattr(value, field.name))
    elif isinstance(value, Mapping):
        for part in value.values():
            yield from read_by(part)
    elif isinstance(value, tuple | list):
        for part in value:
            yield from read_by(part)


def set_by(node: Node) -> Iterator[str]:
    """Yield the variables that a node, or a node within it, sets."""
    if node.activity is not None:
        yield node.activity.variable
        yield from node.activity.outputs
    for assigned in (
        node.script or (),
        node.inputs,
        node.outputs,
        () if node.call is None else node.call.outputs,
    ):
        yield from (assignment.target for assignment in assigned)
    if isinstance(node.loop, MultiInstance):
        yield from (name for name in (node.loop.item_variable, node.loop.output_collection) if name)
    for name in ("code_variable", "message_variable"):
        yield getattr(node.event, name, None) or ""
    on = getattr(node.event, "on", None)
    if on is not None:
        yield on.variable
    if node.scope is not None:
        for inner in node.scope.nodes.values():
            yield from set_by(inner)
