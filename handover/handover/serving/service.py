"""A service: a FastAPI application with the routes that all services have; `serving.py` runs it.

`create_app` adds `/healthz` (the process runs), `/readyz` (its dependencies answer), `/metrics` (Prometheus),
`/context.jsonld` (our @context, so that any broker can fetch it), `/docs` (the routes, to read and try in a
browser) and problem details for every error.

A route accepts only JSON, unless `accepts` names other media types: a page of another site can send a body
only as plain text or as a form.
"""

import asyncio
import math
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Mapping
from contextlib import AsyncExitStack, asynccontextmanager
from http import HTTPStatus
from typing import Any, Final, TypeVar

import orjson
from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.routing import APIRoute
from prometheus_client import CONTENT_TYPE_LATEST, generate_latest
from sqlalchemy.exc import SQLAlchemyError
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.responses import JSONResponse
from starlette.routing import Match, Route
from starlette.types import Lifespan
from starlette.websockets import WebSocket

from handover.database.outage import outage_problem
from handover.errors import ChangeMade, Problem
from handover.formats.validation import fault_text
from handover.http.api_description import TaggedRoutes, describe_problems, sends
from handover.http.api_docs import add_docs
from handover.http.body_limit import limit_of, limited
from handover.http.origin_guard import REFUSED
from handover.security.act_recording import audited, unrecorded
from handover.security.audit_reading.audit_routes import add_audit_routes
from handover.security.audit_trail import AuditTrail, Way, begin_request
from handover.security.guard import Guard
from handover.security.open_streams import EndOfStreams
from handover.telemetry import get_logger, mark_logged

log = get_logger(__name__)

Check = Callable[[], Awaitable[object]]
"""A readiness check: raises an exception with the reason if the dependency is not ready."""


JSON_TYPES: Final = ("application/json", "application/*+json")
XML_TYPES: Final = ("application/xml", "text/xml", "application/*+xml")
YAML_TYPES: Final = ("application/yaml", "application/x-yaml", "text/yaml")
ANY_TYPE: Final = ("*/*",)
_CHANGES: Final = frozenset({"POST", "PUT", "PATCH", "DELETE"})
_WEBSOCKET_CODES_FROM: Final = 4000
"""A refused WebSocket is closed with 4000 plus the HTTP status: 4401, 4403, 4503."""
MAX_FAULTS_LISTED: Final = 20
CHECK_TIMEOUT_S: Final = 2.5
"""Limit of each check, so that `/readyz` names a dependency that hangs before its client gives up."""
CLIENT_CLOSED_REQUEST: Final = 499
"""The status that nginx logs for a client that disconnected before the response; it is not sent."""

Endpoint = TypeVar("Endpoint", bound=Callable[..., Any])


def accepts(*media_types: str) -> Callable[[Endpoint], Endpoint]:
    """Set the media types of the body of a route instead of JSON; a decorator below that of the route."""

    def marked(endpoint: Endpoint) -> Endpoint:
        endpoint.accepted_media_types = media_types  # type: ignore[attr-defined]
        return endpoint

    return marked


