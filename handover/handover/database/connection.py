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
from weakref import WeakKeyDictionary

from sqlalchemy import Connection, Engine, create_engine, event, text
from sqlalchemy.engine import make_url
from sqlalchemy.exc import ArgumentError, DBAPIError, NoSuchModuleError
from sqlalchemy.pool import ConnectionPoolEntry

from handover.database.outage import Outages, database_reason
from handover.database.sqlite_files import prepare_own, unreleased_format
from handover.database.sqlite_integrity.checkpoints import Checkpoints, CountedConnection, make_durable
from handover.database.sqlite_integrity.reserve import with_reserve
from handover.database.sqlite_integrity.stamp import stamp_of
from handover.errors import HandoverError, UsageError
from handover.files.folder_lock import lock_own
from handover.network.tls_trust import postgresql_remedy

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

    A service locks a file of its own until it ends (`folder_lock`). Raises `UsageError` for other URLs, when
    the database cannot be opened, when another process holds its file, or when a file is damaged or, if it
    is our own, was deleted or emptied. `answers_within_s` limits connecting and each statement of PostgreSQL.
    """
    try:
        parsed = make_url(url)
        if parsed.drivername in {"postgresql", "postgres"}:
            parsed = parsed.set(drivername="postgresql+psycopg")
        if parsed.get_backend_name() not in {"sqlite", "postgresql"}:
            raise UsageError(_unusable(url, setting))
        if parsed.get_backend_name() == "postgresql":
            limits = {} if answers_within_s is None else _limits(answers_within_s)
            engine = create_engine(parsed, pool_pre_ping=True, connect_args=limits)
        else:
            engine = create_engine(parsed, connect_args={"factory": CountedConnection})
            event.listen(engine, "connect", lambda connection, _: make_durable(connection))
    except (ArgumentError, NoSuchModuleError):
        raise UsageError(_unusable(url, setting)) from None
    _close_late_ones(engine)
    if engine.dialect.name == "postgresql":
        Outages(engine)
    try:
        if engine.dialect.name == "sqlite" and parsed.database not in {None, "", ":memory:"}:
            file = Path(str(parsed.database))
            file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            if is_own:
                lock_own(file)
                _refuse_unreleased(file)
                with_reserve(file, lambda: _open_own(engine, file))
        _open(engine)
    except (DBAPIError, sqlite3.Error, OSError) as error:
        engine.dispose()
        reason = database_reason(error)
        reason += postgresql_remedy(reason)
        shown = parsed.render_as_string(hide_password=True)
        raise UsageError(
            f"the database {shown} cannot be used: {reason}; correct that or {setting}"
        ) from None
    except UsageError as error:
        engine.dispose()
        raise UsageError(f"{error}; or name another database with {setting}") from None
    return engine


def purge_log(engine: Engine) -> None:
    """Remove deleted data from the write-ahead log of a SQLite file too; other databases have none.

    A transaction with `secure_delete` has removed them from the pages before.
    """
    if (checkpoints := _CHECKPOINTS.get(engine)) is not None:
        checkpoints.purge()


_CHECKPOINTS: "WeakKeyDictionary[Engine, Checkpoints]" = WeakKeyDictionary()


def _open_own(engine: Engine, file: Path) -> None:
    """Check a SQLite file of ours, count its commits and checkpoint it, until the engine is disposed."""
    prepare_own(file)
    _CHECKPOINTS[engine] = Checkpoints(file)
    opening = threading.Lock()

    @event.listens_for(engine, "connect")
    def count(connection: CountedConnection, _: Any) -> None:
        with opening:
            if _CHECKPOINTS[engine].is_closed:  # an engine may be used after `dispose`
                _CHECKPOINTS[engine] = Checkpoints(file)
            _CHECKPOINTS[engine].count(connection)

    event.listen(engine, "engine_disposed", lambda _: _CHECKPOINTS[engine].close())


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


def _refuse_unreleased(file: Path) -> None:
    with suppress(sqlite3.Error):  # a damaged file is reported later
        if (unreleased := unreleased_format(file)) is not None:
            raise UsageError(
                f"the database {file} has {unreleased}, which was never released and which this release does "
                f"not read; move {file.name} and {stamp_of(file).name} to another folder"
            )


def _limits(seconds: float) -> dict[str, Any]:
    return {
        "connect_timeout": max(round(seconds), 2),
        "options": f"-c statement_timeout={round(seconds * 1000)}",
    }


def _unusable(url: str, setting: str) -> str:
    kind = url.split(":", 1)[0]
    return f'a database URL starts with sqlite:/// or postgresql://, not "{kind}"; correct {setting}'
