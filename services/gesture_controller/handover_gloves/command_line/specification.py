"""`handover specification`: fill the specification database from a file, list it, show its table."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
import yaml

from handover.command_line.output import AsJson, print_json
from handover.errors import UsageError
from handover_gloves.settings import ControllerSettings

if TYPE_CHECKING:  # the import takes longer than most commands
    from sqlalchemy import Engine

app = typer.Typer(
    help="Descriptions and gestures of Tasks in a database: import, list, table.", no_args_is_help=True
)

Url = Annotated[
    str | None,
    typer.Option("--url", help="sqlite:///… or postgresql://…; HANDOVER_SPECIFICATION_URL if left out."),
]


@app.command("import")
def take_in(
    path: Annotated[Path, typer.Argument(metavar="FILE", help="A YAML file of definitions.")],
    url: Url = None,
) -> None:
    """Write the definitions of a file into the database; each replaces the one with its id."""
    from handover.tasks import specification_table as table  # noqa: PLC0415 - loads SQLAlchemy
    from handover_gloves.configuration.gestures_file import load  # noqa: PLC0415 - only this command needs it
    from handover_gloves.specifications import file  # noqa: PLC0415 - loads SQLAlchemy

    try:
        definitions = file.read(path.read_text(encoding="utf-8"), path.name)
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"{path} cannot be read: {error}") from None
    gestures = load(ControllerSettings.load().gestures_file).gestures
    for key, definition in definitions.items():
        if definition.gesture is not None and gestures.find(definition.gesture) is None:
            print(f'note: "{key}" asks for "{definition.gesture}", which this site does not know')
    with _database(url, "written") as engine:
        table.create(engine)
        table.save(engine, definitions)
        print(f"{len(definitions)} definitions written to {engine.url.render_as_string(hide_password=True)}")


@app.command("list")
def every(url: Url = None, as_json: AsJson = False) -> None:
    """Print all definitions as a file that can be imported, in YAML or JSON."""
    from handover.tasks import specification_table as table  # noqa: PLC0415 - loads SQLAlchemy
    from handover_gloves.specifications import file  # noqa: PLC0415 - loads SQLAlchemy

    with _database(url, "read") as engine:
        text = file.written(table.every(engine))
    if as_json:
        print_json(yaml.safe_load(text))
    else:
        print(text, end="")


@app.command("table")
def show(url: Url = None) -> None:
    """Print the SQL statement that creates the table."""
    from handover.tasks import specification_table as table  # noqa: PLC0415 - loads SQLAlchemy

    with _database(url, "asked") as engine:
        print(table.statement(engine))


@contextmanager
def _database(url: str | None, act: str) -> "Iterator[Engine]":
    from sqlalchemy.exc import SQLAlchemyError  # noqa: PLC0415

    from handover.database import connect  # noqa: PLC0415
    from handover.tasks.specification_table import SETTING  # noqa: PLC0415

    engine = connect(url or ControllerSettings.load().specifications, setting=SETTING, is_own=False)
    try:
        yield engine
    except SQLAlchemyError as error:
        reason = str(getattr(error, "orig", None) or error).strip().splitlines()[0]
        raise UsageError(
            f"the specification database cannot be {act}: {reason}; "
            "create its table with: handover specification import FILE"
        ) from None
    finally:
        engine.dispose()
