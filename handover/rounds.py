"""Rounds: asking again and again, since notifications are hints that may be late, doubled or lost.

Every few seconds, with jitter so that services do not ask in step; at once when somebody wishes it; and after
a round that failed soon again, then less and less often.
"""

import asyncio
import random
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Final

FIRST_RETRY_S: Final = 0.1
LAST_RETRY_S: Final = 2.0


class Rounds:
    """Goes a round every `every_s` seconds; `go` says whether the round went well."""

    def __init__(self, go: Callable[[], Awaitable[bool]], every_s: float) -> None:
        self._go = go
        self._every_s = every_s
        self._wished = asyncio.Event()

    def wish(self) -> None:
        """Wish for a round without waiting; several wishes are one."""
        self._wished.set()

    async def keep(self) -> None:
        """Go round after round until cancelled; what `go` raises ends it."""
        retry_s = FIRST_RETRY_S
        while True:
            self._wished.clear()  # before the round: a wish that comes during it asks for another
            if await self._go():
                wait_s, retry_s = self._every_s, FIRST_RETRY_S
            else:
                wait_s, retry_s = retry_s, min(2 * retry_s, LAST_RETRY_S)
            with suppress(TimeoutError):
                async with asyncio.timeout(wait_s * random.uniform(0.8, 1.2)):  # noqa: S311 - jitter
                    await self._wished.wait()
