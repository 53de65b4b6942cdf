"""Reports: reads the statistics for people.

Each method opens a connection of its own, so that it runs beside the writer: neither waits for the other.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import Engine

from handover_processes.storage.open_work import (
    Cause,
    OpenTaskCounts,
    open_incidents,
    open_tasks,
    present_work,
    running_processes,
)
from handover_processes.storage.rollups import (
    Distributions,
    ReportScope,
    element_durations,
    process_counts,
    process_durations,
    work_by_resource,
)
from handover_processes.tally import Counted, Period


@dataclass(frozen=True, slots=True)
class RunningCount:
    """The processes that have not ended, and those of them that have incidents."""

    running: int = 0
    stopped: int = 0


@dataclass(frozen=True, slots=True)
class ElementReport:
    """What became of a definition and its elements in a period, and what is open now."""

    durations: Distributions
    open_tasks: dict[str, OpenTaskCounts]
    running: RunningCount


@dataclass(frozen=True, slots=True)
class DefinitionReport:
    """What became of the processes of each definition in a period, and what is running now."""

    durations: Distributions
    running: dict[str, RunningCount]


class Reports:
    """Queries that change nothing; thread-safe."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def elements(self, period: Period, scope: ReportScope) -> ElementReport:
        """Return the statistics of the elements of a definition."""
        with self._engine.connect() as connection:
            running = running_processes(connection, scope)
            counts = [RunningCount(*numbers) for numbers in running.values()]
            return ElementReport(
                element_durations(connection, period, scope),
                open_tasks(connection, scope),
                counts[0] if counts else RunningCount(),
            )

    def definitions(self, period: Period) -> DefinitionReport:
        """Return the statistics of the processes of each definition."""
        everything = ReportScope()
        with self._engine.connect() as connection:
            running = running_processes(connection, everything)
            return DefinitionReport(
                process_durations(connection, period, everything),
                {name: RunningCount(*numbers) for name, numbers in running.items()},
            )

    def throughput(self, period: Period, scope: ReportScope, hours: int) -> dict[tuple[int, Counted], int]:
        """Return the number of processes that started and ended, by hour or day."""
        with self._engine.connect() as connection:
            return process_counts(connection, period, scope, hours)

    def incidents(self, scope: ReportScope) -> Sequence[Cause]:
        """Return the open incidents by element and cause."""
        with self._engine.connect() as connection:
            return open_incidents(connection, scope)

    def work(self, period: Period, scope: ReportScope, now: datetime) -> dict[str, int]:
        """Return the working time of resources in ms, including the work that has not ended."""
        with self._engine.connect() as connection:
            worked = work_by_resource(connection, period, scope)
            for resource, worked_ms in present_work(connection, period, scope, now).items():
                worked[resource] = worked.get(resource, 0) + worked_ms
        return worked
