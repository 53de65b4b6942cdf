"""Due timers: timers of processes, timer start events, and the expiry of stored messages."""

from collections.abc import Callable
from datetime import datetime, timedelta

from handover.errors import Problem
from handover.telemetry import get_logger
from handover_processes.definitions.start_timers import next_timer
from handover_processes.events.correlation import EventStart
from handover_processes.process.process import Process
from handover_processes.records.step import Step
from handover_processes.steps.step_writer import StepWriter
from handover_processes.steps.working_state import WorkingState

log = get_logger(__name__)

RETRY_TICK_AFTER_S = 60.0
"""Pause before the timers of a process are processed again that could not be."""


class DueTimers:
    """Finds and processes timers that are due."""

    def __init__(self, state: WorkingState, writer: StepWriter) -> None:
        self._state = state
        self._writer = writer

    def next_due(self) -> datetime | None:
        """Return when the next timer is due, or a stored message expires."""
        state = self._state
        starts = (
            timer.due
            for definition, timers in state.start_timers.items()
            if not state.registry.holds_of(definition)
            for timer in timers
        )
        moments = (state.active_processes.next_due(), state.events.next_expiry(), *starts)
        return min((moment for moment in moments if moment is not None), default=None)

    async def tick(self) -> None:
        """Process the timers that are due."""
        now = self._state.clock()

        def ticking(process: Process) -> Callable[[Step], None]:
            return lambda step: process.tick(step, now)

        def act(step: Step) -> None:
            self._state.events.expire(step, now)
            self._start_processes(step, now)

        await self._writer.apply(act)
        active_processes = self._state.active_processes
        due = {process.record.id: process for process in active_processes.due(now)}
        answers = await self._writer.apply_each({name: ticking(process) for name, process in due.items()})
        for process_id in due.keys() - answers.keys():
            active_processes.postpone(process_id, now + timedelta(seconds=RETRY_TICK_AFTER_S))

    def _start_processes(self, step: Step, now: datetime) -> None:
        """Start the processes whose timer start events are due; those of a paused definition wait."""
        for definition, timers in self._state.start_timers.items():
            if self._state.registry.holds_of(definition) or all(timer.due > now for timer in timers):
                continue
            kept = []
            for timer in timers:
                if timer.due > now:
                    kept.append(timer)
                    continue
                try:
                    start = EventStart(definition, timer.event)
                    self._state.start_by_event(step, start, {}, partner=None)
                except Problem as problem:
                    log.warning("timer starts no process", definition=definition, error=str(problem))
                following = next_timer(timer, now)
                kept += [] if following is None else [following]
            step.start_timers[definition] = tuple(kept)
