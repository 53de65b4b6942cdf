"""Tasks, call activities and subprocesses."""

from dataclasses import replace

from lxml import etree

from handover.messages import message
from handover_bpmn.model import Call, Kind, Node, Value
from handover_bpmn.notation.context import Context
from handover_bpmn.notation.dialects.handover_elements import has_task
from handover_bpmn.notation.document import child, children, flag
from handover_bpmn.notation.elements import referenced, refuse
from handover_bpmn.notation.names import process_name
from handover_bpmn.notation.nodes.activities import (
    ACTIVITY_PARTS,
    check_quantities,
    read_activity,
    warn_foreign_script,
)
from handover_bpmn.notation.nodes.data import read_data
from handover_bpmn.notation.nodes.event_definitions import read_message
from handover_bpmn.notation.nodes.implementations import has_implementation, warn_message_not_thrown
from handover_bpmn.notation.nodes.loops import read_loop
from handover_bpmn.notation.nodes.node_type import NodeType, Surroundings

MAX_SCOPE_DEPTH = 20


def _with_activity_parts(element: etree._Element, node: Node, context: Context) -> Node:
    """Return a node with what all activities have: loops, and variables that they get and set."""
    main, findings = context.dialects.main, context.findings
    check_quantities(element, context)
    for name in ("standardLoopCharacteristics", "multiInstanceLoopCharacteristics"):
        loop = child(element, name)
        if loop is not None:
            context.dialects.check(loop, findings)
    mapped = main.mapped(element, findings)
    data_inputs, data_outputs = read_data(element, context)
    return replace(
        node,
        is_for_compensation=flag(element, "isForCompensation", default=False),
        loop=read_loop(element, context),
        inputs=mapped.inputs,
        outputs=mapped.outputs,
        data_inputs=data_inputs,
        data_outputs=data_outputs,
    )


def _read_task(element: etree._Element, node: Node, context: Context, _: Surroundings) -> Node:
    node = _with_activity_parts(element, node, context)
    evaluated = None if has_task(element) else context.dialects.main.evaluated(element, context.findings)
    if evaluated is not None:
        return replace(node, kind=Kind.SCRIPT_TASK, script=evaluated)
    return replace(node, activity=read_activity(element, context))


def _read_call(element: etree._Element, node: Node, context: Context, _: Surroundings) -> Node:
    node = _with_activity_parts(element, node, context)
    if referenced(element.get("calledElement") or "") in context.declared.global_tasks:
        return replace(node, activity=read_activity(element, context))
    return replace(node, call=_named_process(context.dialects.main.call(element, context.findings)))


def _named_process(call: Call | None) -> Call | None:
    """Return a call with the name that the definition of the called process has here."""
    if call is None or not isinstance(call.process.literal, str):
        return call
    return replace(call, process=Value(process_name(call.process.literal)))


def _read_script_task(element: etree._Element, node: Node, context: Context, _: Surroundings) -> Node:
    node = _with_activity_parts(element, node, context)
    script = context.dialects.main.script(element, context.findings)
    if has_task(element):
        return replace(node, activity=read_activity(element, context, script=script))
    if script.assignments is not None:
        return replace(node, script=script.assignments)
    if not script.text and not script.format:  # a job without a script
        return replace(node, activity=read_activity(element, context))
    warn_foreign_script(element, script, context)
    return replace(node, activity=read_activity(element, context, script=script))


def _read_message_task(element: etree._Element, node: Node, context: Context, _: Surroundings) -> Node:
    node = _with_activity_parts(element, node, context)
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
    if has_task(element) or (is_send and has_implementation(element, context)):
        if is_send:
            warn_message_not_thrown(element, context)
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


def _read_subprocess(
    element: etree._Element, node: Node, context: Context, surroundings: Surroundings
) -> Node:
    node, depth = _with_activity_parts(element, node, context), surroundings.depth
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
    scope = surroundings.read_scope(element, context, depth + 1, in_event_subprocess=by_event)
    return replace(node, scope=scope, triggered_by_event=by_event)


NODE_TYPES = (
    NodeType(Kind.TASK, _read_task, ACTIVITY_PARTS, has_conditions=True),
    NodeType(Kind.USER_TASK, _read_task, ACTIVITY_PARTS, has_conditions=True),
    NodeType(Kind.MANUAL_TASK, _read_task, ACTIVITY_PARTS, has_conditions=True),
    NodeType(Kind.SERVICE_TASK, _read_task, ACTIVITY_PARTS, has_conditions=True),
    NodeType(Kind.BUSINESS_RULE_TASK, _read_task, ACTIVITY_PARTS, has_conditions=True),
    NodeType(Kind.SCRIPT_TASK, _read_script_task, ACTIVITY_PARTS | {"script"}, has_conditions=True),
    NodeType(Kind.SEND_TASK, _read_message_task, ACTIVITY_PARTS, has_conditions=True),
    NodeType(Kind.RECEIVE_TASK, _read_message_task, ACTIVITY_PARTS, has_conditions=True),
    NodeType(Kind.CALL_ACTIVITY, _read_call, ACTIVITY_PARTS, has_conditions=True),
    NodeType(Kind.SUB_PROCESS, _read_subprocess, None, has_conditions=True),
)
