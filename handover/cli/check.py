"""The complete check of all databases in the data directory: `handover check`."""

import sqlite3
from collections.abc import Iterator
from pathlib import Path

from handover.errors import UsageError
from handover.sqlite_files import fault_of_stamp, faults_of, require_sound

BROKER = "broker.db"


def databases(data_dir: Path) -> list[Path]:
    """Return the databases in a data directory, including those of which only the stamp or WAL is left."""
    found = set(data_dir.glob("*.db"))
    found |= {stamp.with_suffix("") for stamp in data_dir.glob("*.db.stamp")}
    if any(data_dir.glob("broker.log-*")):
        found.add(data_dir / BROKER)
    return sorted(found)


def faults_in(path: Path) -> Iterator[str]:
    """Yield the faults of a database, one line each."""
    if path.name == BROKER:
        from services.context_broker.storage import check  # noqa: PLC0415 - not every check needs it

        yield from check.faults_in(path)
        return
    try:
        require_sound(path, within_s=0.0)
        yield from (f"{path}: {fault}" for fault in faults_of(path)[0])
        if (fault := fault_of_stamp(path)) is not None:
            yield fault
    except UsageError as error:
        yield str(error)
    except sqlite3.Error as error:
        yield f"{path}: {error}"
