"""Routes of migration: running processes continue in another version of their definition."""

from fastapi import FastAPI, Response

from handover.errors import Problem
from handover.http.api_description import TaggedRoutes
from handover.http.body_limit import max_body
from handover.messages import message
from handover.security.guard import require
from handover.security.permissions import Permission
from handover_processes.documents.document import json_response
from handover_processes.documents.migrations import (
    MigrationOfAllView,
    MigrationView,
    migration_of_all_view,
    migration_view,
)
from handover_processes.documents.requests import (
    MAX_PARAMETERS_BYTES,
    MigrationOfAllRequest,
    MigrationRequest,
)
from handover_processes.operations.process_control import check_variables
from handover_processes.records.processes import Act, ActKind
from handover_processes.routes.resources import acting_name, of_definition, of_process
from handover_processes.running.components import Components


def add_migration(app: FastAPI, at: Components) -> None:
    """Add the migration of one process, and of all of a version."""
    routes = TaggedRoutes(app, "migration")
    orchestrator = at.orchestrator

    @routes.post(
        "/processes/{process_id}/migration",
        responses={200: {"model": MigrationView}},
        dependencies=[require(Permission.RUN_PROCESSES, of_process(at))],
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

    @routes.post(
        "/definitions/{name}/migration",
        responses={200: {"model": MigrationOfAllView}},
        dependencies=[require(Permission.RUN_PROCESSES, of_definition(orchestrator.state.registry))],
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
            acting_name(body.by),
            why=body.why,
            values=body.variables or None,
            mapping=body.mapping or None,
        )
