"""The mark of accounts: a service that has seen accounts never opens in local mode again.

Accounts exist where there are public keys. If they are missing, each of these shows that they were lost: the
mark `<service>.accounts` that a service writes into its data directory when it has read them, whichever
service that was, the private keys, tokens of services, and people in the database of accounts. With such a
sign a service refuses to start and names the file; so it does if the database may have had people.
"""

import re
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Final

from handover.errors import UsageError
from handover.files.durable_files import replace_durably
from handover.settings import PUBLIC_KEYS_FILE, SERVICE_TOKENS_FOLDER, SIGNING_KEYS_FILE, Settings
from handover.telemetry import get_logger

log = get_logger(__name__)

ACCOUNTS_DATABASE: Final = "accounts.db"
_CONTENT = b"This service has seen accounts. Without their public keys it does not start.\n"
_HAS_PEOPLE = "SELECT 1 FROM accounts_user LIMIT 1"


class AccountsMark:
    """The mark of the service `service` in its data directory."""

    def __init__(self, settings: Settings, service: str) -> None:
        self._settings = settings
        self._file = settings.data_dir / f"{re.sub(r'[^A-Za-z0-9_.-]', '_', service)}.accounts"

    def write(self) -> None:
        """Write the mark, once."""
        if self._file.exists():
            return
        try:
            replace_durably(self._file, _CONTENT, mode=0o600)
        except OSError as error:
            log.warning("the mark of accounts cannot be written", file=str(self._file), error=str(error))
        else:
            log.info("mark of accounts created", file=str(self._file))

    def require_no_accounts(self) -> None:
        """Raise `UsageError` if accounts have existed, although there are no public keys."""
        public = self._settings.security_folder / PUBLIC_KEYS_FILE
        if self._file.exists():
            raise missing_keys(public, str(self._file))
        if (sign := sign_of_accounts(self._settings)) is not None:
            raise missing_keys(public, sign)


def sign_of_accounts(settings: Settings) -> str | None:
    """Return what shows, beside public keys, that accounts exist; None if nothing does.

    Raises `UsageError` if the database of accounts is damaged, so that nobody knows.
    """
    private = settings.data_dir / SIGNING_KEYS_FILE
    tokens = settings.security_folder / SERVICE_TOKENS_FOLDER
    for file in (*sorted(settings.data_dir.glob("*.accounts")), private, *sorted(tokens.glob("*"))):
        if file.exists():
            return str(file)
    database = settings.data_dir / ACCOUNTS_DATABASE
    return f"{database}, which has people," if _has_people(database) else None


def missing_keys(file: Path, sign: str) -> UsageError:
    """Return the error for a file of keys that is missing although `sign` shows that accounts exist."""
    return UsageError(
        f"{file} is missing, but {sign} shows that accounts exist; "
        "restore it from a backup, or run `handover accounts set-up`, which writes it again. To give up "
        "accounts, move the data directory and the security directory away"
    )


def _has_people(database: Path) -> bool:
    is_empty = not database.exists() or database.stat().st_size == 0
    for other in ("-wal", ".stamp"):
        file = database.with_name(database.name + other)
        if is_empty and file.exists() and file.stat().st_size:
            raise _unknown(database, f"it is missing or empty, but there is {file}")
    if is_empty:
        return False
    try:
        uri = f"{database.absolute().as_uri()}?mode=ro"
        with closing(sqlite3.connect(uri, uri=True, timeout=5.0)) as connection:
            return connection.execute(_HAS_PEOPLE).fetchone() is not None
    except sqlite3.DatabaseError as error:
        if isinstance(error, sqlite3.OperationalError) and "no such table" in str(error):
            return False
        raise _unknown(database, str(error)) from None


def _unknown(database: Path, reason: str) -> UsageError:
    return UsageError(
        f"{database} cannot be read, so it is unknown whether accounts exist: {reason}; restore it from a "
        "backup, or move what is left of it away"
    )
