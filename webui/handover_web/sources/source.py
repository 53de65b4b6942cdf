"""A source: a supervised background task that follows a part of the cell while the server runs."""

from abc import ABC, abstractmethod
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager

from handover.runtime.background_tasks import BackgroundTasks


class Source(ABC):
    """A background task of the server. `run` handles expected errors itself."""

    @abstractmethod
    async def run(self) -> None:
        """Run until cancelled."""


@asynccontextmanager
async def run_sources(sources: Sequence[Source]) -> AsyncIterator[None]:
    """Run `sources` while the context is open; one that fails is restarted."""
    async with BackgroundTasks("sources") as tasks:
        for source in sources:
            tasks.start_restarting(source.run)
        yield
