"""A source: follows a part of the cell for as long as the server runs, whatever goes wrong there."""

import asyncio
from abc import ABC, abstractmethod
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager

from handover.telemetry import get_logger

log = get_logger(__name__)

AFTER_A_FAULT_S = 2.0


class Source(ABC):
    """Something that is followed; what can be expected to go wrong, `follow` deals with itself."""

    @abstractmethod
    async def follow(self) -> None:
        """Follow it until cancelled."""


@asynccontextmanager
async def followed(sources: Sequence[Source]) -> AsyncIterator[None]:
    """Follow `sources` while the context lasts."""
    chores = [asyncio.create_task(_keep_following(source)) for source in sources]
    try:
        yield
    finally:
        for chore in chores:
            chore.cancel()
        await asyncio.gather(*chores, return_exceptions=True)


async def _keep_following(source: Source) -> None:
    while True:
        try:
            await source.follow()
        except Exception:
            log.exception("a source of the screen failed; following it anew", source=type(source).__name__)
        await asyncio.sleep(AFTER_A_FAULT_S)
