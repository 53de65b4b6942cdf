"""Token acts: what an engineer does with one token."""

from collections.abc import Mapping
from typing import Any

from handover_bpmn.execution.activities import cancel_instance, open_work, set_results
from handover_bpmn.execution.events import trigger
from handover_bpmn.execution.machine import Machine
from handover_bpmn.execution.navigation import arrive
from handover_bpmn.execution.propagation import register_event_subprocesses
from handover_bpmn.execution.state import Frame, RunFailed, Token, TokenState
from handover_bpmn.model import Kind


def retry(machine: Machine, token: Token) -> None:
    """Let a token with an incident try again where it stopped."""
    incident = token.incident
    if incident is None:
        raise RunFailed(f"the token {token.id} has no incident")
    token.incident = None
    if token.state is TokenState.JOINED:
        arrive(machine, token, machine.node(token))
    elif token.state is not TokenState.INCIDENT:
        _retry_events(machine, token)
    elif incident.stage is TokenState.WORK:
        open_work(machine, token)
    else:
        machine.change_state(token, incident.stage)


def _retry_events(machine: Machine, token: Token) -> None:
    """Process the failed events of a token again, or wait again for those of its event subprocesses."""
    owners: list[Token | Frame] = [token, machine.frame_of(token)]
    child = None if token.child is None else machine.state.frames[token.child]
    if child is not None:
        owners.append(child)
    stopped = [
        wait
        for owner in owners
        for wait in (machine.state.waits[wait] for wait in owner.waits)
        if wait.stopped is not None
    ]
    if not stopped and child is not None:
        machine.state.clear_waits(child)
        with machine.failures(token):
            register_event_subprocesses(machine, child)
    for wait in stopped:
        if wait.id in machine.state.waits:
            payload, wait.stopped = wait.stopped or {}, None
            trigger(machine, wait, payload)


def skip(machine: Machine, token: Token, results: Mapping[str, Any]) -> None:
    """Let a token leave its node without doing what the node asks for; `results` become variables."""
    node = machine.node(token)
    if node.kind is Kind.EVENT_BASED:
        raise machine.failure(token, "an event-based gateway cannot be skipped, only moved")
    machine.undo_entry(token)
    token.results = None
    set_results(machine, token, node, results)
    machine.change_state(token, TokenState.LEAVING)


def move(machine: Machine, token: Token, node: str) -> None:
    """Move a token to another node of its scope; what it does in its present node is cancelled."""
    while token.body is not None:
        token = machine.state.tokens[token.body]
    frame = machine.frame_of(token)
    target = frame.graph.nodes.get(node)
    if target is None or target.kind is Kind.BOUNDARY_EVENT or target.triggered_by_event:
        raise RunFailed.translated(
            "process.cannot_move",
            '"{node}" is no element of "{scope}" at which a token can be',
            node=node,
            scope=frame.scope,
        )
    machine.add_token(frame, node)
    machine.remove(token)


def set_scope_variables(machine: Machine, scope: str, values: Mapping[str, Any]) -> str:
    """Set variables of an inner scope, a frame or a token, and return its element."""
    holder_id = int(scope) if scope.isascii() and scope.isdecimal() else 0
    frame, token = machine.state.frames.get(holder_id), machine.state.tokens.get(holder_id)
    host = None if frame is None else machine.host(frame)
    if token is not None:
        token.local.update(values)
        host = token
    elif frame is not None and host is not None:
        frame.variables.update(values)
    else:
        raise RunFailed.translated("process.no_such_scope", 'there is no scope "{scope}"', scope=scope)
    machine.variables_changed = True
    return machine.element(host)


def cancel(machine: Machine, token: Token) -> None:
    """End a token where it is; its scope or loop ends if it was the last one."""
    if token.body is None:
        machine.remove(token)
    else:
        cancel_instance(machine, token)
