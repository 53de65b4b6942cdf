"""The signing keys: private keys in a file that only accounts reads, public keys for all services.

The first key ends local mode, since it writes the public keys. A new key is used `ADOPTED_AFTER_S` after it
was published, when every service has read it; the previous one is retired `SUPERSEDED_S` later, when the last
token that it signed has expired: its private part is deleted. Its public part stays published with the time
in which it signed, as long as nobody revokes it: proofs of PINs do not expire, and a retired key verifies
nothing else (`handover.security.access_tokens`). A rotation costs 200 bytes.

Both files are replaced durably; the private one first, so that no key is published that a power cut could
take away.
"""

import json
import threading
import time
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final

from handover.errors import UsageError
from handover.files.durable_files import replace_durably
from handover.security.access_tokens import (
    LEEWAY_S,
    SERVICE_TOKEN_S,
    RetiredKey,
    SigningKey,
    key_set,
)
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
        self._retired: tuple[RetiredKey, ...] = ()
        self._stamp: tuple[int, int, int] | None = None
        self._next_look_s = 0.0

    def exist(self) -> bool:
        """Return whether there is a key, so that accounts exist."""
        with self._lock:
            return bool(self._current())

    def are_published(self) -> bool:
        """Return whether the public keys are those of the private ones. Raises `UsageError`."""
        with self._lock:
            document = key_set(*(key.key for key in self._current(is_forced=True)), retired=self._retired)
        return self._public_file.exists() and self._public_file.read_bytes() == document

    def signing_key(self) -> SigningKey:
        """Return the key that signs now. Raises `UsageError` if there is none."""
        with self._lock:
            keys = self._current()
            if not keys:
                raise UsageError("there is no signing key; run `handover accounts set-up`")
            now_s = time.time()
            ready = [key for key in keys if key.since_s + ADOPTED_AFTER_S <= now_s]
            return (ready or keys[:1])[-1].key

    def create(self) -> bool:
        """Make and publish the first key unless there is one; return whether it was made."""
        with self._lock:
            keys = self._current(is_forced=True)
            if keys:
                self._publish(keys, self._retired)
                return False
            self._write((_DatedKey(SigningKey.generate(), time.time()),), self._retired)
            return True

    def rotate(self, *, revokes_others: bool = False) -> str:
        """Make and publish a new key, which signs from then on; return its id. Raises `UsageError`.

        With `revokes_others` nothing that an earlier key has signed is valid any more, since somebody else
        may have that key: access tokens have to be exchanged again, and proofs of PINs are lost.
        """
        with self._lock:
            keys = self._current(is_forced=True)
            if not keys:
                raise UsageError("there is no signing key to replace; run `handover accounts set-up`")
            new = _DatedKey(SigningKey.generate(), time.time())
            kept, retired = ((), ()) if revokes_others else (keys, self._retired)
            self._write((*kept, new), retired)
            return new.key.key_id

    def expire(self) -> None:
        """Retire the keys whose access tokens have expired."""
        with self._lock:
            keys = self._current(is_forced=True)
            now_s = time.time()
            kept: list[_DatedKey] = []
            retired = list(self._retired)
            for key, successor in pairwise(keys):
                if successor.since_s + SUPERSEDED_S > now_s:
                    kept.append(key)
                else:
                    until_s = successor.since_s + ADOPTED_AFTER_S
                    retired.append(RetiredKey(key.key.public_jwk, key.since_s, until_s))
            if len(retired) > len(self._retired):
                self._write((*kept, *keys[-1:]), tuple(retired))

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
                _DatedKey(SigningKey.from_pem(key["pem"].encode()), float(key["sinceS"]))
                for key in listed
                if "pem" in key
            )
            self._retired = tuple(
                RetiredKey(key["jwk"], float(key["sinceS"]), float(key["untilS"]))
                for key in listed
                if "jwk" in key
            )
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise UsageError(
                f"the signing keys {self._private_file} cannot be read: {error}; restore the file from a "
                "backup, or move it away and run `handover accounts set-up`, which makes a new key: proofs "
                "of PINs that an earlier key has signed are lost"
            ) from None
        self._stamp = stamp

    def _write(self, keys: tuple[_DatedKey, ...], retired: tuple[RetiredKey, ...]) -> None:
        listed = [
            *({"pem": key.key.pem().decode(), "sinceS": key.since_s} for key in keys),
            *({"jwk": key.public_jwk, "sinceS": key.since_s, "untilS": key.until_s} for key in retired),
        ]
        try:
            replace_durably(self._private_file, json.dumps(listed).encode(), mode=0o600)
            self._publish(keys, retired)
        except OSError as error:
            raise UsageError(f"the signing keys cannot be written: {error}") from None
        self._keys, self._retired = keys, retired
        self._stamp = None

    def _publish(self, keys: tuple[_DatedKey, ...], retired: tuple[RetiredKey, ...]) -> None:
        document = key_set(*(key.key for key in keys), retired=retired)
        if not self._public_file.exists() or self._public_file.read_bytes() != document:
            replace_durably(self._public_file, document, mode=0o644)
