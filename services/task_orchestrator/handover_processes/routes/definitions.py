"""Routes: deploy, check and read definitions."""

from typing import Annotated

from fastapi import FastAPI, Path, Query, Request, Response
from starlette.responses import JSONResponse

from handover.database.outage import shown_after_change
from handover.http.api_description import TaggedRoutes, sends
from handover.http.body_limit import max_body
from handover.messages import message
from handover.security.act_recording import lowers
from handover.security.guard import require
from handover.security.permissions import Permission
from handover.serving.service import XML_TYPES, accepts
from handover_bpmn.model import Fault
from handover_bpmn.notation.document import MAX_BYTES
from handover_bpmn.notation.faults import BadBpmn, as_json
from handover_processes.allocation.report import allocation_report
from handover_processes.documents.definitions import (
    DefinitionView,
    DefinitionWithActivities,
    Deployment,
    DeploymentCheck,
    activity_views,
    definition_view,
)
from handover_processes.documents.document import json_response
from handover_processes.documents.forms import TaskForm, form_view
from handover_processes.documents.requests import MAX_VERSION, DefinitionVersion, FormData, Name, PauseRequest
from handover_processes.documents.statistics import VersionStatistics, statistics_view
from handover_processes.operations.start_forms import FormOfStart
from handover_processes.routes.resources import acting_name, of_definition
from handover_processes.running.orchestrator import Orchestrator

VersionNumber = Annotated[int, Path(ge=1, le=MAX_VERSION)]


