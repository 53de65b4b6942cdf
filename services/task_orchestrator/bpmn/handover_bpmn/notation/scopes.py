"""Scopes: the nodes and flows of a process or subprocess, read into the model."""

from dataclasses import replace

from lxml import etree

from handover.messages import message
from handover_bpmn.model import (
    ACTIVITIES,
    EVENTS,
    GATEWAYS,
    Activity,
    Assignment,
    Call,
    CompensateEvent,
    Flow,
    Kind,
    Node,
    Scope,
    Value,
)
from handover_bpmn.notation.activities import (
    ACTIVITY_PARTS,
    TASKS,
    check_quantities,
    read_activity,
    read_data,
    read_loop,
    warn_foreign_script,
)
from handover_bpmn.notation.conditions import read_condition
from handover_bpmn.notation.context import Context
from handover_bpmn.notation.dialects.handover_elements import has_task
from handover_bpmn.notation.document import (
    BPMN,
    child,
    children,
    flag,
    is_bpmn,
    local,
)
from handover_bpmn.notation.elements import (
    Contents,
    check_other,
    data_object_of,
    referenced,
    refuse,
)
from handover_bpmn.notation.events import definitions_of, read_event, read_message
from handover_bpmn.notation.listeners import with_listeners
from handover_bpmn.notation.names import process_name
from handover_bpmn.notation.spans import read_spans

MAX_SCOPE_DEPTH = 20

_EVENT_PARTS = frozenset(
    {
        *("incoming", "outgoing", "eventDefinitionRef", "dataInputAssociation", "dataOutputAssociation"),
        *("dataInput", "dataOutput", "inputSet", "outputSet"),
    }
)
_GATEWAY_PARTS = frozenset({"incoming", "outgoing"})
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
    for element, kind in contents.nodes:
        node = _node(element, kind, context, depth, in_event_subprocess=in_event_subprocess)
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


def _node(
    element: etree._Element, kind: Kind, context: Context, depth: int, *, in_event_subprocess: bool
) -> Node:
    id_ = context.id(element)
    context.dialects.check(element, context.findings)
    node = Node(
        id=id_,
        kind=kind,
        name=" ".join((element.get("name") or "").split()) or id_,
        line=element.sourceline or 0,
        default=referenced(element.get("default") or "") or None,
    )
    if kind in EVENTS:
        return _event(element, node, context, in_event_subprocess=in_event_subprocess)
    if kind in GATEWAYS:
        return _gateway(element, node, context)
    return _activity(element, node, context, depth)


def _event(element: etree._Element, node: Node, context: Context, *, in_event_subprocess: bool) -> Node:
    for part in children(element):
        is_definition = is_bpmn(part) and local(part).endswith("EventDefinition")
        if not is_definition and local(part) not in _EVENT_PARTS:
            check_other(part, node.kind.value, context.findings)
    payload: tuple[Assignment, ...] = ()
    for definition in definitions_of(element, context):
        context.dialects.check(definition, context.findings)
        payload += context.dialects.main.mapped(definition, context.findings).inputs
    if _is_work(element, node.kind, context):
        _warn_message_not_thrown(element, context)
        mapped = context.dialects.main.mapped(element, context.findings)
        return replace(
            node,
            kind=Kind.SEND_TASK,
            activity=_work_of_event(element, context),
            inputs=mapped.inputs,
            outputs=mapped.outputs,
        )
    event = read_event(element, node.kind, context, in_event_subprocess=in_event_subprocess)
    interrupting = "cancelActivity" if node.kind is Kind.BOUNDARY_EVENT else "isInterrupting"
    mapped = context.dialects.main.mapped(element, context.findings)
    data_inputs, data_outputs = read_data(element, context, is_event=True)
    return replace(
        node,
        event=event,
        attached_to=referenced(element.get("attachedToRef") or "") or None
        if node.kind is Kind.BOUNDARY_EVENT
        else None,
        interrupting=isinstance(event, CompensateEvent) or flag(element, interrupting, default=True),
        inputs=(*mapped.inputs, *payload),
        outputs=mapped.outputs,
        data_inputs=data_inputs,
        data_outputs=data_outputs,
    )


def _is_work(element: etree._Element, kind: Kind, context: Context) -> bool:
    """Return whether somebody has to send the message of an event: it has an implementation."""
    if kind not in {Kind.THROW_EVENT, Kind.END_EVENT}:
        return False
    definition = child(element, "messageEventDefinition")
    if definition is None:
        return False
    return any(_has_implementation(part, context) for part in (element, definition))


def _has_implementation(element: etree._Element, context: Context) -> bool:
    return has_task(element) or context.dialects.main.work(element, context.findings).has_implementation


def _work_of_event(element: etree._Element, context: Context) -> Activity:
    activity = read_activity(element, context)
    definition = child(element, "messageEventDefinition")
    if definition is None or has_task(element):
        return activity
    work = context.dialects.main.work(definition, context.findings)
    return replace(
        activity,
        parameters={**activity.parameters, **work.parameters},
        hints={**activity.hints, **work.hints},
    )


def _warn_message_not_thrown(element: etree._Element, context: Context) -> None:
    if element.get("id") in context.collaboration.connected:
        context.findings.warn(
            element,
            message(
                "bpmn.message_sent_by_performer",
                "the performer of its Task has to send the message along the message flow; "
                "without an implementation it is sent here",
            ),
        )


