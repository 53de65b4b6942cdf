"""The database: SQLite in the data directory, or PostgreSQL by URL.

In both a committed transaction survives `kill -9` and a power cut.
"""

import sqlite3
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, Engine, create_engine, event, text
from sqlalchemy.engine import make_url
from sqlalchemy.exc import ArgumentError, DBAPIError, NoSuchModuleError
from sqlalchemy.pool import ConnectionPoolEntry

from handover.errors import HandoverError, UsageError
from handover.sqlite_files import prepare_own, stamp_of, unreleased_format

OPEN_ATTEMPTS = 100
OPEN_RETRY_S = 0.1
"""SQLite does not wait by itself while another process changes a new file to the write-ahead log."""
LOCK_POLL_S = 1.0
"""Pause between two attempts of a standby to get the lock."""
_KEEP_ALIVE = (
    "SET tcp_keepalives_idle = 3",
    "SET tcp_keepalives_interval = 2",
    "SET tcp_keepalives_count = 2",
)
"""The server releases the lock of a process whose machine has vanished within 7 s."""


class LockLost(HandoverError):
    """Another process writes the database now."""


class DatabaseLock:
    """The lock of the one process that writes a PostgreSQL database; others wait for it as standbys.

    Writes use the connection that holds the lock, so a process that has lost it cannot write. On SQLite there
    is no lock: nobody waits, and writes use the pool. Not thread-safe.
    """

    def __init__(self, engine: Engine, name: str) -> None:
        self._engine = engine
        self._name = name
        self._connection: Connection | None = None

    def wait(self) -> None:
        """Wait until this process holds the lock; raise `DBAPIError` if the database is unavailable."""
        while not self.acquire():
            time.sleep(LOCK_POLL_S)

    def acquire(self) -> bool:
        """Take the lock if nobody else holds it; return whether this process holds it now."""
        if self._engine.dialect.name == "sqlite" or self._connection is not None:
            return True
        connection = self._engine.connect()
        try:
            with connection.begin():
                for statement in _KEEP_ALIVE:
                    connection.execute(text(statement))
                is_locked = connection.execute(
                    text("SELECT pg_try_advisory_lock(hashtext(:name))"), {"name": self._name}
                ).scalar()
        except DBAPIError:
            connection.close()
            raise
        if not is_locked:
            connection.close()
            return False
        self._connection = connection
        return True

    @contextmanager
    def transaction(self) -> Iterator[Connection]:
        """Yield a connection within a transaction of the process that holds the lock.

        A connection that was lost is replaced; raises `LockLost` if another process has the lock then.
        """
        if self._engine.dialect.name == "sqlite":
            with self._engine.begin() as connection:
                yield connection
            return
        if self._connection is None and not self.acquire():
            raise LockLost(f"another process writes the database ({self._name})")
        assert self._connection is not None  # noqa: S101 - as `acquire` left it
        try:
            with self._connection.begin():
                yield self._connection
        except DBAPIError as error:
            if error.connection_invalidated:
                self._connection.close()
                self._connection = None
            raise

    def release(self) -> None:
        """Release the lock."""
        if self._connection is not None:
            self._connection.invalidate()  # closing it would return it to the pool, with the lock
            self._connection.close()
            self._connection = None


def connect(
    url: str,
    *,
    setting: str = "HANDOVER_DATABASE_URL",
    answers_within_s: float | None = None,
    is_own: bool = True,
) -> Engine:
    """Return an engine for `url` (`sqlite:///…` or `postgresql://…`), the value of `setting`.

    Raises `UsageError` for other URLs, when the database cannot be opened, or when a file is damaged or, if
    it is our own, was deleted or emptied. `answers_within_s` limits connecting and each statement of
    PostgreSQL.
    """
    try:
        parsed = make_url(url)
        if parsed.drivername in {"postgresql", "postgres"}:
            parsed = parsed.set(drivername="postgresql+psycopg")
        if parsed.get_backend_name() not in {"sqlite", "postgresql"}:
            raise UsageError(_unusable(url, setting))
        if parsed.get_backend_name() == "sqlite" and parsed.database and parsed.database != ":memory:":
            file = Path(parsed.database)
            file.parent.mkdir(parents=True, exist_ok=True)
            if is_own:
                _prepare(file, setting)
        is_server = parsed.get_backend_name() == "postgresql"
        limits = _limits(answers_within_s) if is_server and answers_within_s is not None else {}
        engine = create_engine(parsed, pool_pre_ping=is_server, connect_args=limits)
    except (ArgumentError, NoSuchModuleError):
        raise UsageError(_unusable(url, setting)) from None
    if engine.dialect.name == "sqlite":
        event.listen(engine, "connect", _make_durable)
    _close_late_ones(engine)
    try:
        _open(engine)
    except DBAPIError as error:
        reason = str(error.orig).strip().splitlines()[0]
        shown = parsed.render_as_string(hide_password=True)
        raise UsageError(
            f"the database {shown} cannot be used: {reason}; correct that or {setting}"
        ) from None
    return engine


def _close_late_ones(engine: Engine) -> None:
    """Close what is returned to the pool after `Engine.dispose`, which closes only what is in the pool then.

    A cancelled task leaves the thread behind that executes its statement.
    """
    is_disposed = threading.Event()
    event.listen(engine, "engine_disposed", lambda _: is_disposed.set())

    @event.listens_for(engine, "checkin")
    def close(_: Any, record: ConnectionPoolEntry) -> None:
        if is_disposed.is_set():
            record.invalidate()


def _open(engine: Engine) -> None:
    """Open a first connection; while another process creates the same SQLite file, wait for it."""
    for attempt in range(OPEN_ATTEMPTS):
        try:
            engine.connect().close()
        except DBAPIError as error:
            if "database is locked" not in str(error.orig) or attempt == OPEN_ATTEMPTS - 1:
                raise
            time.sleep(OPEN_RETRY_S)
        else:
            return


def _prepare(file: Path, setting: str) -> None:
    """Raise `UsageError` if a file of ours is damaged, unreleased or not usable; it is not changed then."""
    with suppress(sqlite3.Error):  # a damaged file is reported below
        if (unreleased := unreleased_format(file)) is not None:
            raise UsageError(
                f"the database {file} has {unreleased}, which was never released and which this release does "
                f"not read; move {file.name} and {stamp_of(file).name} to another folder, or name another "
                f"database with {setting}"
            )
    try:
        prepare_own(file)
    except UsageError as error:
        raise UsageError(f"{error}; or name another database with {setting}") from None
    except (sqlite3.Error, OSError) as error:
        raise UsageError(f"the database {file} cannot be used: {error}; correct that or {setting}") from None


def _limits(seconds: float) -> dict[str, Any]:
    return {
        "connect_timeout": max(round(seconds), 2),
        "options": f"-c statement_timeout={round(seconds * 1000)}",
    }


def _unusable(url: str, setting: str) -> str:
    kind = url.split(":", 1)[0]
    return f'a database URL starts with sqlite:/// or postgresql://, not "{kind}"; correct {setting}'


def _make_durable(connection: Any, _: Any) -> None:
    cursor = connection.cursor()
    for pragma in ("journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON", "busy_timeout=5000"):
        cursor.execute(f"PRAGMA {pragma}")
    cursor.close()
