"""Retries with exponential backoff and jitter.

The delay doubles with every failure up to a limit. Jitter of 20 % spreads clients that failed together, so
that they do not return together. A loop that runs as long as its service keeps a `Backoff` and resets it
after a success; a single operation that has to succeed uses `retry`.
"""

import asyncio
import random
from collections.abc import Awaitable, Callable
from typing import Final, TypeVar

INITIAL_DELAY_S: Final = 0.1
MAX_DELAY_S: Final = 2.0
JITTER: Final = 0.2
"""A delay is multiplied by a random factor from 1 - JITTER to 1 + JITTER."""

_MAX_DOUBLINGS: Final = 62
"""The delay of any useful limit is reached earlier; a larger exponent would overflow a float."""

T = TypeVar("T")

_CHANCE: Final = random.Random()  # noqa: S311 - not used for security
"""Not that of the module `random`, whose seed a program may have chosen."""


def with_jitter(delay_s: float, jitter: float = JITTER) -> float:
    """Return `delay_s` times a random factor from 1 - `jitter` to 1 + `jitter`."""
    return delay_s * _CHANCE.uniform(1 - jitter, 1 + jitter)


def backoff_delay_s(
    failures: int, initial_s: float = INITIAL_DELAY_S, max_s: float = MAX_DELAY_S, jitter: float = JITTER
) -> float:
    """Return the delay after `failures` failures in a row (at least 1); `max_s` applies before the jitter."""
    return with_jitter(min(initial_s * 2.0 ** min(failures - 1, _MAX_DOUBLINGS), max_s), jitter)


class Backoff:
    """The delays of one retry loop."""

    def __init__(
        self, initial_s: float = INITIAL_DELAY_S, max_s: float = MAX_DELAY_S, *, jitter: float = JITTER
    ) -> None:
        self.failures = 0
        """Failures in a row, since the last `reset`."""
        self._initial_s = initial_s
        self._max_s = max_s
        self._jitter = jitter

    def next_delay_s(self) -> float:
        """Count a failure and return the delay before the next attempt."""
        self.failures += 1
        return backoff_delay_s(self.failures, self._initial_s, self._max_s, self._jitter)

    def reset(self) -> None:
        """Start again with the initial delay: an attempt has succeeded."""
        self.failures = 0

    async def wait(self) -> None:
        """Count a failure and sleep until the next attempt is due."""
        await asyncio.sleep(self.next_delay_s())


async def retry(
    operation: Callable[[], Awaitable[T]],
    *,
    on: type[Exception] | tuple[type[Exception], ...],
    on_failure: Callable[[Exception], None] | None = None,
    backoff: Backoff | None = None,
) -> T:
    """Repeat `operation` until it succeeds and return its result.

    Exceptions of the types `on` cause another attempt, after `on_failure` was called with the exception;
    others propagate. There is no limit of attempts: use `asyncio.timeout` for a limit of time.
    """
    backoff = backoff or Backoff()
    while True:
        try:
            return await operation()
        except on as error:
            if on_failure is not None:
                on_failure(error)
        await backoff.wait()
