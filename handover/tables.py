"""Tables: what one room of a service keeps in the database is created, and brought forward, by itself.

A room counts the versions of its tables in a table of its own, so that several may share a database. A SQLite
file is copied beside itself before an older room is brought forward; a newer one is left alone.
"""

import os
from collections.abc import Callable, Mapping
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
    update,
)

from handover.errors import UsageError
from handover.telemetry import get_logger

log = get_logger(__name__)

Step = Callable[[Connection], None]


def bring_forward(
    engine: Engine, tables: MetaData, *, room: str, version: int, steps: Mapping[int, Step] | None = None
) -> None:
    """Bring the `tables` of `room` to `version` in one transaction; all are created where none are.

    `steps[n]` leads from version n to n + 1. The version is kept in the table `<room>_schema`. Raises
    `UsageError` if a later release has written them.
    """
    versions = _versions(room)
    before = _version(engine, versions)
    if before is not None and before > version:
        raise UsageError(
            f"the database of {room} has version {before}, newer than {version}; "
            "install the newer release or take another database"
        )
    if before == version:
        return
    if before is not None:
        copy = _copy_beside(engine, f"{room}.v{before}")
        log.warning("tables are brought forward", room=room, before=before, after=version, copy=str(copy))
    with engine.begin() as connection:
        if engine.dialect.name == "sqlite":
            connection.exec_driver_sql("BEGIN IMMEDIATE")  # unasked, the driver begins none for DDL
        if before is None:
            versions.create(connection, checkfirst=True)
            tables.create_all(connection)
            connection.execute(insert(versions).values(version=version))
            return
        connection.execute(select(versions).with_for_update())
        for step in range(before, version):
            (steps or {})[step](connection)
        connection.execute(update(versions).values(version=version))


def _versions(room: str) -> Table:
    return Table(f"{room}_schema", MetaData(), Column("version", Integer, nullable=False))


def _version(engine: Engine, versions: Table) -> int | None:
    with engine.connect() as connection:
        if not inspect(connection).has_table(versions.name):
            return None
        return connection.execute(select(func.max(versions.c.version))).scalar()


def _copy_beside(engine: Engine, label: str) -> Path | None:
    """Copy a SQLite file to one beside it that ends with `label`; return where it is."""
    file = engine.url.database if engine.dialect.name == "sqlite" else None
    if not file or file == ":memory:":
        return None
    copy, being_written = Path(f"{file}.{label}"), Path(f"{file}.{label}.part")
    being_written.unlink(missing_ok=True)
    with engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
        connection.exec_driver_sql("VACUUM INTO ?", (str(being_written),))
    with being_written.open("rb+") as written:
        os.fsync(written.fileno())
    being_written.replace(copy)
    return copy
