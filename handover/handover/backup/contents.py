"""What belongs to a cell: its data directory, the files that settings name, and its databases.

What can be made again is left out: logs of services, lock files, and the files that SQLite and its marks keep
beside a database. A database is copied by a snapshot wherever it is, every other file as it is.
"""

import os
import stat
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import yaml
from dotenv import dotenv_values
from sqlalchemy.engine import make_url

from handover.backup.archive import DATA, SETTINGS
from handover.backup.postgres import is_postgres
from handover.settings import ENV_FILE, PREFIX, Settings

DATA_DIR: Final = f"{PREFIX}DATA_DIR"
LOGS: Final = "logs"
_BESIDE_DATABASES: Final = ("-wal", "-shm", "-journal", ".stamp", ".pages", ".pages.new", ".reserve")
_TEMPORARY: Final = (".lock", ".new", ".unfinished")
_DATABASE_URL: Final = "database_url"
_URL_FIELDS: Final = frozenset({"database_url", "specification_url"})
MAX_CELL_FILE_BYTES: Final = 1024 * 1024


def data_files(folder: Path) -> Iterator[tuple[str, Path]]:
    """Yield the name in the archive and the path of each file of a data directory to keep."""
    for path in _files_in(folder):
        parts = path.relative_to(folder).parts
        if parts[0] == LOGS or path.name.endswith(_TEMPORARY):
            continue
        if any(path.name.endswith(end) and _has_database(path, end) for end in _BESIDE_DATABASES):
            continue
        yield "/".join((DATA, *parts)), path


def _has_database(path: Path, end: str) -> bool:
    return path.with_name(path.name.removesuffix(end)).exists()


def _files_in(folder: Path) -> Iterator[Path]:
    for where, folders, names in os.walk(folder):
        folders.sort()
        for name in sorted(names):
            path = Path(where) / name
            try:
                if stat.S_ISREG(path.stat().st_mode):
                    yield path
            except FileNotFoundError:
                continue  # a temporary file that is gone, or a link to nothing


def settings_in_force() -> dict[str, str]:
    """Return the settings of the file `.env` and of the environment, as environment variables."""
    variables = {**dotenv_values(ENV_FILE), **os.environ}
    names = sorted(name for name in variables if name.upper().startswith(PREFIX) and name.upper() != DATA_DIR)
    return {name.upper(): value for name in names if (value := variables[name]) is not None}


def path_settings(all_settings: Iterable[type[Settings]]) -> Iterator[tuple[str, Path]]:
    """Yield each setting that names an existing file or folder, except the data directory."""
    for name, value in _values(all_settings):
        if name == DATA_DIR or value is None or not str(value):
            continue
        if isinstance(value, Path) and value.exists():
            yield name, value.absolute()


def database_settings(all_settings: Iterable[type[Settings]]) -> Iterator[tuple[str, str]]:
    """Yield each setting that is the URL of a database, with its password; a database once."""
    seen: set[str] = set()
    for name, value in _values(all_settings):
        field = name.removeprefix(PREFIX).lower()
        if not value or (field not in _URL_FIELDS and not field.endswith(_DATABASE_URL)):
            continue
        url = Settings.load().with_password(str(value))
        if url not in seen:
            seen.add(url)
            yield name, url


def sqlite_file_of(url: str) -> Path | None:
    """Return the file of a SQLite URL; None for PostgreSQL."""
    database = None if is_postgres(url) else make_url(url).database
    return None if not database or database == ":memory:" else Path(database).absolute()


def _values(all_settings: Iterable[type[Settings]]) -> Iterator[tuple[str, Any]]:
    seen: set[str] = set()
    for kind in all_settings:
        loaded = kind.load()
        for field in kind.model_fields:
            if field not in seen:
                seen.add(field)
                yield f"{PREFIX}{field}".upper(), getattr(loaded, field)


def files_of_setting(name: str, path: Path) -> Iterator[tuple[str, Path]]:
    """Yield the files of a setting: the file and what it refers to beside it, or the files of its folder."""
    base = f"{SETTINGS}/{name}"
    if path.is_dir():
        for file in _files_in(path):
            yield f"{base}/{file.relative_to(path).as_posix()}", file
        return
    yield f"{base}/{path.name}", path
    taken = {path}
    for reference in _references_in(path):
        for file in _files_in(reference) if reference.is_dir() else (reference,):
            if file not in taken:
                taken.add(file)
                yield f"{base}/{file.relative_to(path.parent).as_posix()}", file


def outside_references(path: Path) -> list[str]:
    """Return what a file refers to that is not in its folder."""
    return [text for text, target in _texts_with_files(path) if not target.is_relative_to(path.parent)]


def _references_in(path: Path) -> Iterator[Path]:
    """Yield the files and folders beside `path` that it names, such as the scene of a cell file."""
    for _, target in _texts_with_files(path):
        if target.is_relative_to(path.parent) and target != path.parent:
            # The description of a robot has its meshes in its folder.
            has_meshes = target.suffix in {".urdf", ".xacro"} and target.parent != path.parent
            yield target.parent if has_meshes else target


def _texts_with_files(path: Path) -> Iterator[tuple[str, Path]]:
    if path.suffix not in {".yaml", ".yml"} or path.stat().st_size > MAX_CELL_FILE_BYTES:
        return
    try:
        written = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError):
        return
    for text in _texts_in(written):
        target = Path(os.path.normpath(path.parent / text))
        is_path = "/" in text or "." in text
        if is_path and len(text) < 1000 and "\0" not in text and os.path.lexists(target):
            yield text, target


def _texts_in(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        for inner in value.values():
            yield from _texts_in(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from _texts_in(inner)
