"""`handover process mapping`: who performs what, by the names in process files."""

from pathlib import Path
from typing import Annotated

import typer
import yaml

from handover.errors import UsageError
from handover_processes.command_line.asking import By, Why, ask

mapping = typer.Typer(help="The mapping from names in process files to performers.", no_args_is_help=True)


@mapping.command("show")
def show_mapping(
    version: Annotated[int | None, typer.Option("--version", help="An earlier version.")] = None,
) -> None:
    """Write the mapping from names in process files to performers, as YAML."""
    table = ask("GET", "/mapping", params={} if version is None else {"version": version})
    print(yaml.safe_dump(table, sort_keys=False, allow_unicode=True), end="")


@mapping.command("set")
def set_mapping(
    file: Annotated[Path, typer.Argument(help="A YAML file with `entries`.")], by: By, why: Why = None
) -> None:
    """Replace the mapping, and confirm that its performers may get work."""
    try:
        entries = yaml.safe_load(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"{file} cannot be read: {error.strerror}") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise UsageError(f"{file} is no YAML: {error}") from None
    if not isinstance(entries, dict) or not isinstance(entries.get("entries"), list):
        raise UsageError(f"{file} has no list `entries`; see docs/how-to/resources.md")
    table = ask("PUT", "/mapping", json={"by": by, "why": why, "entries": entries["entries"]})
    print(f"mapping version {table['version']}: {len(table['entries'])} entries")
