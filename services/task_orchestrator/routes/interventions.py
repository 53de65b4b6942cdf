"""Routes: pause and resume processes, and mend what cannot continue."""

from fastapi import FastAPI, Response

from handover.body_limit import max_body
from handover.errors import Problem
from handover.messages import message
from services.task_orchestrator.components import Components
from services.task_orchestrator.operations.process_control import check_variables
from services.task_orchestrator.records import Act, ActKind
from services.task_orchestrator.requests import (
    MAX_PARAMETERS_BYTES,
    MendRequest,
    MigrationOfAllRequest,
    MigrationRequest,
    MoveRequest,
    PauseRequest,
)
from services.task_orchestrator.responses import (
    MigrationOfAllView,
    MigrationView,
    PausedProcesses,
    json_response,
)
from services.task_orchestrator.routes.process_response import PROCESS, process_response
from services.task_orchestrator.views import migration_of_all_view, migration_view


def add_interventions(app: FastAPI, at: Components) -> None:
    """Add what people do with running processes: pause, resume, and mend what cannot continue."""
    orchestrator = at.orchestrator

    async def mend(process_id: str, kind: ActKind, token: str | None, body: MendRequest) -> Response:
        check_variables(body.variables)
        await orchestrator.processes.mend(
            at.plain_id(process_id),
            kind,
            token,
            by=body.by.strip(),
            why=body.why,
            to=body.to if isinstance(body, MoveRequest) else None,
            values=body.variables,
        )
        return await process_response(at, process_id)

    @app.post("/processes/{process_id}/pause", tags=["processes"], responses=PROCESS)
    async def pause(process_id: str, body: PauseRequest) -> Response:
        """Pause a process: its Tasks are requested to pause, no other is posted, timers wait."""
        await orchestrator.processes.pause(
            at.plain_id(process_id), ActKind.PAUSE, by=body.by.strip(), why=body.why
        )
        return await process_response(at, process_id)

    @app.post("/processes/{process_id}/resume", tags=["processes"], responses=PROCESS)
    async def resume(process_id: str, body: PauseRequest) -> Response:
        """Continue a paused process, with the timers that were due meanwhile."""
        await orchestrator.processes.pause(
            at.plain_id(process_id), ActKind.RESUME, by=body.by.strip(), why=body.why
        )
        return await process_response(at, process_id)

    @app.post("/pause", tags=["processes"], responses={200: {"model": PausedProcesses}})
    async def pause_all(body: PauseRequest, definition: str | None = None) -> Response:
        """Pause all running processes, or those of a definition. Processes can still be started."""
        paused = await orchestrator.processes.pause_all(
            ActKind.PAUSE, by=body.by.strip(), why=body.why, definition=definition
        )
        return json_response({"processes": paused})

    @app.post("/resume", tags=["processes"], responses={200: {"model": PausedProcesses}})
    async def resume_all(body: PauseRequest, definition: str | None = None) -> Response:
        """Continue all paused processes, or those of a definition."""
        resumed = await orchestrator.processes.pause_all(
            ActKind.RESUME, by=body.by.strip(), why=body.why, definition=definition
        )
        return json_response({"processes": resumed})

    @app.post(
        "/processes/{process_id}/migration",
        tags=["migration"],
        responses={200: {"model": MigrationView}},
    )
    @max_body(MAX_PARAMETERS_BYTES)
    async def migrate(process_id: str, body: MigrationRequest, *, dry: bool = False) -> Response:
        """Continue a process in another version of its definition: 409 with the obstacles if it cannot.

        With `dry` nothing is changed: 200 with what differs, and the obstacles.
        """
        check_variables(body.variables)
        report = await orchestrator.processes.migrate(
            at.plain_id(process_id), body.version, _migration(body), dry=dry
        )
        view = migration_view(report, dry=dry)
        if dry or report.is_possible:
            return json_response(view)
        obstacles = [finding for finding in view["findings"] if finding["obstacle"]]
        raise Problem(
            409,
            "Cannot be migrated",
            message(
                "process.cannot_migrate",
                "{process} cannot continue in version {version}: at {element}: {reason}",
                process=report.process,
                version=report.target,
                element=obstacles[0]["name"] or obstacles[0]["element"],
                reason=obstacles[0]["reason"],
            ),
            extra={"findings": view["findings"]},
        )

    @app.post(
        "/definitions/{name}/migration",
        tags=["migration"],
        responses={200: {"model": MigrationOfAllView}},
    )
    @max_body(MAX_PARAMETERS_BYTES)
    async def migrate_all(name: str, body: MigrationOfAllRequest, *, dry: bool = False) -> Response:
        """Continue all running processes of a version in another one, each if it can.

        With `dry` nothing is changed.
        """
        check_variables(body.variables)
        target, reports = await orchestrator.processes.migrate_all(
            name, body.source, body.version, _migration(body), dry=dry
        )
        return json_response(migration_of_all_view(name, body.source, target, reports, dry=dry))

    def _migration(body: MigrationRequest) -> Act:
        return Act(
            orchestrator.clock(),
            ActKind.MIGRATE,
            body.by.strip(),
            why=body.why,
            values=body.variables or None,
            mapping=body.mapping or None,
        )

    @app.post("/processes/{process_id}/reservations/{key}/release", tags=["incidents"], responses=PROCESS)
    async def release(process_id: str, key: str, body: PauseRequest) -> Response:
        """Release what is reserved for a part of a process; the next activity of it reserves again."""
        await orchestrator.processes.release(at.plain_id(process_id), key, by=body.by.strip(), why=body.why)
        return await process_response(at, process_id)

    @app.post("/processes/{process_id}/variables", tags=["incidents"], responses=PROCESS)
    @max_body(MAX_PARAMETERS_BYTES)
    async def set_variables(process_id: str, body: MendRequest) -> Response:
        """Set variables of a running process."""
        return await mend(process_id, ActKind.SET_VARIABLES, None, body)

    @app.post("/processes/{process_id}/tokens/{token}/retry", tags=["incidents"], responses=PROCESS)
    @max_body(MAX_PARAMETERS_BYTES)
    async def retry_token(process_id: str, token: str, body: MendRequest) -> Response:
        """Let a token with an incident try again: a failed Task is posted again, as a new Task."""
        return await mend(process_id, ActKind.RETRY, token, body)

    @app.post("/processes/{process_id}/tokens/{token}/skip", tags=["incidents"], responses=PROCESS)
    @max_body(MAX_PARAMETERS_BYTES)
    async def skip_token(process_id: str, token: str, body: MendRequest) -> Response:
        """Let a token leave its element, as if that had been done with the variables as results."""
        return await mend(process_id, ActKind.SKIP, token, body)

    @app.post("/processes/{process_id}/tokens/{token}/move", tags=["incidents"], responses=PROCESS)
    @max_body(MAX_PARAMETERS_BYTES)
    async def move_token(process_id: str, token: str, body: MoveRequest) -> Response:
        """Move a token to another element of its scope; its present Task is cancelled."""
        return await mend(process_id, ActKind.MOVE, token, body)

    @app.post("/processes/{process_id}/tokens/{token}/cancel", tags=["incidents"], responses=PROCESS)
    @max_body(MAX_PARAMETERS_BYTES)
    async def cancel_token(process_id: str, token: str, body: MendRequest) -> Response:
        """End a token where it is; the process ends if it was the last one."""
        return await mend(process_id, ActKind.CANCEL_BRANCH, token, body)
