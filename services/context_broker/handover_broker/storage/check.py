"""A complete check of a broker's files: every page, every row and the write-ahead log. It writes nothing.

The check at the start takes a second at most; this one reads everything, also while a broker uses the files.
The write-ahead log is left out then, because it changes all the time.
"""

import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any, Final

from handover.database.sqlite_files import faults_of, is_damage
from handover.errors import UsageError
from handover_broker.storage import checksums
from handover_broker.storage.database import NotStored, SqliteDatabase
from handover_broker.storage.journal import SCHEMA_VERSION, SCRIPT
from handover_broker.storage.write_ahead_log.checkpoint import Checkpointer
from handover_broker.storage.write_ahead_log.frames import UnknownVersion
from handover_broker.storage.write_ahead_log.log_file import Damaged

MAX_FAULTS: Final = 20
"""Damaged rows of a table that are listed; the others are counted."""
_ROWS: Final[dict[str, tuple[Callable[..., int], str]]] = {
    "entities": (checksums.of_entity, "seq, tenant, body"),
    "documents": (checksums.of_document, "kind, tenant, id, body"),
    "outbox": (checksums.of_notice, "seq, tenant, subscription, entity, at, body, headers"),
    "history": (checksums.of_change, "entity, seq, observed_from, observed_to, rewritten, body"),
    "temporal_only_entities": (checksums.of_temporal_only, "seq, tenant, id, body"),
}


def faults_in(path: Path) -> Iterator[str]:
    """Yield each fault of a broker's database and of the write-ahead log beside it."""
    database = SqliteDatabase(path)
    checkpointer = Checkpointer(database, lambda *_: None, lambda _: None)
    try:
        checkpointer.require_database()
        if not path.exists():
            return
        yield from (f"{path}: {fault}" for fault in faults_of(path)[0])
        database.require_version(SCHEMA_VERSION, SCRIPT)
    except UsageError as error:
        yield str(error)
        return
    except sqlite3.Error as error:
        if not is_damage(error):
            raise
        yield f"{path}: {error}"
        return
    yield from _faults_of_rows(path)
    yield from _faults_of_log(database, checkpointer)


def _faults_of_rows(path: Path) -> Iterator[str]:
    with closing(sqlite3.connect(path, isolation_level=None, timeout=5)) as reader:
        reader.execute("BEGIN")  # a transaction, so that tables and totals are consistent
        for table, (of, columns) in _ROWS.items():
            try:
                yield from _faults_of_table(reader, path, table, (of, columns))
            except sqlite3.Error as error:
                if not is_damage(error):
                    raise
                yield f"{path}: the table {table} cannot be read: {error}"


def _faults_of_table(
    reader: sqlite3.Connection, path: Path, table: str, look: tuple[Callable[..., int], str]
) -> Iterator[str]:
    of, columns = look
    number = total = damaged = 0
    for *row, checksum in reader.execute(f"SELECT {columns}, checksum FROM {table}"):  # noqa: S608 - ours
        number, total = number + 1, total + (checksum if isinstance(checksum, int) else 0)
        if not checksums.holds(of, checksum, row):
            damaged += 1
            if damaged <= MAX_FAULTS:
                yield f"{path}: {table}: the row {_shown(row)} is not as it was written"
    if damaged > MAX_FAULTS:
        yield f"{path}: {table}: {damaged} rows are not as they were written"
    for wanted in reader.execute("SELECT number, checksum FROM totals WHERE name = ?", (table,)):
        if wanted != (number, total):
            yield f"{path}: {table} has {number} rows, and not the {wanted[0]} that were written"


def _shown(row: list[Any]) -> str:
    """Return the key of a row: the columns before its content."""
    return ", ".join(str(value) for value in row[:3] if not isinstance(value, bytes))


def _faults_of_log(database: SqliteDatabase, checkpointer: Checkpointer) -> Iterator[str]:
    try:
        database.keep_others_out()
    except UsageError:
        return  # a broker is running: its log changes
    except OSError as error:
        yield f"{database.path}: it cannot be locked: {error}"
        return
    try:
        checkpointer.recover()
    except (Damaged, UnknownVersion, NotStored, OSError) as error:
        yield str(error)
    finally:
        database.close()
