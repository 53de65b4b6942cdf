"""Routes: start, read, cancel and retry processes."""

from typing import Annotated

from fastapi import FastAPI, Query, Request, Response
from starlette.responses import JSONResponse

from handover.database.outage import shown_after_change
from handover.formats.validation import Moment
from handover.http.api_description import TaggedRoutes
from handover.http.body_limit import max_body
from handover.security.act_recording import lowers
from handover.security.guard import authenticated, require, require_by_handler
from handover.security.permissions import Permission
from handover_datamodels.times import iso
from handover_processes.documents.document import document, json_response
from handover_processes.documents.processes import ProcessSummary, process_summary
from handover_processes.documents.requests import (
    MAX_PARAMETERS_BYTES,
    CancelRequest,
    ProcessListQuery,
    ProcessStart,
    RetryRequest,
)
from handover_processes.documents.statistics import PeriodStatistics
from handover_processes.routes.process_response import (
    PROCESS,
    changed_process_response,
    process_content,
    process_response,
)
from handover_processes.routes.resources import acting_name, definition_id, of_definition_query, of_process
from handover_processes.running.components import Components


def add_processes(app: FastAPI, at: Components) -> None:
    """Add the routes of processes."""
    routes = TaggedRoutes(app, "processes")
    orchestrator, settings = at.orchestrator, at.settings
    store, registry = orchestrator.store, orchestrator.state.registry

    @routes.post(
        "/processes",
        status_code=201,
        responses={201: PROCESS[200], **PROCESS},
        dependencies=[require_by_handler(Permission.RUN_PROCESSES, "for the ProcessDefinition")],
    )
    @max_body(MAX_PARAMETERS_BYTES)
    async def start(body: ProcessStart, connection: Request) -> JSONResponse:
        """Start a process: 201, or 200 if the same key or request has started it before."""
        at.guard.require(
            await authenticated(connection),
            Permission.RUN_PROCESSES,
            definition_id(registry, body.definition, body.version),
        )
        process_id, created = await orchestrator.processes.start(
            body.definition, body.parameters, version=body.version, key=body.key, request=body.request
        )
        view = await shown_after_change(process_content(at, process_id))
        return JSONResponse(view, 201 if created else 200, {"Location": f"/processes/{process_id}"})

    @routes.get(
        "/processes",
        responses={200: {"model": list[ProcessSummary]}},
        dependencies=[require(Permission.READ, of_definition_query(registry))],
    )
    async def processes(query: Annotated[ProcessListQuery, Query()], request: Request) -> Response:
        """Return processes, the latest first; `before` with the id of the last one returns the next page.

        The header `Link` has the address of the next page. Conditions on variables compare numbers with
        numbers and texts with texts.
        """
        mark = at.plain_id(query.before) if query.before is not None else None
        records = await orchestrator.read(store.page, query.read(), before=mark, limit=query.limit)
        response = json_response([process_summary(settings, registry, record) for record in records])
        if len(records) == query.limit:
            following = request.url.include_query_params(before=records[-1].id)
            response.headers["Link"] = f'<{following.path}?{following.query}>; rel="next"'
        return response

    @routes.get(
        "/statistics", responses={200: {"model": PeriodStatistics}}, dependencies=[require(Permission.READ)]
    )
    async def statistics(
        since: Annotated[Moment, Query(description="count processes that ended at this time or later")],
        until: Annotated[
            Moment | None, Query(description="count processes that ended before this time")
        ] = None,
    ) -> Response:
        """Return the number of processes that run and that ended in a period, and their median duration."""
        counts = await orchestrator.read(store.counts_since, since, orchestrator.clock(), until)
        begins = orchestrator.state.registry.first_deployed_at()
        shown = since if begins is None else max(since, begins)
        return json_response(document(PeriodStatistics, counts, since=iso(shown)))

    @routes.get(
        "/processes/{process_id}", responses=PROCESS, dependencies=[require(Permission.READ, of_process(at))]
    )
    async def process(process_id: str) -> Response:
        """Return a process with its variables, its Tasks, its waiting elements and its next activities."""
        return await process_response(at, process_id)

    @routes.post(
        "/processes/{process_id}/cancel",
        responses=PROCESS,
        dependencies=[require(Permission.RUN_PROCESSES, of_process(at))],
    )
    @lowers()
    async def cancel(process_id: str, body: CancelRequest | None = None) -> Response:
        """Cancel a process and its Tasks."""
        await orchestrator.processes.cancel(
            at.plain_id(process_id), acting_name((body and body.by) or "") or None
        )
        return await changed_process_response(at, process_id)

    @routes.post(
        "/processes/{process_id}/tasks/{task_id}/retry",
        responses=PROCESS,
        dependencies=[require(Permission.RUN_PROCESSES, of_process(at))],
    )
    async def retry(process_id: str, task_id: str, body: RetryRequest) -> Response:
        """Post the failed Task that has ended a process again, as a new Task; the process continues."""
        await orchestrator.processes.retry(
            at.plain_id(process_id), settings.entity_id("Task", task_id), acting_name(body.by)
        )
        return await changed_process_response(at, process_id)
