"""Migrations: the tables of a component are created, and brought to the version of this release.

Each component records the version of its tables in a table of its own, `<component>_version`, so that several
components may share a database. A migration is one transaction, and a SQLite file is copied beforehand. A
database of a later release, or of a format that was never released, is refused and not changed.
"""

import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from sqlalchemy import (
    Column,
    Connection,
    Engine,
    Integer,
    MetaData,
    Table,
    func,
    insert,
    inspect,
    select,
    text,
    update,
)

from handover.database.sqlite_files import UNRELEASED_SUFFIX
from handover.errors import UsageError
from handover.telemetry import get_logger

log = get_logger(__name__)

Step = Callable[[Connection], None]


def migrate(
    engine: Engine,
    tables: MetaData,
    *,
    component: str,
    version: int,
    steps: Mapping[int, Step] | None = None,
) -> None:
    """Bring the `tables` of `component` to `version` in one transaction; create all in a new database.

    `steps[n]` migrates from version n to n + 1. Raises `UsageError` if a later release has written the
    tables, or if their format was never released. Of replicas that start together one migrates, and the
    others wait for it.
    """
    with _alone(engine, component):
        _migrate(engine, tables, component, version, steps or {})


@contextmanager
def _alone(engine: Engine, component: str) -> Iterator[None]:
    """Hold the lock of the migrations of a component in a PostgreSQL database."""
    if engine.dialect.name != "postgresql":
        yield
        return
    name = {"name": f"handover migrations of {component}"}
    with engine.connect() as connection:
        connection.execute(text("SELECT pg_advisory_lock(hashtext(:name))"), name)
        connection.commit()
        try:
            yield
        finally:
            connection.execute(text("SELECT pg_advisory_unlock(hashtext(:name))"), name)
            connection.commit()


def _migrate(
    engine: Engine, tables: MetaData, component: str, version: int, steps: Mapping[int, Step]
) -> None:
    versions = _version_table(component)
    before = _version(engine, versions)
    if before is None:
        _refuse_unreleased(engine, component)
    elif before > version:
        raise UsageError(
            f"the database of {component} has version {before}, newer than {version}; "
            "install the newer release or use another database"
        )
    if before == version:
        _refuse_other_tables(engine, tables, component)
        return
    if before is not None:
        copy = _copy_file(engine, f"{component}.v{before}")
        log.warning("tables migrated", component=component, before=before, after=version, copy=str(copy))
    with engine.begin() as connection:
        if engine.dialect.name == "sqlite":
            connection.exec_driver_sql(
                "BEGIN IMMEDIATE"
            )  # the driver begins no transaction for DDL by itself
        if before is None:
            versions.create(connection, checkfirst=True)
            tables.create_all(connection)
            connection.execute(insert(versions).values(version=version))
            return
        connection.execute(select(versions).with_for_update())
        for step in range(before, version):
            steps[step](connection)
        connection.execute(update(versions).values(version=version))


def _refuse_unreleased(engine: Engine, component: str) -> None:
    if inspect(engine).has_table(f"{component}{UNRELEASED_SUFFIX}"):
        shown = engine.url.render_as_string(hide_password=True)
        raise UsageError(
            f"the tables of {component} in {shown} have a format that was never released, which this release "
            "does not read; use another database or schema"
        )


def _refuse_other_tables(engine: Engine, tables: MetaData, component: str) -> None:
    """Refuse tables of this version that lack some: a state between two releases has made them."""
    inspector = inspect(engine)
    for table in tables.sorted_tables:
        columns = inspector.get_columns(table.name) if inspector.has_table(table.name) else []
        present = {column["name"] for column in columns}
        missing = [column.name for column in table.columns if column.name not in present]
        if missing:
            shown = engine.url.render_as_string(hide_password=True)
            raise UsageError(
                f"the table {table.name} of {component} in {shown} has no {', '.join(missing)}: "
                "a version between two releases has made it, which this one does not read; "
                "use another database or schema"
            )


def _version_table(component: str) -> Table:
    return Table(f"{component}_version", MetaData(), Column("version", Integer, nullable=False))


def _version(engine: Engine, versions: Table) -> int | None:
    with engine.connect() as connection:
        if not inspect(connection).has_table(versions.name):
            return None
        return connection.execute(select(func.max(versions.c.version))).scalar()


def _copy_file(engine: Engine, label: str) -> Path | None:
    """Copy a SQLite file to one beside it that ends with `label`; return the path of the copy."""
    file = engine.url.database if engine.dialect.name == "sqlite" else None
    if not file or file == ":memory:":
        return None
    copy, partial = Path(f"{file}.{label}"), Path(f"{file}.{label}.part")
    partial.unlink(missing_ok=True)
    with engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
        connection.exec_driver_sql("VACUUM INTO ?", (str(partial),))
    with partial.open("rb+") as written:
        os.fsync(written.fileno())
    partial.replace(copy)
    return copy
