"""The schema: a database of an earlier release is brought forward whole; a later one is left alone.

`schema_v1.sql` was written by the first release: of three processes, one runs, one failed, one completed.
"""

import sqlite3
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from sqlalchemy import Engine, inspect, text

from datamodels.entities import TaskStatus
from handover.database import connect
from handover.errors import UsageError
from services.task_orchestrator import schema
from services.task_orchestrator.records import Step
from services.task_orchestrator.store import Store
from tests.unit.task_orchestrator.drawing import NOW

FIRST_RELEASE = Path(__file__).parent / "schema_v1.sql"


@pytest.fixture
def old(tmp_path: Path) -> Path:
    """Return the database file of the first release."""
    file = tmp_path / "orchestrator.db"
    connection = sqlite3.connect(file)
    connection.executescript(FIRST_RELEASE.read_text())
    connection.close()
    return file


@pytest.fixture
def engine(old: Path) -> Iterator[Engine]:
    engine = connect(f"sqlite:///{old}")
    yield engine
    engine.dispose()


def tables(engine: Engine) -> dict[str, list[str]]:
    look = inspect(engine)
    return {
        name: sorted(column["name"] for column in look.get_columns(name)) for name in look.get_table_names()
    }


def indexes(engine: Engine) -> set[str | None]:
    look = inspect(engine)
    return {index["name"] for name in look.get_table_names() for index in look.get_indexes(name)}


def test_a_database_of_the_first_release_is_brought_forward_and_nothing_is_lost(engine: Engine) -> None:
    store = Store(engine)
    store.migrate()
    records = {record.id: record for record in store.processes(["p-running", "p-failed", "p-completed"])}
    assert {name: record.status.value for name, record in records.items()} == {
        "p-running": "inProgress",
        "p-failed": "failed",
        "p-completed": "completed",
    }
    assert records["p-running"].state is not None
    assert all(record.failed_by is None and record.acts == () for record in records.values())
    assert len(store.outbox()) == 19
    first, second = store.tasks("p-running")
    assert (first.status, first.took_ms) == (TaskStatus.COMPLETED, 7250)
    assert second.took_ms is None
    assert store.counts("p", 1).elements["first"].median_ms == 14500
    store.write(Step(100, processes={}, delivered=[1]))
    store.migrate()
    assert len(store.outbox()) == 18


def test_brought_forward_it_is_the_same_as_a_new_one(engine: Engine, tmp_path: Path) -> None:
    schema.migrate(engine)
    new = connect(f"sqlite:///{tmp_path / 'new.db'}")
    schema.migrate(new)
    assert tables(engine) == tables(new)
    assert indexes(engine) == indexes(new)
    new.dispose()


def test_a_copy_of_the_file_is_kept_as_it_was(engine: Engine, old: Path) -> None:
    (old.parent / "orchestrator.db.orchestrator.v1.part").write_text("left by a power cut")
    schema.migrate(engine)
    assert sorted(file.name for file in old.parent.glob("orchestrator.db.*v1*")) == [
        "orchestrator.db.orchestrator.v1"
    ]
    copy = sqlite3.connect(old.parent / "orchestrator.db.orchestrator.v1")
    original = sqlite3.connect(":memory:")
    original.executescript(FIRST_RELEASE.read_text())
    assert list(copy.iterdump()) == list(original.iterdump())
    copy.close()
    original.close()


def test_a_migration_that_breaks_off_leaves_the_database_as_it_was(
    engine: Engine, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = tables(engine)
    migration = schema._MIGRATIONS[1]

    def power_cut(connection: object) -> None:
        migration(connection)  # type: ignore[arg-type]
        raise OSError("the power has failed")

    monkeypatch.setitem(schema._MIGRATIONS, 1, power_cut)  # type: ignore[arg-type]
    with pytest.raises(OSError, match="power"):
        schema.migrate(engine)
    assert tables(engine) == before
    monkeypatch.undo()
    schema.migrate(engine)
    assert "failed_by" in tables(engine)["orchestrator_processes"]


def test_a_database_of_a_later_release_is_refused_in_one_line_and_left_alone(engine: Engine) -> None:
    with engine.begin() as connection:
        connection.execute(text("UPDATE orchestrator_schema SET version = 99"))
        connection.execute(text("DROP TABLE orchestrator_timers"))
    before = tables(engine)
    with pytest.raises(UsageError, match=r"^the database .* version 99, newer than 3; install [^\n]*$"):
        schema.migrate(engine)
    assert tables(engine) == before


def test_postgresql_is_brought_forward_too(new_database: Callable[[], str]) -> None:
    engine = connect(new_database())
    new = Store(engine)
    new.migrate()
    columns, lines = tables(engine), indexes(engine)
    with engine.begin() as connection:
        connection.execute(text("UPDATE orchestrator_schema SET version = 1"))
        for column in (
            "processes DROP COLUMN failed_by",
            "processes DROP COLUMN acts",
            "tasks DROP took_ms",
            "processes DROP COLUMN archived_at CASCADE",
            "processes DROP COLUMN reason_message",
        ):
            connection.execute(text(f"ALTER TABLE orchestrator_{column}"))
        later = ("status_started", "definition_started", "ended", "to_archive")
        for index in ("started", "definition", *later):
            connection.execute(text(f"DROP INDEX IF EXISTS orchestrator_processes_{index}"))
        connection.execute(text("DROP INDEX orchestrator_tasks_unfinished"))
        task = {"id": "t", "process": "p", "element": "work", "token": "x", "status": "completed"}
        times = {"created_at": NOW.isoformat(), "deadline": NOW.isoformat()}
        values = {**task, **times, "ended_at": "2026-05-04T08:00:01.500000+00:00"}
        connection.execute(
            text(
                "INSERT INTO orchestrator_tasks (id, process, element, token, status, created_at,"
                " deadline, ended_at, visit, moves, alerted, lost, entity) VALUES (:id, :process,"
                " :element, :token, :status, :created_at, :deadline, :ended_at, 1, 0, false, 0, '{}')"
            ),
            values,
        )
    new.migrate()
    assert (tables(engine), indexes(engine)) == (columns, lines)
    with engine.connect() as connection:
        assert connection.execute(text("SELECT took_ms FROM orchestrator_tasks")).scalar() == 1500
    engine.dispose()
