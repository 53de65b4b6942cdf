"""Metrics: how many Tasks are open and for how long, how they end, and how fast a hand sets a robot going."""

from collections.abc import Callable, Iterable
from datetime import datetime
from functools import partial

from prometheus_client import Counter, Gauge, Histogram

from datamodels.entities import TaskStatus
from handover.task_life import FINISHED
from services.task_orchestrator.records import Step, TaskRecord

OPEN = tuple(status for status in TaskStatus if status not in FINISHED)

TASKS = Gauge("handover_orchestrator_tasks_open", "Tasks that have not ended", ["status"])
OLDEST = Gauge(
    "handover_orchestrator_task_oldest_seconds", "Age of the oldest Task that has not ended", ["status"]
)
ENDED = Counter("handover_orchestrator_tasks_total", "Tasks that have ended", ["status"])
HOLD_TO_ROBOT = Histogram(
    "handover_orchestrator_hold_to_robot_seconds",
    "From a gesture being held long enough to the robot's next Task being begun, by the performers' clocks",
    buckets=(0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10),
)


def show_open(tasks: Callable[[], Iterable[TaskRecord]], clock: Callable[[], datetime]) -> None:
    """Let whoever reads the metrics see `tasks`, those that have not ended, as they are then."""

    def of(status: TaskStatus) -> list[TaskRecord]:
        return [task for task in tasks() if task.status is status]

    def how_many(status: TaskStatus) -> float:
        return len(of(status))

    def oldest_s(status: TaskStatus) -> float:
        since = min((task.created_at for task in of(status)), default=None)
        return 0.0 if since is None else max(0.0, (clock() - since).total_seconds())

    for status in OPEN:
        TASKS.labels(status.value).set_function(partial(how_many, status))
        OLDEST.labels(status.value).set_function(partial(oldest_s, status))


class Relay:
    """Follows how the processes pass from a person's hand to a robot, and measures it."""

    def __init__(self) -> None:
        self._held_at: dict[str, datetime] = {}
        """By process, when a person last let it go on with a gesture that nobody has taken up yet."""

    def follow(self, step: Step) -> None:
        """Count and measure what has just been written down."""
        for move in step.moves:
            task = step.tasks.get(move.task)
            if task is None or move.observed_at is None:
                continue
            outputs = task.outputs or {}
            allows = outputs.get("by") == "gesture" and outputs.get("outcome", "ok") == "ok"
            if move.status is TaskStatus.COMPLETED and allows:
                self._held_at[task.process] = move.observed_at
            elif move.status is TaskStatus.IN_PROGRESS:
                held_at = self._held_at.pop(task.process, None)
                if held_at is not None and not _asks_a_hand(task):
                    HOLD_TO_ROBOT.observe(max(0.0, (move.observed_at - held_at).total_seconds()))
        for task in step.tasks.values():
            if task.finished:
                ENDED.labels(task.status.value).inc()
        for process_id in step.ended:
            self._held_at.pop(process_id, None)


def _asks_a_hand(task: TaskRecord) -> bool:
    asked = task.entity.get("workParameters", {}).get("value", {})
    return "commandId" in asked or "gesture" in asked
