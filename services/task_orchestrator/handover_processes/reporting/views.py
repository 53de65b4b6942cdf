"""Views of the statistics, as the REST interface returns them. Means are exact, percentiles are not."""

from collections.abc import Mapping, Sequence
from datetime import datetime

from handover_datamodels.times import iso
from handover_processes.allocation.agents import Agent
from handover_processes.documents.document import document
from handover_processes.documents.statistics import (
    CauseView,
    DefinitionTimes,
    Durations,
    ElementsView,
    ElementTimes,
    ResourcesView,
    ResourceTimes,
    ThroughputPoint,
    ThroughputView,
)
from handover_processes.reporting.calendar import available_ms
from handover_processes.storage.open_work import Cause, OpenTaskCounts
from handover_processes.storage.reports import DefinitionReport, ElementReport, RunningCount
from handover_processes.storage.rollups import Distribution, Distributions
from handover_processes.tally import WHOLE_PROCESS, Counted, Period, moment_of

Names = Mapping[str, str]
"""The drawn names of elements, or the titles of definitions."""

_NOTHING = Distribution()


def elements_view(
    report: ElementReport, period: Period, definition: str, version: int | None, *, title: str, names: Names
) -> ElementsView:
    """Return the statistics of a definition and of its elements, in the order of `names`."""
    seen = {element for element, _ in report.durations} | set(report.open_tasks)
    order = [*names, *sorted(seen - set(names) - {WHOLE_PROCESS})]
    return {
        "since": iso(period.begins_at),
        "until": iso(period.ends_at),
        "version": version,
        "processes": _definition(report.durations, WHOLE_PROCESS, definition, title, report.running),
        "elements": [_element(report, element, names.get(element, element)) for element in order],
    }


def _element(report: ElementReport, element: str, name: str) -> ElementTimes:
    completed = report.durations.get((element, Counted.COMPLETED), _NOTHING)
    open_ = report.open_tasks.get(element, OpenTaskCounts())
    sums = completed.total

    def mean(total_ms: int) -> int | None:
        return round(total_ms / sums.counted) if sums.counted else None

    return {
        "element": element,
        "name": name,
        "waiting": open_.waiting,
        "working": open_.working,
        "paused": open_.paused,
        "completed": sums.counted,
        "failed": _count(report.durations, element, Counted.FAILED),
        "cancelled": _count(report.durations, element, Counted.CANCELLED),
        **_durations(completed),
        "waitingMs": mean(sums.waiting_ms),
        "workingMs": mean(sums.working_ms),
        "pausedMs": mean(sums.paused_ms),
    }


def definition_views(report: DefinitionReport, titles: Names) -> list[DefinitionTimes]:
    """Return the statistics of the processes of all definitions."""
    return [
        _definition(report.durations, name, name, title, report.running.get(name, RunningCount()))
        for name, title in titles.items()
    ]


def _definition(
    durations: Distributions, subject: str, definition: str, title: str, running: RunningCount
) -> DefinitionTimes:
    return {
        "definition": definition,
        "title": title,
        "running": running.running,
        "withIncidents": running.stopped,
        "started": _count(durations, subject, Counted.STARTED),
        "completed": _count(durations, subject, Counted.COMPLETED),
        "failed": _count(durations, subject, Counted.FAILED),
        **_durations(durations.get((subject, Counted.COMPLETED), _NOTHING)),
    }


def throughput_view(counts: Mapping[tuple[int, Counted], int], period: Period, hours: int) -> ThroughputView:
    """Return the number of processes by hour or day, with those in which there were none."""
    first = period.begins // hours * hours
    points: list[ThroughputPoint] = [
        {
            "at": iso(moment_of(starts)),
            "started": counts.get((starts, Counted.STARTED), 0),
            "completed": counts.get((starts, Counted.COMPLETED), 0),
            "failed": counts.get((starts, Counted.FAILED), 0),
        }
        for starts in range(first, period.ends, hours)
    ]
    return {"since": iso(moment_of(first)), "until": iso(period.ends_at), "points": points}


def cause_views(causes: Sequence[Cause], titles: Names) -> list[CauseView]:
    """Return the open incidents by element and cause."""
    return [
        document(CauseView, cause, title=titles.get(cause.definition, cause.definition)) for cause in causes
    ]


def resources_view(
    worked: Mapping[str, int],
    agents: Mapping[str, Agent],
    period: Period,
    now: datetime,
    *,
    cell_begins: datetime | None,
) -> ResourcesView:
    """Return the utilisation of all resources that have worked, and of agents with roles or skills.

    Nobody was available before the cell was there: `cell_begins`, when its first definition was deployed.
    """
    ends = min(period.ends_at, now)
    begins = period.begins_at if cell_begins is None else max(period.begins_at, cell_begins)
    idle = (agent.id for agent in agents.values() if agent.skills or agent.roles)
    resources: list[ResourceTimes] = []
    for resource in dict.fromkeys([*worked, *idle]):
        available = available_ms(agents.get(resource), begins, ends)
        worked_ms = worked.get(resource, 0)
        resources.append(
            {
                "resource": resource,
                "workingMs": worked_ms,
                "availableMs": available,
                "utilisation": round(worked_ms / available, 4) if available else None,
            }
        )
    resources.sort(key=lambda worker: (-worker["workingMs"], worker["resource"]))
    return {"since": iso(period.begins_at), "until": iso(ends), "resources": resources}


def _count(durations: Distributions, subject: str, result: Counted) -> int:
    return durations.get((subject, result), _NOTHING).total.counted


def _durations(of: Distribution) -> Durations:
    return document(Durations, of, meanMs=of.mean_ms())
