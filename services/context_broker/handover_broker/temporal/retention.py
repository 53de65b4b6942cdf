"""Deletes history that has reached its retention time, in small commits.

Current entities stay; only their old history is deleted, and entities that have a history only. The history
of an entity with its own `expiresAt` (clause 4.22) is deleted after that time, however young it is.
"""

import asyncio
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Final

from handover.telemetry import get_logger
from handover_broker.storage.commits import Commits
from handover_broker.storage.database import NotStored
from handover_broker.storage.entries import Entries
from handover_broker.storage.history_archive import END_OF_TIME, Archive, TemporalOnlyRow
from handover_broker.temporal.history import TemporalOnlyEntity, seq_before

log = get_logger(__name__)

INITIAL_DELAY_S: Final = 60.0
"""Delay after the start, when the broker is busy loading."""
INTERVAL_S: Final = 6 * 3600.0
CHANGES_PER_COMMIT: Final = 500
"""Changes deleted in one commit; it takes a few milliseconds, for which other commits wait."""
PAUSE_S: Final = 0.05
"""Pause between commits, so that they take a small part of the disk's time."""
ENTITIES_PER_SCAN: Final = 500
"""Entities that are scanned before the thread returns."""


class Retention:
    """Deletes the old history of `tenants`.

    History older than `keep_days` is deleted; 0 keeps all that has no expiry of its own.
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
        """Start the background task; call it on the event loop."""
        self._task = asyncio.get_running_loop().create_task(self._work())

    async def stop(self) -> None:
        """Stop; remaining history is deleted later."""
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
                log.info("old history deleted", commits=cleared, expired=ended)
            except NotStored as error:
                log.warning("old history cannot be deleted", error=str(error))
            await asyncio.sleep(INTERVAL_S)

    async def clear(self, before: int) -> int:
        """Delete all changes with a seq below `before`; return the number of commits.

        Raises `NotStored` when the disk refuses; earlier commits stay.
        """
        pieces, entity_seq = 0, -1
        while True:
            entity_seq, has_old = await asyncio.to_thread(self._next_with_old_history, entity_seq, before)
            if not has_old:
                if entity_seq < 0:
                    return pieces
                await asyncio.sleep(PAUSE_S)
                continue
            pieces += await self._delete(entity_seq, before)
            await self._delete_if_empty(entity_seq)

    async def end(self, now_s: float) -> int:
        """Delete the history of entities whose `expiresAt` has passed; return the number of entities.

        Raises `NotStored` when the disk refuses; earlier commits stay.
        """
        over = await asyncio.to_thread(self._expired, tuple(self._tenants()), now_s)
        for tenant, entity_id, entity_seq in over:
            await self._delete(entity_seq, END_OF_TIME)
            await self._commits.store(
                Entries(temporal_only={entity_seq: TemporalOnlyRow(tenant, entity_id, None)})
            )
        return len(over)

    def _expired(self, tenants: Iterable[str], now_s: float) -> list[tuple[str, str, int]]:
        """Return tenant, id and sequence number of expired history, also earlier ones of the same entity."""
        expired: list[tuple[str, str, int]] = []
        for tenant in tenants:
            before: dict[str, list[int]] = {}
            for entity_seq, entity_id, body in self._archive.temporal_only_entities(tenant):
                before.setdefault(entity_id, []).append(entity_seq)
                if TemporalOnlyEntity.restored(body).has_expired_at(now_s):
                    expired += [(tenant, entity_id, seq) for seq in before.pop(entity_id)]
        return expired

    async def _delete(self, entity_seq: int, before: int) -> int:
        """Delete the changes of an entity with a seq below `before`; return the number of commits."""
        pieces = 0
        bound: int | None = 0
        while bound is not None:
            bound = await asyncio.to_thread(self._archive.bound_of, entity_seq, CHANGES_PER_COMMIT, before)
            await self._commits.store(Entries(cleared=[(entity_seq, before if bound is None else bound)]))
            pieces += 1
            await asyncio.sleep(PAUSE_S)
        return pieces

    def _next_with_old_history(self, after: int, before: int) -> tuple[int, bool]:
        """Return the next entity with something to delete, else the last scanned one, -1 at the end."""
        entity_seq = after
        for _ in range(ENTITIES_PER_SCAN):
            change = self._archive.first_change(entity_seq)
            if change is None:
                return -1, False
            entity_seq, seq = change
            if seq < before:
                return entity_seq, True
        return entity_seq, False

    async def _delete_if_empty(self, entity_seq: int) -> None:
        gone = await asyncio.to_thread(self._archive.temporal_only_without_history, entity_seq)
        if gone is not None:
            tenant, entity_id = gone
            await self._commits.store(
                Entries(temporal_only={entity_seq: TemporalOnlyRow(tenant, entity_id, None)})
            )
