"""The keys in force: whether accounts exist, and the public keys that verify their tokens.

The file `public-keys.json` in the security directory is written with the first account, or by `handover
secure`. As long as it does not exist, there are no accounts. A process that has seen it never returns to
local mode: a file that is deleted or damaged while services run opens nothing. A service that starts without
it compares its `AccountsMark`.
"""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Final

from handover.errors import UsageError
from handover.security.accounts_mark import AccountsMark
from handover.settings import PUBLIC_KEYS_FILE as ACCOUNTS_FILE
from handover.telemetry import get_logger

if TYPE_CHECKING:
    from handover.security.access_tokens import PublicKeys

log = get_logger(__name__)

PUBLIC_KEYS_FILE: Final = ACCOUNTS_FILE
RELOAD_INTERVAL_S: Final = 1.0


class KeysInForce:
    """Reads the public keys again when their file has changed, at most once a second."""

    def __init__(self, folder: Path, mark: AccountsMark | None = None) -> None:
        self._file = folder / PUBLIC_KEYS_FILE
        self._mark = mark
        self._is_first_look = True
        self._stamp: tuple[int, int, int] | None = None
        self._keys: PublicKeys | None = None
        self._next_look_s = 0.0

    def keys(self) -> "PublicKeys | None":
        """Return the keys; None while no account exists.

        Raises `UsageError` if the first keys cannot be read, or are missing although accounts have existed.
        """
        now_s = time.monotonic()
        if now_s < self._next_look_s:
            return self._keys
        self._look()
        self._next_look_s = now_s + RELOAD_INTERVAL_S
        return self._keys

    def keys_now(self) -> "PublicKeys | None":
        """Return the keys after a look at their file, as when others know of accounts already."""
        self._next_look_s = 0.0
        return self.keys()

    def _look(self) -> None:
        try:
            status = self._file.stat()
        except FileNotFoundError:
            if self._is_first_look and self._mark is not None:
                self._mark.require_no_accounts()
            self._is_first_look = False
            return
        except OSError as error:
            raise UsageError(f"the public keys {self._file} cannot be read: {error.strerror}") from None
        stamp = (status.st_mtime_ns, status.st_size, status.st_ino)
        if stamp == self._stamp:
            return
        # Imported only where accounts exist: the cryptography takes 50 ms of the start of each service.
        from handover.security.access_tokens import read_public_keys  # noqa: PLC0415

        try:
            self._keys = read_public_keys(self._file)
        except UsageError as error:
            if self._keys is None:
                raise
            log.warning("public keys cannot be read; the previous keys remain in force", reason=str(error))
        else:
            if self._mark is not None:
                self._mark.write()
        self._stamp = stamp
