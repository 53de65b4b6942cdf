"""SQLite files: whether one is sound, looked at before anything is written to it. Only the standard library.

SQLite keeps no checksums of its pages. Its integrity check finds pages, indexes and rows that do not fit
together; what a table itself can tell of its rows is checked by its owner.
"""

import os
import secrets
import sqlite3
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from tempfile import NamedTemporaryFile, TemporaryDirectory
from typing import Final

from handover.errors import UsageError

UNRELEASED_SUFFIX: Final = "_schema"
"""Formats before the first release recorded their version in a table `<component>_schema`."""
START_CHECK_S: Final = 1.0
"""How long a start waits for the integrity check at most; `handover check` completes it."""
_STEPS: Final = 20_000
"""Steps of SQLite's virtual machine between two looks at the clock: some milliseconds."""
_NO_DAMAGE: Final = frozenset(
    {
        sqlite3.SQLITE_BUSY,
        sqlite3.SQLITE_LOCKED,
        sqlite3.SQLITE_CANTOPEN,
        sqlite3.SQLITE_FULL,
        sqlite3.SQLITE_IOERR,
        sqlite3.SQLITE_READONLY,
    }
)
"""Errors of which the cause is around the file, such as a full disk; the check is not completed then."""
REMEDY: Final = (
    "restore the data directory from a backup (deploy/restore, or a copy of the whole folder); "
    "`handover check` lists all damage"
)


def require_sound(path: Path, within_s: float = START_CHECK_S) -> bool:
    """Raise `UsageError` if a file that exists is damaged; say whether all of it was looked at in time.

    The message names the file, the damage and the remedy. A file that is busy is not waited for.
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
    """Return why a database is not used in one line; `fault` names the file and what is wrong with it."""
    return f"damaged data: {fault}; {REMEDY}"


def fault_of_files(path: Path) -> str | None:
    """Return what is wrong with the files of a database, by their names and sizes alone; None if nothing."""
    wal = path.with_name(f"{path.name}-wal")
    if not path.exists():
        if wal.exists() and wal.stat().st_size:
            return f"{path} is missing, while {wal.name} beside it holds changes of it"
        return None
    return None if path.stat().st_size else f"{path} is empty (0 bytes), where a database was made"


def faults_of(path: Path, within_s: float | None = None) -> tuple[list[str], bool]:
    """Return what SQLite's integrity check finds, and whether it was completed in time.

    Nothing is written; `sqlite3.Error` is a fault too, unless the file is only busy.
    """
    try:
        with closing(
            sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, timeout=5)
        ) as connection:
            return integrity_faults(connection, within_s)
    except sqlite3.OperationalError as error:
        if error.sqlite_errorcode & 0xFF in _NO_DAMAGE:
            return [], False
        return [str(error)], True
    except sqlite3.DatabaseError as error:
        return [str(error)], True


def integrity_faults(connection: sqlite3.Connection, within_s: float | None = None) -> tuple[list[str], bool]:
    """Return what the integrity check finds over a connection, and whether it was completed in time."""
    connection.set_progress_handler(_deadline(within_s), _STEPS)
    try:
        rows = connection.execute("PRAGMA integrity_check(20)").fetchall()
    except sqlite3.OperationalError as error:
        if error.sqlite_errorcode == sqlite3.SQLITE_INTERRUPT:
            return [], False
        raise
    finally:
        connection.set_progress_handler(None, 0)
    found = [line for (text,) in rows for line in str(text).splitlines() if line != "ok"]
    return [line for line in found if not line.startswith("***")] or found, True


def _deadline(within_s: float | None) -> Callable[[], int]:
    end_s = None if within_s is None else time.monotonic() + within_s
    return lambda: int(end_s is not None and time.monotonic() > end_s)


def prepare_own(path: Path) -> None:
    """Make a database of ours if there is none yet; raise `UsageError` if there was one, or it is damaged.

    Beside it stands `….stamp` with the number that is in its header (`application_id`): a database that was
    deleted, or replaced by an empty one or by another one, is not taken for a new one.
    """
    require_sound(path)
    if (fault := fault_of_stamp(path)) is not None:
        raise UsageError(damage(fault))
    if not path.exists():
        _make_stamped(path)
    stamp = stamp_of(path)
    if not stamp.exists():
        with closing(sqlite3.connect(path, timeout=5)) as database:
            number = _number_in(database) or _stamped(database)
        _replace(stamp, f"{number:08x}\n")


def unreleased_format(path: Path) -> str | None:
    """Return which format that was never released a database of ours has; None for any other file.

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


def fault_of_stamp(path: Path) -> str | None:
    """Return what is wrong by what the stamp beside a database says; None if nothing, or if there is none."""
    stamp = stamp_of(path)
    if not stamp.exists():
        return None
    if not path.exists():
        made = f"{path} is missing, while {stamp.name} says that it was made"
        return f"{made} (delete that too to begin with none)"
    with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, timeout=5)) as database:
        if stamp.read_text().strip() != f"{_number_in(database):08x}":
            return (
                f"{path} is empty, or another database than the one of {stamp.name} "
                "(delete that if this database is the right one)"
            )
    return None


def stamp_of(path: Path) -> Path:
    """Return the file beside a database that holds the number of its header."""
    return path.with_name(f"{path.name}.stamp")


def _number_in(database: sqlite3.Connection) -> int:
    ((number,),) = database.execute("PRAGMA application_id")
    return int(number)


def _make_stamped(path: Path) -> None:
    """Make an empty database whole under another name first, so that one of 0 bytes is always damaged.

    Of several processes that make it at the same time, the first one succeeds, and the others use its file.
    """
    with TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as folder:
        unfinished = Path(folder) / path.name
        with closing(sqlite3.connect(unfinished)) as database:
            _stamped(database)
        try:
            os.link(unfinished, path)
        except FileExistsError:
            return
        except OSError:  # a file system without hard links
            unfinished.replace(path)


def _stamped(database: sqlite3.Connection) -> int:
    """Return the number in a database, after writing a random one if it has none; others wait meanwhile."""
    database.execute("BEGIN IMMEDIATE")
    number = _number_in(database)
    if not number:
        number = secrets.randbelow(2**31 - 1) + 1
        database.execute(f"PRAGMA application_id = {number}")
    database.commit()
    return number


def _replace(file: Path, text: str) -> None:
    """Write a small file such that it is there as a whole or not at all, also after a power cut."""
    with NamedTemporaryFile("w", dir=file.parent, prefix=f".{file.name}.", delete=False) as new:
        new.write(text)
        new.flush()
        os.fsync(new.fileno())
    Path(new.name).chmod(0o644)
    Path(new.name).replace(file)
