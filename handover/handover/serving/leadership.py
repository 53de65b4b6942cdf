"""Leader election: of several replicas on one PostgreSQL database, one works and the others wait.

The leader holds the `DatabaseLock` of its service, a lock of its connection. The server releases it when the
connection ends: no clock is compared, and nothing expires while a leader lives. What must not happen twice is
written with `transaction`, on the connection that holds the lock, so that a replica that has lost it cannot
write any more. On SQLite there is one process, which always leads.

    leadership = Leadership(engine, "alert-router")
    async with leadership.led(work):   # enters `work` now, or when the leader has ended
        yield

`OnlyLeading` answers for a replica that waits, and `check` is its readiness.
"""

import asyncio
import threading
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import AbstractAsyncContextManager, asynccontextmanager, contextmanager, suppress
from typing import Final

from sqlalchemy import Connection, Engine, text
from sqlalchemy.exc import DBAPIError
from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Receive, Scope, Send

from handover.database import LOCK_POLL_S, DatabaseLock, LockLost
from handover.database.outage import RETRY_AFTER_S
from handover.errors import Problem
from handover.http.origin_guard import send_problem
from handover.runtime.retry import Backoff
from handover.security.guard import PUBLIC_PATHS, authenticated
from handover.telemetry import get_logger

log = get_logger(__name__)

CHECK_INTERVAL_S: Final = 1.0
NOTIFICATIONS: Final = "/notifications"
Work = Callable[[], AbstractAsyncContextManager[None]]
"""What the leader does while its context is open; it is entered again when the replica leads again."""


class Leadership:
    """Whether this replica of `service` leads."""

    def __init__(self, engine: Engine, service: str) -> None:
        self.service = service
        self.is_leading = False
        self._is_alone = engine.dialect.name == "sqlite"
        self._lock = DatabaseLock(engine, f"handover {service}")
        self._turn = threading.Lock()  # the lock of the database is not thread-safe
        self._has_ended = False

    @asynccontextmanager
    async def led(self, work: Work) -> AsyncIterator[None]:
        """Enter `work` while this replica leads; return at once if another one does.

        Raises what `work` raises when it is entered for the first time.
        """
        begun: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._has_ended = False
        task = asyncio.create_task(self._lead(work, begun))
        try:
            await begun
            yield
        finally:
            task.cancel()
            with suppress(asyncio.CancelledError):
                await task
            await asyncio.to_thread(self._end)

    async def check(self) -> None:
        """Raise an error, with the reason, while another replica leads."""
        if not self.is_leading:
            raise ConnectionError(
                f"standby: another {self.service} leads; this one takes over when that one ends"
            )

    @contextmanager
    def transaction(self) -> Iterator[Connection]:
        """Yield a connection within a transaction; raise `LockLost` if another replica leads."""
        with self._turn, self._lock.transaction() as connection:
            yield connection

    async def _lead(self, work: Work, begun: "asyncio.Future[None]") -> None:
        backoff = Backoff()
        while True:
            if not await asyncio.to_thread(self._acquire):
                if not begun.done():
                    begun.set_result(None)
                    log.info("standby: another replica leads", service=self.service)
                await asyncio.sleep(LOCK_POLL_S)
                continue
            try:
                async with work():
                    self.is_leading = True
                    log.info("this replica leads", service=self.service)
                    if not begun.done():
                        begun.set_result(None)
                    backoff.reset()
                    await self._until_lost()
                    log.error("the lock of the leader is lost", service=self.service)
            except Exception as error:
                if not begun.done():
                    begun.set_exception(error)
                    return
                log.exception("the work of the leader failed", service=self.service)
            finally:
                self.is_leading = False
                await asyncio.to_thread(self._release)
            await backoff.wait()

    async def _until_lost(self) -> None:
        if self._is_alone:
            await asyncio.Event().wait()
        while True:
            await asyncio.sleep(CHECK_INTERVAL_S)
            try:
                await asyncio.to_thread(self._probe)
            except (DBAPIError, LockLost):
                return

    def _acquire(self) -> bool:
        with self._turn:
            if self._has_ended:  # a cancelled task leaves its thread behind, which may come here late
                return False
            try:
                return self._lock.acquire()
            except DBAPIError:
                return False

    def _probe(self) -> None:
        with self.transaction() as connection:
            connection.execute(text("SELECT 1"))

    def _end(self) -> None:
        with self._turn:
            self._has_ended = True
            self._lock.release()

    def _release(self) -> None:
        with self._turn:
            self._lock.release()


class OnlyLeading:
    """ASGI middleware: a replica that waits answers 503 to known callers, except for its health."""

    def __init__(self, app: ASGIApp, leadership: Leadership) -> None:
        self._app = app
        self._leadership = leadership

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one ASGI connection."""
        if scope["type"] == "http" and scope["path"] not in PUBLIC_PATHS:
            try:
                await self._leadership.check()
            except ConnectionError as error:
                await send_problem(send, await _refusal(HTTPConnection(scope), str(error)))
                return
        await self._app(scope, receive, send)


async def _refusal(connection: HTTPConnection, why: str) -> Problem:
    """Return why a replica that waits does not answer; a stranger learns only to identify.

    A broker that notifies has a key instead of a token; it repeats the notification after 503.
    """
    try:
        if not connection.url.path.startswith(NOTIFICATIONS):
            await authenticated(connection)
    except Problem as problem:
        return problem
    return Problem(503, "Standby", why, extra={"retryAfterS": RETRY_AFTER_S})
