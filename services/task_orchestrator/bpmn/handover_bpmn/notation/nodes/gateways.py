"""Gateways."""

from collections.abc import Iterator

from lxml import etree

from handover.messages import message
from handover_bpmn.model import ConditionalEvent, Fault, Kind, MessageEvent, Node, SignalEvent, TimerEvent
from handover_bpmn.notation.context import Context
from handover_bpmn.notation.document import flag
from handover_bpmn.notation.elements import refuse
from handover_bpmn.notation.nodes.node_type import NodeType, Surroundings
from handover_bpmn.notation.scope_graph import ScopeGraph, node_fault

_GATEWAY_PARTS = frozenset({"incoming", "outgoing"})
_AWAITED = (MessageEvent, TimerEvent, SignalEvent, ConditionalEvent)


def _read_gateway(
    _element: etree._Element, node: Node, _context: Context, _surroundings: Surroundings
) -> Node:
    return node


def _read_event_gateway(element: etree._Element, node: Node, context: Context, _: Surroundings) -> Node:
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


def _check_choice(node: Node, graph: ScopeGraph) -> Iterator[Fault]:
    outgoing = graph.outgoing[node.id]
    if len(outgoing) < 2:
        return
    for flow in outgoing:
        if flow.condition is None and flow.id != node.default and flow.id not in graph.broken:
            rule = "has no condition and is not the gateway's default"
            yield node_fault(
                node,
                message(
                    "bpmn.flow_without_condition",
                    'its flow "{flow}" to "{target}" {rule}; give it one',
                    flow=flow.name or flow.id,
                    target=graph.name_of(flow.target),
                    rule=rule,
                ),
            )


def _check_event_gateway(node: Node, graph: ScopeGraph) -> Iterator[Fault]:
    for flow in graph.outgoing[node.id]:
        target = graph.scope.nodes.get(flow.target)
        if target is None or target.id in graph.broken:
            continue
        is_event = target.kind is Kind.CATCH_EVENT and isinstance(target.event, _AWAITED)
        is_receiver = target.kind is Kind.RECEIVE_TASK and isinstance(target.event, MessageEvent)
        if not is_event and not is_receiver:
            yield node_fault(
                node,
                message(
                    "bpmn.event_gateway_target",
                    'its flow leads to "{target}"; behind an eventBasedGateway stand catching message, '
                    "timer, signal and conditional events, and receive tasks",
                    target=target.name,
                ),
            )


NODE_TYPES = (
    NodeType(
        Kind.EXCLUSIVE, _read_gateway, _GATEWAY_PARTS, has_conditions=True, joins=True, check=_check_choice
    ),
    NodeType(Kind.INCLUSIVE, _read_gateway, _GATEWAY_PARTS, has_conditions=True, joins=True),
    NodeType(Kind.PARALLEL, _read_gateway, _GATEWAY_PARTS, joins=True),
    NodeType(Kind.EVENT_BASED, _read_event_gateway, _GATEWAY_PARTS, check=_check_event_gateway),
)
