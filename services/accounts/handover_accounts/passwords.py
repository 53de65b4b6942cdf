"""Passwords: rules, and hashing by argon2id in a bounded pool of threads.

A hash takes some 100 ms and 64 MiB, on purpose. So hashes run off the event loop, few at the same time, and
attempts that find the queue full are refused with 429 instead of waiting. One thread is kept for users who
sign in from an address that they have signed in from before, so that a flood from elsewhere never shuts
them out.

A hash uses a core without a pause, and releases the GIL: on a machine with few cores it competes with all
services. So the threads have a lower priority where the system has one for each thread (Linux): sign-ins wait
for other requests, and not the reverse.
"""

import asyncio
import os
import sys
import threading
import unicodedata
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from handover.errors import Problem

if TYPE_CHECKING:
    from pwdlib import PasswordHash

MIN_CHARACTERS: Final = 10
MAX_CHARACTERS: Final = 200
MIN_DISTINCT: Final = 5
MEMORY_KIB = 65_536
"""Of a hash, by one thread with three passes; RFC 9106 recommends 64 MiB where 2 GiB are too much."""
MAX_WAITING: Final = 8
"""Attempts that wait for a thread of a pool."""
RETRY_AFTER_S: Final = 2
NICENESS: Final = 10
"""Of the threads: with the same demand they get about a tenth of the time of other threads."""


class PasswordHashes:
    """Hashes and verifies passwords, `workers` at the same time."""

    def __init__(self, workers: int) -> None:
        self._workers = {False: workers, True: 1}
        self._pools: dict[bool, ThreadPoolExecutor] = {}
        self._pending = {False: 0, True: 0}
        self._hasher: PasswordHash | None = None
        self._decoy: str | None = None

    def close(self) -> None:
        """End the threads."""
        for pool in self._pools.values():
            pool.shutdown(wait=False, cancel_futures=True)

    async def hash(self, password: str) -> str:
        """Return the hash of a new password. Raises `Problem` 429."""
        return str(await self._run(True, self._hash, password))

    async def verify(self, password: str, stored: str | None, *, is_known: bool) -> bool:
        """Return whether `password` has the hash `stored`, in the same time if there is none.

        `is_known`: the attempt comes from an address of the user. Raises `Problem` 429.
        """
        return bool(await self._run(is_known, self._verify, password, stored))

    async def _run(self, is_known: bool, function: Any, *arguments: Any) -> Any:
        if self._pending[is_known] >= MAX_WAITING + self._workers[is_known]:
            raise too_many_attempts(RETRY_AFTER_S)
        if is_known not in self._pools:
            self._pools[is_known] = ThreadPoolExecutor(
                self._workers[is_known], "password", initializer=lower_priority
            )
        self._pending[is_known] += 1
        try:
            return await asyncio.get_running_loop().run_in_executor(
                self._pools[is_known], partial(function, *arguments)
            )
        finally:
            self._pending[is_known] -= 1

    def _hash(self, password: str) -> str:
        return self._argon2().hash(password)

    def _verify(self, password: str, stored: str | None) -> bool:
        hasher = self._argon2()
        if stored is None:  # as long as for a user who exists, so that names cannot be probed
            self._decoy = self._decoy or hasher.hash("no password")
            hasher.verify(password, self._decoy)
            return False
        return hasher.verify(password, stored)

    def _argon2(self) -> "PasswordHash":
        if self._hasher is None:  # imported with the first password: it takes 4 MiB and 50 ms
            from pwdlib import PasswordHash  # noqa: PLC0415
            from pwdlib.hashers.argon2 import Argon2Hasher  # noqa: PLC0415

            self._hasher = PasswordHash((Argon2Hasher(memory_cost=MEMORY_KIB),))
        return self._hasher


def lower_priority() -> None:
    """Lower the priority of this thread alone; elsewhere than on Linux that would be the whole process."""
    if sys.platform == "linux":
        with suppress(OSError):  # a container may forbid it
            thread = threading.get_native_id()
            os.setpriority(os.PRIO_PROCESS, thread, max(NICENESS, os.getpriority(os.PRIO_PROCESS, thread)))


def require_good_password(password: str, name: str) -> str:
    """Return a new password, normalized; raise `Problem` 422 if it is too weak."""
    text = normalized(password)
    if len(text) < MIN_CHARACTERS:
        raise _weak(f"the password has {len(text)} characters; use {MIN_CHARACTERS} or more")
    if len(set(text)) < MIN_DISTINCT:
        raise _weak(f"the password has fewer than {MIN_DISTINCT} different characters; use more")
    if name.casefold() in text.casefold() and len(text) < len(name) + MIN_CHARACTERS // 2:
        raise _weak("the password is nearly the name; use another")
    return text


def normalized(password: str) -> str:
    """Return a password such that keyboards of all systems give the same."""
    return unicodedata.normalize("NFKC", password)


def too_many_attempts(retry_after_s: int) -> Problem:
    """Return the answer to an attempt that came too early."""
    return Problem(
        429,
        "Too many attempts",
        f"too many attempts to sign in; try again in {retry_after_s} s",
        extra={"retryAfterS": retry_after_s},
    )


def _weak(why: str) -> Problem:
    return Problem(422, "Weak password", why)
