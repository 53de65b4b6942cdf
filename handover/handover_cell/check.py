"""The complete check of all databases in the data directory: `handover check`."""

import sqlite3
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from handover.command_line.foreground import DataDir, say, settings_in
from handover.database.sqlite_files import REMEDY, faults_of, is_damage, renew_marks, require_sound
from handover.database.sqlite_integrity.marks import compare
from handover.database.sqlite_integrity.stamp import stamp_of
from handover.errors import UsageError
from handover.files.private_files import faults_of as faults_of_files
from handover.files.private_files import owner_of
from handover_broker.settings import DATABASE

app = typer.Typer()


def databases(data_dir: Path) -> list[Path]:
    """Return the databases in a data directory, including those of which only the stamp or WAL is left."""
    files = set(data_dir.glob("*.db"))
    files |= {stamp.with_suffix("") for stamp in data_dir.glob("*.db.stamp")}
    if any(data_dir.glob("broker.log-*")):
        files.add(data_dir / DATABASE)
    return sorted(files)


@dataclass(frozen=True, slots=True)
class DatabaseFaults:
    """The faults of a database; `unreadable` is the reason, outside of the file, why it was not checked."""

    faults: list[str]
    unreadable: str | None = None


def check_database(path: Path) -> DatabaseFaults:
    """Return the faults of a database, one line each."""
    faults: list[str] = []
    try:
        faults += _faults_of_broker(path) if path.name == DATABASE else _faults_of(path)
    except UsageError as error:
        faults.append(str(error))
    except sqlite3.Error as error:
        if is_damage(error):
            faults.append(f"{path}: {error}")
        else:
            return DatabaseFaults(faults, str(error))
    except OSError as error:
        return DatabaseFaults(faults, str(error))
    return DatabaseFaults(faults)


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


@app.command()
def check(
    data_dir: DataDir = None,
    restamp: Annotated[
        bool,
        typer.Option(help="Create the marks of sound databases again, after you replaced a file yourself."),
    ] = False,
) -> None:
    """Check all databases, keys and tokens in the data directory completely.

    Exit code 0: all are sound; 1: one is damaged, others can read it, or it could not be checked; 2: there is
    no data directory. What cannot be read, on a full disk for example, is named; it is not damaged.
    """
    folder = settings_in(data_dir).data_dir
    if not folder.is_dir():
        raise UsageError(
            f"there is no data directory {folder.absolute()}; name that of the cell with --data-dir, or run "
            "this command in the folder of the cell"
        )
    files = databases(folder)
    if not files:
        say(f"there is no database in {folder.absolute()}")
    is_damaged = is_unknown = False
    for path in files:
        if restamp and path.name != DATABASE:
            renew_marks(path)
        result = check_database(path)
        is_damaged = is_damaged or bool(result.faults)
        for fault in result.faults:
            say(f"damaged  {fault}")
        is_unknown = is_unknown or result.unreadable is not None
        if result.unreadable:
            say(f"unknown  {path}: {result.unreadable}")
        elif not result.faults:
            say(f"ok       {path}")
    key_faults = faults_of_keys()
    for fault in key_faults:
        say(f"damaged  {fault}")
    readable = list(faults_of_files(folder))
    for line in readable:
        say(f"open     {line}")
    if (owner := owner_of(folder)) is not None:
        say(f"accepted {owner}")
    if is_damaged:
        say(f"remedy: {REMEDY}")
    if is_damaged or is_unknown or key_faults or readable:
        raise typer.Exit(1)
