"""Compensation: runs the handlers of completed activities, the last completed one first.

A frame records its completed activities that have a handler. A subprocess without a handler leaves the
completed activities within it, which are then compensated in a frame that is restored for this purpose.
"""

from handover_bpmn.execution.machine import Machine
from handover_bpmn.execution.state import Compensation, Completion, Content, Frame, Token, TokenState
from handover_bpmn.model import CompensateEvent, Kind, Node


def record_completion(frame: Frame, token: Token) -> None:
    """Record that the activity of `token` has completed, if it can be compensated."""
    completion: Completion = {"activity": token.node}
    if token.node not in frame.graph.handlers:
        if token.inside is None:
            return
        completion["inside"], token.inside = token.inside, None
    elif token.body is not None:
        completion["local"] = token.local
    frame.completions.append(completion)


def start_compensation(machine: Machine, token: Token, event: CompensateEvent) -> None:
    """Run the compensations that a throwing event asks for; afterwards `token` finishes."""
    token.compensation = Compensation([])
    for frame in reversed(_targets(machine, token)):
        kept: list[Completion] = []
        for completion in frame.completions:
            if event.activity in (None, completion["activity"]):
                token.compensation.entries.append((frame.id, completion))
            else:
                kept.append(completion)
        frame.completions = kept
    continue_compensation(machine, token)


def _targets(machine: Machine, token: Token) -> list[Frame]:
    """Return the frames to compensate: the own one; from an event subprocess also the scope that has it."""
    frame = machine.frame_of(token)
    frames = [frame]
    while (host := machine.host(frame)) is not None and machine.node(host).triggered_by_event:
        frame = machine.frame_of(host)
        frames.append(frame)
    return frames


def continue_compensation(machine: Machine, token: Token) -> None:
    """Start the next handler that `token` waits for, or finish it if there is none left."""
    compensation = token.compensation
    assert compensation is not None  # noqa: S101 - only called for a compensating token
    machine.change_state(token, TokenState.COMPENSATING)
    while compensation.entries:
        frame_id, completion = compensation.entries.pop()
        frame = machine.state.frames.get(frame_id)
        if frame is not None:
            _compensate(machine, token, frame, completion)
            return
    token.compensation = None
    if token.compensates is not None and machine.node(token).scope is not None:
        machine.remove(token)  # a completed subprocess, whose content is compensated
    else:
        machine.change_state(token, TokenState.FINISHING)


def _compensate(machine: Machine, waiting: Token, frame: Frame, completion: Completion) -> None:
    activity = completion["activity"]
    if "inside" not in completion:
        handler = machine.add_token(frame, frame.graph.handlers[activity])
        handler.compensates = waiting.id
        handler.local = completion.get("local", {})
        return
    host = machine.add_token(frame, activity, state=TokenState.COMPENSATING)
    host.compensates = waiting.id
    _compensate_content(machine, host, completion["inside"])


def _compensate_content(machine: Machine, host: Token, content: Content) -> None:
    """Compensate what a completed subprocess has left: by its own event subprocess, or one by one."""
    graph = machine.frame_of(host).graph.inner[host.node]
    host.local = content["local"]
    frame = machine.add_frame(graph, host, variables=content["variables"])
    frame.data = content["data"]
    host.compensation = Compensation([])
    own = graph.compensation_subprocess
    if own is None:
        host.compensation.entries = [(frame.id, completion) for completion in content["completions"]]
        continue_compensation(machine, host)
    else:
        machine.change_state(host, TokenState.COMPENSATING)
        frame.completions = content["completions"]
        _start_own(machine, frame, own, host)


def _start_own(machine: Machine, frame: Frame, subprocess: Node, waiting: Token) -> None:
    """Run the event subprocess with which a completed subprocess compensates itself."""
    token = machine.add_token(frame, subprocess.id, state=TokenState.SCOPE)
    token.compensates = waiting.id
    graph = frame.graph.inner[subprocess.id]
    inner = machine.add_frame(graph, token, variables={})
    for node in graph.nodes.values():
        if node.kind is Kind.START_EVENT and isinstance(node.event, CompensateEvent):
            machine.add_token(inner, node.id, state=TokenState.FINISHING)
