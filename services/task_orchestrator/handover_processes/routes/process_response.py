"""The response of the routes that return a process."""

from typing import Any

from fastapi import Response

from handover.database.outage import shown_after_change
from handover.errors import Problem
from handover_processes.documents.document import json_response
from handover_processes.documents.processes import ProcessView, process_view
from handover_processes.running.components import Components

PROCESS: dict[int | str, dict[str, Any]] = {200: {"model": ProcessView}}
"""The response, for the OpenAPI document."""


async def process_response(at: Components, process_id: str) -> Response:
    """Return a process with all details as JSON; raise `Problem` 404 if there is none."""
    return json_response(await process_content(at, process_id))


async def changed_process_response(at: Components, process_id: str) -> Response:
    """Return a process that was changed; raise `ChangeMade` if it cannot be read."""
    return await shown_after_change(process_response(at, process_id))


async def process_content(at: Components, process_id: str) -> ProcessView:
    """Return a process with all details; raise `Problem` 404 if there is none."""
    store, registry = at.orchestrator.store, at.orchestrator.state.registry
    seen = await at.orchestrator.read(store.everything, at.plain_id(process_id))
    if seen is None:
        raise Problem.translated(
            404,
            "No such process",
            "process.unknown",
            'there is no process "{process_id}"',
            process_id=process_id,
        )
    await registry.prepare(registry.record(seen[0].definition, seen[0].version))
    active = at.orchestrator.state.active_processes.processes.get(seen[0].id)
    run = None if active is None or seen[0].ended_at is not None else active.run
    return process_view(at.settings, registry, *seen, allocator=at.orchestrator.state.allocator, run=run)
