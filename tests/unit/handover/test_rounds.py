"""Rounds: regular, at once when wished, soon after one that failed."""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

import pytest

from handover.rounds import Rounds


class Walk:
    """Counts rounds; those whose numbers are in `bad` fail."""

    def __init__(self, bad: Callable[[int], bool] = lambda _: False) -> None:
        self.gone = 0
        self.moved = asyncio.Condition()
        self._bad = bad

    async def go(self) -> bool:
        async with self.moved:
            self.gone += 1
            self.moved.notify_all()
        return not self._bad(self.gone)

    async def has_gone(self, rounds: int) -> None:
        async with asyncio.timeout(120), self.moved:
            await self.moved.wait_for(lambda: self.gone >= rounds)


@asynccontextmanager
async def kept(rounds: Rounds) -> AsyncIterator[None]:
    chore = asyncio.create_task(rounds.keep())
    yield
    chore.cancel()
    await asyncio.gather(chore, return_exceptions=True)


async def test_rounds_are_regular() -> None:
    walk = Walk()
    async with kept(Rounds(walk.go, 0.01)):
        await walk.has_gone(5)


async def test_a_wish_is_a_round_at_once_and_several_are_one() -> None:
    walk = Walk()
    rounds = Rounds(walk.go, 3600)
    async with kept(rounds):
        await walk.has_gone(1)
        for _ in range(3):
            rounds.wish()
        await walk.has_gone(2)
        for _ in range(100):  # turns of the loop in which another round would begin
            await asyncio.sleep(0)
        assert walk.gone == 2
        rounds.wish()
        await walk.has_gone(3)
        assert walk.gone == 3


async def test_a_wish_during_a_round_asks_for_another() -> None:
    rounds: Rounds

    async def go() -> bool:
        walk.gone += 1
        if walk.gone == 1:
            rounds.wish()
        async with walk.moved:
            walk.moved.notify_all()
        return True

    walk = Walk()
    rounds = Rounds(go, 3600)
    async with kept(rounds):
        await walk.has_gone(2)


async def test_a_round_that_failed_is_soon_gone_again() -> None:
    walk = Walk(bad=lambda number: number < 3)
    async with kept(Rounds(walk.go, 3600)):
        await walk.has_gone(3)


async def test_what_a_round_raises_ends_them() -> None:
    async def go() -> bool:
        raise ValueError("a defect")

    with pytest.raises(ValueError, match="a defect"):
        await Rounds(go, 1).keep()
