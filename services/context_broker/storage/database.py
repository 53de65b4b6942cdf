"""The database under the journal: what SQLite and PostgreSQL do each in their own way.

The SQL itself stands in the rooms that use it, once for both: parameters are `?`, types that have different
names are written `{bytes}` and `{number}`. Nothing here knows of entities.
"""

import re
import shutil
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, Protocol

from handover.errors import UsageError

Row = tuple[Any, ...]


class NotStored(Exception):
    """The database did not take a transaction (nothing of it is there), or cannot be read."""


class FateUnknown(NotStored):
    """The connection to the database broke while it was committing: the transaction may be there, or not."""


class Writer(Protocol):
    """An open transaction."""

    def run(self, statement: str, parameters: Sequence[Any] = ()) -> list[Row]:
        """Run one statement; return its rows."""

    def run_many(self, statement: str, rows: Iterable[Sequence[Any]]) -> None:
        """Run one statement for each of `rows`."""


class Database(Protocol):
    """Where the broker keeps what must survive. Transactions come from one thread, reading from any."""

    name: str
    """What the database is called in errors."""

    def open(self, version: int, migrations: Sequence[str]) -> None:
        """Make ready, and bring older content up to `version` (migration n leads to version n + 1).

        Raises `UsageError` if that cannot be.
        """

    @contextmanager
    def transaction(self) -> Iterator[Writer]:
        """Write all that is run inside, or nothing; safe once it is left. Raises `NotStored`."""
        yield  # type: ignore[misc]  # a protocol has no body

    def read(self, statement: str, parameters: Sequence[Any] = ()) -> list[Row]:
        """Return the rows of a query, from any thread. Raises `NotStored`."""

    def scan(self, statement: str, parameters: Sequence[Any] = ()) -> Iterator[Row]:
        """Yield the rows of a query that may be too many to hold."""

    def close(self) -> None:
        """Let go."""


