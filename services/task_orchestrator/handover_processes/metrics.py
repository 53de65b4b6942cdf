"""Metrics: open and ended Tasks, and the time from a confirming gesture to the start of a robot."""

from collections.abc import Callable, Iterable
from datetime import datetime
from functools import partial

from prometheus_client import Counter, Gauge, Histogram

from handover.tasks.task_life import FINISHED
from handover_datamodels.entities import TaskStatus
from handover_processes.records.step import Step
from handover_processes.records.tasks import TaskRecord

OPEN = tuple(status for status in TaskStatus if status not in FINISHED)

TASKS = Gauge("handover_orchestrator_tasks_open", "Tasks that have not ended", ["status"])
OLDEST_AGE = Gauge(
    "handover_orchestrator_oldest_task_age_seconds", "Age of the oldest Task that has not ended", ["status"]
)
ENDED = Counter("handover_orchestrator_tasks_total", "Tasks that have ended", ["status"])
HOLD_TO_ROBOT = Histogram(
    "handover_orchestrator_hold_to_robot_seconds",
    "Time from the confirmed hold of a gesture to the start of the next Task of a robot, by performer clocks",
    buckets=(0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10),
)


def register_open_tasks(tasks: Callable[[], Iterable[TaskRecord]], clock: Callable[[], datetime]) -> None:
    """Compute the gauges from `tasks`, those that have not ended, at each scrape."""

    def of(status: TaskStatus) -> list[TaskRecord]:
        return [task for task in tasks() if task.status is status]

    def count(status: TaskStatus) -> float:
        return len(of(status))

    def oldest_s(status: TaskStatus) -> float:
        since = min((task.created_at for task in of(status)), default=None)
        return 0.0 if since is None else max(0.0, (clock() - since).total_seconds())

    for status in OPEN:
        TASKS.labels(status.value).set_function(partial(count, status))
        OLDEST_AGE.labels(status.value).set_function(partial(oldest_s, status))


class HandoverTimer:
    """Measures the handover from a person's gesture to a robot in each process."""

    def __init__(self) -> None:
        self._held_at: dict[str, datetime] = {}
        """By process, the last confirming gesture that no started Task has followed yet."""

    def observe(self, step: Step) -> None:
        """Count and measure a step that was written."""
        for move in step.moves:
            task = step.tasks.get(move.task)
            if task is None or move.observed_at is None:
                continue
            outputs = task.outputs or {}
            is_confirmed = outputs.get("by") == "gesture" and outputs.get("outcome", "ok") == "ok"
            if move.status is TaskStatus.COMPLETED and is_confirmed:
                self._held_at[task.process] = move.observed_at
            elif move.status is TaskStatus.IN_PROGRESS:
                held_at = self._held_at.pop(task.process, None)
                if held_at is not None and not _requires_gesture(task):
                    HOLD_TO_ROBOT.observe(max(0.0, (move.observed_at - held_at).total_seconds()))
        for task in step.tasks.values():
            if task.finished:
                ENDED.labels(task.status.value).inc()
        for process_id in step.ended:
            self._held_at.pop(process_id, None)


def _requires_gesture(task: TaskRecord) -> bool:
    parameters = task.entity.get("workParameters", {}).get("value", {})
    return "commandId" in parameters or "gesture" in parameters
