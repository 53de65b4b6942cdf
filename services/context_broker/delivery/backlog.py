"""The backlog: what a subscription is owed and is not held in memory, read from the outbox page by page."""

import asyncio
from collections.abc import AsyncIterator
from dataclasses import dataclass
from typing import Final

from services.context_broker.storage.entries import PendingNotification
from services.context_broker.storage.journal import Journal

PAGE_BYTES: Final = 1024 * 1024
"""About what is read in one go: large notifications come one by one."""
SIZES_PAGE: Final = 10_000
"""Notifications whose sizes are looked at in one go."""


@dataclass(frozen=True, slots=True)
class Page:
    """The next notices, and whether there may be more behind them.

    `owed` is how many are owed in all, and their bytes, if that was asked for.
    """

    notices: list[PendingNotification]
    has_more: bool
    pending: tuple[int, int] | None


@dataclass(frozen=True, slots=True)
class Backlog:
    """What waits on disk for one subscription. Reading raises `NotStored` when the disk cannot be read."""

    journal: Journal
    tenant: str
    subscription: str

    async def page(self, after: int, limit: int, *, count: bool) -> Page:
        """Return what is owed next after number `after`, at most `limit`."""
        return await asyncio.to_thread(self._page, after, limit, count)

    async def sizes(self) -> AsyncIterator[list[tuple[int, int]]]:
        """Yield number and size in bytes of all that is owed, oldest first, some at a time."""
        after = 0
        while page := await asyncio.to_thread(
            self.journal.pending_sizes, self.tenant, self.subscription, after, SIZES_PAGE
        ):
            yield page
            after = page[-1][0]

    def _page(self, after: int, limit: int, count: bool) -> Page:
        journal, tenant, one = self.journal, self.tenant, self.subscription
        pending = journal.pending_total(tenant, one) if count else None
        sizes = journal.pending_sizes(tenant, one, after, limit)
        fitting, room_bytes = 0, PAGE_BYTES
        for _, size in sizes:
            fitting += 1
            room_bytes -= size
            if room_bytes <= 0:
                break
        found = journal.pending(tenant, one, after, fitting) if fitting else []
        return Page(found, len(sizes) == limit or fitting < len(sizes), pending)
