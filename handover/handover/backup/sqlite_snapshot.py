"""A SQLite database as of one moment, while services write it."""

import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Final

from handover.database.sqlite_files import faults_of
from handover.database.sqlite_integrity.stamp import stamp_of
from handover.errors import UsageError

_MAGIC: Final = b"SQLite format 3\0"


class SqliteSnapshot:
    """The state of a database at the moment at which this object was made; `close` ends it.

    A read transaction keeps it: writers continue, and their changes stay in the write-ahead log of SQLite
    until the snapshot is closed. Raises `sqlite3.Error`.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.is_marked = stamp_of(path).exists()
        uri = f"{path.absolute().as_uri()}?mode=ro"
        self.reader = sqlite3.connect(uri, uri=True, timeout=30.0, isolation_level=None)
        try:
            self.reader.execute("BEGIN")
            self.reader.execute("SELECT count(*) FROM sqlite_master").fetchone()  # the snapshot begins here
        except BaseException:
            self.reader.close()
            raise

    def write(self, target: Path) -> None:
        """Copy the database (SQLite's online backup) and check the copy. Raises `UsageError` for damage."""
        target.touch(0o600, exist_ok=False)
        with closing(sqlite3.connect(target)) as copy:
            self.reader.backup(copy)
        if faults := faults_of(target)[0]:
            raise UsageError(
                f"{self.path} is damaged: {faults[0]}; nothing was backed up. `handover check` lists all"
            )

    def close(self) -> None:
        """End the snapshot."""
        self.reader.close()


def is_database(path: Path) -> bool:
    """Return whether a file is a SQLite database. Raises `OSError`."""
    with path.open("rb") as file:
        return file.read(len(_MAGIC)) == _MAGIC
