"""Rules of sequence flows. Each fault names the element and the correction."""

from collections.abc import Iterator, Mapping

from handover.messages import message
from services.task_orchestrator.definition import (
    CHOICES,
    GATEWAYS,
    HANDED_OVER,
    Fault,
    Flow,
    Kind,
    Node,
    Trigger,
)

MAX_NODES = 300
MAX_FLOWS = 1_500

Leading = Mapping[str, list[Flow]]


def faults_of_flow(
    process: str, nodes: Mapping[str, Node], flows: Mapping[str, Flow], line: int
) -> list[Fault]:
    """Return the faults of the connections between the `nodes` of `process`, which begins in `line`."""
    if len(nodes) > MAX_NODES:
        return [
            Fault(
                process,
                line,
                message(
                    "bpmn.too_many_nodes",
                    "a process has at most {limit} nodes, not {nodes}; split it",
                    limit=MAX_NODES,
                    nodes=len(nodes),
                ),
            )
        ]
    if len(flows) > MAX_FLOWS:
        rule = f"a process has at most {MAX_FLOWS} sequence flows, not {len(flows)}"
        return [Fault(process, line, message("bpmn.cut_in_two", "{rule}; split it", rule=rule))]
    incoming: dict[str, list[Flow]] = {name: [] for name in nodes}
    outgoing: dict[str, list[Flow]] = {name: [] for name in nodes}
    for flow in flows.values():
        incoming.setdefault(flow.target, []).append(flow)
        outgoing.setdefault(flow.source, []).append(flow)
    faults = list(_of_ends(process, nodes, line))
    dangling = list(_dangling(nodes, flows))
    faults += dangling
    for node in nodes.values():
        faults += _of_node(node, nodes, incoming[node.id], outgoing[node.id])
    for flow in flows.values():
        faults += _of_condition(flow, nodes)
    if not dangling:
        faults += _unreachable(nodes, outgoing)
        faults += _waiting_for_themselves(nodes, incoming, outgoing)
    return faults


def _of_ends(process: str, nodes: Mapping[str, Node], line: int) -> Iterator[Fault]:
    starts = [node for node in nodes.values() if node.kind is Kind.START]
    if not starts:
        yield Fault(
            process,
            line,
            message("bpmn.no_start_event", "a process has one start event, this one has none"),
        )
    for start in starts[1:]:
        yield Fault(
            start.id,
            start.line,
            message("bpmn.second_start_event", "a process has one start event, this is another"),
        )
    if not any(node.kind is Kind.END for node in nodes.values()):
        yield Fault(
            process,
            line,
            message("bpmn.no_end_event", "a process has at least one end event, this one has none"),
        )


def _dangling(nodes: Mapping[str, Node], flows: Mapping[str, Flow]) -> Iterator[Fault]:
    for flow in flows.values():
        for end, name in (("sourceRef", flow.source), ("targetRef", flow.target)):
            if name not in nodes:
                yield Fault(
                    flow.id,
                    flow.line,
                    message(
                        "bpmn.dangling_flow",
                        'the sequence flow dangles: {end} "{name}" is no node of the process',
                        end=end,
                        name=name,
                    ),
                )


def _of_node(
    node: Node, nodes: Mapping[str, Node], incoming: list[Flow], outgoing: list[Flow]
) -> Iterator[Fault]:
    kind = node.kind.value
    if node.kind in {Kind.START, Kind.BOUNDARY}:
        if incoming:
            yield Fault(
                node.id,
                node.line,
                message("bpmn.incoming_flow_forbidden", "no sequence flow may lead to a {kind}", kind=kind),
            )
    elif not incoming:
        yield Fault(
            node.id,
            node.line,
            message("bpmn.no_incoming_flow", "no sequence flow leads to this {kind}", kind=kind),
        )
    if node.kind is Kind.END:
        if outgoing:
            yield Fault(
                node.id,
                node.line,
                message("bpmn.outgoing_flow_forbidden", "no sequence flow may leave an endEvent"),
            )
    elif not outgoing:
        yield Fault(
            node.id,
            node.line,
            message("bpmn.no_outgoing_flow", "no sequence flow leaves this {kind}", kind=kind),
        )
    elif len(outgoing) > 1 and node.kind not in GATEWAYS:
        yield Fault(
            node.id,
            node.line,
            message(
                "bpmn.implicit_split",
                "one sequence flow leaves a {kind}; put a gateway behind it to split",
                kind=kind,
            ),
        )
    if node.kind is Kind.BOUNDARY:
        yield from _of_boundary(node, nodes)
    if node.kind in CHOICES:
        yield from _of_choice(node, outgoing)
    elif node.default is not None:
        yield Fault(
            node.id,
            node.line,
            message(
                "bpmn.default_flow_forbidden", "only an exclusive or inclusive gateway has a default flow"
            ),
        )


