"""The marks of a database: its stamp and the checksums of its pages.

They are created once, and compared with the database at each start.
"""

import sqlite3
import time
from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Final

from handover.database.sqlite_integrity.page_checksums import (
    InvalidChecksums,
    PageChecksums,
    checksums_of_file,
    differing_pages,
    pages_of,
    pending_pages_of,
    read_checksums,
    write_checksums,
)
from handover.database.sqlite_integrity.stamp import InvalidStamp, Stamp, read_stamp, stamp_of, write_stamp
from handover.database.sqlite_integrity.wal_file import read_wal, wal_of

TABLE: Final = "handover_commits"
MAX_LISTED: Final = 10


@dataclass(frozen=True, slots=True)
class Comparison:
    """The result of comparing a database with its marks.

    `is_other`: another program has checkpointed it, so its pages cannot be compared.
    """

    faults: tuple[str, ...] = ()
    is_complete: bool = True
    is_marked: bool = True
    is_other: bool = False


class _Fault(Exception):
    """A difference between a database and its marks."""


class Busy(OSError):
    """The database cannot be marked while another process uses it."""


def compare(database: Path, within_s: float | None, *, with_pages: bool = True) -> Comparison:
    """Compare an existing database with its marks, also while a service uses it. Raises `sqlite3.Error`.

    With pages, no connection of this process may have the file open.
    """
    end_s = None if within_s is None else time.monotonic() + within_s
    try:
        stamp = read_stamp(database)  # before the transaction: afterwards a service may commit more
        with closing(_reader(database)) as reader:
            reader.execute("BEGIN")  # while a reader uses the log, it is not started again
            ((application_id,),) = reader.execute("PRAGMA application_id")
            if not reader.execute("SELECT 1 FROM sqlite_master WHERE name = ?", (TABLE,)).fetchone():
                _require_stamp(database, stamp, int(application_id), None)
                return Comparison(is_marked=False)
            ((commits,),) = reader.execute(f"SELECT number FROM {TABLE}")  # noqa: S608 - ours
            _require_stamp(database, stamp, int(application_id), int(commits))
            accepted = _accepted_checksums(database, is_required=commits > 0)
            if not accepted or not with_pages:
                return Comparison(is_marked=bool(accepted))
            return _compare_pages(database, int(commits), accepted, end_s)
    except _Fault as error:
        return Comparison((str(error),))
    except (InvalidStamp, InvalidChecksums) as error:
        return Comparison((f"{error}; {RESTAMP}",))


RESTAMP: Final = "if you replaced this database yourself, `handover check --restamp` accepts it"


def create(folder: Path, name: str, application_id: int) -> Path:
    """Create an empty database with a table for the number of commits in `folder`; return its path."""
    database = folder / name
    with closing(sqlite3.connect(database, isolation_level=None)) as connection:
        connection.execute("PRAGMA journal_mode=WAL")
        connection.execute("BEGIN IMMEDIATE")
        connection.execute(f"PRAGMA application_id = {application_id}")
        _create_table(connection)
        connection.execute("COMMIT")
    return database


def write_marks(database: Path, application_id_of: Callable[[sqlite3.Connection], int]) -> None:
    """Write the stamp and the checksums of a sound database, as it is.

    No connection of this process may have the file open. Raises `Busy` if another process uses it,
    `sqlite3.Error` or `OSError` if it cannot be written.
    """
    with closing(sqlite3.connect(database, timeout=5.0, isolation_level=None)) as connection:
        connection.execute("PRAGMA journal_mode=WAL")
        connection.execute("BEGIN IMMEDIATE")
        application_id = application_id_of(connection)
        _create_table(connection)
        connection.execute("COMMIT")
        ((is_busy, _, _),) = connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        if is_busy:
            raise Busy(f"another process uses {database}; stop it")
        ((commits,),) = connection.execute(f"SELECT number FROM {TABLE}")  # noqa: S608 - ours
        ((page_size,),) = connection.execute("PRAGMA page_size")
    write_checksums(pages_of(database), checksums_of_file(database, int(page_size), int(commits)))
    pending_pages_of(database).unlink(missing_ok=True)
    write_stamp(database, Stamp(application_id, int(commits)))


def _reader(database: Path) -> sqlite3.Connection:
    return sqlite3.connect(
        f"{database.absolute().as_uri()}?mode=ro", uri=True, timeout=5.0, isolation_level=None
    )


def _create_table(connection: sqlite3.Connection) -> None:
    connection.execute(f"CREATE TABLE IF NOT EXISTS {TABLE} (number INTEGER NOT NULL)")
    connection.execute(f"INSERT INTO {TABLE} SELECT 0 WHERE NOT EXISTS (SELECT 1 FROM {TABLE})")  # noqa: S608


def _require_stamp(database: Path, stamp: Stamp | None, application_id: int, commits: int | None) -> None:
    """Raise `_Fault` if a stamp is not that of a database with so many commits; None: not counted."""
    if stamp is None:
        if commits:
            raise _Fault(f"{stamp_of(database)} is missing; {RESTAMP}")
        return
    if stamp.application_id != application_id:
        raise _Fault(
            f"{database} is empty, or another database than the one of {stamp_of(database).name}; {RESTAMP}"
        )
    if stamp.commits is not None and stamp.commits > (commits or 0):
        missing = stamp.commits - (commits or 0)
        raise _Fault(
            f"{database}: the last {missing} of {stamp.commits} changes are missing, because "
            f"{wal_of(database).name} was deleted, replaced or altered; put it back if you have it; "
            f"{RESTAMP}"
        )


def _accepted_checksums(database: Path, *, is_required: bool) -> list[PageChecksums]:
    """Return the checksums of the last checkpoint, and of one that was interrupted."""
    last = read_checksums(pages_of(database))
    if last is None:
        if is_required:
            raise _Fault(f"{pages_of(database)} is missing; {RESTAMP}")
        return []
    with suppress(InvalidChecksums):
        if (pending := read_checksums(pending_pages_of(database))) is not None:
            return [last, pending]
    return [last]


def _compare_pages(
    database: Path, commits: int, accepted: list[PageChecksums], end_s: float | None
) -> Comparison:
    wal = read_wal(database)
    frames = [(frame.page, frame.database_pages) for frame in wal.frames()] if wal else []
    if commits - accepted[0].commits > sum(1 for _, size in frames if size):
        return Comparison(is_other=True)
    marks = list(
        islice(differing_pages(database, accepted, {page for page, _ in frames}, end_s), MAX_LISTED + 1)
    )
    pages = [str(page) for page in marks if page is not None]
    faults = [f"{database}: page {page} is not as it was written" for page in pages[:MAX_LISTED]]
    if len(pages) > MAX_LISTED:
        faults.append(f"{database}: more pages are not as they were written")
    return Comparison(tuple(faults), is_complete=None not in marks)
