"""Documents of the statistics. Means are exact, percentiles are not."""

from collections.abc import Mapping
from typing import Annotated, Any

from typing_extensions import TypedDict

from handover_processes.documents.document import From, Moment, document
from handover_processes.records.definitions import DefinitionRecord
from handover_processes.storage.counts import ElementCount, VersionCount


class ElementCounts(TypedDict):
    """The counts of a BPMN activity; durations are from creation to end."""

    running: int
    completed: int
    failed: int
    lastMs: int | None
    medianMs: int | None


class ProcessCounts(TypedDict):
    """The number of processes by state."""

    running: int
    completed: int
    failed: int


class VersionStatistics(TypedDict):
    """The statistics of a version."""

    name: str
    version: int
    processes: ProcessCounts
    elements: dict[str, ElementCounts]


class PeriodStatistics(ProcessCounts):
    """The statistics of a period; `since` is when the cell began where that is later than what was asked."""

    since: Moment

    medianMs: int | None


class Durations(TypedDict):
    """The durations of what was completed: the mean is exact, the percentiles are within 9 %."""

    medianMs: Annotated[int | None, From(lambda durations: durations.percentile_ms(0.5))]
    p90Ms: Annotated[int | None, From(lambda durations: durations.percentile_ms(0.9))]
    meanMs: int | None


class DefinitionTimes(Durations):
    """The processes of a definition: `running` and `withIncidents` now, all others in the period."""

    definition: str
    title: str
    running: int
    withIncidents: int
    started: int
    completed: int
    failed: int


class ElementTimes(Durations):
    """The Tasks of an element: `waiting`, `working` and `paused` are open now, others ended in the period.

    The means of the time until a performer began, of the work and of pauses add up to the mean duration.
    """

    element: str
    name: str
    waiting: int
    working: int
    paused: int
    completed: int
    failed: int
    cancelled: int
    waitingMs: int | None
    workingMs: int | None
    pausedMs: int | None


class ElementsView(TypedDict):
    """The statistics of a definition and its elements; `version` null: of all versions."""

    since: str
    until: str
    version: int | None
    processes: DefinitionTimes
    elements: list[ElementTimes]


class ThroughputPoint(TypedDict):
    """The processes that started and ended in an hour or on a day (UTC)."""

    at: str
    started: int
    completed: int
    failed: int


class ThroughputView(TypedDict):
    """The throughput of a period."""

    since: str
    until: str
    points: list[ThroughputPoint]


class CauseView(TypedDict):
    """Open incidents with the same cause at the same element; `processes` names the latest of them."""

    definition: str
    version: int
    title: str
    element: str
    name: str
    reason: Annotated[str, From(lambda cause: str(cause.reason["reason"]))]
    reasonCode: Annotated[str | None, From(lambda cause: cause.reason.get("reasonCode"))]
    reasonParameters: Annotated[
        dict[str, Any] | None, From(lambda cause: cause.reason.get("reasonParameters"))
    ]
    count: int
    since: Moment
    processes: list[str]


class ResourceTimes(TypedDict):
    """The working time of a resource, and its share of the time in which it was available.

    Available is the time of its shifts, or all time, times its capacity.
    """

    resource: str
    workingMs: int
    availableMs: int
    utilisation: float | None


class ResourcesView(TypedDict):
    """The utilisation of resources in a period, until now at most."""

    since: str
    until: str
    resources: list[ResourceTimes]


def statistics_view(record: DefinitionRecord, counts: VersionCount) -> VersionStatistics:
    """Return the statistics of a version."""
    processes = document(ProcessCounts, counts)
    return document(VersionStatistics, record, processes=processes, elements=element_views(counts.elements))


def element_views(counts: Mapping[str, ElementCount]) -> dict[str, ElementCounts]:
    """Return the counts of activities by element."""
    return {element: document(ElementCounts, count) for element, count in counts.items()}
