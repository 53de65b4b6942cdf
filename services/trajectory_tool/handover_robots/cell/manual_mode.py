"""The manual mode of a cell: people move its robots, each person another one, and no robot performs a Task.

The first person acquires the locks under which Tasks perform (`RobotUnit.in_hand`), of all robots; the last
one releases them. Robots that move at the same time keep apart by `limits.neighbours`, and planned motions do
not know of those: so a Task begins when nobody moves a robot of the cell any more.
"""

import asyncio
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager


class ManualMode:
    """The robots of a cell that people move."""

    def __init__(self) -> None:
        self._robots: dict[str, asyncio.Lock] = {}
        self._turn = asyncio.Lock()
        self._people = 0
        self._held: list[asyncio.Lock] = []

    @asynccontextmanager
    async def joined(
        self, name: str, locks: Mapping[str, asyncio.Lock], patience_s: float
    ) -> AsyncIterator[None]:
        """Move the robot `name`; `locks` are those of all robots of the cell, in which Tasks perform.

        Raises `TimeoutError` when a Task, or another person with this robot, does not end in time.
        """
        self._people += 1
        robot = self._robots.setdefault(name, asyncio.Lock())
        try:
            async with asyncio.timeout(patience_s):
                async with self._turn:
                    await self._acquire(locks)
                await robot.acquire()
            try:
                yield
            finally:
                robot.release()
        finally:
            self._people -= 1
            if self._people == 0:
                self._release()

    async def _acquire(self, locks: Mapping[str, asyncio.Lock]) -> None:
        if self._held:
            return
        try:
            for lock in locks.values():
                await lock.acquire()
                self._held.append(lock)
        except BaseException:
            self._release()
            raise

    def _release(self) -> None:
        held, self._held = self._held, []
        for lock in held:
            lock.release()
