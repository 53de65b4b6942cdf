"""What commands print: tables for people, with `--json` one document for programs."""

from typing import Annotated, Any

import orjson
import typer

AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON document, for programs.")]


def print_json(value: Any) -> None:
    """Print a JSON document, for people to read too."""
    print(orjson.dumps(value, option=orjson.OPT_INDENT_2).decode())
