"""`handover backup` and `handover restore`: everything that a cell knows in one file, while it runs."""

from pathlib import Path
from typing import Annotated

import typer

backup_app = typer.Typer()
restore_app = typer.Typer()

PassphraseFile = Annotated[
    Path | None,
    typer.Option("--passphrase-file", help="A file with the passphrase, instead of typing it."),
]


@backup_app.command()
def backup(
    file: Annotated[Path, typer.Argument(help="The new file; only its owner can read it.")],
    encrypt: Annotated[
        bool, typer.Option("--encrypt", help="Encrypt it by a passphrase, which is asked for.")
    ] = False,
    passphrase_file: PassphraseFile = None,
    data_dir: Annotated[
        Path | None, typer.Option("--data-dir", help="The data directory of the cell.")
    ] = None,
) -> None:
    """Write everything that the cell knows into FILE, also while it runs, and check the file."""
    from handover_cell import backup_acts  # noqa: PLC0415 - only this command needs the database

    backup_acts.backup(file, passphrase_file, data_dir, encrypt=encrypt)


@restore_app.command()
def restore(
    file: Annotated[Path, typer.Argument(help="A file of `handover backup`.")],
    passphrase_file: PassphraseFile = None,
    data_dir: Annotated[
        Path | None, typer.Option("--data-dir", help="A folder that does not exist, or an empty one.")
    ] = None,
) -> None:
    """Restore FILE into an empty data directory. The cell then continues where it was."""
    from handover_cell import backup_acts  # noqa: PLC0415 - only this command needs the database

    backup_acts.restore(file, passphrase_file, data_dir)
