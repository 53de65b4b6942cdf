"""The database under the journal: what differs between SQLite and PostgreSQL.

The modules that use it have the SQL, once for both: parameters are `?`, types with different names are
`{bytes}` and `{number}`.
"""

import re
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar, Final, Protocol

from handover.database.sqlite_files import damage, require_sound
from handover.errors import UsageError
from handover.files.durable_files import sync_folder
from handover.files.folder_lock import hold

Row = tuple[Any, ...]


APPLICATION_ID: Final = 0x484F5652
"""`HOVR`, in the header of every database file since the first release; before it there was none."""


class NotStored(Exception):
    """The database refused a transaction (nothing of it is stored), or cannot be read."""

    is_away: ClassVar[bool] = False
    """Whether the database is out of reach, and not merely full."""


class DatabaseAway(NotStored):
    """The server of the database does not answer now."""

    is_away = True


class Writer(Protocol):
    """An open transaction."""

    def run(self, statement: str, parameters: Sequence[Any] = ()) -> list[Row]:
        """Run one statement; return its rows."""

    def run_many(self, statement: str, rows: Iterable[Sequence[Any]]) -> None:
        """Run one statement for each of `rows`."""


class Database(Protocol):
    """Durable storage of the broker. Transactions come from one thread, reads from any."""

    name: str
    """The name of the database in errors."""
    lost: str | None
    """Why this process may not write any more: another broker has written the database."""
    unreachable: str | None
    """Why the database could not be reached the last time."""

    def open(self, version: int, script: str) -> None:
        """Open the database; create a new one with `script`. Raises `UsageError` for another version."""

    def try_lock(self) -> bool:
        """Become the broker that writes the database, if there is no other. Raises `NotStored`."""

    def wait_for_lock(self) -> bool:
        """Wait until this is the broker that writes the database; `close` ends the wait with False."""

    def check_connection(self) -> None:
        """Note in `unreachable` and `lost` whether the database can be written."""

    @contextmanager
    def transaction(self) -> Iterator[Writer]:
        """Write all that is run inside, or nothing; durable after the block. Raises `NotStored`."""
        yield  # type: ignore[misc]  # a protocol has no body

    def read(self, statement: str, parameters: Sequence[Any] = ()) -> list[Row]:
        """Return the rows of a query, from any thread. Raises `NotStored`."""

    def scan(self, statement: str, parameters: Sequence[Any] = ()) -> Iterator[Row]:
        """Yield the rows of a query whose result may not fit into memory."""

    def close(self) -> None:
        """Close the database."""


