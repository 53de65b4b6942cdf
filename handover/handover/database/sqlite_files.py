"""SQLite files: integrity checks before a file is written.

SQLite's integrity check finds inconsistent pages, indexes and rows; `sqlite_integrity` beside it finds lost
commits and changed pages of our own databases.
"""

import os
import secrets
import sqlite3
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from handover.database.sqlite_integrity import marks
from handover.database.sqlite_integrity.checkpoints import is_open
from handover.database.sqlite_integrity.stamp import stamp_of
from handover.errors import UsageError
from handover.telemetry import get_logger

if sys.platform != "win32":
    import fcntl

log = get_logger(__name__)

UNRELEASED_SUFFIX: Final = "_schema"
"""Formats before the first release recorded their version in a table `<component>_schema`."""
START_CHECK_S: Final = 1.0
"""Maximum time of the integrity check at a start; `handover check` completes it."""
_STEPS: Final = 20_000
"""Steps of SQLite's virtual machine between two checks of the time: some milliseconds."""
_OUTSIDE: Final = frozenset(
    {
        sqlite3.SQLITE_BUSY,
        sqlite3.SQLITE_LOCKED,
        sqlite3.SQLITE_CANTOPEN,
        sqlite3.SQLITE_FULL,
        sqlite3.SQLITE_IOERR,
        sqlite3.SQLITE_READONLY,
    }
)
"""Errors with a cause outside the file, such as a full disk; the check is incomplete then."""
REMEDY: Final = (
    "restore the data directory from a backup (`handover restore`, deploy/restore, or a copy of the whole "
    "folder); `handover check` lists all damage"
)


def require_sound(path: Path, within_s: float = START_CHECK_S) -> bool:
    """Raise `UsageError` if an existing file is damaged; return whether the check was completed in time.

    The message names the file, the damage and the remedy. A busy file is not checked.
    """
    if (fault := fault_of_files(path)) is not None:
        raise UsageError(damage(fault))
    if not path.exists():
        return True
    faults, is_complete = faults_of(path, within_s)
    if faults:
        raise UsageError(damage(f"{path}: {faults[0]}"))
    return is_complete


def damage(fault: str) -> str:
    """Return the error text for a damaged database; `fault` names the file and the damage."""
    return f"damaged data: {fault}; {REMEDY}"


def fault_of_files(path: Path) -> str | None:
    """Return a fault of the names and sizes of the files of a database; None if there is none."""
    wal = path.with_name(f"{path.name}-wal")
    if not path.exists():
        if wal.exists() and wal.stat().st_size:
            return f"{path} is missing, but {wal.name} beside it has changes of it"
        return None
    return None if path.stat().st_size else f"{path} is empty (0 bytes) instead of a database"


def faults_of(path: Path, within_s: float | None = None) -> tuple[list[str], bool]:
    """Return the faults of SQLite's integrity check, and whether it was completed in time.

    Nothing is written. An `sqlite3.Error` is a fault as well, unless the file is only busy.
    """
    try:
        with closing(
            sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, timeout=5)
        ) as connection:
            return integrity_faults(connection, within_s)
    except sqlite3.DatabaseError as error:
        return ([str(error)], True) if is_damage(error) else ([], False)


def is_damage(error: sqlite3.Error) -> bool:
    """Return whether an error is damage of the file, and not that of a full disk or a busy file."""
    return not is_outside(error)


def is_outside(error: sqlite3.Error) -> bool:
    """Return whether an error has a cause outside of the file, such as a full disk, so that it may pass."""
    return getattr(error, "sqlite_errorcode", sqlite3.SQLITE_CORRUPT) & 0xFF in _OUTSIDE


