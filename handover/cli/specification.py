"""`handover specification`: fill the specification database from a file, list it, show its table."""

from pathlib import Path
from typing import Annotated

import typer
from sqlalchemy import Engine
from sqlalchemy.exc import SQLAlchemyError

from handover.database import connect
from handover.errors import UsageError
from services.gesture_controller.configuration import load
from services.gesture_controller.settings import ControllerSettings
from services.gesture_controller.specifications import file, table
from services.gesture_controller.specifications.database import SETTING

app = typer.Typer(
    help="What Tasks ask for, looked up where they do not say it: import, list, table.", no_args_is_help=True
)

Url = Annotated[
    str | None, typer.Option("--url", help=f"sqlite:///… or postgresql://…; {SETTING} if left out.")
]


@app.command("import")
def take_in(
    path: Annotated[Path, typer.Argument(metavar="FILE", help="A YAML file of definitions.")],
    url: Url = None,
) -> None:
    """Write the definitions of a file into the database, each in place of the one of its id."""
    try:
        given = file.read(path.read_text(encoding="utf-8"), path.name)
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"{path} cannot be read: {error}") from None
    gestures = load(ControllerSettings.load().gestures_file).gestures
    for key, one in given.items():
        if one.gesture is not None and gestures.find(one.gesture) is None:
            print(f'note: "{key}" asks for "{one.gesture}", which this site does not know')
    engine = _database(url)
    try:
        table.create(engine)
        table.save(engine, given)
    except SQLAlchemyError as error:
        raise UsageError(f"the specification database cannot be written: {_reason(error)}") from None
    finally:
        engine.dispose()
    print(f"{len(given)} definitions written to {engine.url.render_as_string(hide_password=True)}")


@app.command("list")
def every(url: Url = None) -> None:
    """Print all definitions, as a file that can be imported."""
    engine = _database(url)
    try:
        print(file.written(table.every(engine)), end="")
    except SQLAlchemyError as error:
        raise UsageError(
            f"the specification database cannot be read: {_reason(error)}; "
            "make its table with: handover specification import FILE"
        ) from None
    finally:
        engine.dispose()


@app.command("table")
def show(url: Url = None) -> None:
    """Print the SQL that makes the table, for who does that by hand."""
    engine = _database(url)
    print(table.statement(engine))
    engine.dispose()


def _database(url: str | None) -> Engine:
    return connect(url or ControllerSettings.load().specifications, setting=SETTING)


def _reason(error: SQLAlchemyError) -> str:
    return str(getattr(error, "orig", None) or error).strip().splitlines()[0]
