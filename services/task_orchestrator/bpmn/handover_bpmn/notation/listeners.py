"""Listeners that set variables, as script tasks before and after their elements.

Camunda 7 runs listeners when a token enters or leaves an element, or takes a sequence flow. A listener that
sets a variable is a script task at that place: `x.before`, `x.after`, or `f.set` for a sequence flow `f`.
"""

from collections import defaultdict
from dataclasses import replace

from lxml import etree

from handover_bpmn.model import GATEWAYS, Assignment, Flow, Kind, Node
from handover_bpmn.notation.context import Context
from handover_bpmn.notation.document import local
from handover_bpmn.notation.elements import Contents


def with_listeners(
    container: etree._Element,
    contents: Contents,
    nodes: dict[str, Node],
    flows: dict[str, Flow],
    context: Context,
) -> tuple[dict[str, Node], dict[str, Flow]]:
    """Return the nodes and flows of a scope with a script for each listener that sets variables."""
    inserted = _Insertion(nodes, flows, context)
    dialect = context.dialects.main
    for element, kind in contents.nodes:
        before, after = dialect.listeners(element)
        id_ = element.get("id") or ""
        if kind is Kind.START_EVENT:
            inserted.after(id_, (*before, *after))
        elif kind is Kind.END_EVENT or kind in GATEWAYS:
            inserted.before(id_, (*before, *after))
        else:
            inserted.before(id_, before)
            inserted.after(id_, after)
    for element in contents.flows:
        before, after = dialect.listeners(element)
        inserted.into(element.get("id") or "", (*before, *after))
    if local(container) == "process":
        before, _ = dialect.listeners(container)
        for start in [node.id for node in nodes.values() if node.kind is Kind.START_EVENT]:
            inserted.after(start, before)
    return inserted.nodes, inserted.flows


class _Insertion:
    """Inserts script tasks into the flows of a scope."""

    def __init__(self, nodes: dict[str, Node], flows: dict[str, Flow], context: Context) -> None:
        self.nodes = dict(nodes)
        self.flows = dict(flows)
        self._context = context
        self._arriving: dict[str, set[str]] = defaultdict(set)
        self._leaving: dict[str, set[str]] = defaultdict(set)
        for flow in flows.values():
            self._arriving[flow.target].add(flow.id)
            self._leaving[flow.source].add(flow.id)

    def before(self, id_: str, assignments: tuple[Assignment, ...]) -> None:
        """Set variables before a token enters a node; after it, if it is an event behind a gateway."""
        if not assignments:
            return
        arriving = sorted(self._arriving[id_])
        if not arriving or any(self._is_event_based(self.flows[flow].source) for flow in arriving):
            self.after(id_, assignments)
            return
        script = self._script(id_, "before", assignments)
        for flow in arriving:
            self._redirect(flow, target=script.id)
        self._connect(script.id, id_)

    def after(self, id_: str, assignments: tuple[Assignment, ...]) -> None:
        """Set variables when a token has left a node."""
        leaving = sorted(self._leaving[id_])
        if not assignments or not leaving:
            return
        node = self.nodes[id_]
        script = self._script(id_, "after", assignments)
        for flow in leaving:
            self._redirect(flow, source=script.id)
        self.nodes[script.id] = replace(script, default=node.default)
        self.nodes[id_] = replace(node, default=None)
        self._connect(id_, script.id)

    def into(self, id_: str, assignments: tuple[Assignment, ...]) -> None:
        """Set variables when a token takes a sequence flow."""
        if not assignments or id_ not in self.flows:
            return
        target = self.flows[id_].target
        script = self._script(id_, "set", assignments)
        self._redirect(id_, target=script.id)
        self._connect(script.id, target)

    def _is_event_based(self, id_: str) -> bool:
        node = self.nodes.get(id_)
        return node is not None and node.kind is Kind.EVENT_BASED

    def _script(self, id_: str, place: str, assignments: tuple[Assignment, ...]) -> Node:
        owner = self.nodes.get(id_)
        name = f"{id_}.{place}"
        while name in self._context.ids:
            name += "_"
        self._context.ids.add(name)
        line = owner.line if owner is not None else self.flows[id_].line
        drawn = owner.name if owner is not None else self.flows[id_].name or id_
        script = self.nodes[name] = Node(name, Kind.SCRIPT_TASK, drawn, line, script=assignments)
        return script

    def _connect(self, source: str, target: str) -> None:
        name = f"{source}.to.{target}"
        self.flows[name] = Flow(name, source, target)
        self._leaving[source].add(name)
        self._arriving[target].add(name)

    def _redirect(self, id_: str, *, source: str | None = None, target: str | None = None) -> None:
        flow = self.flows[id_]
        self._leaving[flow.source].discard(id_)
        self._arriving[flow.target].discard(id_)
        flow = self.flows[id_] = replace(flow, source=source or flow.source, target=target or flow.target)
        self._leaving[flow.source].add(id_)
        self._arriving[flow.target].add(id_)
