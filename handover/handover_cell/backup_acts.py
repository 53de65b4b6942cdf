"""What `handover backup` and `handover restore` do; apart from them, since it imports the database."""

import getpass
import os
import sqlite3
import sys
import tempfile
from collections.abc import Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Final

from handover.backup import contents, postgres, restoring
from handover.backup.archive import (
    DATA,
    POSTGRES,
    SETTINGS,
    ArchiveWriter,
    needs_passphrase,
    read_archive,
    written,
)
from handover.backup.sqlite_snapshot import SqliteSnapshot, is_database
from handover.errors import UsageError
from handover.files.private_files import UMASK
from handover.services import all_services, has_own_broker
from handover.settings import Settings
from handover_broker.settings import DATABASE
from handover_cell.check import check_database, databases

DATABASE_LOGS: Final = "broker.log-*"
FIRST: Final = ("orchestrator.db", DATABASE)
"""The snapshots that begin first, in this order; see `handover.backup`."""
MIN_PASSPHRASE_CHARS: Final = 12


def backup(file: Path, passphrase_file: Path | None, data_dir: Path | None, *, encrypt: bool) -> None:
    """Write everything that the cell knows into a new file. Raises `UsageError`."""
    os.umask(UMASK)
    if data_dir is not None:
        os.environ[contents.DATA_DIR] = str(data_dir.absolute())
    folder = Settings.load().data_dir.absolute()
    if not folder.is_dir():
        raise UsageError(f"there is no data directory {folder}; name that of the cell with --data-dir")
    if file.exists():
        raise UsageError(f"{file} exists; nothing was written. Choose another name")
    if not file.parent.is_dir():
        raise UsageError(f"the folder {file.parent} does not exist; create it first")
    passphrase = _passphrase(passphrase_file, is_new=True) if encrypt or passphrase_file is not None else None
    unfinished = _unfinished(file)
    unfinished.unlink(missing_ok=True)
    try:
        with written(unfinished, passphrase) as archive:
            _add_all(archive, folder, file.absolute())
        _, manifest = read_archive(unfinished, passphrase, None)
        unfinished.rename(file)
    except (OSError, sqlite3.Error) as error:
        raise UsageError(f"the backup was not made: {error}") from None
    finally:
        unfinished.unlink(missing_ok=True)
    size_mb = file.stat().st_size / 1e6
    print(f"{file}: {len(manifest.files)} files, {size_mb:.1f} MB, read again and complete")
    if passphrase is None:
        print("It has the secrets of the cell and is not encrypted; keep it as you keep secrets.")
    for line in manifest.left_out:
        print(f"left out  {line}")


def restore(file: Path, passphrase_file: Path | None, data_dir: Path | None) -> None:
    """Restore a file into an empty data directory. Raises `UsageError`."""
    os.umask(UMASK)
    folder = (Settings.load().data_dir if data_dir is None else data_dir).absolute()
    restoring.require_free(folder)
    passphrase = None
    if needs_passphrase(file):
        passphrase = _passphrase(passphrase_file, is_new=False)
    urls = dict(contents.database_settings([service.settings for service in all_services()]))
    try:
        head, manifest = restoring.restore(file, passphrase, folder, urls, _faults_in)
    except (OSError, sqlite3.Error) as error:
        raise UsageError(f"nothing was restored: {error}") from None
    print(f"{folder}: {len(manifest.files)} files as of {head.created_at} (Handover {head.release})")
    for line in manifest.left_out:
        print(f"left out  {line}")
    print(f"Its settings are in {folder / restoring.SETTINGS_FILE}: copy it as .env to where you start it.")
    print(f"Then: handover check --data-dir {folder}, and handover up --data-dir {folder}")


def _unfinished(file: Path) -> Path:
    return file.with_name(f".{file.name}.unfinished")


def _faults_in(folder: Path) -> list[str]:
    return [fault for path in databases(folder) for fault in check_database(path).faults]


def _passphrase(file: Path | None, *, is_new: bool) -> str:
    if file is not None:
        try:
            text = file.read_text(encoding="utf-8").strip("\r\n")
        except (OSError, UnicodeDecodeError) as error:
            raise UsageError(f"the passphrase file {file} cannot be read: {error}") from None
    elif sys.stdin.isatty():
        text = getpass.getpass("Passphrase: ")
        if is_new and getpass.getpass("Again: ") != text:
            raise UsageError("the two passphrases differ; nothing was written")
    else:
        raise UsageError("nobody can type a passphrase here; give it with --passphrase-file")
    if is_new and len(text) < MIN_PASSPHRASE_CHARS:
        raise UsageError(
            f"the passphrase has less than {MIN_PASSPHRASE_CHARS} characters; choose a longer one"
        )
    return text


