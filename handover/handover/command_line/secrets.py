"""`handover secrets`: random secrets as files, created once and never overwritten.

The containers run `make` first, so that every installation has its own random secrets. Each secret is a file
with the name of its setting, which only the user of the services can read.
"""

import base64
import os
import secrets
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

import typer

from handover.errors import UsageError
from handover.files.durable_files import replace_durably
from handover.security.glove_token import GLOVE_TOKEN_SECRET
from handover.settings import SECRETS_DIR, Settings

RECORDING_KEY = "HANDOVER_HEALTH_RECORDING_KEY"
"""Without it, no recording of body signals can be read: keep a copy."""
SECRETS = (GLOVE_TOKEN_SECRET, "HANDOVER_DATABASE_PASSWORD", RECORDING_KEY)
RANDOM_BYTES = 32

app = typer.Typer(help="Random secrets as files.", no_args_is_help=True)


@app.command()
def make() -> None:
    """Create the missing secrets; change none."""
    make_in(_folder())
    typer.echo("To read them: handover secrets show (containers: docker compose run --rm init secrets show)")


def make_in(folder: Path) -> None:
    """Create the missing secrets in `folder`, and say which were created."""
    for name in SECRETS:
        if write_once(folder / name, os.environ.get(name) or _random(name)):
            typer.echo(f"{name}: created in {folder / name}")
        else:
            typer.echo(f"{name}: exists in {folder / name}")


def give(folder: Path, readers: Iterable[tuple[Path, tuple[str, ...]]]) -> None:
    """Copy secrets of `folder` into the folders of those who read them, and say which have changed there."""
    for reader, names in readers:
        for name in names:
            if name not in SECRETS:
                raise UsageError(f'there is no secret "{name}"; the secrets are {", ".join(SECRETS)}')
            file, content = reader / name, f"{_read(folder / name)}\n".encode()
            if not file.exists() or file.read_bytes() != content:
                replace_durably(file, content, mode=0o600)
                typer.echo(f"{name}: copied to {file}")


def _random(name: str) -> str:
    if name == RECORDING_KEY:
        return base64.b64encode(secrets.token_bytes(RANDOM_BYTES)).decode("ascii")
    return secrets.token_hex(RANDOM_BYTES)


@app.command()
def show() -> None:
    """Print the secrets: for gloves and databases, and the key of recordings for a copy."""
    folder = _folder()
    for name in SECRETS:
        typer.echo(f"{name}={os.environ.get(name) or _read(folder / name)}")


def write_once(file: Path, secret: str) -> bool:
    """Write `secret` to `file`, readable by its owner only, unless it exists; return whether it was written.

    The write is atomic, and the first of two writers wins.
    """
    if file.exists():
        return False
    new = file.with_name(f".{file.name}.{os.getpid()}.{secrets.token_hex(4)}")
    try:
        file.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        with os.fdopen(os.open(new, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600), "w") as written:
            written.write(f"{secret}\n")
            written.flush()
            os.fsync(written.fileno())
        os.link(new, file)
    except FileExistsError:
        return False
    except OSError as error:
        raise UsageError(
            f"the secret {file} cannot be written: {error.strerror}; make {file.parent} writable for user "
            f"{os.getuid()}, or set {SECRETS_DIR} to another directory"
        ) from None
    finally:
        with suppress(OSError):
            new.unlink()
    folder = os.open(file.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
    return True


def _folder() -> Path:
    folder = Settings.load().secrets_dir
    if folder is None:
        raise UsageError(f"{SECRETS_DIR} is not set; set it to a directory for the secrets")
    return folder


def _read(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8").strip()
    except FileNotFoundError:
        raise UsageError(f"there is no secret {file}; make it with: handover secrets make") from None
    except OSError as error:
        raise UsageError(f"the secret {file} cannot be read: {error.strerror}") from None
