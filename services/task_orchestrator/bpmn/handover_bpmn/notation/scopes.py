"""Scopes: the nodes and flows of a process or subprocess, read into the model."""

from dataclasses import replace

from lxml import etree

from handover.messages import message
from handover_bpmn.model import ACTIVITIES, EVENTS, CompensateEvent, Flow, Kind, Node, Scope
from handover_bpmn.notation.conditions import read_condition
from handover_bpmn.notation.context import Context
from handover_bpmn.notation.document import BPMN, child, children, is_bpmn, local
from handover_bpmn.notation.elements import Contents, check_other, data_object_of, referenced
from handover_bpmn.notation.listeners import with_listeners
from handover_bpmn.notation.nodes.node_type import Surroundings
from handover_bpmn.notation.nodes.table import NODE_TYPES
from handover_bpmn.notation.spans import read_spans

_PLACEHOLDER = Kind.MANUAL_TASK
"""The kind that stands for an element with faults, so that its flows have two ends."""


def read_scope(
    container: etree._Element, context: Context, depth: int = 0, *, in_event_subprocess: bool = False
) -> Scope:
    """Return the content of a process or subprocess; what cannot be read is a fault."""
    contents = Contents.of(container, context.findings)
    name = container.get("id") or ""
    flows = {flow.id: flow for flow in (_flow(sequence_flow, context) for sequence_flow in contents.flows)}
    nodes: dict[str, Node] = {}
    surroundings = Surroundings(depth, in_event_subprocess, read_scope)
    for element, kind in contents.nodes:
        node = _node(element, kind, context, surroundings)
        nodes[node.id] = node
    for element in (refused for refused in contents.refused if refused.get("id")):
        id_ = context.id(element)
        nodes[id_] = Node(id_, _PLACEHOLDER, id_, element.sourceline or 0)
    nodes, flows = with_listeners(container, contents, nodes, flows, context)
    return Scope(
        name,
        _with_defaults(nodes, flows, context),
        flows,
        handlers=_handlers(context, nodes),
        data_objects={data: context.data_names[data] for data in sorted(context.data_scopes.get(name, ()))},
        spans=read_spans(container, nodes, context),
    )


def collect_associations(process: etree._Element, context: Context) -> None:
    """Collect the associations: one may stand in any container around its ends (BPMN 2.0.2, 8.4.1)."""
    beside = process.getroottree().getroot().iterchildren(f"{{{BPMN}}}collaboration")
    context.associations = tuple(
        (referenced(association.get("sourceRef") or ""), referenced(association.get("targetRef") or ""))
        for container in (process, *beside)
        for association in container.iter(f"{{{BPMN}}}association")
    )


def collect_data(process: etree._Element, context: Context) -> None:
    """Collect the data objects of all scopes of a process: nodes refer to those of outer scopes."""
    named: dict[str, str] = {}
    declared = {element.get("id") or "": element for element in process.iter(f"{{{BPMN}}}dataObject")}
    references = list(process.iter(f"{{{BPMN}}}dataObjectReference"))
    for element in references:
        data = context.data[element.get("id") or ""] = data_object_of(element)
        declared.setdefault(data, element)  # a reference without an object stands for its own
    for data, element in declared.items():
        context.data_scopes.setdefault(element.getparent().get("id") or "", set()).add(data)
    referring = ((context.data[element.get("id") or ""], element) for element in references)
    for data, element in (*declared.items(), *referring):
        named[data] = named.get(data) or " ".join((element.get("name") or "").split())
    context.data_names.update({data: name or data for data, name in named.items()})


# Nodes


def _node(element: etree._Element, kind: Kind, context: Context, surroundings: Surroundings) -> Node:
    id_ = context.id(element)
    context.dialects.check(element, context.findings)
    node = Node(
        id=id_,
        kind=kind,
        name=" ".join((element.get("name") or "").split()) or id_,
        line=element.sourceline or 0,
        default=referenced(element.get("default") or "") or None,
    )
    node_type = NODE_TYPES[kind]
    if node_type.parts is not None:
        _check_parts(element, kind, node_type.parts, context)
    return node_type.read(element, node, context, surroundings)


def _check_parts(element: etree._Element, kind: Kind, parts: frozenset[str], context: Context) -> None:
    """Report the child elements that a node of this kind does not have."""
    for part in children(element):
        is_definition = kind in EVENTS and is_bpmn(part) and local(part).endswith("EventDefinition")
        if not is_definition and local(part) not in parts:
            check_other(part, kind.value, context.findings)


# Flows


def _flow(element: etree._Element, context: Context) -> Flow:
    source = referenced(element.get("sourceRef") or "")
    target = referenced(element.get("targetRef") or "")
    id_ = element.get("id") or ""
    if not id_:  # BPMN allows that; the ends name it
        id_ = f"{source}_{target}"
        while id_ in context.ids:
            id_ += "_"
        context.ids.add(id_)
    else:
        id_ = _flow_id(element, id_, context)
    for part in children(element):
        if local(part) != "conditionExpression":
            check_other(part, "sequenceFlow", context.findings)
    context.dialects.check(element, context.findings)
    return Flow(
        id=id_,
        source=source,
        target=target,
        condition=read_condition(element, child(element, "conditionExpression"), context),
        name=" ".join((element.get("name") or "").split()),
        line=element.sourceline or 0,
    )


def _flow_id(element: etree._Element, id_: str, context: Context) -> str:
    if id_ in context.ids and not context.dialects.is_ours and element.get("sourceRef"):
        used, number = id_, 2
        while id_ in context.ids:
            id_, number = f"{used}_{number}", number + 1
        context.findings.warn(
            element,
            message(
                "bpmn.flow_renamed",
                'the id "{id}" is used twice; this sequence flow is called "{other}" here',
                id=used,
                other=id_,
            ),
        )
    elif id_ in context.ids:
        context.findings.fault(element, message("bpmn.id_twice", 'the id "{id}" is used twice', id=id_))
    context.ids.add(id_)
    return id_


def _with_defaults(nodes: dict[str, Node], flows: dict[str, Flow], context: Context) -> dict[str, Node]:
    """Make the only flow without a condition the default of an exclusive gateway, as Camunda does."""
    if not context.dialects.main.lenient:
        return nodes
    without: dict[str, list[Flow]] = {}
    leaving: dict[str, int] = {}
    for flow in flows.values():
        leaving[flow.source] = leaving.get(flow.source, 0) + 1
        if flow.condition is None and flow.id not in context.findings.broken:
            without.setdefault(flow.source, []).append(flow)
    changed = dict(nodes)
    for node in nodes.values():
        open_ = without.get(node.id, [])
        if node.kind is not Kind.EXCLUSIVE or node.default is not None or leaving.get(node.id, 0) < 2:
            continue
        if len(open_) == 1:
            changed[node.id] = replace(node, default=open_[0].id)
    return changed


def _handlers(context: Context, nodes: dict[str, Node]) -> dict[str, str]:
    """Return the activity of `nodes` that each compensation boundary event of them is associated with."""
    handlers: dict[str, str] = {}
    for ends in context.associations:
        for event, activity in (ends, ends[::-1]):
            boundary, handler = nodes.get(event), nodes.get(activity)
            if boundary is None or handler is None or boundary.kind is not Kind.BOUNDARY_EVENT:
                continue
            if isinstance(boundary.event, CompensateEvent) and handler.kind in ACTIVITIES:
                handlers[event] = activity
    return handlers
