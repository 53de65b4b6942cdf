"""Counts: how often each activity was completed or failed, and its duration.

Cancelled Tasks count as neither. The duration is that of completed Tasks, from creation to end, including the
time until a performer accepted the Task.
"""

import statistics
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import ColumnElement, Connection, and_, case, func, select

from datamodels.entities import TaskStatus
from services.task_orchestrator.records import TaskRecord
from services.task_orchestrator.storage.schema import processes, tasks


@dataclass(frozen=True, slots=True)
class ElementCount:
    """The counts of the Tasks of one activity."""

    running: int = 0
    completed: int = 0
    failed: int = 0
    last_ms: int | None = None
    median_ms: int | None = None


@dataclass(frozen=True, slots=True)
class VersionCount:
    """The counts of the processes of one version of a definition, and of their Tasks."""

    running: int
    completed: int
    failed: int
    elements: Mapping[str, ElementCount]


@dataclass(frozen=True, slots=True)
class PeriodCount:
    """The counts of the processes that ended in a period; `running` have not ended."""

    running: int
    completed: int
    failed: int
    median_ms: int | None


def count_elements(listed: Iterable[TaskRecord]) -> dict[str, ElementCount]:
    """Return the counts of the Tasks of one process, by activity."""
    by_element: dict[str, list[TaskRecord]] = {}
    for task in listed:
        by_element.setdefault(task.element, []).append(task)
    return {element: _count(of_element) for element, of_element in by_element.items()}


def _count(of_element: list[TaskRecord]) -> ElementCount:
    completed = [task for task in of_element if task.status is TaskStatus.COMPLETED]
    times = [task.took_ms for task in completed if task.took_ms is not None]
    last = max(completed, key=lambda task: (task.ended_at or task.created_at, task.id), default=None)
    return ElementCount(
        running=sum(not task.finished and task.cancelled_at is None for task in of_element),
        completed=len(completed),
        failed=sum(task.status is TaskStatus.FAILED and task.cancelled_at is None for task in of_element),
        last_ms=last.took_ms if last is not None else None,
        median_ms=round(statistics.median(times)) if times else None,
    )


def count_version(connection: Connection, definition: str, version: int) -> VersionCount:
    """Return the counts of all processes of a version, computed by the database."""
    of_version = and_(processes.c.definition == definition, processes.c.version == version)
    rows = connection.execute(
        select(processes.c.status, func.count()).where(of_version).group_by(processes.c.status)
    )
    ended: dict[str, int] = {row[0]: row[1] for row in rows}
    completed = ended.pop(TaskStatus.COMPLETED.value, 0)
    failed = ended.pop(TaskStatus.FAILED.value, 0)
    return VersionCount(sum(ended.values()), completed, failed, _elements(connection, of_version))


def count_period(connection: Connection, since: str) -> PeriodCount:
    """Return the counts of processes that ended at `since` (in the format of the tables) or later."""
    running = connection.scalar(select(func.count()).where(processes.c.ended_at.is_(None))) or 0
    ended = connection.execute(
        select(processes.c.status, processes.c.started_at, processes.c.ended_at).where(
            processes.c.ended_at >= since
        )
    ).all()
    times = [
        (datetime.fromisoformat(row.ended_at) - datetime.fromisoformat(row.started_at)).total_seconds() * 1000
        for row in ended
        if row.status == TaskStatus.COMPLETED.value
    ]
    failed = sum(row.status == TaskStatus.FAILED.value for row in ended)
    return PeriodCount(running, len(times), failed, round(statistics.median(times)) if times else None)


def _elements(connection: Connection, of_version: ColumnElement[bool]) -> dict[str, ElementCount]:
    ours = tasks.join(processes, processes.c.id == tasks.c.process)
    completed = tasks.c.status == TaskStatus.COMPLETED.value
    failed = tasks.c.status == TaskStatus.FAILED.value
    kept = tasks.c.cancelled_at.is_(None)
    counts = (
        select(
            tasks.c.element,
            _count_if(and_(~completed, ~failed, kept)).label("running"),
            _count_if(completed).label("completed"),
            _count_if(and_(failed, kept)).label("failed"),
        )
        .select_from(ours)
        .where(of_version)
        .group_by(tasks.c.element)
    )
    ranked = (
        select(
            tasks.c.element,
            tasks.c.took_ms,
            func.count().over(partition_by=tasks.c.element).label("times"),
            _row_number(tasks.c.took_ms, tasks.c.id).label("place"),
            _row_number(tasks.c.ended_at.desc(), tasks.c.id.desc()).label("since"),
        )
        .select_from(ours)
        .where(of_version, completed, tasks.c.took_ms.is_not(None))
        .subquery()
    )
    in_the_middle = (2 * ranked.c.place).between(ranked.c.times, ranked.c.times + 2)
    times = select(
        ranked.c.element,
        func.avg(case((in_the_middle, ranked.c.took_ms))).label("median_ms"),
        func.max(case((ranked.c.since == 1, ranked.c.took_ms))).label("last_ms"),
    ).group_by(ranked.c.element)
    took: dict[str, Any] = {row.element: row for row in connection.execute(times)}
    return {
        row.element: ElementCount(
            running=row.running,
            completed=row.completed,
            failed=row.failed,
            last_ms=took[row.element].last_ms if row.element in took else None,
            median_ms=round(took[row.element].median_ms) if row.element in took else None,
        )
        for row in connection.execute(counts)
    }


def _row_number(*order: ColumnElement[Any]) -> ColumnElement[int]:
    """Return the row number of a Task among those of its activity, from 1."""
    return func.row_number().over(partition_by=tasks.c.element, order_by=order)


def _count_if(condition: ColumnElement[bool]) -> ColumnElement[int]:
    return func.sum(case((condition, 1), else_=0))
