"""Routes: the mapping from names to performers, and the agents."""

from typing import Annotated

from fastapi import FastAPI, Query, Response

from handover.body_limit import max_body
from handover.errors import Problem
from handover.messages import message
from services.task_orchestrator.allocation.mapping import MappingRequest
from services.task_orchestrator.orchestrator import Orchestrator
from services.task_orchestrator.requests import (
    MAX_VERSION,
)
from services.task_orchestrator.responses import (
    AgentView,
    MappingView,
    json_response,
)
from services.task_orchestrator.views import (
    agent_views,
    mapping_view,
)

MAX_MAPPING_BYTES = 4 * 1024 * 1024


def add_mapping(app: FastAPI, orchestrator: Orchestrator) -> None:
    """Add the routes of the mapping and of the agents."""

    @app.get("/mapping", tags=["allocation"], responses={200: {"model": MappingView}})
    async def mapping(
        version: Annotated[int | None, Query(ge=1, le=MAX_VERSION)] = None,
    ) -> Response:
        """Return the mapping from names in process files to performers, or an earlier version of it."""
        if version is None:
            return json_response(mapping_view(orchestrator.state.allocator.mapping))
        table = await orchestrator.on_disk(orchestrator.store.mapping, version)
        if table is None:
            raise Problem(
                404,
                "No such version",
                message(
                    "allocation.no_such_mapping",
                    "there is no version {version} of the mapping; the latest is {latest}",
                    version=version,
                    latest=orchestrator.state.allocator.mapping.version,
                ),
            )
        return json_response(mapping_view(table))

    @app.get("/agents", tags=["allocation"], responses={200: {"model": list[AgentView]}})
    async def agents() -> Response:
        """Return the Devices and Persons that can perform Tasks, with their skills and open Tasks."""
        return json_response(agent_views(orchestrator.state.allocator))

    @app.put("/mapping", tags=["allocation"], responses={200: {"model": MappingView}})
    @max_body(MAX_MAPPING_BYTES)
    async def set_mapping(body: MappingRequest) -> Response:
        """Replace the mapping; it applies to Tasks that are posted later."""
        table = await orchestrator.deployments.set_mapping(
            body.entries, by=body.by.strip(), why=body.why, version=body.version
        )
        return json_response(mapping_view(table))
