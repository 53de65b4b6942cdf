"""Counts the uses of @contexts, and writes them now and then.

One write for each use would cost more than the use.
"""

import asyncio
import time
from collections.abc import Callable, Sequence
from typing import Final

import orjson

from handover_broker.contexts.context_store import ContextStore, Documents, StoredContext
from handover_broker.storage.entries import DocumentKind

KEPT_S: Final = 5.0
"""The interval of writes; a crash loses the counts since the last one."""


class Usage:
    """Counts the uses of contexts. `keep_later` writes them; `outdated` is called for one that has to be
    fetched again."""

    def __init__(
        self,
        shelf: ContextStore,
        keep_later: Callable[[Documents], None],
        outdated: Callable[[StoredContext], None],
    ) -> None:
        self._shelf = shelf
        self._keep_later = keep_later
        self._outdated = outdated
        self._due: asyncio.TimerHandle | None = None

    def remember(self, key: str, stored: bytes) -> None:
        """Load stored counts."""
        context = self._shelf.named(key)
        if context is not None:
            fields = orjson.loads(stored)
            context.hits, context.used_s = fields["hits"], fields["used_s"]
            context.hits_kept = context.hits

    def note(self, used: Sequence[StoredContext]) -> None:
        """Count contexts that are used now."""
        now_s = time.time()
        for context in used:
            context.hits += 1
            context.used_s = now_s
            if context.expires_s <= now_s:
                self._outdated(context)
        if self._due is None:
            self._write_soon()

    def seen(self, context: StoredContext) -> None:
        """Count that a client read a cached context (clause 5.13.3.5)."""
        context.hits += 1
        if self._due is None:
            self._write_soon()

    def write(self) -> None:
        """Write the counts that changed since the last write."""
        if self._due is not None:
            self._due.cancel()
            self._due = None
        used = [stored for stored in self._shelf if stored.hits != stored.hits_kept and not stored.gone]
        for context in used:
            context.hits_kept = context.hits
        if used:
            self._keep_later(
                {
                    (DocumentKind.CONTEXT_USAGE, stored.tenant, stored.key): stored.stored_usage()
                    for stored in used
                }
            )

    def _write_soon(self) -> None:
        self._due = asyncio.get_running_loop().call_later(KEPT_S, self.write)
