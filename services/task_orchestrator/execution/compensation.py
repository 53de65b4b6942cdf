"""Compensation: runs the handlers of completed activities, the last completed one first."""

from services.task_orchestrator.execution.machine import Machine
from services.task_orchestrator.execution.state import Compensation, Frame, Token, TokenState
from services.task_orchestrator.model import CompensateEvent, Node


def record_completion(frame: Frame, token: Token) -> None:
    """Record that the activity of `token` has completed, if it can be compensated."""
    if token.node in frame.graph.handlers:
        frame.compensations.append({"activity": token.node})
    elif token.inside is not None:
        frame.compensations.append({"activity": token.node, "inside": token.inside})


def start_compensation(machine: Machine, token: Token, event: CompensateEvent) -> None:
    """Run the compensations that a throwing event asks for; afterwards `token` finishes."""
    frame = _target(machine, token)
    entries = [each for each in frame.compensations if event.activity in (None, each["activity"])]
    frame.compensations = [
        each for each in frame.compensations if event.activity not in (None, each["activity"])
    ]
    token.compensation = Compensation(frame.id, entries)
    continue_compensation(machine, token)


def _target(machine: Machine, token: Token) -> Frame:
    """Return the frame to compensate: the own one; from an event subprocess, the scope that has it."""
    frame = machine.frame_of(token)
    host = machine.host(frame)
    if host is not None and machine.node(host).triggered_by_event:
        return machine.frame_of(host)
    return frame


def continue_compensation(machine: Machine, token: Token) -> None:
    """Start the next handler that `token` waits for, or finish it if there is none left."""
    compensation = token.compensation
    assert compensation is not None  # noqa: S101 - only called for a compensating token
    token.state = TokenState.COMPENSATING
    if not compensation.entries:
        token.compensation = None
        _finish(machine, token)
        return
    entry = compensation.entries.pop()
    frame = machine.state.frames[compensation.frame]
    activity = entry["activity"]
    if "inside" not in entry:
        handler = machine.add_token(frame, frame.graph.handlers.get(activity, activity))
        handler.compensates = token.id
        return
    host = machine.add_token(frame, activity, state=TokenState.COMPENSATING)
    host.compensates = token.id
    inside = entry["inside"]
    graph = frame.graph.inner[activity]
    inner = machine.add_frame(graph, host, variables=inside["variables"])
    inner.data = inside["data"]
    host.state = TokenState.COMPENSATING
    own = graph.compensation_subprocess
    if own is not None:
        inner.compensations = inside["compensations"]
        _start_own(machine, inner, own, host)
        return
    host.compensation = Compensation(inner.id, inside["compensations"])
    continue_compensation(machine, host)


def _start_own(machine: Machine, frame: Frame, subprocess: Node, waiting: Token) -> None:
    """Run the event subprocess with which a completed subprocess compensates itself."""
    waiting.compensation = Compensation(frame.id, [])
    token = machine.add_token(frame, subprocess.id, state=TokenState.SCOPE)
    token.compensates = waiting.id
    graph = frame.graph.inner[subprocess.id]
    inner = machine.add_frame(graph, token, variables={})
    for start in (node for node in graph.nodes.values() if isinstance(node.event, CompensateEvent)):
        if start.kind.value == "startEvent":
            machine.add_token(inner, start.id, state=TokenState.FINISHING)


def _finish(machine: Machine, token: Token) -> None:
    """Continue after the last handler: a throwing event finishes, a compensated subprocess reports."""
    waiting = token.compensates
    if waiting is None or machine.node(token).scope is None:
        machine.change_state(token, TokenState.FINISHING)
        return
    report(machine, token)


def report(machine: Machine, token: Token) -> None:
    """End a token that has compensated, and continue the one that waits for it."""
    waiting = machine.state.tokens.get(token.compensates or 0)
    if token.child is not None:
        machine.discard_frame(machine.state.frames[token.child])
    machine.remove(token)
    if waiting is not None and waiting.compensation is not None:
        continue_compensation(machine, waiting)