class SqliteDatabase:
    """A database in one file, with a log that is flushed at every commit.

    So neither `kill -9` nor a power cut takes back what was acknowledged.
    """

    TYPES: Final = {"bytes": "BLOB", "number": "REAL"}

    def __init__(self, path: Path) -> None:
        self.path = path
        self.name = path.name
        self.before_reading: Callable[[], None] = lambda: None
        """Is called before anything is read: what is not in the tables yet is put there."""
        self._writer: sqlite3.Connection | None = None
        self._guard: sqlite3.Connection | None = None

    def open(self, version: int, migrations: Sequence[str]) -> None:
        """Open or make the file; a copy of an older one is kept beside it before it is changed."""
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._keep_others_out()
            self._bring_up_to_date(self._connected(), version, migrations)
        except (sqlite3.Error, OSError) as error:
            raise UsageError(
                f"the broker cannot use {self.path}: {error}; "
                "give it another HANDOVER_DATA_DIR, or make room there"
            ) from None

    @contextmanager
    def transaction(self) -> Iterator[Writer]:
        """Write all that is run inside, or nothing."""
        try:
            connection = self._connected()
            connection.execute("BEGIN IMMEDIATE")
            yield _SqliteWriter(connection)
            connection.execute("COMMIT")
        except sqlite3.Error as error:
            self._start_over()
            raise NotStored(f"{self.name}: {error}") from error
        except BaseException:
            self._start_over()
            raise

    def read(self, statement: str, parameters: Sequence[Any] = ()) -> list[Row]:
        """Return the rows of a query."""
        return list(self.scan(statement, parameters))

    def scan(self, statement: str, parameters: Sequence[Any] = ()) -> Iterator[Row]:
        """Yield the rows of a query, over a connection of its own."""
        self.before_reading()
        try:
            with closing(sqlite3.connect(self.path, isolation_level=None, timeout=5)) as reader:
                yield from reader.execute(statement, tuple(parameters))
        except sqlite3.Error as error:
            raise NotStored(f"{self.name} cannot be read: {error}") from error

    def close(self) -> None:
        """Close the file; what is in its log is moved into it."""
        for connection in (self._writer, self._guard):
            if connection is not None:
                connection.close()
        self._writer = self._guard = None

    def _keep_others_out(self) -> None:
        """Hold a lock for as long as the process lives: two brokers on one file would undo each other."""
        guard = sqlite3.connect(
            self.path.with_suffix(".lock"), isolation_level=None, check_same_thread=False, timeout=0
        )
        try:
            guard.execute("BEGIN EXCLUSIVE")
        except sqlite3.OperationalError:
            guard.close()
            raise UsageError(
                f"another broker is at work on {self.path}; "
                "stop it, or give this one another HANDOVER_DATA_DIR"
            ) from None
        self._guard = guard

    def _connected(self) -> sqlite3.Connection:
        if self._writer is None:
            writer = sqlite3.connect(
                self.path, isolation_level=None, check_same_thread=False, timeout=5, cached_statements=256
            )
            # FULL flushes at every transaction: once it is committed, the broker's own log is written over.
            for pragma in ("journal_mode=WAL", "synchronous=FULL", "wal_autocheckpoint=4000"):
                writer.execute(f"PRAGMA {pragma}")
            self._writer = writer
        return self._writer

    def _bring_up_to_date(self, writer: sqlite3.Connection, version: int, migrations: Sequence[str]) -> None:
        (found,) = writer.execute("PRAGMA user_version").fetchone()
        if found > version:
            raise UsageError(f"{self.path} was written by a newer version of Handover; use that version")
        if 0 < found < version:
            self._back_up(writer, found)
        for step in range(found, version):
            script = migrations[step].format(**self.TYPES)
            writer.executescript(f"BEGIN; {script} PRAGMA user_version = {step + 1}; COMMIT;")

    def _back_up(self, writer: sqlite3.Connection, version: int) -> None:
        kept = self.path.with_suffix(f".v{version}.backup.db")
        unfinished = kept.with_suffix(".unfinished")
        with suppress(FileNotFoundError):
            unfinished.unlink()
        with closing(sqlite3.connect(unfinished)) as copy:
            writer.backup(copy)
        shutil.move(unfinished, kept)

    def _start_over(self) -> None:
        """Leave a connection on which something failed; the next transaction makes a new one."""
        writer, self._writer = self._writer, None
        if writer is not None:
            writer.close()


class _SqliteWriter:
    def __init__(self, connection: sqlite3.Connection) -> None:
        self._connection = connection

    def run(self, statement: str, parameters: Sequence[Any] = ()) -> list[Row]:
        return list(self._connection.execute(statement, tuple(parameters)))

    def run_many(self, statement: str, rows: Iterable[Sequence[Any]]) -> None:
        """Run one statement for many rows at once.

        Python's SQLite lets go of the interpreter at each row, and may wait milliseconds to get it back while
        requests are answered; so a commit would take as many waits as it has rows.
        """
        listed = rows if isinstance(rows, list) else list(rows)
        start = 0
        for size in _CHUNKS:
            wide = None
            while len(listed) - start >= size:
                wide = wide or _for_rows(statement, size)
                if wide is None:
                    self._connection.executemany(statement, listed[start:])
                    return
                flat = [value for row in listed[start : start + size] for value in row]
                self._connection.execute(wide, flat)
                start += size


_CHUNKS: Final = (256, 64, 32, 16, 8, 4, 2, 1)
"""Rows that go into one statement: few sizes, so that SQLite keeps all of them ready."""
_ROW: Final = re.compile(r"VALUES (\([?, ]+\))")
_KEY: Final = re.compile(r"WHERE (\w+) = \?$")


@lru_cache(maxsize=256)
def _for_rows(statement: str, count: int) -> str | None:
    """Return the statement for so many rows at once; None for one that cannot be widened."""
    if count == 1:
        return statement
    if found := _ROW.search(statement):
        return statement.replace(found[0], f"VALUES {', '.join([found[1]] * count)}")
    if found := _KEY.search(statement):
        return statement.replace(found[0], f"WHERE {found[1]} IN ({', '.join('?' * count)})")
    return None
