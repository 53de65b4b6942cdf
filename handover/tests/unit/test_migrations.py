"""Tables are created and migrated, with a copy of the file; newer and unreleased formats are refused."""

import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import pytest
from sqlalchemy import Column, Connection, Engine, Integer, MetaData, Table, Text, inspect

from handover.database import connect
from handover.database.migrations import migrate
from handover.database.sqlite_files import unreleased_format
from handover.errors import UsageError

FIRST, SECOND = MetaData(), MetaData()
Table("thing", FIRST, Column("id", Integer, primary_key=True))
Table("thing", SECOND, Column("id", Integer, primary_key=True), Column("colour", Text))


def add_colour(connection: Connection) -> None:
    connection.exec_driver_sql("ALTER TABLE thing ADD COLUMN colour TEXT")


@pytest.fixture
def engine(tmp_path: Path) -> Iterator[Engine]:
    engine = connect(f"sqlite:///{tmp_path / 'lamp.db'}")
    yield engine
    engine.dispose()


def test_older_tables_are_migrated_after_the_file_is_copied(engine: Engine, tmp_path: Path) -> None:
    migrate(engine, FIRST, component="lamp", version=1)
    migrate(engine, FIRST, component="lamp", version=1)
    assert not (tmp_path / "lamp.db.lamp.v1").exists()
    with engine.begin() as connection:
        connection.exec_driver_sql("INSERT INTO thing (id) VALUES (7)")
    migrate(engine, SECOND, component="lamp", version=2, steps={1: add_colour})
    assert [column["name"] for column in inspect(engine).get_columns("thing")] == ["id", "colour"]
    with engine.connect() as connection:
        assert connection.exec_driver_sql("SELECT id, colour FROM thing").all() == [(7, None)]
    copy = connect(f"sqlite:///{tmp_path / 'lamp.db.lamp.v1'}", is_own=False)
    assert [column["name"] for column in inspect(copy).get_columns("thing")] == ["id"]
    copy.dispose()


def test_tables_of_a_version_between_two_releases_are_refused(engine: Engine) -> None:
    migrate(engine, FIRST, component="lamp", version=1)
    with pytest.raises(UsageError, match=r"table thing of lamp .* has no colour: .* use another database"):
        migrate(engine, SECOND, component="lamp", version=1)
    assert [column["name"] for column in inspect(engine).get_columns("thing")] == ["id"]


def test_a_failed_step_changes_nothing(engine: Engine) -> None:
    def breaks(connection: Connection) -> None:
        add_colour(connection)
        raise RuntimeError("power cut")

    migrate(engine, FIRST, component="lamp", version=1)
    with pytest.raises(RuntimeError):
        migrate(engine, SECOND, component="lamp", version=2, steps={1: breaks})
    assert [column["name"] for column in inspect(engine).get_columns("thing")] == ["id"]
    migrate(engine, SECOND, component="lamp", version=2, steps={1: add_colour})


def test_components_share_a_database_and_newer_tables_are_refused(engine: Engine) -> None:
    other = MetaData()
    Table("other", other, Column("id", Integer, primary_key=True))
    migrate(engine, FIRST, component="lamp", version=1)
    migrate(engine, other, component="switch", version=3)
    with pytest.raises(UsageError, match="switch has version 3, newer than 2"):
        migrate(engine, other, component="switch", version=2)


def of_unreleased_format(file: Path) -> Path:
    with closing(sqlite3.connect(file)) as database:
        database.execute("PRAGMA journal_mode=WAL")
        database.execute("CREATE TABLE lamp_schema (version INTEGER NOT NULL)")
        database.execute("INSERT INTO lamp_schema VALUES (3)")
        database.execute("CREATE TABLE thing (id INTEGER PRIMARY KEY)")
        database.commit()
    return file


def test_a_file_of_an_unreleased_format_is_refused_with_the_way_out_and_not_changed(tmp_path: Path) -> None:
    file = of_unreleased_format(tmp_path / "lamp.db")
    before = file.read_bytes()
    with pytest.raises(UsageError) as refused:
        connect(f"sqlite:///{file}")
    text = str(refused.value)
    assert str(file) in text
    assert "format 3 of lamp" in text
    assert "never released" in text
    assert "move lamp.db and lamp.db.stamp to another folder" in text
    assert "\n" not in text
    assert file.read_bytes() == before
    assert not (tmp_path / "lamp.db.stamp").exists()


def test_after_the_file_was_moved_a_new_database_is_created(tmp_path: Path) -> None:
    file = of_unreleased_format(tmp_path / "lamp.db")
    (tmp_path / "old").mkdir()
    file.rename(tmp_path / "old" / "lamp.db")
    engine = connect(f"sqlite:///{file}")
    migrate(engine, FIRST, component="lamp", version=1)
    assert inspect(engine).has_table("thing")
    engine.dispose()


def test_a_table_that_only_has_a_similar_name_is_no_unreleased_format(tmp_path: Path) -> None:
    file = tmp_path / "lamp.db"
    with closing(sqlite3.connect(file)) as database:
        database.execute("CREATE TABLE colour_schema (version INTEGER, name TEXT)")
        database.commit()
    assert unreleased_format(file) is None


def test_unreleased_tables_of_postgresql_are_refused_and_not_changed(new_database: Callable[[], str]) -> None:
    engine = connect(new_database())
    with engine.begin() as connection:
        connection.exec_driver_sql("CREATE TABLE lamp_schema (version INTEGER NOT NULL)")
        connection.exec_driver_sql("INSERT INTO lamp_schema VALUES (3)")
    with pytest.raises(UsageError, match="never released"):
        migrate(engine, FIRST, component="lamp", version=1)
    assert inspect(engine).get_table_names() == ["lamp_schema"]
    engine.dispose()
