"""Events: start, end, intermediate and boundary events."""

from collections.abc import Iterator
from dataclasses import replace

from lxml import etree

from handover.messages import message
from handover_bpmn.model import (
    ACTIVITIES,
    Activity,
    Assignment,
    CompensateEvent,
    ErrorEvent,
    EscalationEvent,
    Fault,
    Kind,
    Node,
)
from handover_bpmn.notation.context import Context
from handover_bpmn.notation.dialects.handover_elements import has_task
from handover_bpmn.notation.document import child, flag
from handover_bpmn.notation.elements import referenced
from handover_bpmn.notation.nodes.activities import read_activity
from handover_bpmn.notation.nodes.data import read_data
from handover_bpmn.notation.nodes.event_definitions import definitions_of, read_event
from handover_bpmn.notation.nodes.implementations import has_implementation, warn_message_not_thrown
from handover_bpmn.notation.nodes.node_type import NodeType, Surroundings
from handover_bpmn.notation.scope_graph import ScopeGraph, node_fault

EVENT_PARTS = frozenset(
    {
        *("incoming", "outgoing", "eventDefinitionRef", "dataInputAssociation", "dataOutputAssociation"),
        *("dataInput", "dataOutput", "inputSet", "outputSet"),
    }
)
"""The child elements of events, beside event definitions."""


def read_event_node(
    element: etree._Element, node: Node, context: Context, surroundings: Surroundings
) -> Node:
    """Return an event; one that somebody has to send is a send task."""
    payload: tuple[Assignment, ...] = ()
    for definition in definitions_of(element, context):
        context.dialects.check(definition, context.findings)
        payload += context.dialects.main.mapped(definition, context.findings).inputs
    if _is_work(element, node.kind, context):
        warn_message_not_thrown(element, context)
        mapped = context.dialects.main.mapped(element, context.findings)
        return replace(
            node,
            kind=Kind.SEND_TASK,
            activity=_work_of_event(element, context),
            inputs=mapped.inputs,
            outputs=mapped.outputs,
        )
    event = read_event(element, node.kind, context, in_event_subprocess=surroundings.in_event_subprocess)
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
    return any(has_implementation(part, context) for part in (element, definition))


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


def _check_boundary(node: Node, graph: ScopeGraph) -> Iterator[Fault]:
    host = graph.scope.nodes.get(node.attached_to or "")
    if host is None or host.kind not in ACTIVITIES:
        yield node_fault(
            node,
            message(
                "bpmn.unknown_attached_task",
                'attachedToRef "{attached_to}" names no task that can be interrupted',
                attached_to=node.attached_to,
            ),
        )
        return
    if isinstance(node.event, ErrorEvent) and not node.interrupting:
        yield node_fault(
            node,
            message(
                "bpmn.error_event_not_interrupting",
                'an error boundary event interrupts; set cancelActivity="true"',
            ),
        )
    if isinstance(node.event, CompensateEvent):
        yield from _check_compensation_boundary(node, graph)
    elif isinstance(node.event, ErrorEvent | EscalationEvent):
        first = graph.catchers[node.attached_to, type(node.event), node.event.code]
        if first is not node:
            yield node_fault(
                node,
                message(
                    "bpmn.error_caught_twice",
                    '"{name}" catches the same error of the same task already',
                    name=first.name,
                ),
            )


def _check_compensation_boundary(node: Node, graph: ScopeGraph) -> Iterator[Fault]:
    handler = graph.scope.nodes.get(graph.scope.handlers.get(node.id, ""))
    if handler is None or not handler.is_for_compensation:
        yield node_fault(
            node,
            message(
                "bpmn.no_compensation_handler",
                "the compensation boundary event has no handler; connect it by an association with an "
                'activity that has isForCompensation="true"',
            ),
        )
    if graph.outgoing[node.id]:
        yield node_fault(
            node,
            message(
                "bpmn.compensation_by_flow",
                "no sequence flow leaves a compensation boundary event; "
                "connect the compensation activity by an association",
            ),
        )


NODE_TYPES = (
    NodeType(Kind.START_EVENT, read_event_node, EVENT_PARTS, has_incoming=False),
    NodeType(Kind.END_EVENT, read_event_node, EVENT_PARTS, has_outgoing=False),
    NodeType(Kind.CATCH_EVENT, read_event_node, EVENT_PARTS),
    NodeType(Kind.THROW_EVENT, read_event_node, EVENT_PARTS),
    NodeType(Kind.BOUNDARY_EVENT, read_event_node, EVENT_PARTS, has_incoming=False, check=_check_boundary),
)
