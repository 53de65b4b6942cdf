"""Start timers: the timer start events of definitions, which start processes by the clock.

A repeating timer without a number of repetitions skips the moments that were missed while the orchestrator
was not running; every other moment starts a process, even late.
"""

import sys
from collections.abc import Iterator
from dataclasses import replace
from datetime import datetime

from handover.telemetry import get_logger
from handover_bpmn.languages.base import ExpressionError
from handover_bpmn.model import Definition, Kind, TimerEvent, TimerType
from handover_bpmn.timing.timers import due_at, parse_cycle
from handover_processes.records.timers import StartTimer

log = get_logger(__name__)


def start_timers(definition: Definition, now: datetime) -> tuple[StartTimer, ...]:
    """Return the timers of a definition that was deployed at `now`."""
    return tuple(_timers(definition, now))


def _timers(definition: Definition, now: datetime) -> Iterator[StartTimer]:
    for node in definition.scope.nodes.values():
        if node.kind is not Kind.START_EVENT or not isinstance(node.event, TimerEvent):
            continue
        try:
            text = str(node.event.value.value({}))
            if node.event.type is TimerType.CYCLE:
                yield StartTimer(definition.name, node.id, parse_cycle(text).first(now), text)
            else:
                yield StartTimer(definition.name, node.id, due_at(text, now))
        except (ExpressionError, ValueError) as error:
            log.warning(
                "timer starts no process", definition=definition.name, element=node.id, error=str(error)
            )


def next_timer(timer: StartTimer, now: datetime) -> StartTimer | None:
    """Return the timer as it is after it was due; None if it is not due again."""
    if timer.text is None:
        return None
    cycle, count = parse_cycle(timer.text), timer.count + 1
    due = cycle.next(timer.due, count)
    if due is not None and due <= now and cycle.next(timer.due, sys.maxsize) is not None:
        due = cycle.next_after(due, now)
    return None if due is None else replace(timer, due=due, count=count)
