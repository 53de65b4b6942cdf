"""Routes: the event log of processes, for process mining."""

from typing import Annotated

from fastapi import FastAPI, Query, Response

from handover.formats.tables import csv_table
from handover.http.api_description import sends
from handover.security.guard import require
from handover.security.permissions import Permission
from handover.tasks.event_log import TASK_COLUMNS, task_rows, xes_log
from handover_processes.documents.processes import process_view
from handover_processes.documents.requests import EventLogQuery
from handover_processes.routes.resources import of_definition_query
from handover_processes.routes.tables import file_response
from handover_processes.running.components import Components


def add_event_log(app: FastAPI, at: Components) -> None:
    """Add the route of the event log."""
    orchestrator = at.orchestrator
    registry, allocator = orchestrator.state.registry, orchestrator.state.allocator

    @app.get(
        "/event-log",
        tags=["statistics"],
        response_class=Response,
        responses=sends("application/xml", "text/csv"),
        dependencies=[require(Permission.READ, of_definition_query(registry))],
    )
    async def event_log(query: Annotated[EventLogQuery, Query()]) -> Response:
        """Return the history of processes for process mining: XES (IEEE 1849-2016), or a CSV of Tasks.

        The filter is that of `GET /processes`; without one it has the processes that started last.
        """
        histories = await orchestrator.read(orchestrator.store.histories, query.read(), query.limit)
        for record, _, _ in histories:
            await registry.prepare(registry.record(record.definition, record.version))

        def write() -> bytes:
            views = [
                process_view(at.settings, registry, *history, allocator=allocator) for history in histories
            ]
            if query.format == "csv":
                return csv_table(TASK_COLUMNS, (row for view in views for row in task_rows(view)))
            return xes_log(query.definition or "Handover", views)

        media_type = "application/xml" if query.format == "xes" else "text/csv; charset=utf-8"
        return file_response(f"processes.{query.format}", media_type, await orchestrator.read(write))
