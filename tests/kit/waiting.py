"""Waiting for a condition, with a bound that grows with the load of the machine.

A bound is written in seconds of an idle machine. While tests wait, the time that has passed is divided by how
many processes compete for each core. Thus a bound of 20 s fails after 20 s on an idle machine, and after some
minutes with a load average of 25 on two cores. A test that passes never waits for its bound.
"""

import asyncio
import inspect
import os
import time
from collections.abc import Awaitable, Callable
from typing import Any, Final, TypeVar

T = TypeVar("T")

DEFAULT_TIMEOUT_S: Final = 30.0
MAX_SLOWDOWN: Final = 20.0
POLL_S: Final = 0.02

Reason = str | Callable[[], str]


def slowdown() -> float:
    """Return how many times slower than idle the machine is, estimated from its load: 1 to `MAX_SLOWDOWN`."""
    load, _, _ = os.getloadavg()
    return min(MAX_SLOWDOWN, max(1.0, load / (os.cpu_count() or 1)))


def scaled(seconds: float) -> float:
    """Return a time limit for the machine as it is now: for limits of libraries, which cannot grow later."""
    return seconds * slowdown()


class Bound:
    """A time limit in seconds of an idle machine."""

    def __init__(self, within_s: float) -> None:
        self.within_s = within_s
        self._spent_s = 0.0
        self._last_s = time.monotonic()

    def remaining_s(self) -> float:
        """Return the rest of the limit in seconds of an idle machine; 0 if it has been exceeded."""
        now_s = time.monotonic()
        self._spent_s += (now_s - self._last_s) / slowdown()
        self._last_s = now_s
        return max(self.within_s - self._spent_s, 0.0)

    def check(self, reason: Reason) -> None:
        """Raise AssertionError with `reason` if the limit has been exceeded."""
        if self.remaining_s() == 0.0:
            text = reason() if callable(reason) else reason
            raise AssertionError(f"{text} (waited {self.within_s:g} s of an idle machine)")


def wait_for(
    condition: Callable[[], T | None],
    within_s: float = DEFAULT_TIMEOUT_S,
    why: Reason = "the condition did not become true",
) -> T:
    """Return the first true value of `condition`; raise AssertionError with `why` after `within_s`."""
    bound = Bound(within_s)
    while not (found := condition()):
        bound.check(why)
        time.sleep(POLL_S)
    return found


async def until(
    condition: Callable[[], T | Awaitable[T]],
    within_s: float = DEFAULT_TIMEOUT_S,
    why: Reason = "the condition did not become true",
) -> Any:
    """Return the first true value of `condition`, a function or coroutine function, as `wait_for` does."""
    bound = Bound(within_s)
    while True:
        found = condition()
        if inspect.isawaitable(found):
            found = await found
        if found:
            return found
        bound.check(why)
        await asyncio.sleep(POLL_S)
