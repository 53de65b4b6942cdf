"""Open Tasks: the Tasks of a process that have not ended, and the open activities without a Task."""

from collections.abc import Iterator
from datetime import datetime, timedelta

from handover_bpmn.execution.run import Run
from handover_bpmn.timing.due_queue import DueQueue
from handover_datamodels.entities import TaskStatus
from handover_processes.allocation.allocator import Allocator
from handover_processes.records.tasks import TaskRecord
from handover_processes.records.timers import Timer, TimerKind
from handover_processes.settings import OrchestratorSettings


class OpenTasks:
    """The open Tasks of one process, by id in `records`; the allocator counts those of each agent."""

    __slots__ = ("_allocator", "_by_visit", "_compared", "_dues", "_settings", "records", "unposted")

    def __init__(self, settings: OrchestratorSettings, allocator: Allocator) -> None:
        self._settings = settings
        self._allocator = allocator
        self.records: dict[str, TaskRecord] = {}
        self.unposted: dict[tuple[str, int], None] = {}
        """The open activities without a Task, as token and visit."""
        self._by_visit: dict[tuple[str, int], str] = {}
        """The Task of each token and visit."""
        self._compared: Run | None = None
        """The run of which `unposted` is known; a run that takes its place is compared as a whole."""
        self._dues: DueQueue[str] = DueQueue()

    def track(self, task: TaskRecord) -> None:
        """Note the present record of a Task."""
        visit = task.token, task.visit
        dues = () if task.finished else (timer.due for timer in self.timers_of(task))
        self._dues.set(task.id, min(dues, default=None))
        if task.finished:
            self.records.pop(task.id, None)
            self._by_visit.pop(visit, None)
            self._allocator.remove_task(task.id)
            return
        self.records[task.id] = task
        self._by_visit[visit] = task.id
        self.unposted.pop(visit, None)
        if task.performer:
            self._allocator.add_task(task.id, task.performer)

    def release(self) -> None:
        """Remove the Tasks from the allocator: the process leaves the memory."""
        for task_id in self.records:
            self._allocator.remove_task(task_id)

    def compare(self, run: Run) -> list[TaskRecord]:
        """Note the open activities without a Task; return the Tasks of those that were left."""
        changes = run.take_work_changes()
        opened, left = changes.opened, changes.left
        if self._compared is not run:
            self._compared = run
            self.unposted.clear()
            opened, left = tuple(run.open_visits().items()), tuple(self._by_visit)
        abandoned = []
        for visit in left:
            self.unposted.pop(visit, None)
            task = self.records.get(self._by_visit.get(visit, ""))
            if task is not None and run.visit(visit[0]) != visit[1]:
                abandoned.append(task)
        for visit in opened:
            if visit not in self._by_visit:
                self.unposted[visit] = None
        return abandoned

    def timers_of(self, task: TaskRecord) -> Iterator[Timer]:
        """Yield the timers of a Task while its process is not paused."""
        if task.escalates_at is not None and task.cancelled_at is None:
            yield Timer(TimerKind.ESCALATION, task.id, task.escalates_at)
        if task.status is not TaskStatus.PENDING and not task.claims:
            return
        if task.cancelled_at is not None:
            grace = timedelta(seconds=0 if task.claims else self._settings.cancel_grace_s)
            yield Timer(TimerKind.GRACE, task.id, task.cancelled_at + grace)
        elif _can_be_overdue(task):
            yield Timer(TimerKind.DEADLINE, task.id, task.deadline)

    def next_due(self) -> datetime | None:
        """Return when the first timer is due."""
        return self._dues.next_due()

    def due_timers(self, now: datetime) -> list[Timer]:
        """Return the timers that are due at `now`."""
        tasks = [self.records[task] for task in self._dues.due(now)]
        return [timer for task in tasks for timer in self.timers_of(task) if timer.due <= now]


def _can_be_overdue(task: TaskRecord) -> bool:
    """Return whether its deadline counts; of an unreadable one nobody knows whether it was accepted."""
    is_waiting = task.status is TaskStatus.PENDING and not task.alerted and task.unreadable is None
    return is_waiting and "deadline" in task.entity
