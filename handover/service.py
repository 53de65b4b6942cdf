"""A service: a FastAPI application with the rooms that every one has. (`serving.py` runs it.)

`create_app` adds `/healthz` (the process lives), `/readyz` (what it depends on answers), `/metrics`
(Prometheus), `/context.jsonld` (our @context, so that any broker can fetch it) and problem details for
every error.
"""

from collections.abc import Awaitable, Callable, Mapping
from http import HTTPStatus

from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from prometheus_client import CONTENT_TYPE_LATEST, generate_latest
from starlette.exceptions import HTTPException
from starlette.responses import JSONResponse
from starlette.types import Lifespan

from handover.errors import Problem
from handover.telemetry import get_logger

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
