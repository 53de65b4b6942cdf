"""Periodic reconciliation: repeat an action regularly, at once on request, and with backoff after a failure.

Notifications are hints that may be late, duplicated or lost. So a component compares its state with the
broker every few seconds, with jitter so that the components do not query the broker at the same time.
"""

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress

from handover.runtime.retry import Backoff, with_jitter


class Resync:
    """Runs `reconcile` every `period_s` seconds; `reconcile` returns whether it succeeded."""

    def __init__(self, reconcile: Callable[[], Awaitable[bool]], period_s: float) -> None:
        self._reconcile = reconcile
        self._period_s = period_s
        self._requested = asyncio.Event()

    def request(self) -> None:
        """Request a run without delay; several requests before it starts are one."""
        self._requested.set()

    async def run(self) -> None:
        """Reconcile until cancelled; an exception of `reconcile` propagates."""
        backoff = Backoff()
        while True:
            self._requested.clear()  # before the run: a request during the run causes another
            if await self._reconcile():
                backoff.reset()
                wait_s = with_jitter(self._period_s)
            else:
                wait_s = backoff.next_delay_s()
            with suppress(TimeoutError):
                async with asyncio.timeout(wait_s):
                    await self._requested.wait()
