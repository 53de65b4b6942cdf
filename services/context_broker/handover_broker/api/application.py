"""The broker as an application: NGSI-LD under /ngsi-ld/v1 in plain ASGI, health and metrics beside it.

One broker writes a database. On PostgreSQL another one may be started on the same database as a standby: it
waits for the lock, and answers NGSI-LD requests with 503. With the lock it loads the database and serves. A
broker that lost its connection becomes a standby if another one has taken over meanwhile.
"""

import asyncio
import random
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from importlib import import_module
from pathlib import Path
from shutil import disk_usage
from typing import TYPE_CHECKING, Any, Final, Protocol

from prometheus_client import Gauge
from starlette.types import ASGIApp, Receive, Scope, Send

from handover.errors import Problem, UsageError
from handover.serving.storage import require_storage
from handover.telemetry import get_logger
from handover_broker.api.description import paths_of
from handover_broker.api.http_protocol import BrokerProtocol
from handover_broker.model.problems import is_standby, went_wrong
from handover_broker.request.request_context import (
    PREFIX,
    Disconnected,
    Request,
    Response,
    of_tenant,
    problem_response,
    send_response,
)
from handover_broker.request.routing import Router
from handover_broker.storage.journal import Journal, NotStored

if TYPE_CHECKING:
    from fastapi import FastAPI
    from sqlalchemy import Connection

    from handover.security.audit import AuditLog
    from handover.security.audit_trail import AuditTrail
    from handover.security.authentication import Guard
    from handover.security.caller import Caller
    from handover.serving.service import Check

log = get_logger(__name__)

CHECK_INTERVAL_S: Final = 1.0
"""How often the connection to the database is checked, and how long a failed takeover pauses."""
STANDBY = Gauge("handover_broker_standby", "1 while another broker writes the database and this one waits")


class ServedBroker(Protocol):
    """What the application needs of a broker."""

    journal: Journal
    router: Router
    guard: "Guard"
    audit: "AuditTrail"

    async def start(self) -> None:
        """Load the database and serve."""

    async def stop(self) -> None:
        """Commit what is pending, and close the database."""

    async def answer(self, request: Request, body: bytes | Receive) -> Response:
        """Return the response to a request, whose body is there or still to be received."""