class SqliteDatabase:
    """A database in one file, with a log that is flushed at every commit.

    So neither `kill -9` nor a power failure loses an acknowledged change.
    """

    TYPES: Final = {"bytes": "BLOB", "number": "REAL", "keyed": "WITHOUT ROWID"}

    def __init__(self, path: Path) -> None:
        self.path = path
        self.name = path.name
        self.before_reading: Callable[[], None] = lambda: None
        """Called before every read, to write what is not in the tables yet."""
        self.lost: str | None = None
        self.unreachable: str | None = None
        self.is_checked = False
        """Whether the integrity check at the start was completed."""
        self._writer: sqlite3.Connection | None = None
        self._release: Callable[[], None] = lambda: None
        """Releases the lock of the file."""

    def open(self, version: int, script: str) -> None:
        """Create the file, or open it if it is sound and of this version; else it is left unchanged."""
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self.keep_others_out()
            if self.path.exists():
                self.is_checked = require_sound(self.path)
                self.require_version(version, script)
            else:
                require_sound(self.path)
                self._make(version, script)
                self.is_checked = True
        except sqlite3.DatabaseError as error:
            if isinstance(error, sqlite3.OperationalError):
                raise unusable(self.path, error) from None
            raise UsageError(damage(f"{self.path}: {error}")) from None
        except OSError as error:
            raise unusable(self.path, error) from None

    def try_lock(self) -> bool:
        """Return True: `open` has locked the file, or refused it."""
        return True

    def wait_for_lock(self) -> bool:
        """Return True, as `try_lock`."""
        return True

    def check_connection(self) -> None:
        """Do nothing: a file has no connection to lose."""

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
        """Yield the rows of a query, on a new connection."""
        self.before_reading()
        yield from self.scan_tables(statement, parameters)

    def scan_tables(self, statement: str, parameters: Sequence[Any] = ()) -> Iterator[Row]:
        """Yield the rows of a query from the tables, without what is not in them yet."""
        try:
            with closing(self._reader()) as reader:
                yield from reader.execute(statement, tuple(parameters))
        except sqlite3.Error as error:
            raise NotStored(f"{self.name} cannot be read: {error}") from error

    def checkpoint(self) -> None:
        """Move the content of SQLite's WAL into the file, so that a lost WAL is detected afterwards."""
        with suppress(sqlite3.Error):  # else a later checkpoint does it
            self._connected().execute("PRAGMA wal_checkpoint(TRUNCATE)")

    def close(self) -> None:
        """Close the file; the content of its WAL is moved into it."""
        if self._writer is not None:
            self._writer.close()
        self._writer = None
        self._release()

    def keep_others_out(self) -> None:
        """Hold the lock of the file: two brokers on one file would overwrite each other."""
        self._release = hold(self.path, "broker", is_only_use=True)

    def _connected(self) -> sqlite3.Connection:
        if self._writer is None:
            writer = sqlite3.connect(
                self.path, isolation_level=None, check_same_thread=False, timeout=5, cached_statements=256
            )
            # FULL flushes at every transaction: after it the broker's own log is overwritten.
            for pragma in ("journal_mode=WAL", "synchronous=FULL", "wal_autocheckpoint=4000"):
                writer.execute(f"PRAGMA {pragma}")
            self._writer = writer
        return self._writer

    def _reader(self) -> sqlite3.Connection:
        """Return a connection for reading, also when there is no space for files beside the database."""
        reader = sqlite3.connect(self.path, isolation_level=None, timeout=5)
        try:
            reader.execute("SELECT 1 FROM sqlite_master")
        except sqlite3.OperationalError:
            reader.close()
            wal = self.path.with_name(f"{self.path.name}-wal")
            if wal.exists() and wal.stat().st_size:
                raise
            return sqlite3.connect(f"{self.path.absolute().as_uri()}?mode=ro&immutable=1", uri=True)
        return reader

    def require_version(self, version: int, script: str) -> None:
        """Raise `UsageError` unless the file is of this version, with the tables that `script` creates."""
        with closing(self._reader()) as reader:
            ((application_id,),) = reader.execute("PRAGMA application_id")
            ((stored,),) = reader.execute("PRAGMA user_version")
            if application_id != APPLICATION_ID and stored:
                raise UsageError(
                    f"{self.path} has the format {stored} of a version before the first release, which this "
                    "one cannot read; move the data directory away to start with an empty one"
                )
            if stored > version:
                raise UsageError(f"{self.path} was written by a newer version of Handover; use that version")
            tables = set(reader.execute(_TABLES))
        with closing(sqlite3.connect(":memory:")) as connection:
            connection.executescript(script.format(**self.TYPES))
            wanted = set(connection.execute(_TABLES))
        if missing := sorted(str(name) for name, _ in wanted - tables):
            raise UsageError(damage(f"{self.path}: the table or index {missing[0]} is missing or altered"))

    def _make(self, version: int, script: str) -> None:
        """Create the file completely under another name first: an empty one, or one without tables, is
        damaged."""
        unfinished = self.path.with_suffix(".new")
        for left in (unfinished, unfinished.with_name(f"{unfinished.name}-journal")):
            left.unlink(missing_ok=True)
        with closing(sqlite3.connect(unfinished, isolation_level=None)) as connection:
            connection.execute("PRAGMA synchronous=FULL")
            script = script.format(**self.TYPES)
            header = f"PRAGMA application_id = {APPLICATION_ID}; PRAGMA user_version = {version};"
            connection.executescript(f"BEGIN; {script} {header} COMMIT;")
        unfinished.replace(self.path)
        sync_folder(self.path.parent)

    def _start_over(self) -> None:
        """Close a connection on which something failed; the next transaction opens a new one."""
        writer, self._writer = self._writer, None
        if writer is not None:
            writer.close()


_TABLES: Final = "SELECT name, sql FROM sqlite_master WHERE sql IS NOT NULL"


def unusable(path: Path, error: Exception) -> UsageError:
    """Return the error for a file that the broker cannot use, for a reason outside of it."""
    return UsageError(
        f"the broker cannot use {path}: {error}; give it another HANDOVER_DATA_DIR, or free space there"
    )


class _SqliteWriter:
    def __init__(self, connection: sqlite3.Connection) -> None:
        self._connection = connection

    def run(self, statement: str, parameters: Sequence[Any] = ()) -> list[Row]:
        return list(self._connection.execute(statement, tuple(parameters)))

    def run_many(self, statement: str, rows: Iterable[Sequence[Any]]) -> None:
        """Run one statement for many rows at once.

        Python's SQLite module releases the interpreter lock at each row, and may wait milliseconds to get it
        back while requests are answered; a commit would wait once for each row.
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
"""Rows in one statement: few sizes, so that SQLite caches all of them."""
_ROW: Final = re.compile(r"VALUES (\([?, ]+\))")
_KEY: Final = re.compile(r"WHERE (\w+) = \?$")


@lru_cache(maxsize=256)
def _for_rows(statement: str, count: int) -> str | None:
    """Return the statement for so many rows at once; None if that is not possible."""
    if count == 1:
        return statement
    if match := _ROW.search(statement):
        return statement.replace(match[0], f"VALUES {', '.join([match[1]] * count)}")
    if match := _KEY.search(statement):
        return statement.replace(match[0], f"WHERE {match[1]} IN ({', '.join('?' * count)})")
    return None
