"""The broker's database on a PostgreSQL server. One broker writes it, others wait for its lock.

The connection that writes holds an advisory lock for as long as it lives. The server releases the lock when
that connection ends, however it ended, and not before its last transaction is decided. The row in `writer`
names the process that holds the lock and counts its transactions:

- A process that lost its connection takes the lock again. It continues only if the row is as it left it;
  otherwise another broker has written, and its own memory is out of date (`lost`).
- When the connection breaks during COMMIT, the counter says whether the transaction was stored.

Statements are sent in a pipeline: a commit costs one round trip for each query whose result it needs.
"""

import re
import selectors
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import urlsplit
from uuid import uuid4

from handover.errors import UsageError
from handover.network.tls_trust import postgresql_remedy
from handover.telemetry import get_logger
from handover_broker.storage.database import DatabaseAway, NotStored, Row

if TYPE_CHECKING:
    import psycopg

log = get_logger(__name__)

CONNECT_TIMEOUT_S: Final = 5
RECONNECT_INTERVAL_S: Final = 0.25
"""Minimum time between two attempts to connect for writing."""
COMMIT_LOOKUP_TIMEOUT_S: Final = 10.0
"""How long the result of a COMMIT is looked up whose answer was lost."""
LOCK_WAIT_S: Final = 5
"""How long a standby waits for the lock before it looks whether it has to stop."""
MAX_SPARE_READERS: Final = 4
"""Connections for reading that are kept open; more are opened while more queries run at once."""
SCAN_ROWS: Final = 5000
"""Rows fetched at a time from a query whose result may not fit into memory."""
_SESSION_OPTIONS: Final = (
    "-c synchronous_commit=on -c lock_timeout=20s -c idle_in_transaction_session_timeout=10s "
    "-c tcp_keepalives_idle=5 -c tcp_keepalives_interval=2 -c tcp_keepalives_count=3"
)
"""Commits are durable when acknowledged; a process that has vanished loses its lock within 11 s."""
SCHEMA: Final = "context_broker"
"""Schema of the tables, unless the URL sets a search_path."""
_SETUP_LOCK: Final = "SELECT pg_advisory_xact_lock(hashtext('handover context broker'))"
_LOCK_KEY: Final = "hashtext('handover context broker ' || current_schema()), 1"
TRY_LOCK: Final = f"SELECT pg_try_advisory_lock({_LOCK_KEY})"
WAIT_FOR_LOCK: Final = f"SELECT pg_advisory_lock({_LOCK_KEY})"
_SETUP: Final = """
    CREATE TABLE format (version BIGINT NOT NULL);
    CREATE TABLE writer (process TEXT NOT NULL, commits BIGINT NOT NULL);
    INSERT INTO writer VALUES ('', 0);
"""