class BrokerApplication:
    """The broker as an ASGI application; `protocol` lets its server call it without ASGI.

    `open_broker` returns a broker on its database. It is called again when another broker has taken over.
    """

    def __init__(
        self, open_broker: Callable[[], ServedBroker], data_dir: Path, *, over_asgi: bool = False
    ) -> None:
        self._open_broker = open_broker
        self._data_dir = data_dir
        self._broker: ServedBroker
        self._is_serving = False
        self._standby_reason = ""
        self._checks: Mapping[str, Check] = {"database": self._check_database, "storage": self._check_storage}
        self._rest: FastAPI | None = None
        self.protocol = None if over_asgi else partial(BrokerProtocol, handler=self.answer)

    def open(self) -> None:
        """Open the database. Raises `UsageError` when it cannot be used."""
        self._broker = self._open_broker()
        self._standby_reason = f"another broker writes {self._broker.journal.name}"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle a request over ASGI, or the lifespan."""
        if scope["type"] == "lifespan":
            await self._live(receive, send)
        elif scope["type"] != "http" or not scope["path"].startswith(PREFIX):
            await (await self._others())(scope, receive, send)
        elif (answer := await self.answer(Request.of_scope(scope), receive)) is not None:
            await send_response(send, answer)

    async def _live(self, receive: Receive, send: Send) -> None:
        await receive()
        try:
            if await asyncio.to_thread(self._broker.journal.try_lock):
                await self._serve()
        except BaseException as error:
            await asyncio.to_thread(self._broker.journal.close)
            await send({"type": "lifespan.startup.failed", "message": str(error)})
            raise
        supervision = asyncio.get_running_loop().create_task(self._supervise())
        await send({"type": "lifespan.startup.complete"})
        await receive()
        if not self._is_serving:  # ends a wait for the lock, which runs in a thread
            await asyncio.to_thread(self._broker.journal.close)
        supervision.cancel()
        with suppress(asyncio.CancelledError):
            await supervision
        if self._is_serving:
            await self._broker.stop()
        await send({"type": "lifespan.shutdown.complete"})

    async def _serve(self) -> None:
        await self._broker.start()
        self._is_serving = True
        STANDBY.set(0)

    async def _supervise(self) -> None:
        """Take over when the lock is free, stand by when it is lost."""
        while not self._broker.journal.is_on_disk:
            if not self._is_serving:
                await self._stand_by()
            await asyncio.sleep(CHECK_INTERVAL_S)
            journal = self._broker.journal
            await asyncio.to_thread(journal.check_connection)
            if journal.lost is not None:
                log.error("another broker has taken over", database=journal.name, reason=journal.lost)
                self._is_serving = False
                await self._broker.stop()

    async def _stand_by(self) -> None:
        """Return once this broker has the lock, has loaded the database and serves."""
        STANDBY.set(1)
        log.info("standby: waiting for the lock of the database", database=self._broker.journal.name)
        while True:
            try:
                if self._broker.journal.is_closed:
                    await asyncio.to_thread(self.open)
                if await asyncio.to_thread(self._broker.journal.wait_for_lock):
                    log.info("took over the database", database=self._broker.journal.name)
                    await self._serve()
                    return
            except (NotStored, UsageError) as error:
                await self._fail_takeover(error)
            except Exception as error:
                log.exception("taking over the database failed")
                await self._fail_takeover(error)
            await asyncio.sleep(CHECK_INTERVAL_S * random.uniform(0.5, 1.0))  # noqa: S311 - jitter

    async def _fail_takeover(self, error: Exception) -> None:
        self._standby_reason = str(error)
        log.warning("cannot take over the database", error=str(error))
        await asyncio.to_thread(self._broker.journal.close)

    async def _others(self) -> ASGIApp:
        """Return the application for everything but NGSI-LD: health, metrics and the like."""
        if self._rest is None:
            # Importing the web framework takes a quarter of the start; NGSI-LD does not need it.
            service = await asyncio.to_thread(import_module, "handover.serving.service")
            self._rest = service.create_app(
                "Context broker",
                description="An NGSI-LD broker (ETSI GS CIM 009). NGSI-LD itself is under /ngsi-ld/v1.",
                checks=self._checks,
            )
            self._rest.state.audit = None
            service.add_audit_routes(self._rest, _PresentAudit(self))
            self._rest.openapi()["paths"] |= paths_of(self._broker.router.operations)
        self._rest.state.guard = self._broker.guard
        return self._rest

    def audit(self) -> "AuditTrail":
        """Return the audit trail of this broker. Raises `Problem` 503 while it is a standby."""
        if not self._is_serving:
            raise is_standby(self._standby_reason)
        return self._broker.audit

    async def answer(self, request: Request, body: bytes | Receive) -> Response | None:
        """Return the response to an NGSI-LD request; None if the client has disconnected."""
        try:
            if self._is_serving:
                return await self._broker.answer(request, body)
            return of_tenant(request, problem_response(is_standby(self._standby_reason)))
        except Problem as problem:
            return of_tenant(request, problem_response(problem))
        except Disconnected:
            return None
        except Exception as error:  # an unexpected error must not close the connection without a response
            log.exception("request failed", method=request.method, path=request.path)
            return of_tenant(request, problem_response(went_wrong(error, "answering")))

    async def _check_database(self) -> None:
        """Raise an error, with the reason, unless this broker serves and can write its database."""
        if not self._is_serving:
            raise ConnectionError(f"standby: {self._standby_reason}; this one takes over when that one ends")
        if (reason := self._broker.journal.unreachable) is not None:
            raise ConnectionError(f"{reason}; reads are answered, changes are refused with 507")

    async def _check_storage(self) -> None:
        """Raise an error with the reason while the disk refuses what is committed, or soon may."""
        if not self._broker.journal.is_on_disk:
            return
        try:
            self._broker.journal.require_space()
        except NotStored as error:
            free = disk_usage(self._data_dir).free
            raise NotStored(f"{self._data_dir} ({free} bytes free) does not take changes: {error}") from error
        require_storage(self._data_dir)


class _PresentAudit:
    """The audit log of the broker that serves now, for the routes of all audit logs."""

    def __init__(self, application: BrokerApplication) -> None:
        self._application = application

    @property
    def service(self) -> str:
        return self._application.audit().service

    @property
    def log(self) -> "AuditLog":
        return self._application.audit().log

    async def read(self, function: Callable[["Connection"], Any], /) -> Any:
        return await self._application.audit().read(function)

    async def record(self, caller: "Caller", action: str, resource: str, /) -> None:
        await self._application.audit().record(caller, action, resource)
