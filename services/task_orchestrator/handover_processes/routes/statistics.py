"""Routes: statistics of processes, Tasks and resources, as JSON or CSV."""

from contextlib import suppress
from datetime import timedelta
from typing import Annotated

from fastapi import FastAPI, Query, Response

from handover.errors import HandoverError, Problem
from handover.http.api_description import TaggedRoutes, sends
from handover.security.guard import require
from handover.security.permissions import Permission
from handover_processes.definitions.definition_registry import DefinitionRegistry
from handover_processes.documents.document import json_response
from handover_processes.documents.requests import (
    ElementsQuery,
    IncidentsQuery,
    PeriodQuery,
    ScopedQuery,
    ThroughputQuery,
)
from handover_processes.documents.statistics import (
    CauseView,
    DefinitionTimes,
    ElementsView,
    ElementTimes,
    ResourcesView,
    ResourceTimes,
    ThroughputPoint,
    ThroughputView,
)
from handover_processes.records.definitions import DefinitionRecord
from handover_processes.reporting.period import read_period
from handover_processes.reporting.views import (
    cause_views,
    definition_views,
    elements_view,
    resources_view,
    throughput_view,
)
from handover_processes.routes.resources import of_definition_query
from handover_processes.routes.tables import csv_response
from handover_processes.running.components import Components
from handover_processes.storage.rollups import ReportScope
from handover_processes.tally import DAY_H, Period

MAX_HOURLY = timedelta(days=92)
DEFAULT_HOURLY = timedelta(days=7, hours=1)
"""Seven days are up to 169 whole hours."""


def scope_of(
    registry: DefinitionRegistry, query: ScopedQuery | ElementsQuery | IncidentsQuery
) -> ReportScope:
    """Return the scope of a report; raise `Problem` 404 for an unknown definition or version."""
    if query.definition is None:
        return ReportScope()
    registry.record(query.definition, query.version)
    return ReportScope(query.definition, query.version)


def step_hours(step: str | None, period: Period) -> int:
    """Return the hours of a point: 1 or 24; raise `Problem` 422 for too many points."""
    length = period.ends_at - period.begins_at
    if step is None:
        step = "hour" if length <= DEFAULT_HOURLY else "day"
    if step == "hour" and length > MAX_HOURLY:
        raise Problem.translated(
            422,
            "Bad period",
            "statistics.too_many_hours",
            "the period has {days} days; ask by hour for {max_days} days at most, or by day",
            days=length.days,
            max_days=MAX_HOURLY.days,
        )
    return 1 if step == "hour" else DAY_H


async def activity_names(registry: DefinitionRegistry, record: DefinitionRecord) -> dict[str, str]:
    """Return the drawn names of the activities of a version; none if this release cannot read it."""
    await registry.prepare(record)
    with suppress(HandoverError):
        activities = registry.plan_of(record).definition.activities()
        return {element: activity.name for element, activity in activities.items()}
    return {}


def add_statistics(app: FastAPI, at: Components) -> None:
    """Add the routes of statistics."""
    routes = TaggedRoutes(app, "statistics")
    orchestrator = at.orchestrator
    reports, registry = orchestrator.store.reports, orchestrator.state.registry

    def titles() -> dict[str, str]:
        return {record.name: record.title for record in registry.latest()}

    def period_of(query: PeriodQuery) -> Period:
        return read_period(query.since, query.until, orchestrator.clock())

    @routes.get(
        "/statistics/definitions",
        responses=sends("text/csv", or_json=list[DefinitionTimes]),
        dependencies=[require(Permission.READ)],
    )
    async def definitions(query: Annotated[PeriodQuery, Query()]) -> Response:
        """Return the number and durations of the processes of each definition in a period."""
        report = await orchestrator.read(reports.definitions, period_of(query))
        views = definition_views(report, titles())
        if query.format == "csv":
            return csv_response("definitions", DefinitionTimes, views)
        return json_response(views)

    @routes.get(
        "/statistics/elements",
        responses=sends("text/csv", or_json=ElementsView),
        dependencies=[require(Permission.READ, of_definition_query(registry))],
    )
    async def elements(query: Annotated[ElementsQuery, Query()]) -> Response:
        """Return the number and durations of the Tasks of each element of a definition in a period.

        Running and archived processes count alike. The period begins and ends at a full hour.
        """
        period, scope = period_of(query), scope_of(registry, query)
        report = await orchestrator.read(reports.elements, period, scope)
        record = registry.record(query.definition, query.version)
        names = await activity_names(registry, record)
        view = elements_view(report, period, record.name, query.version, title=record.title, names=names)
        if query.format == "csv":
            return csv_response("elements", ElementTimes, view["elements"])
        return json_response(view)

    @routes.get(
        "/statistics/throughput",
        responses=sends("text/csv", or_json=ThroughputView),
        dependencies=[require(Permission.READ, of_definition_query(registry))],
    )
    async def throughput(query: Annotated[ThroughputQuery, Query()]) -> Response:
        """Return how many processes started, completed and failed in each hour or on each day."""
        period, scope = period_of(query), scope_of(registry, query)
        hours = step_hours(query.step, period)
        counts = await orchestrator.read(reports.throughput, period, scope, hours)
        view = throughput_view(counts, period, hours)
        if query.format == "csv":
            return csv_response("throughput", ThroughputPoint, view["points"])
        return json_response(view)

    @routes.get(
        "/statistics/incidents",
        responses=sends("text/csv", or_json=list[CauseView]),
        dependencies=[require(Permission.READ, of_definition_query(registry))],
    )
    async def incidents(query: Annotated[IncidentsQuery, Query()]) -> Response:
        """Return the open incidents by element and cause, the most frequent first."""
        views = cause_views(await orchestrator.read(reports.incidents, scope_of(registry, query)), titles())
        if query.format == "csv":
            rows = [{**view, "processes": " ".join(view["processes"])} for view in views]
            return csv_response("incidents", CauseView, rows, without=("reasonParameters",))
        return json_response(views)

    @routes.get(
        "/statistics/resources",
        responses=sends("text/csv", or_json=ResourcesView),
        dependencies=[require(Permission.READ, of_definition_query(registry))],
    )
    async def resources(query: Annotated[ScopedQuery, Query()]) -> Response:
        """Return the working time and utilisation of people, robots and devices in a period.

        With a definition only the work for its processes counts.
        """
        period, now = period_of(query), orchestrator.clock()
        worked = await orchestrator.read(reports.work, period, scope_of(registry, query), now)
        agents = orchestrator.state.allocator.rules.agents.by_id
        view = resources_view(worked, agents, period, now, cell_begins=registry.first_deployed_at())
        if query.format == "csv":
            return csv_response("resources", ResourceTimes, view["resources"])
        return json_response(view)