def _add_all(archive: ArchiveWriter, folder: Path, target: Path) -> None:
    kinds = [service.settings for service in all_services()]
    parent = target.parent
    with (
        tempfile.TemporaryDirectory(dir=parent, prefix=f".{target.name}.copies-") as name,
        ExitStack() as stack,
    ):
        staging = Path(name)
        files = dict(contents.data_files(folder))
        _add_outside(archive, folder, kinds, files)
        own = {target, _unfinished(target)}
        files = {key: path for key, path in files.items() if path not in own}
        database_files = {key: path for key, path in files.items() if is_database(path)}
        dumps = _dumps(kinds, stack)
        snapshots = {
            key: stack.enter_context(closing(_snapshot(database_files[key], folder, staging)))
            for key in sorted(database_files, key=_order)
        }
        _add_dumps(archive, dumps, staging)
        _add_snapshots(archive, snapshots, staging, folder)
        logs = {f"{DATA}/{path.name}" for path in folder.glob(DATABASE_LOGS)}
        for key, path in files.items():
            if key not in database_files and key not in logs:
                _add_file(archive, key, path)
    archive.manifest.settings = contents.settings_in_force()
    if not has_own_broker():
        archive.manifest.left_out.append(
            f"the entities of the broker {Settings.load().broker_url}, which is not ours: back it up with "
            "its own tools"
        )
    if (folder / contents.LOGS).is_dir():
        archive.manifest.left_out.append(f"the texts that services have logged, {folder / contents.LOGS}")


def _snapshot(path: Path, folder: Path, staging: Path) -> SqliteSnapshot:
    from handover_broker.storage.online_copy import snapshot_with_log  # noqa: PLC0415 - heavy

    return snapshot_with_log(path, staging) if path == folder / DATABASE else SqliteSnapshot(path)


def _dumps(kinds: Sequence[type[Settings]], stack: ExitStack) -> dict[str, postgres.PostgresSnapshot]:
    """Begin the snapshots of the databases in PostgreSQL, the broker's last."""
    urls = {key: url for key, url in contents.database_settings(kinds) if postgres.is_postgres(url)}
    return {
        key: stack.enter_context(closing(postgres.PostgresSnapshot(urls[key], key)))
        for key in sorted(urls, key=lambda key: "DATABASE" in key)
    }


def _order(key: str) -> tuple[int, str]:
    name = key.rpartition("/")[2]
    return (FIRST.index(name) if name in FIRST else len(FIRST), key)


def _add_snapshots(
    archive: ArchiveWriter, snapshots: dict[str, SqliteSnapshot], staging: Path, folder: Path
) -> None:
    """Add each snapshot, and end it as soon as it is copied."""
    for number, (key, snapshot) in enumerate(snapshots.items()):
        is_broker = snapshot.path == folder / DATABASE
        copy = staging / (DATABASE if is_broker else f"{number}.db")
        snapshot.write(copy)
        snapshot.close()
        if is_broker and (faults := check_database(copy).faults):
            raise UsageError(f"{snapshot.path} is damaged: {faults[0]}; nothing was backed up")
        if snapshot.is_marked:
            archive.manifest.marked.append(key)
        archive.add(key, copy)
        for log in sorted(staging.glob(DATABASE_LOGS)) if is_broker else ():
            archive.add(f"{DATA}/{log.name}", log)
            log.unlink()
        copy.unlink()


def _add_dumps(archive: ArchiveWriter, dumps: dict[str, postgres.PostgresSnapshot], staging: Path) -> None:
    for setting, snapshot in dumps.items():
        key, copy = f"{POSTGRES}/{setting}.dump", staging / f"{setting}.dump"
        snapshot.write(copy)
        snapshot.close()
        archive.add(key, copy)
        archive.manifest.dumps[setting] = key
        copy.unlink()


def _add_outside(
    archive: ArchiveWriter, folder: Path, kinds: Sequence[type[Settings]], files: dict[str, Path]
) -> None:
    """Add to `files` what settings name, and note where each of these has its place."""
    named = list(contents.path_settings(kinds))
    for setting, url in contents.database_settings(kinds):
        path = contents.sqlite_file_of(url)
        if path is not None and path.exists():
            named.append((setting, path))
    for setting, path in named:
        if path.is_relative_to(folder):
            archive.manifest.places[setting] = f"{DATA}/{path.relative_to(folder).as_posix()}".rstrip("/.")
            continue
        files.update(contents.files_of_setting(setting, path))
        archive.manifest.places[setting] = f"{SETTINGS}/{setting}" + (
            "" if path.is_dir() else f"/{path.name}"
        )
        for text in contents.outside_references(path) if path.is_file() else ():
            archive.manifest.left_out.append(f"{text}, which {path} names outside of its folder")


def _add_file(archive: ArchiveWriter, key: str, path: Path) -> None:
    try:
        archive.add(key, path)
    except FileNotFoundError:
        return  # a service has just removed it
    except PermissionError as error:
        raise UsageError(
            f"{path} cannot be read: {error.strerror}; run the command as the user of the cell"
        ) from None
