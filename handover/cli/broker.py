"""`handover broker`: look into the files of the embedded broker."""

import os
from pathlib import Path
from typing import Annotated

import orjson
import typer

from handover.cli.check import BROKER
from handover.settings import Settings

app = typer.Typer(help="The embedded broker: inspect its files.", no_args_is_help=True)


@app.callback()
def broker() -> None:
    """The embedded broker: inspect its files."""


@app.command()
def inspect(
    data_dir: Annotated[
        Path | None, typer.Option(help="The data directory; by default that of the settings.")
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the content of each change, one JSON document a line.")
    ] = False,
) -> None:
    """List the changes in the write-ahead log of the broker, also of a running one; nothing is written."""
    from services.context_broker.storage.write_ahead_log import (  # noqa: PLC0415 - no other command needs it
        inspection,
    )

    folder = data_dir if data_dir is not None else Settings.load().data_dir
    path = folder / BROKER
    lines = (
        (orjson.dumps(change).decode() for change in inspection.changes(path))
        if as_json
        else inspection.describe(path)
    )
    try:
        for line in lines:
            print(line)
    except BrokenPipeError:  # such as `| head`
        os._exit(0)
