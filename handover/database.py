"""The database: SQLite in the data directory, or PostgreSQL by URL.

Either way a committed transaction survives `kill -9` and a power cut.
"""

from pathlib import Path
from typing import Any

from sqlalchemy import Engine, create_engine, event
from sqlalchemy.engine import make_url
from sqlalchemy.exc import ArgumentError, NoSuchModuleError, OperationalError

from handover.errors import UsageError


def connect(url: str) -> Engine:
    """Return an engine for `url` (`sqlite:///…` or `postgresql://…`).

    Raises `UsageError` for any other, and when the database cannot be reached or opened.
    """
    try:
        parsed = make_url(url)
        if parsed.drivername in {"postgresql", "postgres"}:
            parsed = parsed.set(drivername="postgresql+psycopg")
        if parsed.get_backend_name() not in {"sqlite", "postgresql"}:
            raise UsageError(_unusable(url))
        if parsed.get_backend_name() == "sqlite" and parsed.database:
            Path(parsed.database).parent.mkdir(parents=True, exist_ok=True)
        engine = create_engine(parsed, pool_pre_ping=parsed.get_backend_name() == "postgresql")
    except (ArgumentError, NoSuchModuleError):
        raise UsageError(_unusable(url)) from None
    if engine.dialect.name == "sqlite":
        event.listen(engine, "connect", _make_durable)
    try:
        engine.connect().close()
    except OperationalError as error:
        reason = str(error.orig).strip().splitlines()[0]
        shown = parsed.render_as_string(hide_password=True)
        raise UsageError(
            f"the database {shown} cannot be used: {reason}; mend that or correct HANDOVER_DATABASE_URL"
        ) from None
    return engine


def _unusable(url: str) -> str:
    kind = url.split(":", 1)[0]
    return (
        f'a database URL starts with sqlite:/// or postgresql://, not "{kind}"; correct HANDOVER_DATABASE_URL'
    )


def _make_durable(connection: Any, _: Any) -> None:
    cursor = connection.cursor()
    for pragma in ("journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON", "busy_timeout=5000"):
        cursor.execute(f"PRAGMA {pragma}")
    cursor.close()
