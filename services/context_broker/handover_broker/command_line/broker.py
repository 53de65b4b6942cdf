"""`handover broker`: look into the files of the embedded broker, and copy a broker into another one."""

import os
from pathlib import Path
from typing import Annotated

import orjson
import typer

from handover.settings import Settings
from handover_broker.settings import DATABASE

app = typer.Typer(help="Inspect the files of the embedded broker, copy a broker.", no_args_is_help=True)

TokenFile = Annotated[Path | None, typer.Option(help="A file with the bearer token for that broker.")]


@app.callback()
def broker() -> None:
    """Inspect the files of the embedded broker, copy a broker."""


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
    from handover_broker.storage.write_ahead_log import (  # noqa: PLC0415 - no other command needs it
        inspection,
    )

    folder = data_dir if data_dir is not None else Settings.load().data_dir
    path = folder / DATABASE
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


@app.command(name="copy")
def copy_to(  # noqa: PLR0917 - options of a command
    source: Annotated[str, typer.Argument(metavar="FROM", help="The URL of the broker to copy.")],
    target: Annotated[str, typer.Argument(metavar="TO", help="The URL of the broker that gets the copy.")],
    tenant: Annotated[
        list[str] | None,
        typer.Option(help="A tenant to copy besides the default one; repeat it for several."),
    ] = None,
    only: Annotated[bool, typer.Option("--only", help="Copy the tenants of --tenant only.")] = False,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace what is in TO with another content.")
    ] = False,
    from_token_file: TokenFile = None,
    to_token_file: TokenFile = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the result as JSON; the progress goes to stderr.")
    ] = False,
) -> None:
    """Copy entities, subscriptions, registrations and hosted @contexts of a broker into another one.

    Both are compared at the end. The same command again continues a copy that was interrupted. Exit code 0:
    TO has everything, and the same; 1: something is missing or differs, or a broker does not answer; 2: wrong
    use. History is not copied.
    """
    from handover_broker.command_line.copying import CopyWish, run_copy  # noqa: PLC0415 - only this command

    wish = CopyWish(
        source=source,
        target=target,
        tenants=tuple(tenant or ()),
        only=only,
        overwrites=overwrite,
        source_token_file=from_token_file,
        target_token_file=to_token_file,
    )
    if not run_copy(wish, as_json=as_json):
        raise typer.Exit(1)
