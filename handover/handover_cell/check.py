"""The complete check of all databases in the data directory: `handover check`."""

import sqlite3
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from handover.errors import UsageError
from handover.sqlite_files import faults_of, is_damage, require_sound
from handover.sqlite_integrity.marks import compare
from handover.sqlite_integrity.stamp import stamp_of

BROKER = "broker.db"


def databases(data_dir: Path) -> list[Path]:
    """Return the databases in a data directory, including those of which only the stamp or WAL is left."""
    found = set(data_dir.glob("*.db"))
    found |= {stamp.with_suffix("") for stamp in data_dir.glob("*.db.stamp")}
    if any(data_dir.glob("broker.log-*")):
        found.add(data_dir / BROKER)
    return sorted(found)


@dataclass(frozen=True, slots=True)
class Checked:
    """The faults of a database; `unreadable` is the reason, outside of the file, why it was not checked."""

    faults: list[str]
    unreadable: str | None = None


def check_database(path: Path) -> Checked:
    """Return the faults of a database, one line each."""
    faults: list[str] = []
    try:
        faults += _faults_of_broker(path) if path.name == BROKER else _faults_of(path)
    except UsageError as error:
        faults.append(str(error))
    except sqlite3.Error as error:
        if is_damage(error):
            faults.append(f"{path}: {error}")
        else:
            return Checked(faults, str(error))
    except OSError as error:
        return Checked(faults, str(error))
    return Checked(faults)


def _faults_of_broker(path: Path) -> Iterator[str]:
    from handover_broker.storage import check  # noqa: PLC0415 - not every check needs it

    yield from check.faults_in(path)


def _faults_of(path: Path) -> Iterator[str]:
    require_sound(path, within_s=0.0)
    if not path.exists():
        yield f"{path} is missing, but {stamp_of(path).name} shows that it was created"
        return
    faults, is_complete = faults_of(path)
    yield from (f"{path}: {fault}" for fault in faults)
    if not is_complete:
        raise OSError("it is busy, or the disk is full or read-only")
    yield from compare(path, None).faults


def faults_of_keys() -> list[str]:
    """Return the faults of the keys and tokens of an installation, one line each."""
    from handover_accounts.check import faults_in  # noqa: PLC0415 - it needs the database of accounts
    from handover_accounts.settings import AccountsSettings  # noqa: PLC0415 - as above

    return list(faults_in(AccountsSettings.load()))
