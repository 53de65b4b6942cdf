"""Tables of a room are created, brought forward with a copy beside, and left alone when they are newer."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from sqlalchemy import Column, Connection, Engine, Integer, MetaData, Table, Text, inspect

from handover.database import connect
from handover.errors import UsageError
from handover.tables import bring_forward

FIRST, SECOND = MetaData(), MetaData()
Table("thing", FIRST, Column("id", Integer, primary_key=True))
Table("thing", SECOND, Column("id", Integer, primary_key=True), Column("colour", Text))


def add_colour(connection: Connection) -> None:
    connection.exec_driver_sql("ALTER TABLE thing ADD COLUMN colour TEXT")


@pytest.fixture
def engine(tmp_path: Path) -> Iterator[Engine]:
    engine = connect(f"sqlite:///{tmp_path / 'shed.db'}")
    yield engine
    engine.dispose()


def test_an_older_room_is_brought_forward_and_copied_before(engine: Engine, tmp_path: Path) -> None:
    bring_forward(engine, FIRST, room="shed", version=1)
    bring_forward(engine, FIRST, room="shed", version=1)
    assert not (tmp_path / "shed.db.shed.v1").exists()
    with engine.begin() as connection:
        connection.exec_driver_sql("INSERT INTO thing (id) VALUES (7)")
    bring_forward(engine, SECOND, room="shed", version=2, steps={1: add_colour})
    assert [column["name"] for column in inspect(engine).get_columns("thing")] == ["id", "colour"]
    with engine.connect() as connection:
        assert connection.exec_driver_sql("SELECT id, colour FROM thing").all() == [(7, None)]
    copy = connect(f"sqlite:///{tmp_path / 'shed.db.shed.v1'}")
    assert [column["name"] for column in inspect(copy).get_columns("thing")] == ["id"]
    copy.dispose()


def test_a_step_that_fails_leaves_everything_as_it_was(engine: Engine) -> None:
    def breaks(connection: Connection) -> None:
        add_colour(connection)
        raise RuntimeError("power cut")

    bring_forward(engine, FIRST, room="shed", version=1)
    with pytest.raises(RuntimeError):
        bring_forward(engine, SECOND, room="shed", version=2, steps={1: breaks})
    assert [column["name"] for column in inspect(engine).get_columns("thing")] == ["id"]
    bring_forward(engine, SECOND, room="shed", version=2, steps={1: add_colour})


def test_rooms_share_a_database_and_a_newer_one_is_left_alone(engine: Engine) -> None:
    other = MetaData()
    Table("other", other, Column("id", Integer, primary_key=True))
    bring_forward(engine, FIRST, room="shed", version=1)
    bring_forward(engine, other, room="loft", version=3)
    with pytest.raises(UsageError, match="loft has version 3, newer than 2"):
        bring_forward(engine, other, room="loft", version=2)
