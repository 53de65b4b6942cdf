"""When the next live document is sent: after a period, and earlier for a new pose of the person.

A headset asks for documents as often as it draws. A document that follows each of its poses is on the page
before the next frame; one by a timer alone comes up to a period later.
"""

import asyncio
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Final

FOLLOWS_FROM_HZ: Final = 60.0
"""A reader that asks for fewer documents, such as a page on a desk, does not draw in step with the poses."""


class Poses:
    """Wakes those who follow, for each pose that comes."""

    def __init__(self) -> None:
        self._followers: set[asyncio.Event] = set()

    @contextmanager
    def followed(self) -> Iterator[asyncio.Event]:
        """Return an event that each pose sets."""
        event = asyncio.Event()
        self._followers.add(event)
        try:
            yield event
        finally:
            self._followers.discard(event)

    def report(self) -> None:
        """Report a pose."""
        for event in self._followers:
            event.set()


class Pace:
    """Waits for the time of the next document; `least_s` is the shortest time between two."""

    def __init__(self, period_s: float, pose: asyncio.Event, least_s: float | None = None) -> None:
        self._period_s = period_s
        self._pose = pose
        in_step = period_s <= 1.0 / FOLLOWS_FROM_HZ
        self._least_s = least_s if least_s is not None else period_s / 2 if in_step else period_s
        self._due_s = asyncio.get_running_loop().time()

    async def next(self) -> None:
        """Wait; a reader that was slow gets no documents to make up for it."""
        clock = asyncio.get_running_loop().time
        start_s = clock()
        due_s = max(self._due_s + self._period_s, start_s)
        await asyncio.sleep(min(self._least_s, due_s - start_s))
        if not self._pose.is_set() and clock() < due_s:
            with suppress(TimeoutError):
                async with asyncio.timeout_at(due_s):
                    await self._pose.wait()
        self._due_s = min(due_s, clock())
        self._pose.clear()
