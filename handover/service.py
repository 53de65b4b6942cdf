"""A service: a FastAPI application with the rooms that every one has, and the way it is run.

`create_app` adds `/healthz` (the process lives), `/readyz` (what it depends on answers), `/metrics`
(Prometheus), `/context.jsonld` (our @context, so that any broker can fetch it) and problem details for
every error. `run` serves it until SIGTERM or Ctrl-C.
"""

import os
import signal
import sys
import threading
from collections.abc import Awaitable, Callable, Mapping
from contextlib import suppress
from http import HTTPStatus
from typing import TypeVar

import uvicorn
from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from prometheus_client import CONTENT_TYPE_LATEST, generate_latest
from starlette.exceptions import HTTPException
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Lifespan, Message, Receive, Scope, Send

from handover.errors import Problem, UsageError
from handover.ports import require_free
from handover.settings import LIFELINE, PREFIX, Settings
from handover.telemetry import get_logger, set_up_logging

log = get_logger(__name__)

Check = Callable[[], Awaitable[None]]
"""A readiness probe: returns when the thing answers, raises (with a sentence) when it does not."""


def create_app(
    title: str,
    *,
    description: str,
    lifespan: Lifespan[FastAPI] | None = None,
    checks: Mapping[str, Check] | None = None,
) -> FastAPI:
    """Return a FastAPI application with health, metrics and problem details in place.

    `checks` names what the service cannot work without; each is awaited by `/readyz`.
    """
    app = FastAPI(title=title, description=description, lifespan=lifespan)
    add_operations(app, checks or {})
    app.add_exception_handler(Problem, _on_problem)
    app.add_exception_handler(HTTPException, _on_http_exception)
    app.add_exception_handler(RequestValidationError, _on_validation_error)
    app.add_exception_handler(Exception, _on_unexpected)
    return app


def add_operations(app: FastAPI, checks: Mapping[str, Check]) -> None:
    """Add the routes that operators and orchestrating platforms expect of every service."""

    @app.get("/healthz", tags=["operations"])
    async def healthz() -> dict[str, str]:
        """Say that the process lives."""
        return {"status": "ok"}

    @app.get("/readyz", tags=["operations"])
    async def readyz() -> Response:
        """Say whether everything the service depends on answers: 200, or 503 with what does not."""
        failures: dict[str, str] = {}
        for name, check in checks.items():
            try:
                await check()
            except Exception as error:  # noqa: BLE001 - any failure of a probe is its answer
                failures[name] = str(error) or type(error).__name__
        status = HTTPStatus.SERVICE_UNAVAILABLE if failures else HTTPStatus.OK
        return JSONResponse({"status": "not ready" if failures else "ready", **failures}, status)

    @app.get("/metrics", tags=["operations"])
    async def metrics() -> Response:
        """Return the metrics of this process in the Prometheus text format."""
        return Response(generate_latest(), media_type=CONTENT_TYPE_LATEST)

    @app.get("/context.jsonld", tags=["operations"])
    async def context() -> Response:
        """Return our @context."""
        from datamodels.contexts import handover_context  # noqa: PLC0415 - read only when somebody asks

        return JSONResponse(handover_context(), media_type="application/ld+json")


def problem_response(problem: Problem) -> JSONResponse:
    """Return `problem` as an `application/problem+json` answer."""
    return JSONResponse(problem.body(), problem.status, media_type="application/problem+json")


async def _on_problem(_: Request, error: Exception) -> Response:
    assert isinstance(error, Problem)  # noqa: S101 - Starlette calls us with what we registered for
    return problem_response(error)


async def _on_http_exception(_: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)  # noqa: S101
    return problem_response(
        Problem(error.status_code, HTTPStatus(error.status_code).phrase, str(error.detail))
    )


async def _on_validation_error(_: Request, error: Exception) -> Response:
    assert isinstance(error, RequestValidationError)  # noqa: S101
    faults = [f"{'.'.join(str(part) for part in fault['loc'])}: {fault['msg']}" for fault in error.errors()]
    return problem_response(Problem(422, "Unprocessable Content", "; ".join(faults)))


async def _on_unexpected(request: Request, error: Exception) -> Response:
    log.error("request failed", path=request.url.path, exc_info=error)
    return problem_response(
        Problem(
            500, "Internal error", f"{type(error).__name__} while answering; the log of this service has more"
        )
    )


KEEP_ALIVE_S = 75
"""Longer than clients keep idle connections (httpx: 5 s), so that they never write to one that is closing."""

SomeSettings = TypeVar("SomeSettings", bound=Settings)


def run(
    service: str,
    make_app: Callable[[SomeSettings], ASGIApp],
    settings_class: type[SomeSettings],
    *,
    port_field: str,
) -> None:
    """Run a service until it is told to stop; `port_field` is the setting that says where it listens.

    Exits with 2 and one line when it cannot start as it is set.
    """
    try:
        settings = settings_class.load()
    except UsageError as error:
        raise SystemExit(_in_one_line(service, error)) from None
    serve(
        lambda: make_app(settings),
        settings,
        service=service,
        port=getattr(settings, port_field),
        port_setting=f"{PREFIX}{port_field}".upper(),
    )


def serve(
    make_app: Callable[[], ASGIApp], settings: Settings, *, service: str, port: int, port_setting: str
) -> None:
    """Serve what `make_app` makes on `port` until told to stop; exits as `run` does."""
    try:
        set_up_logging(settings, service)
        require_free(settings.host, port, port_setting, say=log.warning)
        settings.data_dir.mkdir(parents=True, exist_ok=True)
        made = make_app()
        application = _SaysWhy(made)
    except (UsageError, OSError) as error:
        raise SystemExit(_in_one_line(service, error)) from None
    if os.environ.get(LIFELINE):
        threading.Thread(target=_end_with_parent, daemon=True).start()
    server = uvicorn.Server(
        uvicorn.Config(
            application,
            host=settings.host,
            port=port,
            log_config=None,
            access_log=False,
            timeout_graceful_shutdown=1,
            timeout_keep_alive=KEEP_ALIVE_S,
            server_header=False,
            http=getattr(made, "protocol", "auto"),  # an application may bring a shorter way in
        )
    )
    try:
        with suppress(KeyboardInterrupt):  # Ctrl-C has stopped it in good order by now
            server.run()
    except SystemExit:  # so it ends when the start has failed, and would take the reason along
        if application.why is None:
            raise
    if application.why is not None:
        raise SystemExit(_in_one_line(service, application.why))
    if not server.started:
        raise SystemExit(1)


class _SaysWhy:
    """Keeps what makes the start fail, if it is for a person to mend, from being told as a traceback."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app
        self.why: UsageError | None = None

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "lifespan":
            await self._app(scope, receive, send)
            return
        failure: Message | None = None

        async def hold_failure(message: Message) -> None:
            nonlocal failure
            if message["type"] == "lifespan.startup.failed":
                failure = message
            else:
                await send(message)

        try:
            await self._app(scope, receive, hold_failure)
        except UsageError as error:
            self.why = error
            await send({"type": "lifespan.startup.failed", "message": ""})
        except BaseException:
            if failure is not None:
                await send(failure)
            raise


def _in_one_line(service: str, error: Exception) -> int:
    print(f"{service}: {error}", file=sys.stderr)  # noqa: T201 - the one line a person reads
    return 2


def _end_with_parent() -> None:
    while sys.stdin.buffer.read(4096):
        pass
    os.kill(os.getpid(), signal.SIGTERM)
