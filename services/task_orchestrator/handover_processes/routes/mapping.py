"""Routes: the mapping from names to performers, and the agents."""

from contextlib import suppress
from typing import Annotated

from fastapi import FastAPI, Query, Response

from handover.errors import HandoverError, Problem
from handover.http.api_description import TaggedRoutes
from handover.http.body_limit import max_body
from handover.security.guard import require
from handover.security.permissions import Permission
from handover_processes.allocation.mapping import MappingRequest
from handover_processes.documents.agents import AgentView, agent_views
from handover_processes.documents.document import json_response
from handover_processes.documents.mapping import MappingUse, MappingView, mapping_use, mapping_view
from handover_processes.documents.requests import MAX_VERSION
from handover_processes.routes.resources import acting_name
from handover_processes.running.orchestrator import Orchestrator

MAX_MAPPING_BYTES = 4 * 1024 * 1024


def add_mapping(app: FastAPI, orchestrator: Orchestrator) -> None:
    """Add the routes of the mapping and of the agents."""
    routes = TaggedRoutes(app, "allocation")

    @routes.get("/mapping", responses={200: {"model": MappingView}}, dependencies=[require(Permission.READ)])
    async def mapping(
        version: Annotated[int | None, Query(ge=1, le=MAX_VERSION)] = None,
    ) -> Response:
        """Return the mapping from names in process files to performers, or an earlier version of it."""
        if version is None:
            return json_response(mapping_view(orchestrator.state.allocator.rules.mapping))
        table = await orchestrator.on_disk(orchestrator.store.mapping, version)
        if table is None:
            raise Problem.translated(
                404,
                "No such version",
                "allocation.no_such_mapping",
                "there is no version {version} of the mapping; the latest is {latest}",
                version=version,
                latest=orchestrator.state.allocator.rules.mapping.version,
            )
        return json_response(mapping_view(table))

    @routes.get(
        "/agents", responses={200: {"model": list[AgentView]}}, dependencies=[require(Permission.READ)]
    )
    async def agents() -> Response:
        """Return the Devices and Persons that can perform Tasks, with their skills, shifts and open Tasks."""
        state = orchestrator.state
        tasks = list(state.active_processes.open_tasks())
        return json_response(agent_views(state.allocator, tasks, orchestrator.clock()))

    @routes.get(
        "/mapping/names", responses={200: {"model": MappingUse}}, dependencies=[require(Permission.READ)]
    )
    async def names() -> Response:
        """Return the names in the deployed definitions that the mapping can relate to performers.

        `missing` are the entries whose role or skills no agent has.
        """
        state = orchestrator.state
        definitions = []
        for record in state.registry.latest():
            await state.registry.prepare(record)
            with suppress(HandoverError):  # a version that this release cannot read
                definitions.append(state.registry.plan_of(record).definition)
        return json_response(mapping_use(state.allocator, definitions))

    @routes.put(
        "/mapping",
        responses={200: {"model": MappingView}},
        dependencies=[require(Permission.DEPLOY_PROCESSES)],
    )
    @max_body(MAX_MAPPING_BYTES)
    async def set_mapping(body: MappingRequest) -> Response:
        """Replace the mapping; it applies to Tasks that are posted later."""
        table = await orchestrator.deployments.set_mapping(
            body.entries, by=acting_name(body.by), why=body.why, version=body.version
        )
        return json_response(mapping_view(table))