class PostgresDatabase:
    """A database on a server; a connection that breaks refuses what it carried, and the next is a new one.

    Transactions come from one thread at a time; `check_connection` may be called from any.
    """

    TYPES: Final = {"bytes": "BYTEA", "number": "DOUBLE PRECISION", "keyed": ""}

    def __init__(self, url: str) -> None:
        self.url = url
        self.name = shown_url(url)
        self.lost: str | None = None
        """Why this process may not write any more: another broker has written the database."""
        self.unreachable: str | None = None
        """Why the database could not be reached the last time."""
        self._process = uuid4().hex
        self._commits = 0
        self._version = 0
        self._writer: psycopg.Connection | None = None
        self._writer_lock = threading.RLock()
        self._waiting: psycopg.Connection | None = None
        self._is_closed = False
        self._not_before_s = 0.0
        self._readers: list[psycopg.Connection] = []
        self._readers_lock = threading.Lock()

    def open(self, version: int, script: str) -> None:
        """Make the tables with `script` where there are none; refuse those of another version."""
        import psycopg  # noqa: PLC0415 - takes time to load, and most brokers use SQLite

        self._version = version
        try:
            with self.connected() as connection, connection.transaction():
                connection.execute(_SETUP_LOCK)
                if "search_path" not in _options_in(self.url):
                    connection.execute(f"CREATE SCHEMA IF NOT EXISTS {SCHEMA}")
                if self._is_new(connection):
                    connection.execute(_SETUP)
                    connection.execute("INSERT INTO format VALUES (%s)", (version,))
                    connection.execute(_in_postgres_sql(script, self.TYPES))
        except psycopg.Error as error:
            reason = _in_one_line(error)
            raise UsageError(
                f"the broker cannot use {self.name}: {reason}{postgresql_remedy(reason)}; "
                "correct that or HANDOVER_BROKER_DATABASE_URL"
            ) from None

    def _is_new(self, connection: "psycopg.Connection") -> bool:
        """Return whether there are no tables yet. Raises `UsageError` for tables of another version."""
        if _one(connection, "SELECT to_regclass('schema_version')") is not None:
            raise UsageError(
                f"{self.name} has tables of a version before the first release, which this one cannot read; "
                f"give the broker another database or schema, or drop the schema {SCHEMA} to start empty"
            )
        if _one(connection, "SELECT to_regclass('format')") is None:
            return True
        version = _one(connection, "SELECT max(version) FROM format")
        if version != self._version:
            raise UsageError(
                f"{self.name} has tables of format {version}, and this version of Handover reads "
                f"{self._version}; use the version that wrote them"
            )
        return False

    # The lock of the one that writes

    def try_lock(self) -> bool:
        """Become the broker that writes the database, if there is no other. Raises `NotStored`."""
        return self._lock(is_patient=False)

    def wait_for_lock(self) -> bool:
        """Wait until this is the broker that writes the database; `close` ends the wait with False."""
        return self._lock(is_patient=True)

    def _lock(self, *, is_patient: bool) -> bool:
        import psycopg  # noqa: PLC0415 - as above

        connection: psycopg.Connection | None = None
        try:
            connection = self._waiting = self.connected()
            while not self._is_locked_on(connection, is_patient=is_patient):
                if not is_patient or self._is_closed:
                    connection.close()
                    return False
            self._require_version(connection)
            with self._writer_lock:
                if self._is_closed:  # meanwhile; `close` knows only the connections from before
                    connection.close()
                    return False
                connection.execute("UPDATE writer SET process = %s, commits = 0", (self._process,))
                self._writer, self._commits = connection, 0
        except psycopg.Error as error:
            if connection is not None:
                connection.close()
            if self._is_closed:
                return False
            raise _refused_with(error, f"{self.name}: {_in_one_line(error)}") from error
        except NotStored:
            if connection is not None:
                connection.close()
            raise
        finally:
            self._waiting = None
        return True

    @staticmethod
    def _is_locked_on(connection: "psycopg.Connection", *, is_patient: bool) -> bool:
        import psycopg  # noqa: PLC0415 - as above

        if not is_patient:
            return bool(_one(connection, TRY_LOCK))
        try:
            connection.execute(f"SET lock_timeout = '{LOCK_WAIT_S}s'")
            connection.execute(WAIT_FOR_LOCK)
            connection.execute("RESET lock_timeout")
        except psycopg.errors.LockNotAvailable:
            return False
        return True

    def check_connection(self) -> None:
        """Connect and lock again if the connection that writes has ended; note what is wrong, if anything."""
        with self._writer_lock:
            if self._is_closed or self.lost is not None:
                return
            try:
                self._connected()
            except NotStored:
                return  # noted in `unreachable` or `lost`

    @contextmanager
    def transaction(self) -> Iterator["_PostgresWriter"]:
        """Write all that is run inside, or nothing. Raises `NotStored`."""
        import psycopg  # noqa: PLC0415 - as above

        with self._writer_lock:
            is_committing = False
            try:
                connection = self._connected()
                with connection.pipeline():
                    connection.execute("BEGIN")
                    connection.execute("UPDATE writer SET commits = commits + 1")
                    yield _PostgresWriter(connection)
                    is_committing = True
                    connection.execute("COMMIT")
            except psycopg.Error as error:
                is_alive = self._roll_back()
                if is_alive or not (is_committing and self._was_committed()):
                    raise _refused_with(error, f"{self.name}: {_in_one_line(error)}") from error
            except BaseException:
                self._roll_back()
                raise
            self._commits += 1

    def _roll_back(self) -> bool:
        """Return whether the connection that writes, and so the lock, survives the end of its transaction."""
        try:
            if self._writer is not None and not self._writer.closed:
                self._writer.rollback()
                return True
        except Exception as error:  # noqa: BLE001 - whatever it is, the next connection is a new one
            log.info("the connection that writes is closed", database=self.name, error=_in_one_line(error))
        self._drop_writer()
        return False

    def _was_committed(self) -> bool:
        """Return whether a transaction was stored during whose COMMIT the connection broke.

        Raises `NotStored` if that cannot be looked up in time. If the transaction turns out later to have
        been stored, `_reconnected` finds one commit too many, and this process may not write any more.
        """
        deadline_s = time.monotonic() + COMMIT_LOOKUP_TIMEOUT_S
        while True:
            try:
                self._writer, commits = self._reconnected((self._commits, self._commits + 1))
            except NotStored:
                if self.lost is not None or self._is_closed or time.monotonic() > deadline_s:
                    raise
            else:
                return commits > self._commits

    def read(self, statement: str, parameters: Sequence[Any] = ()) -> list[Row]:
        """Return the rows of a query."""
        with self._reader() as connection:
            return connection.execute(_query(statement), tuple(parameters)).fetchall()

    def scan(self, statement: str, parameters: Sequence[Any] = ()) -> Iterator[Row]:
        """Yield the rows of a query, some thousand at a time."""
        with self._reader() as connection, connection.transaction(), connection.cursor("scan") as cursor:
            cursor.itersize = SCAN_ROWS
            yield from cursor.execute(_query(statement), tuple(parameters))

    def close(self) -> None:
        """Release the lock, end a wait for it, and close all connections; from any thread."""
        self._is_closed = True
        waiting = self._waiting
        if waiting is not None:
            with suppress(Exception):  # the wait may have ended meanwhile
                waiting.cancel_safe(timeout=CONNECT_TIMEOUT_S)
        with self._writer_lock:
            self._drop_writer()
        with self._readers_lock:
            for connection in self._readers:
                connection.close()
            self._readers.clear()

    def connected(self) -> "psycopg.Connection":
        """Return a new connection; raise `psycopg.OperationalError` if there cannot be one."""
        import psycopg  # noqa: PLC0415 - as above

        options = _options_in(self.url)
        search_path = "" if "search_path" in options else f"-c search_path={SCHEMA}"
        return psycopg.connect(
            self.url,
            autocommit=True,
            connect_timeout=CONNECT_TIMEOUT_S,
            options=f"{options} {search_path} {_SESSION_OPTIONS}".strip(),
            application_name="handover context broker",
            keepalives_idle=5,
            keepalives_interval=2,
            keepalives_count=3,
            tcp_user_timeout=15_000,
        )

    def _connected(self) -> "psycopg.Connection":
        """Return the connection that holds the lock. Raises `NotStored`."""
        if self._writer is None or not _is_alive(self._writer):
            self._drop_writer()
            self._writer, _ = self._reconnected((self._commits,))
        return self._writer

    def _reconnected(self, expected: tuple[int, ...]) -> "tuple[psycopg.Connection, int]":
        """Return a new connection with the lock, and the number of commits, one of those `expected`.

        Raises `NotStored` if the database is out of reach, or if another broker has written it (`lost`).
        """
        import psycopg  # noqa: PLC0415 - as above

        if self.lost is not None or self._is_closed:
            raise DatabaseAway(self.lost or f"{self.name} is closed")
        time.sleep(max(0.0, self._not_before_s - time.monotonic()))
        self._not_before_s = time.monotonic() + RECONNECT_INTERVAL_S
        connection: psycopg.Connection | None = None
        try:
            connection = self.connected()
            is_locked = _one(connection, TRY_LOCK)
            process, commits = connection.execute("SELECT process, commits FROM writer").fetchall()[0]
            if process != self._process or (is_locked and commits not in expected):
                self.lost = f"another broker has written {self.name}; this one has to load it again"
            self._require_ownership(is_locked=is_locked)
            self._require_version(connection)
        except (psycopg.Error, NotStored) as error:
            if connection is not None:
                connection.close()
            self.unreachable = _in_one_line(error)
            raise _refused_with(error, f"{self.name}: {self.unreachable}") from error
        self.unreachable = None
        return connection, commits

    def _require_ownership(self, *, is_locked: bool) -> None:
        if self.lost is not None:
            raise DatabaseAway(self.lost)
        if not is_locked:
            raise DatabaseAway("the server still holds the lock of the connection that ended")

    def _require_version(self, connection: "psycopg.Connection") -> None:
        version = _one(connection, "SELECT max(version) FROM format")
        if version != self._version:
            raise NotStored(
                f"{self.name} has tables of format {version}, this broker writes {self._version}; "
                "start it again with the newer release"
            )

    @contextmanager
    def _reader(self) -> Iterator["psycopg.Connection"]:
        import psycopg  # noqa: PLC0415 - as above

        with self._readers_lock:
            connection = self._readers.pop() if self._readers else None
        try:
            if connection is None or not _is_alive(connection):
                connection = self.connected()
            yield connection
        except psycopg.Error as error:
            if connection is not None:
                connection.close()
            raise _refused_with(error, f"{self.name} cannot be read: {_in_one_line(error)}") from error
        except BaseException:
            if connection is not None:
                connection.close()
            raise
        with self._readers_lock:
            if len(self._readers) < MAX_SPARE_READERS and not self._is_closed:
                self._readers.append(connection)
                return
        connection.close()

    def _drop_writer(self) -> None:
        writer, self._writer = self._writer, None
        if writer is not None:
            with suppress(Exception):  # closing a broken connection may fail too
                writer.close()


