"""Transient entities and attributes: they are deleted at their `expiresAt` (clause 4.22).

Each entity with an `expiresAt` is in the queue once, however often it changes; its state when it is due
counts. After a restart the queue is built again, and what expired meanwhile is deleted at once.
"""

import asyncio
import heapq
import itertools
import time
from typing import Final, Protocol

from handover.errors import Problem
from handover.telemetry import get_logger
from handover_broker.model import changes
from handover_broker.model.entity import Entity, Event
from handover_broker.model.validation import has_expired, moment, timestamp_now
from handover_broker.storage.journal import NotStored

log = get_logger(__name__)

MAX_SLEEP_S: Final = 30.0
"""Maximum sleep, because the wall clock may be set meanwhile."""
RETRY_S: Final = 1.0
"""Delay before an expiry is tried again that could not be stored."""
LEFT_BEHIND: Final = 1000
"""Entries of deleted entities that may stay in the queue: removing them is expensive."""
AT_ONCE: Final = 500
"""Expiries that are handled before other tasks run."""


class ExpiringStore(Protocol):
    """The entities of one tenant, as the queue uses them."""

    def latest(self, entity_id: str) -> Entity | None:
        """Return the entity as the last write left it."""

    def stage(self, event: Event) -> asyncio.Future[None]:
        """Start to write a change."""


class ExpiryQueue:
    """Deletes transient entities and attributes of all tenants when they expire."""

    def __init__(self) -> None:
        self._queue: list[tuple[float, int, ExpiringStore, str]] = []
        self._due_s: dict[tuple[ExpiringStore, str], float] = {}
        self._numbers = itertools.count()
        self._timer: asyncio.TimerHandle | None = None
        self._loop: asyncio.AbstractEventLoop | None = None

    @property
    def waiting(self) -> int:
        """The length of the queue."""
        return len(self._queue)

    def watch(self, store: ExpiringStore, entity: Entity) -> None:
        """Add an entity with its next expiry."""
        end_s = moment(entity.ends_at or "")
        if end_s is not None:
            self._put(store, entity.id, end_s)

    def forget(self, store: ExpiringStore, entity_id: str) -> None:
        """Remove an entity that was deleted before; its entry leaves the queue when there are many."""
        self._due_s.pop((store, entity_id), None)
        if len(self._queue) > 2 * len(self._due_s) + LEFT_BEHIND:
            self._queue = [end for end in self._queue if self._due_s.get((end[2], end[3])) == end[0]]
            heapq.heapify(self._queue)

    def start(self) -> None:
        """Start; call it on the event loop."""
        self._loop = asyncio.get_running_loop()
        self._work()

    def stop(self) -> None:
        """Stop."""
        self._loop = None
        if self._timer is not None:
            self._timer.cancel()

    def _put(self, store: ExpiringStore, entity_id: str, due_s: float) -> None:
        known_s = self._due_s.get((store, entity_id))
        if known_s is not None and known_s <= due_s:
            return
        self._due_s[store, entity_id] = due_s
        heapq.heappush(self._queue, (due_s, next(self._numbers), store, entity_id))
        if self._queue[0][0] == due_s:
            self._set_timer()

    def _set_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if self._loop is not None and self._queue:
            wait_s = min(max(0.0, self._queue[0][0] - time.time()), MAX_SLEEP_S)
            self._timer = self._loop.call_later(wait_s, self._work)

    def _work(self) -> None:
        now_s = time.time()
        for _ in range(AT_ONCE):
            if not self._queue or self._queue[0][0] > now_s:
                break
            due_s, _, store, entity_id = heapq.heappop(self._queue)
            if self._due_s.get((store, entity_id)) != due_s:
                continue  # an earlier expiry has replaced it
            del self._due_s[store, entity_id]
            self._look_at(store, entity_id, now_s)
        self._set_timer()

    def _look_at(self, store: ExpiringStore, entity_id: str, now_s: float) -> None:
        entity = store.latest(entity_id)
        end_s = None if entity is None or entity.ends_at is None else moment(entity.ends_at)
        if entity is None or end_s is None:
            return
        if end_s > now_s:
            self._put(store, entity_id, end_s)
        else:
            self._end(store, entity, now_s)

    def _end(self, store: ExpiringStore, entity: Entity, now_s: float) -> None:
        if has_expired(entity.expires_at, now_s):
            event = Event.end_of(entity)
        else:
            outcome = changes.outlived(entity, now_s, timestamp_now())
            event = Event(entity, outcome.entity, outcome.touched)

        def ended(outcome: asyncio.Future[None]) -> None:
            error = None if outcome.cancelled() else outcome.exception()
            if isinstance(error, NotStored | Problem):
                log.warning("an expiry could not be stored", entity=entity.id, error=str(error))
                self._put(store, entity.id, time.time() + RETRY_S)

        store.stage(event).add_done_callback(ended)