class TypedRoute(APIRoute):
    """A route that answers 415 to other media types and 413 to a body that is too large, before parsing.

    What it changes is recorded before its handler is called, with the change, or after it (`audit_trail`).
    """

    def __init__(self, path: str, endpoint: Callable[..., Any], **kwargs: Any) -> None:
        super().__init__(path, audited(endpoint), **kwargs)

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Return the handler of requests."""
        answer = super().get_route_handler()
        accepted = getattr(self.endpoint, "accepted_media_types", JSON_TYPES)
        max_bytes = limit_of(self.endpoint, self.path)

        async def checked(request: Request) -> Response:
            if request.method in _CHANGES:
                require_media_type(request, accepted)
            trail = getattr(request.app.state, "audit", None)
            if trail is None:
                return await answer(limited(request, max_bytes))
            act = begin_request(trail, f"{request.method} {self.path}", request.url.path)
            try:
                response = await answer(limited(request, max_bytes))
            except (RequestValidationError, HTTPException, ClientDisconnect):
                raise  # the handler was not called
            except Exception as error:
                await trail.finish(act, _recorded_status(error))
                raise
            is_recorded = await trail.finish(act, response.status_code)
            if act.way is Way.AFTER and response.status_code < 400 and not is_recorded:
                return unrecorded(response)
            return response

        return checked


def _recorded_status(error: Exception) -> int:
    """Return the status that the record of a request has whose handler raised `error`."""
    problem = outage_problem(error) if isinstance(error, SQLAlchemyError) else error
    if isinstance(problem, ChangeMade):
        return HTTPStatus.OK
    return problem.status if isinstance(problem, Problem) else HTTPStatus.INTERNAL_SERVER_ERROR


def require_media_type(request: Request, accepted: tuple[str, ...]) -> None:
    """Raise `Problem` 415 unless the body of `request` has an `accepted` media type."""
    media_type = request.headers.get("content-type")
    if media_type is None:
        has_body = request.headers.get("content-length", "0") != "0" or "transfer-encoding" in request.headers
        if not has_body or accepted == ANY_TYPE:
            return
    elif any(_matches(media_type.partition(";")[0].strip().lower(), pattern) for pattern in accepted):
        return
    REFUSED.labels("media type").inc()
    received = "no Content-Type" if media_type is None else f'Content-Type "{media_type[:100]}"'
    raise Problem(
        415, "Unsupported media type", f"{received} is not accepted here; send {' or '.join(accepted)}"
    )


def _matches(media_type: str, accepted: str) -> bool:
    start, star, end = accepted.partition("*")
    if not star:
        return media_type == accepted
    return accepted == "*/*" or (media_type.startswith(start) and media_type.endswith(end))


def create_app(
    title: str,
    *,
    description: str,
    lifespan: Lifespan[FastAPI] | None = None,
    checks: Mapping[str, Check] | None = None,
    guard: Guard | None = None,
    audit: AuditTrail | None = None,
    audit_prefix: str = "",
) -> FastAPI:
    """Return a FastAPI application with health, metrics and problem details in place.

    `checks` are the dependencies of the service by name; `/readyz` awaits each. `guard` authenticates the
    callers of routes that `require` a permission; the application starts and ends it, and `audit`, which
    records what callers change and which data of persons they read; its routes begin with `audit_prefix`.
    """
    app = FastAPI(
        title=title,
        description=description,
        docs_url=None,
        redoc_url=None,
        lifespan=lifespan if guard is None else _guarded(guard, audit, lifespan),
    )
    app.state.guard = guard
    app.state.audit = audit
    if guard is not None:
        app.add_middleware(EndOfStreams, guard=guard)
    app.router.route_class = TypedRoute
    add_operations(app, checks or {})
    if audit is not None:
        add_audit_routes(app, audit, prefix=audit_prefix)
    add_docs(app)
    describe_problems(app, has_guard=guard is not None)
    app.add_exception_handler(Problem, _on_problem)  # type: ignore[arg-type]  # WebSockets as well
    app.add_exception_handler(HTTPException, _on_http_exception)  # type: ignore[arg-type]
    app.add_exception_handler(RequestValidationError, _on_validation_error)
    app.add_exception_handler(ClientDisconnect, _on_disconnect)
    app.add_exception_handler(SQLAlchemyError, _on_database_error)  # type: ignore[arg-type]
    app.add_exception_handler(Exception, _on_unexpected)
    return app


def _guarded(guard: Guard, audit: AuditTrail | None, lifespan: Lifespan[FastAPI] | None) -> Lifespan[FastAPI]:
    @asynccontextmanager
    async def guarded(app: FastAPI) -> AsyncIterator[Any]:
        async with guard, AsyncExitStack() as stack:
            if audit is not None:
                await stack.enter_async_context(audit)
            yield await stack.enter_async_context(lifespan(app)) if lifespan is not None else None

    return guarded


def add_operations(app: FastAPI, checks: Mapping[str, Check]) -> None:
    """Add the routes for operators and orchestration platforms."""
    routes = TaggedRoutes(app, "operations")

    @routes.get("/healthz")
    async def healthz() -> dict[str, str]:
        """Return that the process runs."""
        return {"status": "ok"}

    @routes.get("/readyz", response_model=dict[str, str])
    async def readyz() -> Response:
        """Return whether all dependencies are ready: 200, or 503 with those that are not."""
        reasons = await asyncio.gather(*map(_failure_of, checks.values()))
        failures = {name: reason for name, reason in zip(checks, reasons, strict=True) if reason is not None}
        status = HTTPStatus.SERVICE_UNAVAILABLE if failures else HTTPStatus.OK
        return JSONResponse({"status": "not ready" if failures else "ready", **failures}, status)

    @routes.get("/metrics", response_class=Response, responses=sends("text/plain"))
    async def metrics() -> Response:
        """Return the metrics of this process in the Prometheus text format."""
        return Response(generate_latest(), media_type=CONTENT_TYPE_LATEST)

    @routes.get("/context.jsonld", response_class=Response, responses=sends("application/ld+json"))
    async def context() -> Response:
        """Return our @context."""
        from handover_datamodels.contexts import handover_context  # noqa: PLC0415 - read only when somebody asks

        return JSONResponse(handover_context(), media_type="application/ld+json")


async def _failure_of(check: Check) -> str | None:
    """Return why a dependency is not ready; None if it is."""
    try:
        async with asyncio.timeout(CHECK_TIMEOUT_S) as limit:
            await check()
    except Exception as error:  # noqa: BLE001 - any failure of a probe is its answer
        if limit.expired():
            return f"no answer within {CHECK_TIMEOUT_S} s"
        return str(error) or type(error).__name__
    return None


def json_response(content: Any, status: int = 200) -> Response:
    """Return JSON for a frequent request, without the validation that a route makes of its own results.

    The route names its `response_model` for the documentation; a test compares the two.
    """
    return Response(orjson.dumps(content), status, media_type="application/json")


def problem_response(problem: Problem) -> JSONResponse:
    """Return `problem` as an `application/problem+json` answer."""
    headers: dict[str, str] = {}
    if problem.status == HTTPStatus.UNAUTHORIZED:
        headers["WWW-Authenticate"] = "Bearer"
    if (retry_after_s := (problem.extra or {}).get("retryAfterS")) is not None:
        headers["Retry-After"] = str(retry_after_s)
    return _ProblemResponse(problem.body(), problem.status, headers)


class _ProblemResponse(JSONResponse):
    """Problem details, which may repeat what a client has sent: they can be written whatever that was."""

    media_type = "application/problem+json"

    def render(self, content: Any) -> bytes:
        try:
            return super().render(content)
        except ValueError:  # a lone surrogate, or a number that is not finite
            return super().render(_writable(content))


def _writable(content: Any) -> Any:
    if isinstance(content, Mapping):
        return {_writable(str(name)): _writable(value) for name, value in content.items()}
    if isinstance(content, list | tuple):
        return [_writable(value) for value in content]
    if isinstance(content, str):
        return content.encode("utf-8", "backslashreplace").decode()
    if isinstance(content, float) and not math.isfinite(content):
        return str(content)
    return content


async def _on_problem(connection: Request | WebSocket, error: Exception) -> Response | None:
    assert isinstance(error, Problem)  # noqa: S101 - Starlette calls us with what we registered for
    if isinstance(connection, WebSocket):
        await connection.close(_WEBSOCKET_CODES_FROM + error.status, error.title)
        return None
    response = problem_response(error)
    if error.status == HTTPStatus.METHOD_NOT_ALLOWED:
        response.headers["Allow"] = _methods_text(connection)
    return response


async def _on_http_exception(request: Request, error: Exception) -> Response | None:
    assert isinstance(error, HTTPException)  # noqa: S101
    if error.status_code == HTTPStatus.METHOD_NOT_ALLOWED:
        return await _on_problem(request, method_not_allowed(request))
    problem = Problem(error.status_code, HTTPStatus(error.status_code).phrase, str(error.detail))
    response = problem_response(problem)
    response.headers.update(error.headers or {})
    return response


def method_not_allowed(request: Request) -> Problem:
    """Return the refusal of the method of a request, with those of its path; Starlette names only some."""
    detail = f"{request.method} is no method of {request.url.path}; use {_methods_text(request)}"
    return Problem(405, HTTPStatus.METHOD_NOT_ALLOWED.phrase, detail)


def methods_of(request: Request) -> frozenset[str]:
    """Return the methods of the routes for the path of a request, as the OpenAPI document describes them.

    A path without parameters goes before others: `/rules/test` has not the methods of `/rules/{rule}`.
    Routes that are not described count where no other route has the path.
    """
    matching = [
        route
        for route in request.app.routes
        if isinstance(route, Route) and route.matches(request.scope)[0] is not Match.NONE
    ]
    described = [route for route in matching if route.include_in_schema] or matching
    exact = [route for route in described if not route.param_convertors] or described
    return frozenset(method for route in exact for method in route.methods or ())


def _methods_text(request: Request) -> str:
    return ", ".join(sorted(methods_of(request)))


async def _on_validation_error(_: Request, error: Exception) -> Response:
    assert isinstance(error, RequestValidationError)  # noqa: S101
    return problem_response(Problem(422, "Unprocessable Content", fault_text(error, most=MAX_FAULTS_LISTED)))


async def _on_disconnect(_: Request, __: Exception) -> Response:
    return Response(status_code=CLIENT_CLOSED_REQUEST)  # it is not sent, and it is no error of the service


async def _on_database_error(connection: Request | WebSocket, error: Exception) -> Response | None:
    """Answer 503 while the database is away, of which its engine writes one log line (`Outages`)."""
    assert isinstance(error, SQLAlchemyError)  # noqa: S101
    problem = outage_problem(error)
    if problem is None:
        raise error
    return await _on_problem(connection, problem)


async def _on_unexpected(request: Request, error: Exception) -> Response:
    log.error("request failed", path=request.url.path, exc_info=error)
    mark_logged(error)
    return problem_response(
        Problem(
            500, "Internal error", f"{type(error).__name__} while answering; the log of this service has more"
        )
    )
