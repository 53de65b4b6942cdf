"""Process tally: counts what becomes of a process and of its Tasks, in the step in which it happens."""

from collections.abc import Mapping
from datetime import datetime
from typing import Any

from handover.tasks.task_life import FINISHED
from handover_datamodels.entities import TaskStatus
from handover_processes.records.processes import ProcessRecord
from handover_processes.records.step import Step
from handover_processes.records.tasks import TaskRecord
from handover_processes.tally import Counted, Sums, Version, elapsed_ms


def count_start(step: Step, process: ProcessRecord) -> None:
    """Count a process that starts."""
    step.tally.add_start(_version(process), process.started_at)


def count_end(step: Step, process: ProcessRecord) -> None:
    """Count a process that has ended."""
    ended_at = process.ended_at or process.started_at
    sums = Sums(1, elapsed_ms(process.started_at, ended_at))
    step.tally.add_end(_version(process), Counted(process.status.value), ended_at, sums)


def count_change(
    step: Step, process: ProcessRecord, task: TaskRecord, outputs: Mapping[str, Any], now: datetime
) -> TaskRecord:
    """Count the work until the status of a Task changes; return it with the time in its present status."""
    since = task.status_since or task.created_at
    spent_ms = elapsed_ms(since, now)
    working_ms, paused_ms = task.working_ms, task.paused_ms
    if task.status is TaskStatus.IN_PROGRESS:
        working_ms += spent_ms
        performer = task.performer or outputs.get("operator")  # the person who has claimed it
        if isinstance(performer, str) and performer:
            step.tally.add_work(_version(process), performer, since, now)
    elif task.status is TaskStatus.PAUSED:
        paused_ms += spent_ms
    return task.changed(status_since=now, working_ms=working_ms, paused_ms=paused_ms)


def count_task(step: Step, process: ProcessRecord, task: TaskRecord) -> None:
    """Count a Task that may have ended."""
    if task.status not in FINISHED or task.ended_at is None:
        return
    result = Counted(task.status.value)
    if result is Counted.FAILED and task.cancelled_at is not None:
        result = Counted.CANCELLED
    sums = Sums(1, elapsed_ms(task.created_at, task.ended_at), task.working_ms, task.paused_ms)
    step.tally.add_end(_version(process), result, task.ended_at, sums, task.element)


def _version(process: ProcessRecord) -> Version:
    return process.definition, process.version
