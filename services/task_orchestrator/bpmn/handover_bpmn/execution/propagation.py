"""Propagation: an error or escalation goes outwards until an event catches it.

From the activity where it occurs it is offered to the boundary events of the activity, to the event
subprocesses of its scope, and so on for each enclosing scope and calling process (BPMN 2.0.2, 10.5.6).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from handover.messages import text_of
from handover_bpmn.execution.machine import Machine, UncaughtEscalation
from handover_bpmn.execution.state import Frame, Token, TokenState
from handover_bpmn.execution.waits import add_wait
from handover_bpmn.languages.base import ExpressionError
from handover_bpmn.model import ErrorEvent, EscalationEvent, Event, Node


@dataclass(frozen=True, slots=True)
class Catcher:
    """The event that catches: a boundary event of `host`, or the start event of `subprocess` in `frame`."""

    event: Node
    host: Token | None = None
    frame: Frame | None = None
    subprocess: Node | None = None


def throw_error(
    machine: Machine, token: Token, code: str | None, details: dict[str, Any], *, only_named: bool = False
) -> bool:
    """Continue at the event that catches the error `code`; return False without a change if none does.

    The variable `error` gets `details`. If `only_named`, events that catch every error do not count.
    """
    catcher = _find_catcher(machine, token, ErrorEvent, code, only_named=only_named)
    if catcher is None:
        return False
    event = catcher.event.event
    assert isinstance(event, ErrorEvent)  # noqa: S101 - as `_find_catcher` was asked
    results: dict[str, Any] = {"error": details}
    if event.code_variable is not None:
        results[event.code_variable] = code
    if event.message_variable is not None:
        results[event.message_variable] = details.get("reason")
    _catch(machine, catcher, results, interrupting=True)
    return True


def is_caught(machine: Machine, token: Token, code: str | None) -> bool:
    """Return whether an event catches the error `code`."""
    return _find_catcher(machine, token, ErrorEvent, code) is not None


def throw_escalation(machine: Machine, token: Token, code: str | None, details: dict[str, Any]) -> bool:
    """Start the event that catches the escalation `code`; return whether `token` was cancelled by it."""
    catcher = _find_catcher(machine, token, EscalationEvent, code)
    if catcher is None:
        machine.effects.append(UncaughtEscalation(code, machine.element(token)))
        return False
    event = catcher.event.event
    assert isinstance(event, EscalationEvent)  # noqa: S101 - as `_find_catcher` was asked
    results: dict[str, Any] = {"escalation": details}
    if event.code_variable is not None:
        results[event.code_variable] = code
    _catch(machine, catcher, results, interrupting=catcher.event.interrupting)
    return token.id not in machine.state.tokens


def _find_catcher(
    machine: Machine,
    token: Token,
    type_: type[ErrorEvent] | type[EscalationEvent],
    code: str | None,
    *,
    only_named: bool = False,
) -> Catcher | None:
    codes = (code,) if only_named else (None, code)

    def matches(event: Event | None) -> bool:
        return isinstance(event, type_) and event.code in codes

    while True:
        host = token if token.body is None else machine.state.tokens[token.body]
        frame = machine.frame_of(host)
        boundary = _best(frame.graph.boundaries.get(host.node, []), matches)
        if boundary is not None:
            return Catcher(boundary, host=host)
        if not machine.node(host).triggered_by_event:  # what it throws concerns the enclosing scope
            starts = {start.id: node for node, start in frame.graph.event_subprocesses}
            boundary = _best([start for _, start in frame.graph.event_subprocesses], matches)
            if boundary is not None:
                return Catcher(boundary, frame=frame, subprocess=starts[boundary.id])
        outer = machine.host(frame)
        if outer is None:
            return None
        token = outer


def _best(nodes: list[Node], matches: Callable[[Event | None], bool]) -> Node | None:
    """Return the node whose event matches; one with a code comes before one that catches everything."""
    catching = [node for node in nodes if matches(node.event)]
    catching.sort(key=lambda node: getattr(node.event, "code", None) is None)
    return catching[0] if catching else None


def _catch(machine: Machine, catcher: Catcher, results: dict[str, Any], *, interrupting: bool) -> None:
    if catcher.host is not None:
        start_boundary(machine, catcher.host, catcher.event, results, interrupting=interrupting)
    elif catcher.frame is not None and catcher.subprocess is not None:
        start_event_subprocess(
            machine, catcher.frame, catcher.subprocess, catcher.event, results, interrupting=interrupting
        )


def start_boundary(
    machine: Machine, host: Token, event: Node, results: dict[str, Any], *, interrupting: bool
) -> None:
    """Continue at a boundary event of the activity of `host`, which is cancelled if it interrupts."""
    machine.add_token(machine.frame_of(host), event.id, state=TokenState.FINISHING, results=results)
    if interrupting:
        machine.remove(host)


def start_event_subprocess(
    machine: Machine,
    frame: Frame,
    subprocess: Node,
    start: Node,
    results: dict[str, Any],
    *,
    interrupting: bool,
) -> None:
    """Run an event subprocess in `frame`, whose tokens are cancelled if it interrupts."""
    host = machine.add_token(frame, subprocess.id, state=TokenState.SCOPE)
    if interrupting:
        machine.cancel_others(frame, but=host)
        machine.state.clear_waits(frame)
    inner = machine.add_frame(frame.graph.inner[subprocess.id], host, variables={})
    machine.add_token(inner, start.id, state=TokenState.FINISHING, results=results)
    try:
        register_event_subprocesses(machine, inner)
    except (ExpressionError, ValueError) as error:
        machine.report_incident(host, machine.failure(host, text_of(error)).args[0])


def register_event_subprocesses(machine: Machine, frame: Frame) -> None:
    """Wait for the start events of the event subprocesses of a frame.

    Raises `ExpressionError` or `ValueError` for values that are invalid.
    """
    for _, start in frame.graph.event_subprocesses:
        add_wait(machine, frame, start)
