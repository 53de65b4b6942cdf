"""Routes: messages and signals of clients, notifications of the broker."""

from datetime import timedelta

from fastapi import FastAPI, Request, Response

from handover.errors import Problem
from handover.formats.durations import parse_duration
from handover.http.api_description import TaggedRoutes
from handover.http.body_limit import max_body
from handover.security.guard import authenticated, require, require_by_handler
from handover.security.permissions import Permission
from handover.security.resource_patterns import ANY_RESOURCE
from handover.subscriptions.notifications import REQUIRES_NOTIFICATION_KEY
from handover_processes.documents.document import json_response
from handover_processes.documents.events import SentMessage, SentSignal
from handover_processes.documents.requests import MAX_PARAMETERS_BYTES, MessageRequest, SignalRequest
from handover_processes.operations.process_control import check_variables
from handover_processes.routes.resources import process_resource
from handover_processes.running.components import Components


def add_events(app: FastAPI, at: Components) -> None:
    """Add the routes."""
    events_routes = TaggedRoutes(app, "events")
    notifications_routes = TaggedRoutes(app, "notifications")

    @events_routes.post(
        "/messages",
        responses={200: {"model": SentMessage}},
        dependencies=[
            require_by_handler(Permission.RUN_PROCESSES, "for the process, or for every resource without one")
        ],
    )
    @max_body(MAX_PARAMETERS_BYTES)
    async def publish(body: MessageRequest, connection: Request) -> Response:
        """Send a message: to the process that waits for it, else a start event, else it is kept.

        With `process` only that process gets it, now or when it waits for it: 404 without such a process,
        409 if it has ended.
        """
        resource = ANY_RESOURCE if body.process is None else await process_resource(at, body.process)
        at.guard.require(await authenticated(connection), Permission.RUN_PROCESSES, resource)
        check_variables(body.variables)
        try:
            ttl = None if body.ttl is None else timedelta(seconds=parse_duration(body.ttl).nominal_s)
        except ValueError as error:
            raise Problem(422, "Bad time to live", str(error)) from error
        process = None if body.process is None else at.plain_id(body.process)
        outcome, reached = await at.orchestrator.processes.publish(
            body.name, key=body.key, process=process, variables=body.variables, ttl=ttl
        )
        return json_response({"outcome": outcome.value, "process": reached})

    @events_routes.post(
        "/signals", responses={200: {"model": SentSignal}}, dependencies=[require(Permission.RUN_PROCESSES)]
    )
    @max_body(MAX_PARAMETERS_BYTES)
    async def broadcast(body: SignalRequest) -> Response:
        """Send a signal to every process that waits for it, and to start events."""
        check_variables(body.variables)
        return json_response(
            {"processes": await at.orchestrator.processes.broadcast(body.name, body.variables)}
        )

    @notifications_routes.post("/notifications", status_code=204, dependencies=[REQUIRES_NOTIFICATION_KEY])
    async def notify(request: Request) -> Response:
        """Read the changed Tasks from the broker; the response is sent when their changes are stored."""
        await at.reconciler.receive_notification(request)
        return Response(status_code=204)

    @notifications_routes.post(
        "/notifications/entities/{filter_key}", status_code=204, dependencies=[REQUIRES_NOTIFICATION_KEY]
    )
    async def notify_entities(filter_key: str, request: Request) -> Response:
        """Deliver the changed entities of a filter; the response is sent when the consequences are stored."""
        await at.entity_events.receive_notification(filter_key, request)
        return Response(status_code=204)