def _of_boundary(node: Node, nodes: Mapping[str, Node]) -> Iterator[Fault]:
    host = nodes.get(node.attached_to or "")
    if host is None or host.kind not in HANDED_OVER:
        yield Fault(
            node.id,
            node.line,
            message(
                "bpmn.unknown_attached_task",
                'attachedToRef "{attached_to}" names no task that can be interrupted',
                attached_to=node.attached_to,
            ),
        )
    if node.trigger is Trigger.ERROR and not node.interrupting:
        yield Fault(
            node.id,
            node.line,
            message(
                "bpmn.error_event_not_interrupting",
                'an error boundary event interrupts; set cancelActivity="true"',
            ),
        )
    twins = [
        other
        for other in nodes.values()
        if other.kind is Kind.BOUNDARY
        and other.attached_to == node.attached_to
        and other.trigger is node.trigger is Trigger.ERROR
        and other.error_code == node.error_code
    ]
    if len(twins) > 1 and twins[0] is not node:
        yield Fault(
            node.id,
            node.line,
            message(
                "bpmn.error_caught_twice",
                '"{name}" catches the same error of the same task already',
                name=twins[0].id,
            ),
        )


def _of_choice(node: Node, outgoing: list[Flow]) -> Iterator[Fault]:
    if node.default is not None and node.default not in {flow.id for flow in outgoing}:
        yield Fault(
            node.id,
            node.line,
            message(
                "bpmn.wrong_default_flow",
                'its default flow "{default}" does not leave it',
                default=node.default,
            ),
        )
    if len(outgoing) < 2:
        return
    for flow in outgoing:
        if flow.condition is None and flow.id != node.default:
            rule = "has no condition and is not the gateway's default"
            yield Fault(
                node.id,
                node.line,
                message(
                    "bpmn.flow_without_condition",
                    'its flow "{flow}" to "{target}" {rule}; give it one',
                    flow=flow.id,
                    target=flow.target,
                    rule=rule,
                ),
            )


def _of_condition(flow: Flow, nodes: Mapping[str, Node]) -> Iterator[Fault]:
    source = nodes.get(flow.source)
    if flow.condition is not None and source is not None and source.kind not in CHOICES:
        rule = "only flows that leave an exclusive or inclusive gateway have conditions"
        yield Fault(
            flow.id,
            flow.line,
            message(
                "bpmn.wrong_source",
                '{rule}; "{source}" is a {kind}',
                rule=rule,
                source=source.id,
                kind=source.kind.value,
            ),
        )


def _unreachable(nodes: Mapping[str, Node], outgoing: Leading) -> Iterator[Fault]:
    reached = _reached(nodes, outgoing)
    led_to = {flow.target for leaving in outgoing.values() for flow in leaving}
    for node in nodes.values():
        if node.id not in reached and (node.id in led_to or node.kind is Kind.BOUNDARY):
            yield Fault(
                node.id,
                node.line,
                message("bpmn.unreachable", "it cannot be reached from the start event"),
            )


def _waiting_for_themselves(
    nodes: Mapping[str, Node], incoming: Leading, outgoing: Leading
) -> Iterator[Fault]:
    for node in nodes.values():
        if node.kind is not Kind.PARALLEL or len(incoming[node.id]) < 2:
            continue
        reached = _reached(nodes, outgoing, without=node.id)
        for flow in incoming[node.id]:
            if flow.source not in reached:
                rule = "comes only after the gateway itself, so the gateway would never continue"
                way_out = "put an exclusive gateway before it, where the loop returns"
                yield Fault(
                    node.id,
                    node.line,
                    message(
                        "bpmn.wrong_flow",
                        'its flow "{flow}" {rule}; {way_out}',
                        flow=flow.id,
                        rule=rule,
                        way_out=way_out,
                    ),
                )


def _reached(nodes: Mapping[str, Node], outgoing: Leading, *, without: str | None = None) -> set[str]:
    """Return the nodes that a token can reach from the start event without passing `without`."""
    reached: set[str] = set()
    stack = [node.id for node in nodes.values() if node.kind is Kind.START]
    while stack:
        here = stack.pop()
        if here in reached or here == without:
            continue
        reached.add(here)
        stack += [flow.target for flow in outgoing[here]]
        stack += [node.id for node in nodes.values() if node.attached_to == here]
    return reached
