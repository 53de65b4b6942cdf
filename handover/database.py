"""The database: SQLite in the data directory, or PostgreSQL by URL.

In both a committed transaction survives `kill -9` and a power cut.
"""

import sqlite3
from contextlib import suppress
from pathlib import Path
from typing import Any

from sqlalchemy import Engine, create_engine, event
from sqlalchemy.engine import make_url
from sqlalchemy.exc import ArgumentError, DBAPIError, NoSuchModuleError

from handover.errors import UsageError
from handover.sqlite_files import prepare_own, stamp_of, unreleased_format


def connect(
    url: str,
    *,
    setting: str = "HANDOVER_DATABASE_URL",
    answers_within_s: float | None = None,
    is_own: bool = True,
) -> Engine:
    """Return an engine for `url` (`sqlite:///…` or `postgresql://…`), the value of `setting`.

    Raises `UsageError` for other URLs, when the database cannot be opened, or when a file is damaged or, if
    it is our own, was deleted or emptied. `answers_within_s` limits connecting and each statement of
    PostgreSQL.
    """
    try:
        parsed = make_url(url)
        if parsed.drivername in {"postgresql", "postgres"}:
            parsed = parsed.set(drivername="postgresql+psycopg")
        if parsed.get_backend_name() not in {"sqlite", "postgresql"}:
            raise UsageError(_unusable(url, setting))
        if parsed.get_backend_name() == "sqlite" and parsed.database and parsed.database != ":memory:":
            file = Path(parsed.database)
            file.parent.mkdir(parents=True, exist_ok=True)
            if is_own:
                _prepare(file, setting)
        is_server = parsed.get_backend_name() == "postgresql"
        limits = _limits(answers_within_s) if is_server and answers_within_s is not None else {}
        engine = create_engine(parsed, pool_pre_ping=is_server, connect_args=limits)
    except (ArgumentError, NoSuchModuleError):
        raise UsageError(_unusable(url, setting)) from None
    if engine.dialect.name == "sqlite":
        event.listen(engine, "connect", _make_durable)
    try:
        engine.connect().close()
    except DBAPIError as error:
        reason = str(error.orig).strip().splitlines()[0]
        shown = parsed.render_as_string(hide_password=True)
        raise UsageError(
            f"the database {shown} cannot be used: {reason}; correct that or {setting}"
        ) from None
    return engine


def _prepare(file: Path, setting: str) -> None:
    """Raise `UsageError` if a file of ours is damaged, unreleased or not usable; it is not changed then."""
    with suppress(sqlite3.Error):  # a damaged file is reported below
        if (unreleased := unreleased_format(file)) is not None:
            raise UsageError(
                f"the database {file} has {unreleased}, which was never released and which this release does "
                f"not read; move {file.name} and {stamp_of(file).name} to another folder, or name another "
                f"database with {setting}"
            )
    try:
        prepare_own(file)
    except UsageError as error:
        raise UsageError(f"{error}; or name another database with {setting}") from None
    except (sqlite3.Error, OSError) as error:
        raise UsageError(f"the database {file} cannot be used: {error}; correct that or {setting}") from None


def _limits(seconds: float) -> dict[str, Any]:
    return {
        "connect_timeout": max(round(seconds), 2),
        "options": f"-c statement_timeout={round(seconds * 1000)}",
    }


def _unusable(url: str, setting: str) -> str:
    kind = url.split(":", 1)[0]
    return f'a database URL starts with sqlite:/// or postgresql://, not "{kind}"; correct {setting}'


def _make_durable(connection: Any, _: Any) -> None:
    cursor = connection.cursor()
    for pragma in ("journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON", "busy_timeout=5000"):
        cursor.execute(f"PRAGMA {pragma}")
    cursor.close()
