"""A source: a supervised background task that follows a part of the cell while the server runs."""

import asyncio
from abc import ABC, abstractmethod
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager

from handover.telemetry import get_logger

log = get_logger(__name__)

RESTART_DELAY_S = 2.0


class Source(ABC):
    """A background task of the server. `run` handles expected errors itself."""

    @abstractmethod
    async def run(self) -> None:
        """Run until cancelled."""


@asynccontextmanager
async def run_sources(sources: Sequence[Source]) -> AsyncIterator[None]:
    """Run `sources` while the context is open."""
    tasks = [asyncio.create_task(_supervise(source)) for source in sources]
    try:
        yield
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _supervise(source: Source) -> None:
    while True:
        try:
            await source.run()
        except Exception:
            log.exception("source failed; restarting it", source=type(source).__name__)
        await asyncio.sleep(RESTART_DELAY_S)