def integrity_faults(connection: sqlite3.Connection, within_s: float | None = None) -> tuple[list[str], bool]:
    """Return the faults of the integrity check of a connection, and whether it was completed in time."""
    connection.set_progress_handler(_deadline(within_s), _STEPS)
    try:
        rows = connection.execute("PRAGMA integrity_check(20)").fetchall()
    except sqlite3.OperationalError as error:
        if error.sqlite_errorcode == sqlite3.SQLITE_INTERRUPT:
            return [], False
        raise
    finally:
        connection.set_progress_handler(None, 0)
    lines = [line for (text,) in rows for line in str(text).splitlines() if line != "ok"]
    return [line for line in lines if not line.startswith("***")] or lines, True


def _deadline(within_s: float | None) -> Callable[[], int]:
    end_s = None if within_s is None else time.monotonic() + within_s
    return lambda: int(end_s is not None and time.monotonic() > end_s)


def prepare_own(path: Path) -> None:
    """Create a database of ours if there was none; raise `UsageError` if it is missing or damaged.

    Its marks beside it (`handover.database.sqlite_integrity`) are created once, and compared from then on.
    """
    with _folder_lock(path.parent):
        require_sound(path)
        is_new = not path.exists()
        if is_new:
            if stamp_of(path).exists():
                made = f"{path} is missing, but {stamp_of(path).name} shows that it was created"
                raise UsageError(damage(f"{made} (delete that as well to start without data)"))
            _create(path)
        compared = marks.compare(path, START_CHECK_S, with_pages=not is_open(path))
        if compared.faults:
            raise UsageError(damage(compared.faults[0]))
        if compared.is_other:
            log.warning("another program has changed the file of the database", file=str(path))
        if compared.is_other or not compared.is_marked:
            marks.write_marks(path, _numbered)
            if not is_new:
                log.info("marks of the database created", file=str(path))


def renew_marks(path: Path) -> None:
    """Create the marks of a database of ours again, as it is. Raises `UsageError` if it is damaged."""
    with _folder_lock(path.parent):
        if (fault := fault_of_files(path)) is not None:
            raise UsageError(damage(fault))
        if faults := faults_of(path)[0]:
            raise UsageError(damage(f"{path}: {faults[0]}"))
        marks.write_marks(path, _numbered)


def unreleased_format(path: Path) -> str | None:
    """Return the format of a database of ours if it was never released; None for any other file.

    The file is opened read-only. Raises `sqlite3.Error` if it cannot be read.
    """
    if not path.exists():
        return None
    with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, timeout=5)) as database:
        for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'table' ORDER BY name"):
            if not str(name).endswith(UNRELEASED_SUFFIX):
                continue
            columns = [column[1] for column in database.execute(f'PRAGMA table_info("{name}")')]
            if columns == ["version"]:
                (version,) = database.execute(f'SELECT max(version) FROM "{name}"').fetchone()  # noqa: S608
                return f"format {version} of {str(name).removesuffix(UNRELEASED_SUFFIX)}"
    return None


def _number_in(database: sqlite3.Connection) -> int:
    ((number,),) = database.execute("PRAGMA application_id")
    return int(number)


def _create(path: Path) -> None:
    """Create an empty database atomically, so that a file of 0 bytes is always damage.

    Nobody else may read it, also where a command and not a service makes it. Its log inherits that.
    """
    with TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as folder:
        unfinished = marks.create(Path(folder), path.name, _random_number())
        unfinished.chmod(0o600)
        try:
            os.link(unfinished, path)
        except FileExistsError:
            return
        except OSError:  # a file system without hard links
            unfinished.replace(path)


def _numbered(database: sqlite3.Connection) -> int:
    """Return the number of a database, after writing a random one if it has none, in a transaction."""
    number = _number_in(database)
    if not number:
        number = _random_number()
        database.execute(f"PRAGMA application_id = {number}")
    return number


def _random_number() -> int:
    return secrets.randbelow(2**31 - 1) + 1


@contextmanager
def _folder_lock(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder: of several processes, one prepares databases in it at a time."""
    if sys.platform == "win32":
        yield
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)
