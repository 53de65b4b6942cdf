"""Missing values of a Task are looked up by URN or its last part; a failure is reported."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from sqlalchemy import Engine

from handover.database import connect
from handover.tasks import specification_table as table
from handover.tasks.specification import Specification
from handover_gloves.specifications import file
from handover_gloves.specifications.database import DatabaseState, SpecificationDatabase
from handover_gloves.specifications.definition import Definition, needs_definition

URN = "urn:ngsi-ld:TaskDefinition:demo:confirm"
GRIP = Definition("Confirm the grip", "Look whether it holds", None, 4)
BIN = Definition(None, "Look into the bin", "Horns", None)


def row(definition: Definition) -> Specification:
    """Return what the table has of a definition."""
    return Specification.of(definition.as_values())


@pytest.fixture(params=["sqlite", "postgresql"])
def url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """An empty specification database of either kind."""
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path / 'specifications.db'}"
    new_database: Callable[[], str] = request.getfixturevalue("new_database")
    return new_database()


@pytest.fixture
def fill(url: str) -> Iterator[Callable[..., Engine]]:
    """Write definitions into the database."""
    engine = connect(url)

    def write(**given: Definition) -> Engine:
        table.create(engine)
        table.save(engine, given)
        return engine

    yield write
    engine.dispose()


async def test_a_definition_is_found_by_its_urn_before_the_last_part(
    url: str, fill: Callable[..., Engine]
) -> None:
    fill(confirm=GRIP)
    database = SpecificationDatabase(url)
    assert await database.look_up(URN) == GRIP
    engine = fill(**{URN: BIN})
    assert await database.look_up(URN) == BIN
    assert await database.look_up("confirm") == GRIP
    assert await database.look_up("urn:ngsi-ld:TaskDefinition:demo:other") == Definition()
    assert database.state == DatabaseState("ok")
    assert table.every(engine) == {"confirm": row(GRIP), URN: row(BIN)}


async def test_a_missing_table_is_reported_and_found_after_it_was_created(
    url: str, fill: Callable[..., Engine]
) -> None:
    connect(url).dispose()  # as an empty database
    states: list[str] = []
    database = SpecificationDatabase(url, lambda state: states.append(state.name))
    assert await database.look_up(URN) == Definition()
    assert database.state.name == "away"
    assert "task_definitions" in database.state.detail
    assert "handover specification import" in database.state.detail
    fill(confirm=GRIP)
    assert await database.look_up(URN, timeout_s=10) == GRIP
    assert states == ["away", "ok"]


async def test_a_database_that_nobody_made_is_no_fault_and_is_not_created(tmp_path: Path) -> None:
    database = SpecificationDatabase(f"sqlite:///{tmp_path / 'nothing.db'}")
    assert await database.look_up(URN, timeout_s=60) == Definition()
    assert database.state.name == "absent"
    assert not (tmp_path / "nothing.db").exists()


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("mysql://x/y", "correct HANDOVER_SPECIFICATION_URL"),
        ("postgresql://u:secret@127.0.0.1:1/x", "postgresql+psycopg://u:***@127.0.0.1:1/x cannot be used"),
    ],
)
async def test_an_unavailable_database_is_reported_without_its_password(url: str, words: str) -> None:
    database = SpecificationDatabase(url)
    assert await database.look_up(URN) == Definition()
    assert words in database.state.detail
    assert "secret" not in database.state.detail
    assert "secret" not in database.shown
    before_s = time.monotonic()
    assert await database.look_up(URN, timeout_s=0.1) == Definition()
    assert time.monotonic() - before_s < 30


def test_what_one_leaves_out_the_next_says_but_commands_and_gestures_are_not_mixed() -> None:
    assert Definition("A").filled_from(GRIP) == Definition("A", GRIP.description, None, 4)
    assert Definition(command_id=7).filled_from(BIN) == Definition(None, BIN.description, None, 7)
    assert Definition(gesture="Thumbs up").filled_from(GRIP).command_id == 4
    assert not needs_definition({"gesture": "Horns"}, Definition(description="Look"))
    assert needs_definition({"gesture": "Horns"}, Definition(name="Look"))
    assert needs_definition({"description": "Look"}, Definition("A"))


def test_a_file_of_definitions_goes_in_and_out() -> None:
    text = file.written({"confirm": GRIP, URN: BIN})
    assert file.read(text) == {"confirm": GRIP, URN: BIN}
    assert file.read("") == {}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("- 1", "s.yaml:1: the file must be names with values"),
        ("confirm:\n  commandID: 3", 's.yaml:2: "confirm" has an unknown field "commandID"; there are name'),
        ("confirm:\n  commandId: three", 's.yaml:2: the commandId of "confirm" is a whole number'),
        ("confirm: {}", 's.yaml:1: "confirm" says nothing'),
        ("confirm:", 's.yaml:1: "confirm" says nothing'),
        ("a: {name: A}\na: {name: B}", 's.yaml:2: "a" stands twice in the file'),
    ],
)
def test_a_mistake_in_a_file_is_one_clear_line(text: str, words: str) -> None:
    with pytest.raises(file.WrongSpecification) as wrong:
        file.read(text, "s.yaml")
    assert words in str(wrong.value)


def test_the_table_can_be_made_by_hand(tmp_path: Path) -> None:
    engine = connect(f"sqlite:///{tmp_path / 'mine.db'}")
    with engine.begin() as connection:
        connection.exec_driver_sql(table.statement(engine))
        connection.exec_driver_sql("INSERT INTO task_definitions (id, gesture) VALUES ('confirm', 'Horns')")
    assert table.find(engine, [URN, "confirm"]) == Specification(gesture="Horns")
    table.create(engine)
    table.save(engine, {"confirm": GRIP})
    assert table.every(engine) == {"confirm": row(GRIP)}
    engine.dispose()


async def test_a_table_whose_ids_are_numbers_is_read_too(tmp_path: Path) -> None:
    engine = connect(f"sqlite:///{tmp_path / 'theirs.db'}")
    with engine.begin() as connection:
        connection.exec_driver_sql(
            "CREATE TABLE task_definitions (id INTEGER, name TEXT, description TEXT, gesture TEXT, "
            "command_id INTEGER)"
        )
        connection.exec_driver_sql("INSERT INTO task_definitions (id, command_id) VALUES (17, 3)")
    engine.dispose()
    database = SpecificationDatabase(f"sqlite:///{tmp_path / 'theirs.db'}")
    assert (await database.look_up("urn:ngsi-ld:TaskDefinition:demo:17")).command_id == 3
