"""The way back: a backup becomes the data directory of a cell that has none yet, all of it or nothing."""

import os
import shutil
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

from handover.backup import postgres
from handover.backup.archive import DATA, POSTGRES, SETTINGS, Head, Manifest, read_archive
from handover.backup.contents import DATA_DIR
from handover.database.sqlite_files import renew_marks
from handover.errors import UsageError
from handover.files.folder_lock import holders_in

SETTINGS_FILE: Final = "restored.env"
SETTINGS_FOLDER: Final = "restored"

Check = Callable[[Path], list[str]]
"""Returns the faults of the databases in a folder."""


def require_free(folder: Path) -> None:
    """Raise `UsageError` if a cell runs on a data directory, or if there is anything in it."""
    if not folder.exists():
        return
    if not folder.is_dir():
        raise UsageError(f"{folder} is a file; name a folder that does not exist, or an empty one")
    if running := holders_in(folder):
        raise UsageError(
            f"a cell runs on {folder}: {'; '.join(running)}. Nothing was restored; stop it, and restore into "
            "another folder"
        )
    if any(folder.iterdir()):
        raise UsageError(
            f"{folder} is not empty; nothing was restored. Name a folder that does not exist (--data-dir), "
            "or move this one away"
        )


def restore(
    file: Path, passphrase: str | None, folder: Path, urls: Mapping[str, str], check: Check
) -> tuple[Head, Manifest]:
    """Restore a backup into `folder`; `urls` are the databases of the settings, for dumps.

    Everything is extracted and checked beside the folder first. Raises `UsageError` before any change.
    """
    require_free(folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix=f".{folder.name}.restoring-") as name:
        staging = Path(name)
        head, manifest = read_archive(file, passphrase, staging)
        data = staging / DATA
        data.mkdir(exist_ok=True)
        data.chmod(0o700)
        for marked in manifest.marked:
            renew_marks(staging / marked)
        if faults := check(data):
            raise UsageError(f"the restored databases are damaged: {faults[0]}; use another backup")
        _restore_dumps(staging, manifest, urls)
        if (staging / SETTINGS).exists():
            (staging / SETTINGS).rename(data / SETTINGS_FOLDER)
        _write_settings(data, folder, manifest)
        if folder.exists():
            folder.rmdir()
        data.rename(folder)
    return head, manifest


def _restore_dumps(staging: Path, manifest: Manifest, urls: Mapping[str, str]) -> None:
    if not manifest.dumps:
        return
    postgres.require_tools()
    for setting in manifest.dumps:
        if setting not in urls or not postgres.is_postgres(urls[setting]):
            raise UsageError(
                f"the backup has the PostgreSQL database of {setting}; set {setting} to an empty database"
            )
        postgres.require_empty(urls[setting], setting)
    for setting, dump in manifest.dumps.items():
        postgres.restore(urls[setting], staging / dump)
    shutil.rmtree(staging / POSTGRES)


def _write_settings(data: Path, folder: Path, manifest: Manifest) -> None:
    """Write the settings of the cell with the new places of its files, to be used as `.env`."""
    settings = {name: value for name, value in manifest.settings.items() if name not in manifest.dumps}
    for name, place in manifest.places.items():
        first, _, rest = place.partition("/")
        path = folder / (rest if first == DATA else f"{SETTINGS_FOLDER}/{rest}")
        is_database = settings.get(name, "").startswith("sqlite:")
        settings[name] = f"sqlite:///{path.absolute()}" if is_database else str(path.absolute())
    lines = [f"{name}={_quoted(value)}\n" for name, value in sorted(settings.items())]
    text = "".join(("# The settings of the restored cell; use this file as .env\n", *lines))
    file = data / SETTINGS_FILE
    file.touch(0o600)
    file.write_text(f"{text}{DATA_DIR}={_quoted(str(folder.absolute()))}\n", encoding="utf-8")
    if os.name == "posix":
        file.chmod(0o600)


def _quoted(value: str) -> str:
    escaped = value.replace("\\", "\\\\").replace("'", "\\'")
    return f"'{escaped}'"
