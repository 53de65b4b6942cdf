"""`handover audit`: verify and export the audit logs of all services of a data directory."""

import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import orjson
import typer

from handover.errors import UsageError
from handover.settings import Settings

if TYPE_CHECKING:
    from handover.security.audit_reading.audit_chains import AuditChain

app = typer.Typer(help="Audit: verify and export the records of all services.", no_args_is_help=True)

MAX_NUMBERS_SHOWN = 20

DataDir = Annotated[Path | None, typer.Option("--data-dir", help="The directory of all persistent data.")]


@app.command("verify")
def verify(data_dir: DataDir = None) -> None:
    """Check the chain of each audit log: exit code 1 if a record was changed, removed or inserted.

    It also names the acts whose outcome is not recorded: they run now, or their service was killed.
    """
    damaged = 0
    for chain in _chains(data_dir):
        began_s = time.perf_counter()
        with chain.engine.connect() as connection:
            verification = chain.log.verify(connection)
            without_outcome = chain.log.open_intents(connection)
        took_s = time.perf_counter() - began_s
        if verification.fault is None:
            intact = f"{verification.records} records are intact ({took_s:.1f} s)"
            print(f"{chain.service}: {intact}, head {verification.head}")
        else:
            damaged += 1
            intact = f"the {verification.records} records before are intact"
            print(f"{chain.service}: damaged: {verification.fault}; {intact}")
        if without_outcome:
            numbers = ", ".join(str(seq) for seq in without_outcome[:MAX_NUMBERS_SHOWN])
            more = ", …" if len(without_outcome) > MAX_NUMBERS_SHOWN else ""
            print(
                f"{chain.service}: no outcome of {len(without_outcome)} acts is recorded (records {numbers}"
                f"{more}): they run now, or the service ended in between and they may have happened"
            )
    if damaged:
        raise typer.Exit(1)


@app.command("export")
def export(
    data_dir: DataDir = None,
    file_format: Annotated[Literal["csv", "json"], typer.Option("--format", help="csv or json")] = "csv",
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="A file; by default standard output.")
    ] = None,
) -> None:
    """Write the records of all services, by time."""
    from handover.security.audit_reading.audit_chains import records_of  # noqa: PLC0415 - the database is slow to import
    from handover.security.audit_reading.audit_routes import csv_of  # noqa: PLC0415 - as above

    chains = _chains(data_dir)
    views = records_of(chains, _names(chains))
    content = csv_of(views) if file_format == "csv" else orjson.dumps(views, option=orjson.OPT_INDENT_2)
    if output is None:
        print(content.decode("utf-8-sig"))
        return
    try:
        output.write_bytes(content)
    except OSError as error:
        raise UsageError(f"the records cannot be written to {output}: {error.strerror}") from None
    print(f"{len(views)} records are in {output}")


def _names(chains: "list[AuditChain]") -> Mapping[str, str]:
    """Return the names of users and tokens, which accounts knows."""
    from handover_accounts.names import subject_names  # noqa: PLC0415 - the database is slow to import

    for chain in chains:
        if chain.service == "accounts":
            with chain.engine.connect() as connection:
                return subject_names(connection)
    return {}


def _chains(data_dir: Path | None) -> "list[AuditChain]":
    from handover.security.audit_reading.audit_chains import chains_of  # noqa: PLC0415 - the database is slow to import

    settings = Settings.load(**({} if data_dir is None else {"data_dir": data_dir}))
    chains = chains_of(settings)
    if not chains:
        raise UsageError(
            f"there is no audit log in {settings.data_dir}; name the data directory of the services with "
            "--data-dir"
        )
    return chains
