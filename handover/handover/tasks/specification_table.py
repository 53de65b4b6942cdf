"""The table of the specification database: what a person is shown for the Tasks of a TaskDefinition.

The orchestrator and planning systems write it, the gesture controller reads it. A row may also belong to one
Task.

CREATE TABLE task_definitions (
    id TEXT PRIMARY KEY,       -- the last part of the TaskDefinition's URN, the whole URN, or a Task's URN
    name TEXT, description TEXT,
    gesture TEXT,              -- its name in the gestures file, or
    command_id INTEGER         -- the command, shown with the person's own gesture
);
"""

from collections.abc import Iterable, Mapping

from sqlalchemy import (
    Column,
    Engine,
    Integer,
    MetaData,
    String,
    Table,
    Text,
    cast,
    delete,
    insert,
    inspect,
    select,
)
from sqlalchemy.schema import CreateTable

from handover.database.migrations import migrate
from handover.tasks.specification import Specification

VERSION = 1
SETTING = "HANDOVER_SPECIFICATION_URL"
MAX_ID = 300

tables = MetaData()
definitions = Table(
    "task_definitions",
    tables,
    Column("id", String(MAX_ID), primary_key=True),
    Column("name", Text),
    Column("description", Text),
    Column("gesture", Text),
    Column("command_id", Integer),
)


def create(engine: Engine) -> None:
    """Create or upgrade the table."""
    migrate(engine, tables, component="specifications", version=VERSION)


def create_if_missing(engine: Engine) -> None:
    """Create the table if there is none; the table of another system stays as it is."""
    if not inspect(engine).has_table(definitions.name):
        create(engine)


def statement(engine: Engine) -> str:
    """Return the SQL statement that creates the table, in the dialect of `engine`."""
    return str(CreateTable(definitions).compile(engine)).strip() + ";"


def save(engine: Engine, changed: Mapping[str, Specification]) -> None:
    """Write the definitions of `changed` by id in one transaction; each replaces the stored one."""
    with engine.begin() as connection:
        connection.execute(delete(definitions).where(definitions.c.id.in_(list(changed))))
        rows = [
            {
                "id": key,
                "name": definition.name,
                "description": definition.description,
                "gesture": definition.gesture,
                "command_id": definition.command_id,
            }
            for key, definition in changed.items()
        ]
        if rows:
            connection.execute(insert(definitions), rows)


def remove(engine: Engine, ids: Iterable[str]) -> None:
    """Delete rows; those that do not exist are ignored."""
    with engine.begin() as connection:
        connection.execute(delete(definitions).where(definitions.c.id.in_(list(ids))))


def find(engine: Engine, ids: Iterable[str]) -> Specification | None:
    """Return the definition of the first of `ids` that is in the table."""
    names = list(ids)
    others = (column for column in definitions.c if column.name != "id")
    columns = (cast(definitions.c.id, Text).label("id"), *others)
    query = select(*columns).where(
        cast(definitions.c.id, Text).in_(names)
    )  # in tables of other systems the id may be a number
    with engine.connect() as connection:
        rows = {row.id: row for row in connection.execute(query)}
    row = next((rows[key] for key in names if key in rows), None)
    return None if row is None else Specification(row.name, row.description, row.gesture, row.command_id)


def every(engine: Engine) -> dict[str, Specification]:
    """Return all definitions by id."""
    with engine.connect() as connection:
        rows = connection.execute(select(definitions).order_by(definitions.c.id)).all()
    return {
        str(row.id): Specification(row.name, row.description, row.gesture, row.command_id) for row in rows
    }
