"""The signing keys: private keys in a file that only accounts reads, public keys for all services.

The first key ends local mode, since it writes the public keys. A new key is used `ADOPTED_AFTER_S` after it
was published, when every service has read it; the previous one is removed `SUPERSEDED_S` later, when the last
token that it signed has expired. Both files are replaced durably; the private one first, so that no key is
published that a power cut could take away.
"""

import json
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from handover.durable_files import replace_durably
from handover.errors import UsageError
from handover.security.access_tokens import LEEWAY_S, SERVICE_TOKEN_S, SigningKey, key_set
from handover.security.keys_in_force import PUBLIC_KEYS_FILE, RELOAD_INTERVAL_S

ADOPTED_AFTER_S: Final = 3 * RELOAD_INTERVAL_S
SUPERSEDED_S: Final = ADOPTED_AFTER_S + SERVICE_TOKEN_S + 2 * LEEWAY_S


@dataclass(frozen=True, slots=True)
class _DatedKey:
    key: SigningKey
    since_s: float


class SigningKeys:
    """The private keys in `private_file`, and their public keys in the security `folder`; thread-safe."""

    def __init__(self, private_file: Path, folder: Path) -> None:
        self._private_file = private_file
        self._public_file = folder / PUBLIC_KEYS_FILE
        self._lock = threading.Lock()
        self._keys: tuple[_DatedKey, ...] = ()
        self._stamp: tuple[int, int, int] | None = None
        self._next_look_s = 0.0

    def exist(self) -> bool:
        """Return whether there is a key, so that accounts exist."""
        with self._lock:
            return bool(self._current())

    def signing_key(self) -> SigningKey:
        """Return the key that signs now. Raises `UsageError` if there is none."""
        with self._lock:
            keys = self._current()
            if not keys:
                raise UsageError("there is no signing key; run `handover accounts set-up`")
            now_s = time.time()
            ready = [one for one in keys if one.since_s + ADOPTED_AFTER_S <= now_s]
            return (ready or keys[:1])[-1].key

    def create(self) -> bool:
        """Make and publish the first key unless there is one; return whether it was made."""
        with self._lock:
            keys = self._current(is_forced=True)
            if keys:
                self._publish(keys)
                return False
            self._write((_DatedKey(SigningKey.generate(), time.time()),))
            return True

    def rotate(self) -> str:
        """Make and publish a new key, which signs from then on; return its id. Raises `UsageError`."""
        with self._lock:
            keys = self._current(is_forced=True)
            if not keys:
                raise UsageError("there is no signing key to replace; run `handover accounts set-up`")
            new = _DatedKey(SigningKey.generate(), time.time())
            self._write((*keys, new))
            return new.key.key_id

    def expire(self) -> None:
        """Remove the keys whose tokens have expired."""
        with self._lock:
            keys = self._current(is_forced=True)
            now_s = time.time()
            kept = tuple(
                one
                for number, one in enumerate(keys)
                if number == len(keys) - 1 or keys[number + 1].since_s + SUPERSEDED_S > now_s
            )
            if len(kept) < len(keys):
                self._write(kept)

    def _current(self, *, is_forced: bool = False) -> tuple[_DatedKey, ...]:
        now_s = time.monotonic()
        if now_s >= self._next_look_s or is_forced:
            self._next_look_s = now_s + RELOAD_INTERVAL_S
            self._look()
        return self._keys

    def _look(self) -> None:
        try:
            status = self._private_file.stat()
        except FileNotFoundError:
            return
        stamp = (status.st_mtime_ns, status.st_size, status.st_ino)
        if stamp == self._stamp:
            return
        try:
            listed = json.loads(self._private_file.read_bytes())
            self._keys = tuple(
                _DatedKey(SigningKey.from_pem(one["pem"].encode()), float(one["sinceS"])) for one in listed
            )
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise UsageError(f"the signing keys {self._private_file} cannot be read: {error}") from None
        self._stamp = stamp

    def _write(self, keys: tuple[_DatedKey, ...]) -> None:
        listed = [{"pem": one.key.pem().decode(), "sinceS": one.since_s} for one in keys]
        try:
            replace_durably(self._private_file, json.dumps(listed).encode(), mode=0o600)
            self._publish(keys)
        except OSError as error:
            raise UsageError(f"the signing keys cannot be written: {error}") from None
        self._keys = keys
        self._stamp = None

    def _publish(self, keys: tuple[_DatedKey, ...]) -> None:
        document = key_set(*(one.key for one in keys))
        if not self._public_file.exists() or self._public_file.read_bytes() != document:
            replace_durably(self._public_file, document, mode=0o644)
