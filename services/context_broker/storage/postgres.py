"""The journal's database on a PostgreSQL server, which several brokers may share.

Every transaction waits for the one lock that all brokers on a database agree on, so that there is one order
of all changes. Statements are sent in a pipeline: a commit costs as few round trips as its questions need.
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

from handover.errors import UsageError
from services.context_broker.storage.database import FateUnknown, NotStored, Row

if TYPE_CHECKING:
    import psycopg

CONNECT_TIMEOUT_S: Final = 5
CALM_S: Final = 0.25
"""Between two attempts to connect for writing; what is to be written meanwhile waits for the next."""
SPARE_READERS: Final = 4
"""Connections for reading that are kept open; more are opened while more is read at once."""
SCAN_AT_ONCE: Final = 5000
"""Rows fetched at a time of what may be too much to hold."""
_SAFE: Final = (
    "-c synchronous_commit=on -c lock_timeout=20s -c idle_in_transaction_session_timeout=10s "
    "-c tcp_keepalives_idle=5 -c tcp_keepalives_interval=2 -c tcp_keepalives_count=3"
)
"""An acknowledgement is true; one who hangs or has vanished does not hold up the others for ever."""
SCHEMA: Final = "context_broker"
"""Where the tables are, so that others may have theirs in the same database; a search_path in the URL says
otherwise."""
_FIRST_LOCK: Final = "SELECT pg_advisory_xact_lock(hashtext('handover context broker'))"
_LOCK: Final = "hashtext('handover context broker ' || current_schema()), "
WRITING_LOCK: Final = f"SELECT pg_advisory_xact_lock({_LOCK}1)"
_PRESENCE: Final = f"{_LOCK}2"
LEADING: Final = f"{_LOCK}3"
CHANNEL: Final = "handover_context_broker"
_VERSIONS: Final = "CREATE TABLE IF NOT EXISTS schema_version (version BIGINT NOT NULL)"


class PostgresDatabase:
    """A database on a server; a connection that breaks refuses what it carried, and the next is a new one."""

    TYPES: Final = {"bytes": "BYTEA", "number": "DOUBLE PRECISION", "keyed": ""}

    def __init__(self, url: str) -> None:
        self.url = url
        self.name = shown_url(url)
        self._version = 0
        self._writer: psycopg.Connection | None = None
        self._not_before_s = 0.0
        self._readers: list[psycopg.Connection] = []
        self._readers_lock = threading.Lock()

    def open(self, version: int, script: str) -> None:
        """Make the tables with `script` where there are none; refuse those of another version."""
        import psycopg  # noqa: PLC0415 - takes time to load, and most brokers have a file

        self._version = version
        try:
            with self.connected() as connection, connection.transaction():
                connection.execute(_FIRST_LOCK)
                if "search_path" not in _options_in(self.url):
                    connection.execute(f"CREATE SCHEMA IF NOT EXISTS {SCHEMA}")
                connection.execute(WRITING_LOCK)
                connection.execute(_VERSIONS)
                found = _one(connection, "SELECT coalesce(max(version), 0) FROM schema_version")
                if found > version:
                    raise UsageError(
                        f"{self.name} was written by a newer version of Handover; use that version"
                    )
                if 0 < found < version:
                    raise UsageError(
                        f"{self.name} has the tables {found} of a version before the first release, which "
                        f"cannot be read (this one reads {version}); drop them to begin with none"
                    )
                if not found:
                    connection.execute(_in_its_words(script, self.TYPES))
                    connection.execute("INSERT INTO schema_version VALUES (%s)", (version,))
            self._connected()
        except (psycopg.Error, NotStored) as error:
            raise UsageError(
                f"the broker cannot use {self.name}: {_in_one_line(error)}; "
                "mend that or correct HANDOVER_BROKER_DATABASE_URL"
            ) from None

    @contextmanager
    def transaction(self) -> Iterator["_PostgresWriter"]:
        """Write all that is run inside, or nothing, when no other broker does."""
        import psycopg  # noqa: PLC0415 - as above

        committing = False
        try:
            connection = self._connected()
            with connection.pipeline():
                connection.execute("BEGIN")
                connection.execute(WRITING_LOCK)
                yield _PostgresWriter(connection)
                committing = True
                connection.execute("COMMIT")
        except psycopg.Error as error:
            self._start_over()
            lost = committing and isinstance(error, psycopg.OperationalError)
            kind = FateUnknown if lost else NotStored
            raise kind(f"{self.name}: {_in_one_line(error)}") from error
        except BaseException:
            self._start_over()
            raise

    def read(self, statement: str, parameters: Sequence[Any] = ()) -> list[Row]:
        """Return the rows of a query."""
        with self._reader() as connection:
            return connection.execute(_query(statement), tuple(parameters)).fetchall()

    def scan(self, statement: str, parameters: Sequence[Any] = ()) -> Iterator[Row]:
        """Yield the rows of a query, some thousand at a time."""
        with self._reader() as connection, connection.transaction(), connection.cursor("scan") as cursor:
            cursor.itersize = SCAN_AT_ONCE
            yield from cursor.execute(_query(statement), tuple(parameters))

    def close(self) -> None:
        """Let go."""
        self._start_over()
        with self._readers_lock:
            for connection in self._readers:
                connection.close()
            self._readers.clear()

    def connected(self) -> "psycopg.Connection":
        """Return a new connection; raise `psycopg.OperationalError` if there cannot be one."""
        import psycopg  # noqa: PLC0415 - as above

        told = _options_in(self.url)
        place = "" if "search_path" in told else f"-c search_path={SCHEMA}"
        return psycopg.connect(
            self.url,
            autocommit=True,
            connect_timeout=CONNECT_TIMEOUT_S,
            options=f"{told} {place} {_SAFE}".strip(),
            application_name="handover context broker",
            keepalives_idle=5,
            keepalives_interval=2,
            keepalives_count=3,
            tcp_user_timeout=15_000,
        )

    def _connected(self) -> "psycopg.Connection":
        if self._writer is None or not _is_alive(self._writer):
            time.sleep(max(0.0, self._not_before_s - time.monotonic()))
            self._not_before_s = time.monotonic() + CALM_S
            writer = self.connected()
            writer.execute(f"SELECT pg_advisory_lock_shared({_PRESENCE})")
            found = _one(writer, "SELECT max(version) FROM schema_version")
            if found != self._version:
                writer.close()
                raise NotStored(
                    f"{self.name} has been brought to version {found} of its tables, this broker knows "
                    f"{self._version}; start it again with the newer release"
                )
            self._writer = writer
        return self._writer

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
            raise NotStored(f"{self.name} cannot be read: {_in_one_line(error)}") from error
        except BaseException:
            if connection is not None:
                connection.close()
            raise
        with self._readers_lock:
            if len(self._readers) < SPARE_READERS:
                self._readers.append(connection)
                return
        connection.close()

    def _start_over(self) -> None:
        writer, self._writer = self._writer, None
        if writer is not None:
            with suppress(Exception):  # what is broken may also break on its way out
                writer.close()


class _PostgresWriter:
    def __init__(self, connection: "psycopg.Connection") -> None:
        self._connection = connection

    def run(self, statement: str, parameters: Sequence[Any] = ()) -> list[Row]:
        cursor = self._connection.execute(_query(statement), tuple(parameters))
        return cursor.fetchall() if _GIVES_ROWS.match(statement) else []

    def run_many(self, statement: str, rows: Iterable[Sequence[Any]]) -> None:
        with self._connection.cursor() as cursor:
            cursor.executemany(_query(statement), rows)


_GIVES_ROWS: Final = re.compile(r"\s*(SELECT|WITH)\b|.*\bRETURNING\b", re.IGNORECASE | re.DOTALL)


@lru_cache(maxsize=256)
def _query(statement: str) -> str:
    """Return a statement as psycopg takes it."""
    return statement.replace("%", "%%").replace("?", "%s")


def _in_its_words(script: str, types: dict[str, str]) -> str:
    """Return a migration in PostgreSQL's words, with SQLite's numbers of 64 bits and its order of texts."""
    in_types = re.sub(r"\bINTEGER\b", "BIGINT", script.format(**types))
    return re.sub(r"\bTEXT\b", 'TEXT COLLATE "C"', in_types)


def _is_alive(connection: "psycopg.Connection") -> bool:
    """Say whether an idle connection is as it was left: what a server says unasked is goodbye."""
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


def _in_one_line(error: BaseException) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0]


def shown_url(url: str) -> str:
    """Return the URL without what is secret in it."""
    parts = urlsplit(url)
    return f"postgresql://{parts.netloc.rpartition('@')[2]}{parts.path}"