def add_definitions(app: FastAPI, orchestrator: Orchestrator) -> None:
    """Add the routes of definitions."""
    routes = TaggedRoutes(app, "definitions")
    registry = orchestrator.state.registry

    @routes.post(
        "/definitions",
        status_code=201,
        responses={201: {"model": Deployment}, 200: {"model": Deployment | DeploymentCheck}},
        dependencies=[require(Permission.DEPLOY_PROCESSES)],
    )
    @accepts(*XML_TYPES)
    @max_body(2 * MAX_BYTES)
    async def deploy(request: Request, *, dry: bool = False) -> JSONResponse:
        """Deploy a BPMN file (the body is the XML): 201 for a new version, 200 if it is deployed already.

        With `dry` nothing is deployed: 200 with the version that the deployment would have.
        """
        body = await _body(request)
        if dry:
            return JSONResponse(await orchestrator.deployments.check(body), 200)
        deployed = await orchestrator.deployments.deploy(body)
        views = [
            definition_view(registry, registry.record(deployment.name, deployment.version))
            for deployment in deployed.deployments
        ]
        allocation = [
            line
            for deployment in deployed.deployments
            for line in allocation_report(
                orchestrator.state.allocator.rules,
                orchestrator.state.allocator.forms,
                registry.plan_of(registry.record(deployment.name, deployment.version)).definition,
            )
        ]
        warnings = as_json(deployed.warnings)
        view = {**views[0], "definitions": views, "warnings": warnings, "allocation": allocation}
        return JSONResponse(view, 201 if deployed.created else 200)

    @routes.get(
        "/definitions",
        responses={200: {"model": list[DefinitionView]}},
        dependencies=[require(Permission.READ)],
    )
    async def definitions() -> Response:
        """Return the latest version of every definition."""
        latest = registry.latest()
        for record in latest:
            await registry.prepare(record)
        return json_response([definition_view(registry, record) for record in latest])

    @routes.get(
        "/definitions/{name}",
        responses={200: {"model": DefinitionWithActivities}},
        dependencies=[require(Permission.READ, of_definition(registry))],
    )
    async def definition(name: str, version: DefinitionVersion = None) -> Response:
        """Return a definition with its activities, and who gets them now."""
        record = registry.record(name, version)
        await registry.prepare(record)
        read = registry.plan_of(record).definition
        allocation = allocation_report(
            orchestrator.state.allocator.rules, orchestrator.state.allocator.forms, read
        )
        view = {"activities": activity_views(read), "allocation": allocation}
        return json_response({**definition_view(registry, record), **view})

    @routes.post(
        "/definitions/{name}/suspend",
        responses={200: {"model": DefinitionView}},
        dependencies=[require(Permission.RUN_PROCESSES, of_definition(registry))],
    )
    @lowers()
    async def suspend(name: str, body: PauseRequest) -> Response:
        """Suspend a definition: no process of it starts, those that run continue."""
        await orchestrator.holds.suspend(name, acting_name(body.by), body.why)
        return json_response(await shown_after_change(_view(orchestrator, name)))

    @routes.post(
        "/definitions/{name}/activate",
        responses={200: {"model": DefinitionView}},
        dependencies=[require(Permission.RUN_PROCESSES, of_definition(registry))],
    )
    async def activate(name: str, body: PauseRequest) -> Response:  # noqa: ARG001 - for the audit log
        """Let processes of a suspended definition start again; messages that wait for it start some."""
        await orchestrator.holds.activate(name)
        return json_response(await shown_after_change(_view(orchestrator, name)))

    @routes.delete(
        "/definitions/{name}",
        status_code=204,
        dependencies=[require(Permission.DEPLOY_PROCESSES, of_definition(registry))],
    )
    async def delete(
        name: str, by: Name, why: Annotated[str | None, Query(max_length=1000)] = None
    ) -> Response:
        """Delete a definition with all versions: 409 while processes of it run.

        Processes of it that have ended can be read as before. A deployment of its file makes a new version.
        """
        await orchestrator.holds.delete(name, acting_name(by), why)
        return Response(status_code=204)

    @routes.delete(
        "/definitions/{name}/versions/{version}",
        status_code=204,
        dependencies=[require(Permission.DEPLOY_PROCESSES, of_definition(registry))],
    )
    async def delete_version(
        name: str, version: VersionNumber, by: Name, why: Annotated[str | None, Query(max_length=1000)] = None
    ) -> Response:
        """Delete an earlier version: 409 while processes of it run, or a call names it.

        The latest version is not deleted: deploy the one that follows it before. Processes of a deleted
        version that have ended can be read as before, and so can its file.
        """
        await orchestrator.holds.delete_version(name, version, acting_name(by), why)
        return Response(status_code=204)

    @routes.get(
        "/definitions/{name}/statistics",
        responses={200: {"model": VersionStatistics}},
        dependencies=[require(Permission.READ, of_definition(registry))],
    )
    async def statistics(name: str, version: DefinitionVersion = None) -> Response:
        """Return the statistics of all processes of a version (default: the latest), by activity."""
        record = registry.record(name, version)
        counts = await orchestrator.read(
            orchestrator.store.counts, record.name, record.version, orchestrator.clock()
        )
        return json_response(statistics_view(record, counts))

    @routes.post(
        "/definitions/{name}/start-form",
        responses={200: {"model": TaskForm | None}},
        dependencies=[require(Permission.READ, of_definition(registry))],
    )
    async def start_form(name: str, body: FormData, version: DefinitionVersion = None) -> Response:
        """Return the form of the start variables, for those typed so far; null if there is none."""
        record = registry.record(name, version)
        await registry.prepare(record)
        state = orchestrator.state
        definition = registry.plan_of(record).definition
        form = FormOfStart(definition, state.allocator.forms, record.deployed_at, state.clock())
        resolved = form.resolve(body.values)
        return JSONResponse(None if resolved is None else form_view(form.id, form.version, resolved))

    @routes.get(
        "/definitions/{name}/bpmn",
        response_class=Response,
        responses=sends("application/xml"),
        dependencies=[require(Permission.READ, of_definition(registry))],
    )
    async def bpmn(name: str, version: DefinitionVersion = None) -> Response:
        """Return the BPMN file as it was deployed."""
        return Response(registry.record(name, version).xml, media_type="application/xml")


async def _view(orchestrator: Orchestrator, name: str) -> DefinitionView:
    registry = orchestrator.state.registry
    record = registry.record(name)
    await registry.prepare(record)
    return definition_view(registry, record)


async def _body(request: Request) -> bytes:
    body = bytearray()
    async for chunk in request.stream():
        body += chunk
        if len(body) > MAX_BYTES:
            raise BadBpmn(
                [
                    Fault(
                        None,
                        None,
                        message(
                            "bpmn.upload_too_large",
                            "a BPMN file has at most {max_bytes} bytes",
                            max_bytes=MAX_BYTES,
                        ),
                    )
                ]
            )
    return bytes(body)
