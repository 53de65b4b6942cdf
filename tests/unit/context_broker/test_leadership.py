"""Leadership: a broker leads from the moment in which its event loop has looked for what is owed."""

import asyncio
import time
from contextlib import contextmanager
from typing import Any

from services.context_broker.storage.leadership import ElectedBroker


class Database:
    """Gives the lock to whoever asks, and says which statements it was sent."""

    name = "postgresql://nowhere"

    @contextmanager
    def connected(self) -> Any:
        yield self

    def execute(self, statement: str) -> "Database":
        return self

    def fetchone(self) -> tuple[bool]:
        return (True,)

    def notifies(self, timeout: float, stop_after: int) -> list[Any]:
        return []


async def test_a_broker_that_has_won_leads_when_its_event_loop_has_been_told_and_not_before() -> None:
    broker = ElectedBroker(Database(), "SELECT 1")  # type: ignore[arg-type]  # what it needs of one
    turns: list[bool] = []

    def told(leads: bool) -> None:
        turns.append(leads)

    broker.start(told, lambda: None)
    try:
        while not broker._has_lock:  # the event loop stands still meanwhile: it has not been told
            time.sleep(0.001)
        assert not broker.leads
        assert turns == []
        async with asyncio.timeout(120):
            while not turns:
                await asyncio.sleep(0.001)
        assert turns == [True]
        assert broker.leads
    finally:
        broker.stop()
    assert not broker.leads
