"""Resync: an action is repeated regularly, at once on request, and soon after a failure."""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

import pytest

from handover.broker.resync import Resync


class Reconciliation:
    """Counts its runs; those whose numbers fulfil `fails` fail."""

    def __init__(self, fails: Callable[[int], bool] = lambda _: False) -> None:
        self.runs = 0
        self.changed = asyncio.Condition()
        self._fails = fails

    async def run(self) -> bool:
        async with self.changed:
            self.runs += 1
            self.changed.notify_all()
        return not self._fails(self.runs)

    async def wait_for(self, runs: int) -> None:
        async with asyncio.timeout(120), self.changed:
            await self.changed.wait_for(lambda: self.runs >= runs)


@asynccontextmanager
async def running(resync: Resync) -> AsyncIterator[None]:
    task = asyncio.create_task(resync.run())
    yield
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)


async def test_runs_are_regular() -> None:
    reconciliation = Reconciliation()
    async with running(Resync(reconciliation.run, 0.01)):
        await reconciliation.wait_for(5)


async def test_several_requests_cause_one_run_at_once() -> None:
    reconciliation = Reconciliation()
    resync = Resync(reconciliation.run, 3600)
    async with running(resync):
        await reconciliation.wait_for(1)
        for _ in range(3):
            resync.request()
        await reconciliation.wait_for(2)
        for _ in range(100):  # iterations of the event loop in which another run would start
            await asyncio.sleep(0)
        assert reconciliation.runs == 2
        resync.request()
        await reconciliation.wait_for(3)
        assert reconciliation.runs == 3


async def test_a_request_during_a_run_causes_another_run() -> None:
    resync: Resync

    async def run() -> bool:
        reconciliation.runs += 1
        if reconciliation.runs == 1:
            resync.request()
        async with reconciliation.changed:
            reconciliation.changed.notify_all()
        return True

    reconciliation = Reconciliation()
    resync = Resync(run, 3600)
    async with running(resync):
        await reconciliation.wait_for(2)


async def test_a_failed_run_is_soon_repeated() -> None:
    reconciliation = Reconciliation(fails=lambda number: number < 3)
    async with running(Resync(reconciliation.run, 3600)):
        await reconciliation.wait_for(3)


async def test_an_exception_of_a_run_propagates() -> None:
    async def run() -> bool:
        raise ValueError("a defect")

    with pytest.raises(ValueError, match="a defect"):
        await Resync(run, 1).run()
