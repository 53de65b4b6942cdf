"""Retention: history that is older than it is to be kept is cleared away, a little at a time.

Entities stay as they are; only what has been is forgotten, and entities that are nothing else any more.
"""

import asyncio
from collections.abc import Callable
from contextlib import suppress
from typing import Final

from handover.telemetry import get_logger
from services.context_broker.storage.commits import Commits
from services.context_broker.storage.journal import Entries, NotStored
from services.context_broker.temporal.archive import Archive, DepartedRow
from services.context_broker.temporal.history import seq_before

log = get_logger(__name__)

FIRST_S: Final = 60.0
"""After the start: first the broker takes up its work."""
EVERY_S: Final = 6 * 3600.0
PIECE: Final = 500
"""Changes that are forgotten in one commit: a few milliseconds, for which other commits wait."""
PAUSE_S: Final = 0.05
"""Between pieces, so that clearing takes a small part of the disk's time."""
PLACES_A_LOOK: Final = 500
"""Entities that are looked at before others get their turn."""


class Retention:
    """Clears history away. `is_due` says whether this broker is the one to do it."""

    def __init__(
        self, archive: Archive, commits: Commits, keep_days: float, is_due: Callable[[], bool] = lambda: True
    ) -> None:
        self._archive = archive
        self._commits = commits
        self._keep_days = keep_days
        self._is_due = is_due
        self._task: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Begin; call it on the event loop. Nothing is done where history is kept for ever."""
        if self._keep_days > 0:
            self._task = asyncio.get_running_loop().create_task(self._work())

    async def stop(self) -> None:
        """End; what is not cleared yet is cleared another time."""
        if self._task is not None:
            self._task.cancel()
            with suppress(asyncio.CancelledError):
                await self._task

    async def _work(self) -> None:
        await asyncio.sleep(FIRST_S)
        while True:
            if self._is_due():
                try:
                    cleared = await self.clear(seq_before(self._keep_days))
                    log.info("old history cleared", pieces=cleared)
                except NotStored as error:
                    log.warning("old history cannot be cleared now", error=str(error))
            await asyncio.sleep(EVERY_S)

    async def clear(self, before: int) -> int:
        """Forget all changes with a seq below `before`; return in how many pieces.

        Raises `NotStored` when the disk refuses; what was cleared stays cleared.
        """
        pieces, place = 0, -1
        while True:
            place, has_old = await asyncio.to_thread(self._next_with_old, place, before)
            if not has_old:
                if place < 0:
                    return pieces
                await asyncio.sleep(PAUSE_S)
                continue
            bound: int | None = 0
            while bound is not None:
                bound = await asyncio.to_thread(self._archive.bound_of, place, PIECE, before)
                await self._commits.store(Entries(cleared=[(place, before if bound is None else bound)]))
                pieces += 1
                await asyncio.sleep(PAUSE_S)
            await self._forget_if_empty(place)

    def _next_with_old(self, after: int, before: int) -> tuple[int, bool]:
        """Return the next place with something to clear, else how far has been looked, -1 at the end."""
        place = after
        for _ in range(PLACES_A_LOOK):
            found = self._archive.first_change(place)
            if found is None:
                return -1, False
            place, seq = found
            if seq < before:
                return place, True
        return place, False

    async def _forget_if_empty(self, place: int) -> None:
        gone = await asyncio.to_thread(self._archive.departed_without_history, place)
        if gone is not None:
            tenant, entity_id = gone
            await self._commits.store(Entries(departed={place: DepartedRow(tenant, entity_id, None)}))
