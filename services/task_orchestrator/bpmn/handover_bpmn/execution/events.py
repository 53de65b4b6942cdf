"""Events and gateways: what happens when a token enters one, and when a wait ends."""

from typing import Any

from handover.messages import message
from handover_bpmn.execution.activities import enter_activity, throw_message
from handover_bpmn.execution.compensation import start_compensation
from handover_bpmn.execution.machine import Machine, ThrownSignal
from handover_bpmn.execution.navigation import arrive, choose_event
from handover_bpmn.execution.propagation import (
    start_boundary,
    start_event_subprocess,
    throw_error,
    throw_escalation,
)
from handover_bpmn.execution.state import Frame, Token, TokenState, Wait, WaitType
from handover_bpmn.execution.waits import add_wait, repeat
from handover_bpmn.model import (
    ACTIVITIES,
    CompensateEvent,
    ErrorEvent,
    EscalationEvent,
    Kind,
    LinkEvent,
    MessageEvent,
    Node,
    SignalEvent,
    TerminateEvent,
)


def enter(machine: Machine, token: Token, node: Node) -> None:
    """Enter a node; raise `RunFailed` if that is impossible."""
    if node.kind in ACTIVITIES:
        enter_activity(machine, token, node)
        return
    match node.kind:
        case Kind.CATCH_EVENT:
            _enter_catch(machine, token, node)
        case Kind.THROW_EVENT | Kind.END_EVENT:
            _throw(machine, token, node)
        case Kind.PARALLEL | Kind.INCLUSIVE if len(machine.frame_of(token).graph.incoming[node.id]) > 1:
            arrive(machine, token, node)
        case Kind.EVENT_BASED:
            for event in choose_event(machine, token):
                _await(machine, token, event)
            token.state = TokenState.WAITING
        case _:
            token.state = TokenState.FINISHING


def _enter_catch(machine: Machine, token: Token, node: Node) -> None:
    if node.event is None or isinstance(node.event, LinkEvent):
        token.state = TokenState.FINISHING
        return
    _await(machine, token, node)
    token.state = TokenState.WAITING


def _await(machine: Machine, token: Token, event: Node) -> None:
    with machine.failures(token):
        is_awaited = add_wait(machine, token, event)
    if not is_awaited:
        raise machine.failure(token, f'"{event.id}" is no event that a process can wait for')


def _throw(machine: Machine, token: Token, node: Node) -> None:
    if node.inputs:
        with machine.failures(token):
            variables = machine.variables(token)
            token.local.update(
                {assignment.target: assignment.value.value(variables) for assignment in node.inputs}
            )
    match node.event:
        case MessageEvent() as event:
            throw_message(machine, token, event)
        case SignalEvent() as event:
            with machine.failures(token):
                name = str(event.name.value(machine.variables(token)))
            machine.effects.append(ThrownSignal(name, dict(token.local), machine.element(token)))
        case EscalationEvent() as event:
            details = {"activity": node.id, "code": event.code}
            if throw_escalation(machine, token, event.code, details):
                return
        case CompensateEvent() as event:
            start_compensation(machine, token, event)
            return
        case ErrorEvent() as event:
            _throw_error(machine, token, node, event)
            return
        case TerminateEvent():
            machine.cancel_others(machine.frame_of(token), but=token)
        case LinkEvent() as event:
            frame = machine.frame_of(token)
            target = frame.graph.links.get(event.name)
            if target is None:
                raise machine.failure(token, f'no event catches the link "{event.name}"')
            machine.add_token(frame, target.id, state=TokenState.FINISHING)
            machine.remove(token)
            return
        case _:
            pass
    token.state = TokenState.FINISHING


def _throw_error(machine: Machine, token: Token, node: Node, event: ErrorEvent) -> None:
    reason = message("process.error_end_event", 'the error end event "{node}" was reached', node=node.name)
    details = {"activity": node.id, "reason": str(reason), "code": event.code}
    if not throw_error(machine, token, event.code, details):
        machine.fail_process(reason)


def trigger(machine: Machine, wait: Wait, results: dict[str, Any]) -> None:
    """Let the event of a wait occur; `results` are the variables that it brings."""
    frame = machine.state.frames[wait.frame]
    if wait.token is None:
        _trigger_subprocess(machine, frame, wait, results)
        return
    token = machine.state.tokens[wait.token]
    event = frame.graph.nodes[wait.node]
    if event.kind is Kind.BOUNDARY_EVENT:
        if not event.interrupting:
            _keep_or_remove(machine, wait)
        start_boundary(machine, token, event, results, interrupting=event.interrupting)
    elif token.node == wait.node:
        machine.state.clear_waits(token)
        token.results = results
        machine.change_state(token, TokenState.FINISHING)
    else:  # an event-based gateway
        machine.add_token(frame, event.id, state=TokenState.FINISHING, results=results)
        machine.remove(token)


def _trigger_subprocess(machine: Machine, frame: Frame, wait: Wait, results: dict[str, Any]) -> None:
    for subprocess, start in frame.graph.event_subprocesses:
        if start.id != wait.node:
            continue
        if not start.interrupting:
            _keep_or_remove(machine, wait)
        start_event_subprocess(machine, frame, subprocess, start, results, interrupting=start.interrupting)


def _keep_or_remove(machine: Machine, wait: Wait) -> None:
    """Keep the wait of an event that does not interrupt, unless it is a timer that is not due again."""
    if wait.type is WaitType.TIMER and not repeat(machine, wait):
        machine.state.remove_wait(wait)
