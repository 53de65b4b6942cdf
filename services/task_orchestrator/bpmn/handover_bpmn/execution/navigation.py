"""Navigation: tokens take sequence flows, are split and joined by gateways, and end."""

from handover.messages import message, text_of
from handover_bpmn.execution.machine import Machine
from handover_bpmn.execution.state import Frame, Token, TokenState
from handover_bpmn.languages.base import Variables
from handover_bpmn.model import Flow, Kind, Node


def take_flows(machine: Machine, token: Token) -> None:
    """Move a token from its node along the sequence flows to be taken; without any it ends.

    Raises `RunFailed`, without a change, if there are flows but none can be taken.
    """
    frame = machine.frame_of(token)
    node = frame.graph.nodes[token.node]
    flows = frame.graph.outgoing[node.id]
    if len(flows) > 1 or (flows and flows[0].condition is not None):
        flows = _chosen(machine, token, node, flows)
    for flow in flows:
        machine.add_token(frame, flow.target, via=flow.id)
    machine.remove(token)


def _chosen(machine: Machine, token: Token, node: Node, flows: list[Flow]) -> list[Flow]:
    if node.kind is Kind.PARALLEL:
        return flows
    variables = machine.variables(token)
    taken: list[Flow] = []
    for flow in flows:
        if flow.id == node.default:
            continue
        if _holds(machine, token, flow, variables):
            taken.append(flow)
            if node.kind is Kind.EXCLUSIVE:
                break
    taken = taken or [flow for flow in flows if flow.id == node.default]
    if not taken:
        raise machine.failure(token, _no_match(flows))
    return taken


def _holds(machine: Machine, token: Token, flow: Flow, variables: Variables) -> bool:
    if flow.condition is None:
        return True
    with machine.failures(token):
        return bool(flow.condition.value(variables))


def _no_match(flows: list[Flow]) -> str:
    described = "; ".join(
        f"{flow.name or flow.id}: {flow.condition.text if flow.condition is not None else 'no condition'}"
        for flow in flows
    )
    return message(
        "process.no_condition_holds",
        "no condition holds and there is no default flow ({conditions})",
        conditions=described,
    )


def arrive(machine: Machine, token: Token, node: Node) -> None:
    """Let a token wait at a joining gateway, or continue with those that it was waiting for."""
    frame = machine.frame_of(token)
    incoming = frame.graph.incoming[node.id]
    arrived = _arrived(frame, node.id)
    if token.via is None or all(flow.id != token.via for flow in incoming):  # it was moved here
        token.via = next((flow.id for flow in incoming if flow.id not in arrived), incoming[0].id)
    machine.change_state(token, TokenState.JOINED)
    machine.left_frames[frame.id] = None
    if node.kind is Kind.INCLUSIVE:
        machine.joins_to_check[frame.id, node.id] = None
        return
    arrived.setdefault(token.via, token)
    if len(arrived) == len(incoming):
        _merge(machine, [arrived[flow.id] for flow in incoming])


def check_joins(machine: Machine) -> bool:
    """Continue one inclusive join that no other token can reach; return whether there was one."""
    while machine.joins_to_check:
        frame_id, name = next(iter(machine.joins_to_check))
        del machine.joins_to_check[frame_id, name]
        frame = machine.state.frames.get(frame_id)
        if frame is None:
            continue
        arrived = _arrived(frame, name)
        if arrived and _is_complete(frame, name, arrived):
            _merge(machine, list(arrived.values()))
            return True
    return False


def _arrived(frame: Frame, join: str) -> dict[str, Token]:
    """Return the first token that has arrived at `join` by each flow."""
    arrived: dict[str, Token] = {}
    for token in frame.tokens.values():
        if token.node == join and token.state is TokenState.JOINED and token.via is not None:
            arrived.setdefault(token.via, token)
    return arrived


def _is_complete(frame: Frame, join: str, arrived: dict[str, Token]) -> bool:
    """Return whether no token can reach an incoming flow that is still empty (BPMN 2.0.2, 13.4.3)."""
    upstream = frame.graph.upstream[join]
    empty = [nodes for flow, nodes in upstream.items() if flow not in arrived]
    full = [nodes for flow, nodes in upstream.items() if flow in arrived]
    for token in frame.tokens.values():
        if token.node == join:
            continue
        can_arrive = any(token.node in nodes for nodes in empty)
        if can_arrive and not any(token.node in nodes for nodes in full):
            return False
    return True


def _merge(machine: Machine, tokens: list[Token]) -> None:
    first, *others = tokens
    machine.change_state(first, TokenState.LEAVING)
    for other in others:
        machine.remove(other)


def find_stalled(machine: Machine) -> None:
    """Raise incidents at joins that wait for branches from which no token can come any more."""
    for frame_id in machine.left_frames:
        frame = machine.state.frames.get(frame_id)
        if frame is None or any(token_.state is not TokenState.JOINED for token_ in frame.tokens.peek_all()):
            continue
        for token in frame.tokens.values():
            if token.incident is None:
                machine.report_incident(token, _never_complete(machine, frame, token))
    machine.left_frames.clear()


def _never_complete(machine: Machine, frame: Frame, token: Token) -> str:
    arrived = _arrived(frame, token.node)
    missing = [flow for flow in frame.graph.incoming[token.node] if flow.id not in arrived]
    why = message(
        "process.join_never_complete",
        "the join waits for {flows}, and no token can come from there any more",
        flows=", ".join(flow.name or flow.id for flow in missing),
    )
    return text_of(machine.failure(token, why))


def choose_event(machine: Machine, token: Token) -> list[Node]:
    """Return the events that follow an event-based gateway; raise `RunFailed` if there is none."""
    graph = machine.frame_of(token).graph
    events = [graph.nodes[flow.target] for flow in graph.outgoing[token.node]]
    if not events:
        raise machine.failure(token, "no event follows the gateway")
    return events
