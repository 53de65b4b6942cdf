"""The mark of accounts: a service that has seen accounts never opens in local mode again.

Accounts exist where there are public keys. If they are missing, these show that they were lost: the mark
`<service>.accounts` that a service writes into its data directory when it has read them, the private keys,
and people in the database of accounts. A service with such a sign refuses to start and names the file.
"""

import re
import sqlite3
from contextlib import closing
from pathlib import Path

from handover.durable_files import replace_durably
from handover.errors import UsageError
from handover.settings import PUBLIC_KEYS_FILE, SIGNING_KEYS_FILE, Settings
from handover.telemetry import get_logger

log = get_logger(__name__)

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
    """Return what shows, beside the mark of a service, that accounts exist; None if nothing does."""
    private = settings.data_dir / SIGNING_KEYS_FILE
    if private.exists():
        return str(private)
    database = settings.data_dir / "accounts.db"
    return f"{database}, which has people," if _has_people(database) else None


def missing_keys(file: Path, sign: str) -> UsageError:
    """Return the error for a file of keys that is missing although `sign` shows that accounts exist."""
    return UsageError(
        f"{file} is missing, but {sign} shows that accounts exist; "
        "restore it from a backup, or run `handover accounts set-up`, which writes it again. To give up "
        "accounts, move the data directory and the security directory away"
    )


def _has_people(database: Path) -> bool:
    if not database.exists():
        return False
    try:
        uri = f"{database.absolute().as_uri()}?mode=ro"
        with closing(sqlite3.connect(uri, uri=True, timeout=5.0)) as connection:
            return connection.execute(_HAS_PEOPLE).fetchone() is not None
    except sqlite3.DatabaseError as error:
        if isinstance(error, sqlite3.OperationalError) and "no such table" in str(error):
            return False
        raise UsageError(
            f"{database} cannot be read, so it is unknown whether accounts exist: {error}"
        ) from None