def _gateway(element: etree._Element, node: Node, context: Context) -> Node:
    for part in children(element):
        if local(part) not in _GATEWAY_PARTS:
            check_other(part, node.kind.value, context.findings)
    if node.kind is Kind.EVENT_BASED:
        if element.get("eventGatewayType") == "Parallel":
            refuse(
                element,
                "a parallel eventBasedGateway",
                "use a parallel gateway with one event a branch",
                context.findings,
            )
        if flag(element, "instantiate", default=False):
            refuse(
                element,
                "an eventBasedGateway that starts the process",
                "draw one start event for each event",
                context.findings,
            )
    return node


def _activity(element: etree._Element, node: Node, context: Context, depth: int) -> Node:
    main, findings = context.dialects.main, context.findings
    is_scope = node.kind is Kind.SUB_PROCESS
    if not is_scope:
        for part in children(element):
            is_script = local(part) == "script" and node.kind is Kind.SCRIPT_TASK
            if local(part) not in ACTIVITY_PARTS and not is_script:
                check_other(part, node.kind.value, findings)
    check_quantities(element, context)
    for name in ("standardLoopCharacteristics", "multiInstanceLoopCharacteristics"):
        loop = child(element, name)
        if loop is not None:
            context.dialects.check(loop, findings)
    mapped = main.mapped(element, findings)
    data_inputs, data_outputs = read_data(element, context)
    node = replace(
        node,
        is_for_compensation=flag(element, "isForCompensation", default=False),
        loop=read_loop(element, context),
        inputs=mapped.inputs,
        outputs=mapped.outputs,
        data_inputs=data_inputs,
        data_outputs=data_outputs,
    )
    if node.kind in TASKS:
        return _task(element, node, context)
    if node.kind is Kind.SCRIPT_TASK:
        return _script_task(element, node, context)
    if node.kind in {Kind.SEND_TASK, Kind.RECEIVE_TASK}:
        return _message_task(element, node, context)
    if node.kind is Kind.CALL_ACTIVITY:
        if referenced(element.get("calledElement") or "") in context.declared.global_tasks:
            return replace(node, activity=read_activity(element, context))
        return replace(node, call=_named_process(main.call(element, findings)))
    return _subprocess(element, node, context, depth)


def _task(element: etree._Element, node: Node, context: Context) -> Node:
    evaluated = None if has_task(element) else context.dialects.main.evaluated(element, context.findings)
    if evaluated is not None:
        return replace(node, kind=Kind.SCRIPT_TASK, script=evaluated)
    return replace(node, activity=read_activity(element, context))


def _named_process(call: Call | None) -> Call | None:
    """Return a call with the name that the definition of the called process has here."""
    if call is None or not isinstance(call.process.literal, str):
        return call
    return replace(call, process=Value(process_name(call.process.literal)))


def _script_task(element: etree._Element, node: Node, context: Context) -> Node:
    script = context.dialects.main.script(element, context.findings)
    if has_task(element):
        return replace(node, activity=read_activity(element, context, script=script))
    if script.assignments is not None:
        return replace(node, script=script.assignments)
    if not script.text and not script.format:  # a job without a script
        return replace(node, activity=read_activity(element, context))
    warn_foreign_script(element, script, context)
    return replace(node, activity=read_activity(element, context, script=script))


def _message_task(element: etree._Element, node: Node, context: Context) -> Node:
    if flag(element, "instantiate", default=False):
        if not _has_incoming(element):  # the same as a start event
            event = read_message(
                element, context.dialects.of(element).occurrence(element, None, context.findings), context
            )
            return replace(node, kind=Kind.START_EVENT, event=event)
        refuse(
            element,
            "a receiveTask that starts the process",
            "draw a message start event before it",
            context.findings,
        )
        return node
    is_send = node.kind is Kind.SEND_TASK
    if has_task(element) or (is_send and _has_implementation(element, context)):
        if is_send:
            _warn_message_not_thrown(element, context)
        return replace(node, activity=read_activity(element, context))
    has_message = element.get("messageRef") or element.get("id") in context.collaboration.names
    if is_send and not has_message:
        return replace(node, activity=read_activity(element, context))
    dialect = context.dialects.of(element)
    occurrence = dialect.occurrence(element, None, context.findings)
    return replace(node, event=read_message(element, occurrence, context))


def _has_incoming(element: etree._Element) -> bool:
    parent = element.getparent()
    flows = () if parent is None else children(parent, "sequenceFlow")
    return any(referenced(flow.get("targetRef") or "") == element.get("id") for flow in flows)


def _subprocess(element: etree._Element, node: Node, context: Context, depth: int) -> Node:
    by_event = flag(element, "triggeredByEvent", default=False)
    if depth >= MAX_SCOPE_DEPTH:
        context.findings.fault(
            element,
            message(
                "bpmn.subprocesses_too_deep",
                "subprocesses are nested at most {limit} deep; call a process instead",
                limit=MAX_SCOPE_DEPTH,
            ),
        )
        return node
    scope = read_scope(element, context, depth + 1, in_event_subprocess=by_event)
    return replace(node, scope=scope, triggered_by_event=by_event)


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