class _PostgresWriter:
    def __init__(self, connection: "psycopg.Connection") -> None:
        self._connection = connection

    def run(self, statement: str, parameters: Sequence[Any] = ()) -> list[Row]:
        cursor = self._connection.execute(_query(statement), tuple(parameters))
        return cursor.fetchall() if _RETURNS_ROWS.match(statement) else []

    def run_many(self, statement: str, rows: Iterable[Sequence[Any]]) -> None:
        with self._connection.cursor() as cursor:
            cursor.executemany(_query(statement), rows)


_RETURNS_ROWS: Final = re.compile(r"\s*(SELECT|WITH)\b|.*\bRETURNING\b", re.IGNORECASE | re.DOTALL)


@lru_cache(maxsize=256)
def _query(statement: str) -> str:
    """Return a statement with psycopg's placeholders."""
    return statement.replace("%", "%%").replace("?", "%s")


def _in_postgres_sql(script: str, types: dict[str, str]) -> str:
    """Return a script for PostgreSQL, with integers of 64 bits and the byte order of texts, as in SQLite."""
    in_types = re.sub(r"\bINTEGER\b", "BIGINT", script.format(**types))
    return re.sub(r"\bTEXT\b", 'TEXT COLLATE "C"', in_types)


def _is_alive(connection: "psycopg.Connection") -> bool:
    """Return whether an idle connection is open: the server sends nothing unasked but the end of it."""
    if connection.closed:
        return False
    with selectors.DefaultSelector() as selector:
        selector.register(connection.fileno(), selectors.EVENT_READ)
        if not selector.select(0):
            return True
    connection.close()
    return False


def _one(connection: "psycopg.Connection", query: str) -> Any:
    row = connection.execute(query).fetchone()
    return row[0] if row else None


def _options_in(url: str) -> str:
    from psycopg.conninfo import conninfo_to_dict  # noqa: PLC0415 - as above

    return str(conninfo_to_dict(url).get("options") or "")


def _refused_with(error: Exception, text: str) -> NotStored:
    """Return what a refusal of the server, or ours, means for a write: its disk is full, or it is away."""
    import psycopg  # noqa: PLC0415 - as above

    if isinstance(error, psycopg.errors.DiskFull):
        return NotStored(text)
    is_away = isinstance(error, psycopg.OperationalError | psycopg.InterfaceError | DatabaseAway)
    return DatabaseAway(text) if is_away else NotStored(text)


def _in_one_line(error: BaseException) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0]


def shown_url(url: str) -> str:
    """Return the URL without the password in it."""
    parts = urlsplit(url)
    return f"postgresql://{parts.netloc.rpartition('@')[2]}{parts.path}"
