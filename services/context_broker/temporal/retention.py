"""Retention: history that is older than it is to be kept is cleared away, a little at a time.

Entities stay as they are; only what has been is forgotten, and entities that are nothing else any more. The
past of an entity that has an `expiresAt` of its own (clause 4.22) is forgotten after that, however young.
"""

import asyncio
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Final

from handover.telemetry import get_logger
from services.context_broker.storage.commits import Commits
from services.context_broker.storage.database import NotStored
from services.context_broker.storage.entries import Entries
from services.context_broker.storage.history_archive import END_OF_TIME, Archive, DepartedRow
from services.context_broker.temporal.history import Departed, seq_before

log = get_logger(__name__)

INITIAL_DELAY_S: Final = 60.0
"""After the start: first the broker takes up its work."""
INTERVAL_S: Final = 6 * 3600.0
CHANGES_PER_COMMIT: Final = 500
"""Changes that are forgotten in one commit: a few milliseconds, for which other commits wait."""
PAUSE_S: Final = 0.05
"""Between pieces, so that clearing takes a small part of the disk's time."""
PLACES_PER_SCAN: Final = 500
"""Entities that are looked at before others get their turn."""


class Retention:
    """Clears away the history of `tenants`.

    What is older than `keep_days` goes; 0 keeps for ever what has no end of its own.
    """

    def __init__(
        self,
        archive: Archive,
        commits: Commits,
        keep_days: float,
        tenants: Callable[[], Iterable[str]] = tuple,
    ) -> None:
        self._archive = archive
        self._commits = commits
        self._keep_days = keep_days
        self._tenants = tenants
        self._task: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Begin; call it on the event loop."""
        self._task = asyncio.get_running_loop().create_task(self._work())

    async def stop(self) -> None:
        """End; what is not cleared yet is cleared another time."""
        if self._task is not None:
            self._task.cancel()
            with suppress(asyncio.CancelledError):
                await self._task

    async def _work(self) -> None:
        await asyncio.sleep(INITIAL_DELAY_S)
        while True:
            try:
                ended = await self.end(time.time())
                cleared = await self.clear(seq_before(self._keep_days)) if self._keep_days > 0 else 0
                log.info("old history cleared", pieces=cleared, ended=ended)
            except NotStored as error:
                log.warning("old history cannot be cleared now", error=str(error))
            await asyncio.sleep(INTERVAL_S)

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
            pieces += await self._forget(place, before)
            await self._forget_if_empty(place)

    async def end(self, now_s: float) -> int:
        """Forget the past of entities whose `expiresAt` has come; return of how many places.

        Raises `NotStored` when the disk refuses; what was forgotten stays so.
        """
        over = await asyncio.to_thread(self._over, tuple(self._tenants()), now_s)
        for tenant, entity_id, place in over:
            await self._forget(place, END_OF_TIME)
            await self._commits.store(Entries(departed={place: DepartedRow(tenant, entity_id, None)}))
        return len(over)

    def _over(self, tenants: Iterable[str], now_s: float) -> list[tuple[str, str, int]]:
        """Return tenant, id and place of what has ended, and of what such an entity was before."""
        found: list[tuple[str, str, int]] = []
        for tenant in tenants:
            before: dict[str, list[int]] = {}
            for place, entity_id, body in self._archive.departed(tenant):
                before.setdefault(entity_id, []).append(place)
                if Departed.restored(body).has_expired_at(now_s):
                    found += [(tenant, entity_id, one) for one in before.pop(entity_id)]
        return found

    async def _forget(self, place: int, before: int) -> int:
        """Forget the changes at a place with a seq below `before`; return in how many pieces."""
        pieces = 0
        bound: int | None = 0
        while bound is not None:
            bound = await asyncio.to_thread(self._archive.bound_of, place, CHANGES_PER_COMMIT, before)
            await self._commits.store(Entries(cleared=[(place, before if bound is None else bound)]))
            pieces += 1
            await asyncio.sleep(PAUSE_S)
        return pieces

    def _next_with_old(self, after: int, before: int) -> tuple[int, bool]:
        """Return the next place with something to clear, else how far has been looked, -1 at the end."""
        place = after
        for _ in range(PLACES_PER_SCAN):
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
