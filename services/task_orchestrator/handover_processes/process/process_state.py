"""State: a process in memory, with its Tasks, timers and reservations."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import Any

from handover.errors import Problem
from handover.tasks.task_life import is_reachable
from handover_bpmn.execution.graph import Plan
from handover_bpmn.execution.run import Run
from handover_bpmn.execution.state import Library
from handover_datamodels.entities import Task, TaskStatus
from handover_processes.allocation.allocator import Allocator
from handover_processes.process.open_tasks import OpenTasks
from handover_processes.process.span_reservations import SpanReservations
from handover_processes.records.processes import Act, ProcessRecord
from handover_processes.records.step import Step
from handover_processes.records.tasks import TaskRecord
from handover_processes.records.timers import Timer, TimerKind
from handover_processes.settings import OrchestratorSettings


@dataclass(slots=True)
class ProcessState:
    """A process in memory; `run` is None after its end.

    `composed` are the ids of all its Tasks.
    """

    settings: OrchestratorSettings
    record: ProcessRecord
    plan: Plan
    run: Run | None
    library: Library
    allocator: Allocator
    composed: list[str] = field(default_factory=list)
    open_tasks: OpenTasks = field(init=False)
    reservations: SpanReservations = field(init=False)
    reported: tuple[TaskStatus, int] | None = None
    """The status and the number of Tasks that were last written to the broker."""

    def __post_init__(self) -> None:
        self.open_tasks = OpenTasks(self.settings, self.allocator)
        self.reservations = SpanReservations(self.record.id, self.allocator, self.record.reservations)

    @property
    def tasks(self) -> dict[str, TaskRecord]:
        """Return the Tasks that have not ended, by id."""
        return self.open_tasks.records

    @property
    def urn(self) -> str:
        """Return the id of its Process entity."""
        return self.settings.entity_id("Process", self.record.id)

    @property
    def over(self) -> bool:
        """Return whether it and all its Tasks have ended."""
        return self.run is None and not self.tasks

    def is_current(self, run: Run, task: TaskRecord) -> bool:
        """Return whether the activity that the Task was made for is still open."""
        return run.visit(task.token) == task.visit

    def is_news(self, seen: Task) -> bool:
        """Return whether the Task as `seen` has a new status that can follow the known one."""
        task = self.tasks.get(seen.id)
        if task is None or seen.status.value is task.status:
            return False
        return is_reachable(task.status, seen.status.value)

    def require_running(self) -> Run:
        """Return the run; raise `Problem` 409 if the process has ended."""
        if self.run is None:
            raise Problem.translated(
                409,
                "Process has ended",
                "process.process_has_ended",
                "{process} is {status} already",
                process=self.record.id,
                status=self.record.status,
            )
        return self.run

    def timers(self) -> tuple[Timer, ...]:
        """Return the timers, the earliest first."""
        return tuple(sorted(self._timers(), key=lambda timer: timer.due))

    def _timers(self) -> Iterator[Timer]:
        is_paused = self.record.status is TaskStatus.PAUSED
        if not is_paused and self.run is not None and (event := self.run.next_due()) is not None:
            yield Timer(TimerKind.EVENT, "", event)
        for task in self.tasks.values():
            if not is_paused or task.cancelled_at is not None:
                yield from self.open_tasks.timers_of(task)
        for retry in self.record.retries:
            if retry.due is not None and not is_paused:
                yield Timer(TimerKind.RETRY, retry.token, retry.due)

    def next_due(self) -> datetime | None:
        """Return when the first of the timers is due."""
        if self.record.status is TaskStatus.PAUSED:
            return min((timer.due for timer in self._timers()), default=None)
        moments = [self.open_tasks.next_due(), *(retry.due for retry in self.record.retries)]
        if self.run is not None:
            moments.append(self.run.next_due())
        return min((moment for moment in moments if moment is not None), default=None)

    def due_timers(self, now: datetime) -> list[Timer]:
        """Return the timers that are due at `now`, the earliest first."""
        if self.record.status is TaskStatus.PAUSED:
            return [timer for timer in self.timers() if timer.due <= now]
        due = self.open_tasks.due_timers(now)
        event = None if self.run is None else self.run.next_due()
        if event is not None and event <= now:
            due.append(Timer(TimerKind.EVENT, "", event))
        due += [
            Timer(TimerKind.RETRY, retry.token, retry.due)
            for retry in self.record.retries
            if retry.due is not None and retry.due <= now
        ]
        return sorted(due, key=lambda timer: timer.due)

    def form_data(self, task: TaskRecord) -> dict[str, Any]:
        """Return what a form of an open Task knows: the variables and the parameters of the Task."""
        values: dict[str, Any] = {}
        if self.run is not None and self.is_current(self.run, task):
            values |= self.run.open_activity(task.token).variables
        return {**values, **task.entity["workParameters"]["value"]}

    def record_task(self, task: TaskRecord, step: Step) -> None:
        """Record a new or changed Task."""
        step.tasks[task.id] = task
        self.open_tasks.track(task)

    def record_act(self, act: Act, step: Step) -> None:
        """Add an act to the history, with whether its name is that of who is signed in."""
        self.revise(acts=(*self.record.acts, replace(act, verified=step.is_verified(act.by))))

    def revise(self, **changes: Any) -> None:
        """Change fields of the record."""
        self.record = replace(self.record, **changes)
