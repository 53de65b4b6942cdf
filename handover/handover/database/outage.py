"""A database that is away: which errors mean it, 503 for the requests, and one log line at each change.

A PostgreSQL server that restarts, a full disk and a lock that is not released are states of the outside: the
same request may succeed later. A statement that the database refuses for what it says is a fault of ours.
"""

import asyncio
import math
import sqlite3
import time
from collections.abc import Awaitable, Callable
from threading import Lock
from typing import Any, Final, ParamSpec, TypeVar

from sqlalchemy import Engine, event
from sqlalchemy.engine import ExceptionContext
from sqlalchemy.exc import DBAPIError, SQLAlchemyError
from sqlalchemy.exc import TimeoutError as NoConnectionFree
from sqlalchemy.pool import ConnectionPoolEntry

from handover.database.sqlite_files import is_outside
from handover.errors import ChangeMade, Problem
from handover.messages import message
from handover.telemetry import get_logger

log = get_logger(__name__)

P = ParamSpec("P")
T = TypeVar("T")

RETRY_AFTER_S: Final = 2
_MADE_S: Final = "handover_made_s"


def database_reason(error: BaseException) -> str:
    """Return why the database refused, as one line."""
    lines = str(getattr(error, "orig", None) or error).strip().splitlines()
    return lines[0] if lines else type(error).__name__


def is_outage(error: BaseException) -> bool:
    """Return whether the database cannot be used now; False if it was used wrongly."""
    if isinstance(error, NoConnectionFree):
        return True
    if isinstance(error, DBAPIError):
        if error.connection_invalidated:
            return True
        error = error.orig or error
    if isinstance(error, sqlite3.Error):
        return is_outside(error)
    # psycopg's, by the names of PEP 249, since it is loaded only where PostgreSQL is used
    return any(kind.__name__ in {"OperationalError", "InterfaceError"} for kind in type(error).__mro__)


def outage_problem(error: SQLAlchemyError) -> Problem | None:
    """Return the response to a request that met `error`; None unless that is an outage.

    A connection that breaks during a commit leaves open whether the server has carried it out.
    """
    if not is_outage(error):
        return None
    if isinstance(error, DBAPIError) and error.connection_invalidated:
        detail = message(
            "service.database_lost",
            "the connection to the database broke ({reason}); see whether the change was made, and try again",
            reason=database_reason(error),
        )
    else:
        detail = message(
            "service.database_unavailable",
            "nothing was changed: the database cannot be used now ({reason}); try again",
            reason=database_reason(error),
        )
    return Problem(503, "Database unavailable", detail, extra={"retryAfterS": RETRY_AFTER_S})


async def in_database(function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
    """Return the result of `function`, called in a thread. Raises `Problem` 503 if the database is away."""
    try:
        return await asyncio.to_thread(function, *args, **kwargs)
    except SQLAlchemyError as error:
        if (problem := outage_problem(error)) is not None:
            raise problem from error
        raise


async def shown_after_change(view: Awaitable[T]) -> T:
    """Return `view`, which reads what a change has made.

    Raises `ChangeMade` 504 if the database is away by now: 503 would say that nothing was changed.
    """
    try:
        return await view
    except SQLAlchemyError as error:
        if not is_outage(error):
            raise
        detail = message(
            "service.change_made",
            "the change was made, and cannot be shown: the database cannot be used now ({reason}); look "
            "again later, and do not repeat it",
            reason=database_reason(error),
        )
        raise ChangeMade(504, "Changed, not shown", detail) from error


def _made_s(context: ExceptionContext) -> float:
    """Return when the connection that has failed was made."""
    try:
        return float(context.connection.info[_MADE_S]) if context.connection is not None else math.inf
    except (SQLAlchemyError, KeyError):
        return math.inf


class Outages:
    """Logs when the PostgreSQL server of `engine` goes and when it is back. Thread-safe."""

    def __init__(self, engine: Engine) -> None:
        self._database = engine.url.render_as_string(hide_password=True)
        self._lock = Lock()
        self._count = 0
        self._since_s: float | None = None
        self._available_s = 0.0
        """When it was back the last time."""
        event.listen(engine, "handle_error", self._failed)
        event.listen(engine, "connect", self._connected)

    def _failed(self, context: ExceptionContext) -> None:
        error = context.sqlalchemy_exception or context.original_exception
        is_refused = context.connection is None
        if not (context.is_disconnect or is_refused) or not is_outage(error):
            return
        with self._lock:
            if self._since_s is not None or _made_s(context) < self._available_s:
                return  # a connection that was not used since notices the same outage late
            self._since_s = time.monotonic()
            self._count += 1
        log.error(
            "database unavailable", database=self._database, nth=self._count, error=database_reason(error)
        )

    def _connected(self, _: Any, record: ConnectionPoolEntry) -> None:
        record.info[_MADE_S] = time.monotonic()
        with self._lock:
            since_s, self._since_s = self._since_s, None
            if since_s is not None:
                self._available_s = record.info[_MADE_S]
        if since_s is not None:
            seconds = round(time.monotonic() - since_s, 1)
            log.warning("database available again", database=self._database, nth=self._count, after_s=seconds)
