"""Waits: timers, messages, signals and conditions that a process waits for."""

import sys
from collections import ChainMap
from collections.abc import MutableMapping
from typing import Any

from handover_bpmn.execution.machine import Machine
from handover_bpmn.execution.state import Frame, Token, Wait, WaitType
from handover_bpmn.languages.base import ExpressionError, Variables
from handover_bpmn.model import ConditionalEvent, MessageEvent, Node, SignalEvent, TimerEvent, TimerType
from handover_bpmn.timing.timers import due_at, parse_cycle

Owner = Token | Frame


def add_wait(machine: Machine, owner: Owner, event: Node) -> bool:
    """Wait for the event `event`; return False if it is none that is waited for.

    The owner is the token that continues at the event or whose activity the event is attached to, or the
    frame of an event subprocess. Raises `ExpressionError` or `ValueError` for values that are invalid.
    """
    if not isinstance(event.event, TimerEvent | MessageEvent | SignalEvent | ConditionalEvent):
        return False
    if isinstance(owner, Token):
        variables = machine.variables(owner)
        wait = Wait(0, WaitType.TIMER, owner.frame, event.id, owner.id)
    else:
        variables = machine.frame_variables(owner)
        wait = Wait(0, WaitType.TIMER, owner.id, event.id)
    match event.event:
        case TimerEvent() as timer:
            _set_due(machine, wait, timer, timer.value.value(variables))
        case MessageEvent() as definition:
            wait.type = WaitType.MESSAGE
            wait.text = str(definition.name.value(variables))
            if definition.correlation is not None:
                wait.key = definition.correlation.value(variables)
        case SignalEvent() as definition:
            wait.type = WaitType.SIGNAL
            wait.text = str(definition.name.value(variables))
        case ConditionalEvent():
            wait.type = WaitType.CONDITION
            machine.variables_changed = True  # so that it is evaluated at the end of this step
    wait.id = machine.state.new_id()
    machine.state.add_wait(wait)
    return True


def _set_due(machine: Machine, wait: Wait, timer: TimerEvent, value: object) -> None:
    if not isinstance(value, str):
        raise ExpressionError(f"a timer needs a text such as PT5M, not {value!r:.80}")
    if timer.type is TimerType.CYCLE:
        wait.text = value
        wait.due = parse_cycle(value).first(machine.now)
    else:
        wait.due = due_at(value, machine.now)


def repeat(machine: Machine, wait: Wait) -> bool:
    """Set a repeating timer to its next moment; return False if there is none.

    A cycle without a number of repetitions skips the moments that were missed while nobody was there.
    """
    if wait.text is None or wait.due is None:
        return False
    cycle = parse_cycle(wait.text)
    wait.count += 1
    following = cycle.next(wait.due, wait.count)
    is_endless = cycle.next(wait.due, sys.maxsize) is not None
    if following is not None and following <= machine.now and is_endless:
        following = cycle.next_after(following, machine.now)
    wait.due = following
    return following is not None


def conditions_that_became_true(machine: Machine) -> list[Wait]:
    """Return the waits whose conditions are true now and were not at the last evaluation."""
    waits = []
    for wait_id in machine.state.conditions:
        wait = machine.state.waits[wait_id]
        if wait.stopped is not None:
            continue
        event = event_of(machine, wait).event
        if not isinstance(event, ConditionalEvent) or event.on is not None:
            continue
        held, wait.holds = wait.holds, _holds(event, _visible(machine, wait))
        if wait.holds and not held:
            waits.append(wait)
    return waits


def holds_for(machine: Machine, wait: Wait, entity: Variables) -> bool:
    """Return whether the condition of a wait is true with the variable that holds an entity."""
    event = event_of(machine, wait).event
    if not isinstance(event, ConditionalEvent):
        return False
    return _holds(event, ChainMap(dict(entity), _visible(machine, wait)))


def event_of(machine: Machine, wait: Wait) -> Node:
    """Return the node of the event that is waited for."""
    frame = machine.state.frames[wait.frame]
    return frame.graph.nodes.get(wait.node) or _start_of(frame, wait.node)


def _visible(machine: Machine, wait: Wait) -> MutableMapping[str, Any]:
    if wait.token is None:
        return machine.frame_variables(machine.state.frames[wait.frame])
    return machine.variables(machine.state.tokens[wait.token])


def _holds(event: ConditionalEvent, variables: Variables) -> bool:
    try:
        return bool(event.condition.value(variables))
    except ExpressionError:
        return False  # a variable that is not there yet


def _start_of(frame: Frame, name: str) -> Node:
    """Return the start event `name` of an event subprocess of a frame."""
    return next(start for _, start in frame.graph.event_subprocesses if start.id == name)
