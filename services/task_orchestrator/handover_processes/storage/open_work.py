"""Open work: Tasks that have not ended, and incidents by element and cause."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, Final

import orjson
from sqlalchemy import Connection, case, func, select, text

from handover_datamodels.entities import TaskStatus
from handover_processes.storage.rollups import ReportScope
from handover_processes.storage.schema import processes, tasks
from handover_processes.tally import Period, elapsed_ms, moment_of

MAX_PROCESSES: Final = 5
"""Processes that a cause names."""


@dataclass(frozen=True, slots=True)
class OpenTaskCounts:
    """The Tasks of an element that have not ended."""

    waiting: int = 0
    working: int = 0
    paused: int = 0

    @property
    def total(self) -> int:
        """Return the number of all."""
        return self.waiting + self.working + self.paused


@dataclass(slots=True)
class Cause:
    """Incidents with the same cause at the same element."""

    definition: str
    version: int
    element: str
    name: str
    reason: Mapping[str, Any]
    """The reason of the first of them, with its code and parameters."""
    since: datetime
    count: int = 0
    processes: list[str] = field(default_factory=list)
    """The processes that started last, some of them."""


def open_tasks(connection: Connection, scope: ReportScope) -> dict[str, OpenTaskCounts]:
    """Return the open Tasks of the elements of a definition; Tasks that were cancelled are none of them."""
    columns = (processes.c.definition, processes.c.version, tasks.c.element, tasks.c.status)
    statement = (
        select(*columns, func.count())
        .join(processes, processes.c.id == tasks.c.process)
        .where(tasks.c.ended_at.is_(None), tasks.c.cancelled_at.is_(None))
        .group_by(*columns)
    )
    counts: dict[str, Counter[str]] = {}
    # Selected here: with more conditions a database may begin with all processes of the definition.
    for definition, version, element, status, count in connection.execute(statement):
        if scope.contains(definition, version):
            counts.setdefault(element, Counter())[status] += count
    return {
        element: OpenTaskCounts(
            count_by_status[TaskStatus.PENDING] + count_by_status[TaskStatus.ASSIGNED],
            count_by_status[TaskStatus.IN_PROGRESS],
            count_by_status[TaskStatus.PAUSED],
        )
        for element, count_by_status in counts.items()
    }


def running_processes(connection: Connection, scope: ReportScope) -> dict[str, tuple[int, int]]:
    """Return the number of processes that have not ended, and of those with incidents, by definition."""
    has_incident = case((processes.c.incidents != "[]", 1), else_=0)
    statement = (
        select(processes.c.definition, func.count(), func.sum(has_incident))
        .where(processes.c.ended_at.is_(None), *scope.conditions(processes))
        .group_by(processes.c.definition)
    )
    return {name: (int(running), int(stopped)) for name, running, stopped in connection.execute(statement)}


def open_incidents(connection: Connection, scope: ReportScope) -> Sequence[Cause]:
    """Return the open incidents by element and cause, the most frequent first."""
    table = processes.c
    statement = (
        select(table.id, table.definition, table.version, table.incidents)
        .where(text("incidents <> '[]'"), *scope.conditions(processes))
        .order_by(table.started_at.desc(), table.id.desc())
    )
    causes: dict[tuple[str, int, str, str], Cause] = {}
    for process, definition, version, incidents in connection.execute(statement):
        for incident in orjson.loads(incidents):
            cause = incident.get("reasonCode") or incident["reason"]
            key = (definition, version, incident["element"], cause)
            since = datetime.fromisoformat(incident["since"])
            names = ("reason", "reasonCode", "reasonParameters")
            reason = {name: incident[name] for name in names if name in incident}
            earlier = causes.setdefault(
                key, Cause(definition, version, incident["element"], incident["name"], reason, since)
            )
            earlier.count += 1
            earlier.since = min(earlier.since, since)
            if process not in earlier.processes and len(earlier.processes) < MAX_PROCESSES:
                earlier.processes.append(process)
    return sorted(causes.values(), key=lambda cause: (-cause.count, cause.since, cause.element))


def present_work(connection: Connection, period: Period, scope: ReportScope, now: datetime) -> dict[str, int]:
    """Return the time in ms that resources have worked in a period on Tasks that they still work on."""
    statement = (
        select(
            processes.c.definition,
            processes.c.version,
            tasks.c.performer,
            func.coalesce(tasks.c.status_since, tasks.c.created_at),
        )
        .join(processes, processes.c.id == tasks.c.process)
        .where(
            tasks.c.ended_at.is_(None),
            tasks.c.status == TaskStatus.IN_PROGRESS.value,
            tasks.c.performer.is_not(None),
        )
    )
    worked: dict[str, int] = {}
    for definition, version, performer, since in connection.execute(statement):
        if not scope.contains(definition, version):
            continue
        begins = max(datetime.fromisoformat(since), period.begins_at)
        ends = min(now, moment_of(period.ends))
        worked[performer] = worked.get(performer, 0) + elapsed_ms(begins, ends)
    return worked
