"""Routes: pause and resume processes, and mend what cannot continue."""

from fastapi import FastAPI, Response

from handover.http.api_description import TaggedRoutes
from handover.http.body_limit import max_body
from handover.security.act_recording import lowers
from handover.security.guard import require
from handover.security.permissions import Permission
from handover_processes.documents.document import json_response
from handover_processes.documents.events import PausedProcesses
from handover_processes.documents.requests import (
    MAX_PARAMETERS_BYTES,
    MendRequest,
    MoveRequest,
    PauseRequest,
    VariablesRequest,
)
from handover_processes.operations.process_control import check_variables
from handover_processes.records.processes import ActKind
from handover_processes.routes.process_response import PROCESS, changed_process_response
from handover_processes.routes.resources import acting_name, of_definition_query, of_process
from handover_processes.running.components import Components


def add_pausing(app: FastAPI, at: Components) -> None:
    """Add pausing and resuming of processes."""
    routes = TaggedRoutes(app, "processes")
    orchestrator = at.orchestrator

    @routes.post(
        "/processes/{process_id}/pause",
        responses=PROCESS,
        dependencies=[require(Permission.RUN_PROCESSES, of_process(at))],
    )
    @lowers()
    async def pause(process_id: str, body: PauseRequest) -> Response:
        """Pause a process: its Tasks are requested to pause, no other is posted, timers wait."""
        await orchestrator.processes.pause(
            at.plain_id(process_id), ActKind.PAUSE, by=acting_name(body.by), why=body.why
        )
        return await changed_process_response(at, process_id)

    @routes.post(
        "/processes/{process_id}/resume",
        responses=PROCESS,
        dependencies=[require(Permission.RUN_PROCESSES, of_process(at))],
    )
    async def resume(process_id: str, body: PauseRequest) -> Response:
        """Continue a paused process, with the timers that were due meanwhile."""
        await orchestrator.processes.pause(
            at.plain_id(process_id), ActKind.RESUME, by=acting_name(body.by), why=body.why
        )
        return await changed_process_response(at, process_id)

    @routes.post(
        "/pause",
        responses={200: {"model": PausedProcesses}},
        dependencies=[require(Permission.RUN_PROCESSES, of_definition_query(at.orchestrator.state.registry))],
    )
    @lowers()
    async def pause_all(body: PauseRequest, definition: str | None = None) -> Response:
        """Pause all running processes and timer start events, or those of a definition.

        Processes can still be started by a request, a message, a signal or an entity.
        """
        await orchestrator.holds.pause_starts(definition, acting_name(body.by), body.why)
        paused = await orchestrator.processes.pause_all(
            ActKind.PAUSE, by=acting_name(body.by), why=body.why, definition=definition
        )
        return json_response({"processes": paused})

    @routes.post(
        "/resume",
        responses={200: {"model": PausedProcesses}},
        dependencies=[require(Permission.RUN_PROCESSES, of_definition_query(at.orchestrator.state.registry))],
    )
    async def resume_all(body: PauseRequest, definition: str | None = None) -> Response:
        """Continue all paused processes and timer start events, or those of a definition."""
        await orchestrator.holds.resume_starts(definition)
        resumed = await orchestrator.processes.pause_all(
            ActKind.RESUME, by=acting_name(body.by), why=body.why, definition=definition
        )
        return json_response({"processes": resumed})


def add_repairs(app: FastAPI, at: Components) -> None:
    """Add what an engineer does with a process that cannot continue: each act names one token or none."""
    routes = TaggedRoutes(app, "incidents")
    orchestrator = at.orchestrator

    async def mend(process_id: str, kind: ActKind, token: str | None, body: MendRequest) -> Response:
        check_variables(body.variables)
        await orchestrator.processes.mend(
            at.plain_id(process_id),
            kind,
            token,
            by=acting_name(body.by),
            why=body.why,
            to=body.to if isinstance(body, MoveRequest) else None,
            scope=body.scope if isinstance(body, VariablesRequest) else None,
            values=body.variables,
        )
        return await changed_process_response(at, process_id)

    @routes.post(
        "/processes/{process_id}/reservations/{key}/release",
        responses=PROCESS,
        dependencies=[require(Permission.RUN_PROCESSES, of_process(at))],
    )
    async def release(process_id: str, key: str, body: PauseRequest) -> Response:
        """Release what is reserved for a part of a process; the next activity of it reserves again."""
        await orchestrator.processes.release(
            at.plain_id(process_id), key, by=acting_name(body.by), why=body.why
        )
        return await changed_process_response(at, process_id)

    @routes.post(
        "/processes/{process_id}/variables",
        responses=PROCESS,
        dependencies=[require(Permission.RUN_PROCESSES, of_process(at))],
    )
    @max_body(MAX_PARAMETERS_BYTES)
    async def set_variables(process_id: str, body: VariablesRequest) -> Response:
        """Set variables of a running process, or with `scope` of a part of it."""
        return await mend(process_id, ActKind.SET_VARIABLES, None, body)

    @routes.post(
        "/processes/{process_id}/tokens/{token}/retry",
        responses=PROCESS,
        dependencies=[require(Permission.RUN_PROCESSES, of_process(at))],
    )
    @max_body(MAX_PARAMETERS_BYTES)
    async def retry_token(process_id: str, token: str, body: MendRequest) -> Response:
        """Let a token with an incident try again: a failed Task is posted again, as a new Task."""
        return await mend(process_id, ActKind.RETRY, token, body)

    @routes.post(
        "/processes/{process_id}/tokens/{token}/skip",
        responses=PROCESS,
        dependencies=[require(Permission.RUN_PROCESSES, of_process(at))],
    )
    @max_body(MAX_PARAMETERS_BYTES)
    async def skip_token(process_id: str, token: str, body: MendRequest) -> Response:
        """Let a token leave its element, as if that had been done with the variables as results."""
        return await mend(process_id, ActKind.SKIP, token, body)

    @routes.post(
        "/processes/{process_id}/tokens/{token}/move",
        responses=PROCESS,
        dependencies=[require(Permission.RUN_PROCESSES, of_process(at))],
    )
    @max_body(MAX_PARAMETERS_BYTES)
    async def move_token(process_id: str, token: str, body: MoveRequest) -> Response:
        """Move a token to another element of its scope; its present Task is cancelled."""
        return await mend(process_id, ActKind.MOVE, token, body)

    @routes.post(
        "/processes/{process_id}/tokens/{token}/cancel",
        responses=PROCESS,
        dependencies=[require(Permission.RUN_PROCESSES, of_process(at))],
    )
    @max_body(MAX_PARAMETERS_BYTES)
    async def cancel_token(process_id: str, token: str, body: MendRequest) -> Response:
        """End a token where it is; the process ends if it was the last one."""
        return await mend(process_id, ActKind.CANCEL_BRANCH, token, body)
