"""Dumps of PostgreSQL databases, by the tools of PostgreSQL: `pg_dump` makes one of a single snapshot."""

import os
import shutil
import subprocess
from pathlib import Path
from typing import Final

from sqlalchemy import create_engine, text
from sqlalchemy.engine import URL, make_url
from sqlalchemy.exc import SQLAlchemyError

from handover.database.outage import database_reason
from handover.errors import UsageError

_TABLES: Final = (
    "SELECT count(*) FROM pg_catalog.pg_tables WHERE schemaname NOT IN ('pg_catalog', 'information_schema')"
)


def is_postgres(url: str) -> bool:
    """Return whether a SQLAlchemy URL is of PostgreSQL."""
    return make_url(url).get_backend_name() == "postgresql"


def shown(url: str) -> str:
    """Return a database URL without its password."""
    return make_url(url).render_as_string(hide_password=True)


class PostgresSnapshot:
    """A database as of the moment at which this object was made; `close` ends it. Raises `UsageError`."""

    def __init__(self, url: str, setting: str) -> None:
        require_tools()
        self._url = url
        self._engine = create_engine(url, isolation_level="REPEATABLE READ")
        try:
            self._connection = self._engine.connect()
            self._id = str(self._connection.execute(text("SELECT pg_export_snapshot()")).scalar_one())
        except SQLAlchemyError as error:
            self._engine.dispose()
            raise UsageError(f"the database {shown(url)} of {setting}: {database_reason(error)}") from None

    def write(self, target: Path) -> None:
        """Dump the database into a new file, and check that the dump can be read. Raises `UsageError`."""
        target.touch(0o600, exist_ok=False)
        options = ("--format=custom", "--no-owner", "--no-privileges", f"--snapshot={self._id}")
        _run("pg_dump", self._url, *options, f"--file={target}")
        _run("pg_restore", None, "--list", str(target))

    def close(self) -> None:
        """End the snapshot."""
        self._connection.close()
        self._engine.dispose()


def require_empty(url: str, setting: str) -> None:
    """Raise `UsageError` if a database has tables, or cannot be reached."""
    engine = create_engine(url)
    try:
        with engine.connect() as connection:
            tables = int(connection.execute(text(_TABLES)).scalar_one())
    except SQLAlchemyError as error:
        raise UsageError(f"the database {shown(url)} of {setting}: {database_reason(error)}") from None
    finally:
        engine.dispose()
    if tables:
        raise UsageError(
            f"the database {shown(url)} of {setting} has {tables} tables already; nothing was restored. Set "
            f"{setting} to an empty database"
        )


def restore(url: str, source: Path) -> None:
    """Load a dump into an empty database, all of it or nothing. Raises `UsageError`."""
    _run(
        *("pg_restore", url, "--no-owner", "--no-privileges", "--exit-on-error", "--single-transaction"),
        str(source),
    )


def require_tools() -> None:
    """Raise `UsageError` if a tool of PostgreSQL is missing."""
    for name in ("pg_dump", "pg_restore"):
        if shutil.which(name) is None:
            raise UsageError(
                f"{name} is missing, which a database in PostgreSQL needs; install PostgreSQL's client "
                "programs (the package postgresql-client) of the server's version or a newer one"
            )


def _run(program: str, url: str | None, *arguments: str) -> None:
    environment = dict(os.environ)
    database: list[str] = []
    if url is not None:
        parsed = make_url(url)
        if parsed.password:
            environment["PGPASSWORD"] = str(parsed.password)  # not in the list of processes
        database = [f"--dbname={_plain(parsed)}"]
    ended = subprocess.run(  # noqa: S603 - a fixed program, found in PATH
        [shutil.which(program) or program, *database, *arguments],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    if ended.returncode:
        reason = " ".join(ended.stderr.split()) or f"exit code {ended.returncode}"
        raise UsageError(f"{program} failed: {reason[:1000]}")


def _plain(url: URL) -> str:
    """Return the URL as PostgreSQL's tools read it: without SQLAlchemy's driver and the password."""
    bare = URL.create("postgresql", url.username, None, url.host, url.port, url.database, url.query)
    return bare.render_as_string(hide_password=False)
