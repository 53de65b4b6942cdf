"""The tables of the orchestrator: created once, and refused if another release has written them."""

import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest
from sqlalchemy import Engine, inspect, text

from handover.database import connect
from handover.database.sqlite_integrity.marks import TABLE as COMMITS
from handover.errors import UsageError
from handover_processes.records.step import Step
from handover_processes.storage import schema
from handover_processes.storage.store import Store
from services.task_orchestrator.tests.unit.earlier_tables import MADE, take_back


def tables(engine: Engine) -> dict[str, list[str]]:
    inspector = inspect(engine)
    return {
        name: sorted(column["name"] for column in inspector.get_columns(name))
        for name in inspector.get_table_names()
        if name != COMMITS
    }


def test_a_new_database_has_the_version_and_a_second_start_changes_nothing(tmp_path: Path) -> None:
    engine = connect(f"sqlite:///{tmp_path / 'orchestrator.db'}")
    schema.migrate(engine)
    created = tables(engine)
    with engine.connect() as connection:
        assert connection.execute(text("SELECT version FROM orchestrator_version")).all() == [
            (schema.SCHEMA_VERSION,)
        ]
    schema.migrate(engine)
    assert tables(engine) == created
    engine.dispose()


@pytest.mark.parametrize("version", MADE)
def test_a_database_of_an_earlier_version_is_migrated(version: int, tmp_path: Path) -> None:
    assert max(MADE) + 1 == schema.SCHEMA_VERSION
    engine = connect(f"sqlite:///{tmp_path / 'orchestrator.db'}")
    schema.migrate(engine)
    created = tables(engine)
    with engine.begin() as connection:
        take_back(connection, version)
        connection.execute(
            text(
                "INSERT INTO orchestrator_messages (id, name, key, variables, sent_at, expires_at) "
                "VALUES ('m', 'go', 'null', '{}', :at, :at)"
            ),
            {"at": "2026-05-04T08:00:00+00:00"},
        )
    schema.migrate(engine)
    assert tables(engine) == created
    (stored,) = Store(engine).stored_messages()
    assert (stored.id, stored.process) == ("m", None)
    engine.dispose()


def test_postgresql_has_the_same_tables(new_database: Callable[[], str], tmp_path: Path) -> None:
    sqlite = connect(f"sqlite:///{tmp_path / 'orchestrator.db'}")
    postgresql = connect(new_database())
    for engine in (sqlite, postgresql):
        store = Store(engine)
        store.migrate()
        store.write(Step(1, delivered=[1]))
        store.lock.release()
    assert tables(sqlite) == tables(postgresql)
    sqlite.dispose()
    postgresql.dispose()


def test_a_database_of_a_later_release_is_refused_in_one_line_and_not_changed(tmp_path: Path) -> None:
    engine = connect(f"sqlite:///{tmp_path / 'orchestrator.db'}")
    schema.migrate(engine)
    with engine.begin() as connection:
        connection.execute(text("UPDATE orchestrator_version SET version = 99"))
        connection.execute(text("DROP TABLE orchestrator_start_timers"))
    before = tables(engine)
    refused = rf"^the database .* version 99, newer than {schema.SCHEMA_VERSION}; install [^\n]*$"
    with pytest.raises(UsageError, match=refused):
        schema.migrate(engine)
    assert tables(engine) == before
    engine.dispose()


def test_a_file_of_an_unreleased_format_is_refused_and_not_changed(tmp_path: Path) -> None:
    file = tmp_path / "orchestrator.db"
    with closing(sqlite3.connect(file)) as database:
        database.execute("CREATE TABLE orchestrator_schema (version INTEGER NOT NULL)")
        database.execute("INSERT INTO orchestrator_schema VALUES (3)")
        database.commit()
    before = file.read_bytes()
    with pytest.raises(UsageError, match=r"format 3 of orchestrator, which was never released .* move "):
        connect(f"sqlite:///{file}")
    assert file.read_bytes() == before
