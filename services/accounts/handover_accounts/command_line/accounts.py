"""`handover accounts`: set up accounts on the machine itself."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer

from handover.errors import UsageError
from handover.extensions import SERVICES
from handover.service_addresses import OWN_SERVICES, PageAddress
from handover.settings import Settings
from handover_accounts.settings import AccountsSettings

app = typer.Typer(help="Accounts: people, keys, tokens of services.", no_args_is_help=True)

COMMAND_LINE = "cli"
"""The name by which commands identify themselves to services."""

DataDir = Annotated[Path | None, typer.Option("--data-dir", help="The directory of all persistent data.")]


class PageSettings(PageAddress, Settings):
    """The address of the page, for the links that are printed."""


@app.command("set-up")
def set_up_command(data_dir: DataDir = None) -> None:
    """Make the keys and tokens that are missing, and print the link of the first owner. Ends local mode."""
    set_up_accounts(_settings(data_dir), PageSettings.load())


@app.command("owner-link")
def owner_link_command(data_dir: DataDir = None) -> None:
    """Print a one-time link for an owner; an earlier one becomes invalid."""
    from handover_accounts.set_up import owner_link  # noqa: PLC0415 - the database is slow to import

    _say_link(owner_link(_settings(data_dir)), PageSettings.load())


@app.command("rotate-key")
def rotate_key(
    data_dir: DataDir = None,
    revoke: Annotated[
        bool, typer.Option("--revoke", help="Trust no earlier key any more: somebody else may have it.")
    ] = False,
) -> None:
    """Replace the signing key; nobody is signed out. Proofs of PINs by earlier keys stay valid."""
    from handover_accounts.signing_keys import SigningKeys  # noqa: PLC0415 - as above

    settings = _settings(data_dir)
    keys = SigningKeys(settings.signing_keys_file, settings.security_folder)
    key_id = keys.rotate(revokes_others=revoke)
    if revoke:
        print(f"the key {key_id} signs from now on, and no earlier key is trusted; restart the services")
    else:
        print(f"the key {key_id} signs from now on; the previous one is removed when its tokens have expired")


def service_names() -> tuple[str, ...]:
    """Return the names of all that has the token of a service."""
    return tuple(dict.fromkeys((*OWN_SERVICES, COMMAND_LINE, *SERVICES.names())))


def set_up_accounts(
    settings: AccountsSettings, page: PageSettings, *, token_files: Mapping[str, Path] | None = None
) -> None:
    """Make what is missing, and say what was made. Raises `UsageError`.

    Every service gets a token in the security directory, unless `token_files` names those who get one and
    their files. `page` has the address of the page, for the link.
    """
    from handover_accounts.set_up import set_up  # noqa: PLC0415 - as above

    made = set_up(settings, service_names() if token_files is None else (), token_files=token_files)
    if made.services:
        where = settings.security_folder if token_files is None else "beside their certificates"
        print(f"tokens of services: {', '.join(made.services)} ({where})")
    if made.is_new:
        print("accounts exist now: everybody signs in, also on this machine")
    if made.owner_link is None:
        print("a user exists already; `handover accounts owner-link` prints a link for another owner")
    else:
        _say_link(made.owner_link, page)


def _say_link(secret: str, page: PageSettings) -> None:
    print("The owner signs in with this link, once, within a day:")
    print(f"  {page.public_url}/join#{secret}")


def _settings(data_dir: Path | None) -> AccountsSettings:
    settings = AccountsSettings.load(**({} if data_dir is None else {"data_dir": data_dir}))
    if settings.data_dir.exists() and not settings.data_dir.is_dir():
        raise UsageError(f"the data directory {settings.data_dir} is no directory; choose another")
    return settings
