"""A database of accounts that was lost: there are keys, but nobody whom they are for.

Accounts on a new, empty database would refuse all people and services, and the next link of an owner would
replace them without a word. So accounts and its commands refuse such a database, and do not make a new one.
"""

from pathlib import Path

from sqlalchemy import Connection, func, select

from handover.errors import UsageError
from handover.security.accounts_mark import ACCOUNTS_DATABASE
from handover.security.keys_in_force import PUBLIC_KEYS_FILE
from handover_accounts.settings import AccountsSettings
from handover_accounts.storage import tables

_REMEDY = (
    "restore it from a backup. To begin with new accounts, move accounts-keys.json, the files *.accounts and "
    "the security directory away"
)


def require_file(settings: AccountsSettings) -> None:
    """Raise `UsageError` if the file of the database is missing, although there are keys."""
    file = settings.data_dir / ACCOUNTS_DATABASE
    sign = _sign(settings)
    if not settings.database_url and sign is not None and not file.exists():
        raise UsageError(f"{file} is missing, but {sign} shows that accounts exist; {_REMEDY}")


def require_anybody(settings: AccountsSettings, connection: Connection) -> None:
    """Raise `UsageError` if the database is empty, although there are keys."""
    if (sign := _sign(settings)) is not None and not has_anybody(connection):
        raise UsageError(
            "the database of accounts has neither people nor tokens, but "
            f"{sign} shows that accounts exist; {_REMEDY}"
        )


def has_anybody(connection: Connection) -> bool:
    """Return whether there are people, tokens or links."""
    return any(
        connection.execute(select(func.count()).select_from(table)).scalar()
        for table in (tables.users, tables.tokens, tables.links)
    )


def _sign(settings: AccountsSettings) -> Path | None:
    signs = (
        settings.signing_keys_file,
        settings.security_folder / PUBLIC_KEYS_FILE,
        settings.data_dir / "accounts.accounts",
    )
    return next((file for file in signs if file.exists()), None)
