"""The audience: whether anybody looks, and what they want to see beyond the usual.

What costs the services something, a stream of a glove or of a robot's joints, is followed only meanwhile.
"""

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress

from webui.world import Reader

FRESH_WITHIN_S = 1.0
"""A first look waits so long at most for what was not followed while nobody looked."""

Look = Callable[[], Awaitable[None]]


class Audience:
    """The readers of the pages that are open."""

    def __init__(self) -> None:
        self._readers: set[Reader] = set()
        self._waiting: set[asyncio.Future[None]] = set()
        self._first_looks: list[Look] = []
        self._freshening: asyncio.Task[None] | None = None

    @property
    def size(self) -> int:
        """Return how many pages are open."""
        return len(self._readers)

    @property
    def looks(self) -> bool:
        """Say whether anybody looks."""
        return bool(self._readers)

    def wants(self, topic: str) -> bool:
        """Say whether any page wants `topic`."""
        return any(topic in reader.wanted for reader in self._readers)

    def before_first_look(self, look: Look) -> None:
        """Have `look` called when a page comes and none was there, before the page is shown anything."""
        self._first_looks.append(look)

    async def join(self, reader: Reader) -> None:
        """Let `reader` look, once what is shown is fresh."""
        if not self._readers:
            self._freshening = asyncio.create_task(self._freshen())
        self._readers.add(reader)
        self.changed()
        if self._freshening is not None:
            await asyncio.wait({self._freshening}, timeout=FRESH_WITHIN_S)

    def leave(self, reader: Reader) -> None:
        """Take leave of `reader`."""
        self._readers.discard(reader)
        self.changed()

    def changed(self) -> None:
        """Say that somebody came, went, or wants something else."""
        for future in self._waiting:
            if not future.done():
                future.set_result(None)
        self._waiting.clear()

    async def until(self, condition: Callable[[], bool], timeout_s: float | None = None) -> bool:
        """Wait until `condition` holds (looked at when the audience changes); False if that is too late."""
        with suppress(TimeoutError):
            async with asyncio.timeout(timeout_s):
                while not condition():
                    future: asyncio.Future[None] = asyncio.get_running_loop().create_future()
                    self._waiting.add(future)
                    try:
                        await future
                    finally:
                        self._waiting.discard(future)
        return condition()

    async def _freshen(self) -> None:
        await asyncio.gather(*(look() for look in self._first_looks), return_exceptions=True)
