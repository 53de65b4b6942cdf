"""The backlog of a subscription: pending notifications that are not in memory, read from the outbox by
pages."""

import asyncio
from collections.abc import AsyncIterator
from dataclasses import dataclass
from typing import Final

from handover_broker.storage.entries import PendingNotification
from handover_broker.storage.journal import Journal

PAGE_BYTES: Final = 1024 * 1024
"""Approximate size of one page: large notifications are read one by one."""
SIZES_PAGE: Final = 10_000
"""Notifications whose sizes are read at once."""


@dataclass(frozen=True, slots=True)
class BacklogPage:
    """The next notifications, and whether there may be more after them.

    `pending` is the number and the size in bytes of all pending ones, if that was asked for.
    """

    notices: list[PendingNotification]
    has_more: bool
    pending: tuple[int, int] | None


@dataclass(frozen=True, slots=True)
class Backlog:
    """The notifications on disk of one subscription. Reading raises `NotStored` when the disk cannot be
    read."""

    journal: Journal
    tenant: str
    subscription: str

    async def page(self, after: int, limit: int, *, count: bool) -> BacklogPage:
        """Return at most `limit` pending notifications after number `after`."""
        return await asyncio.to_thread(self._page, after, limit, count)

    async def sizes(self) -> AsyncIterator[list[tuple[int, int]]]:
        """Yield number and size in bytes of all pending notifications, oldest first, in pages."""
        after = 0
        while page := await asyncio.to_thread(
            self.journal.pending_sizes, self.tenant, self.subscription, after, SIZES_PAGE
        ):
            yield page
            after = page[-1][0]

    def _page(self, after: int, limit: int, count: bool) -> BacklogPage:
        journal, tenant, subscription = self.journal, self.tenant, self.subscription
        pending = journal.pending_total(tenant, subscription) if count else None
        sizes = journal.pending_sizes(tenant, subscription, after, limit)
        fitting, room_bytes = 0, PAGE_BYTES
        for _, size in sizes:
            fitting += 1
            room_bytes -= size
            if room_bytes <= 0:
                break
        notices = journal.pending(tenant, subscription, after, fitting) if fitting else []
        return BacklogPage(notices, len(sizes) == limit or fitting < len(sizes), pending)
