"""Counts: how often each activity was completed or failed, and its duration.

Those of one process are counted from its Tasks, those of all processes come from the statistics that are
written with each step. Cancelled Tasks count as neither. The duration is that of completed Tasks, from
creation to end, including the time until a performer accepted the Task.
"""

import statistics
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import Connection, func, select

from handover_datamodels.entities import TaskStatus
from handover_processes.records.tasks import TaskRecord
from handover_processes.storage.open_work import open_tasks, running_processes
from handover_processes.storage.rollups import Distribution, ReportScope, element_durations, process_durations
from handover_processes.storage.rows import as_column
from handover_processes.storage.schema import processes, tasks
from handover_processes.tally import (
    WHOLE_PROCESS,
    Counted,
    Period,
    Sums,
    bin_of,
    elapsed_ms,
    hour_of,
    moment_of,
)

LATEST_PROCESSES = 20
LATEST_TASKS = 1_000
"""The last duration of an element is looked for in so many processes, and in so many Tasks of them."""


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


def count_version(connection: Connection, definition: str, version: int, now: datetime) -> VersionCount:
    """Return the counts of all processes of a version, from the statistics and the open Tasks.

    The cost depends on the number of elements and months, not on that of Tasks. A median is accurate to 9 %.
    """
    scope = ReportScope(definition, version)
    counted = element_durations(connection, Period(0, hour_of(now) + 1), scope)
    running = running_processes(connection, scope).get(definition, (0, 0))[0]
    present = open_tasks(connection, scope)
    last = _last_durations(connection, definition, version)
    elements = {}
    for element in sorted({*present, *(name for name, _ in counted)} - {WHOLE_PROCESS}):
        completed = counted.get((element, Counted.COMPLETED), Distribution())
        elements[element] = ElementCount(
            running=present[element].total if element in present else 0,
            completed=completed.total.counted,
            failed=counted.get((element, Counted.FAILED), Distribution()).total.counted,
            last_ms=last.get(element),
            median_ms=completed.percentile_ms(0.5),
        )
    ended = {
        result: counted.get((WHOLE_PROCESS, result), Distribution()).total.counted
        for result in (Counted.COMPLETED, Counted.FAILED)
    }
    return VersionCount(running, ended[Counted.COMPLETED], ended[Counted.FAILED], elements)


def count_period(
    connection: Connection, since: datetime, now: datetime, until: datetime | None = None
) -> PeriodCount:
    """Return the counts of processes that ended at `since` or later, and before `until` if there is one.

    Whole hours are read from the statistics, the parts of hours at both ends from the processes.
    """
    running = connection.scalar(select(func.count()).where(processes.c.ended_at.is_(None))) or 0
    first = hour_of(since) if moment_of(hour_of(since)) == since else hour_of(since) + 1
    last = hour_of(now) + 1 if until is None else hour_of(until)
    parts = [(since, moment_of(first))]
    if until is not None:
        parts = [(since, until)] if last < first else [*parts, (moment_of(last), until)]
    completed: dict[int, Sums] = {}
    failed = 0
    for begins, ends in parts:
        in_part = (processes.c.ended_at >= as_column(begins)) & (processes.c.ended_at < as_column(ends))
        ended = select(processes.c.status, processes.c.started_at, processes.c.ended_at).where(in_part)
        for status, started_at, ended_at in connection.execute(ended):
            if status == TaskStatus.FAILED.value:
                failed += 1
            elif status == TaskStatus.COMPLETED.value:
                took_ms = elapsed_ms(datetime.fromisoformat(started_at), datetime.fromisoformat(ended_at))
                completed.setdefault(bin_of(took_ms), Sums()).add(Sums(1, took_ms))
    whole = Period(first, last)
    counted = process_durations(connection, whole, ReportScope()) if first < last else {}
    for (_, result), distribution in counted.items():
        if result is Counted.FAILED:
            failed += distribution.total.counted
        elif result is Counted.COMPLETED:
            for sums in distribution.bins:
                completed.setdefault(bin_of(sums.duration_ms // sums.counted), Sums()).add(sums)
    durations = Distribution(tuple(completed[duration] for duration in sorted(completed)))
    return PeriodCount(running, durations.total.counted, failed, durations.percentile_ms(0.5))


def _last_durations(connection: Connection, definition: str, version: int) -> dict[str, int]:
    """Return the duration of the last completed Task of each element in the latest processes."""
    latest = (
        select(processes.c.id)
        # Added to nothing, the version is no reason to read all its processes instead of the last ones.
        .where(processes.c.definition == definition, processes.c.version + 0 == version)
        .order_by(processes.c.started_at.desc(), processes.c.id.desc())
        .limit(LATEST_PROCESSES)
    )
    processes_: dict[str, int] = {}
    ids = [row.id for row in connection.execute(latest)]
    statement = (
        select(tasks.c.element, tasks.c.status, tasks.c.took_ms)
        .where(tasks.c.process.in_(ids), tasks.c.took_ms.is_not(None))
        .order_by(tasks.c.ended_at.desc(), tasks.c.id.desc())
        .limit(LATEST_TASKS)
    )
    for element, status, took_ms in connection.execute(statement):
        if status == TaskStatus.COMPLETED.value:  # in the statement it would lead to all completed Tasks
            processes_.setdefault(element, took_ms)
    return processes_
