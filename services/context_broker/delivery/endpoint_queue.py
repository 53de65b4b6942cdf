"""A line: the way to one endpoint, shared by all subscriptions that notify it.

While notifications arrive, every subscription sends at its own pace. When one does not, the line rests,
longer each time, and then a single one is sent to see whether anybody is there again: a hundred subscriptions
to a dead endpoint cost one attempt at a time. What waits is bounded here, in memory and on disk.
"""

import time
from collections import deque
from dataclasses import dataclass, field
from typing import Final, Protocol

from prometheus_client import Gauge

from handover.retry import backoff_delay_s

WINDOW: Final = 256
"""Notifications to one endpoint that are held in memory; the others wait on disk."""
MAX_HELD_BYTES: Final = 64 * 1024 * 1024
"""Bytes of all notifications together that are held in memory."""
INITIAL_BACKOFF_S: Final = 0.1
MAX_BACKOFF_S: Final = 15.0
SHED: Final = 0.05
"""Part of what may wait for an endpoint that is given up at once when there is too much."""

WAITING: Final = Gauge(
    "handover_broker_notifications_pending",
    "Notifications that wait: in memory to be sent next, on disk, or for their throttling to end",
    ["state"],
)


class EndpointUser(Protocol):
    """Somebody with notifications for a line: the courier of a subscription."""

    pending_bytes: int
    """How much is owed, on disk and in memory."""

    @property
    def held(self) -> int:
        """How many notifications are held in memory."""

    @property
    def on_disk(self) -> int:
        """How many notifications wait on disk only."""

    @property
    def throttled(self) -> int:
        """How many entities wait for their throttling to end."""

    def wake(self) -> None:
        """Look again whether it is your turn."""


@dataclass(slots=True)
class MemoryBudget:
    """How many bytes of notifications are in memory, on all lines together."""

    held_bytes: int = 0


@dataclass(eq=False)
class EndpointQueue:
    """The way to one endpoint. Times are those of the monotonic clock."""

    memory_budget: MemoryBudget
    max_pending_bytes: int
    """How much may wait, on disk and in memory."""
    workers: set[EndpointUser] = field(default_factory=set)
    failures: int = 0
    """Attempts that failed since the last that did not."""
    held: int = 0
    pending_bytes: int = 0
    is_shedding: bool = False
    _rests_until_s: float = 0.0
    _last_failure_s: float = float("-inf")
    _prober: EndpointUser | None = None
    _queue: deque[EndpointUser] = field(default_factory=deque)

    def take(self, size: int) -> None:
        """Note a notification of `size` bytes that is in memory now."""
        self.held += 1
        self.memory_budget.held_bytes += size

    def release(self, size: int) -> None:
        """Note that it no longer is."""
        self.held -= 1
        self.memory_budget.held_bytes -= size

    @property
    def room(self) -> int:
        """How many more notifications may be held in memory."""
        return WINDOW - self.held if self.memory_budget.held_bytes < MAX_HELD_BYTES else 0

    @property
    def has_too_much(self) -> bool:
        """Say whether more waits than may."""
        return self.pending_bytes > self.max_pending_bytes

    def join(self, worker: EndpointUser) -> None:
        """Note a courier that goes this way from now on, with all that it has to deliver."""
        self.workers.add(worker)
        self.pending_bytes += worker.pending_bytes

    def part(self, worker: EndpointUser) -> None:
        """Note that a courier no longer goes this way."""
        self.workers.discard(worker)
        self.pending_bytes -= worker.pending_bytes
        self.leave(worker)

    # Turns

    def wait_s(self, worker: EndpointUser) -> float | None:
        """Return how long a courier has to wait before it sends; None until it is woken."""
        if not self.failures:
            return 0.0
        if self._prober is None:
            self._prober = worker
        if self._prober is not worker:
            if worker not in self._queue:
                self._queue.append(worker)
            return None
        return max(0.0, self._rests_until_s - time.monotonic())

    def succeeded(self) -> None:
        """Note that somebody is there: all may send."""
        if self.failures:
            self.failures = 0
            self._prober = None
            waiting, self._queue = self._queue, deque()
            for one in waiting:
                one.wake()

    def failed(self, worker: EndpointUser, started_s: float, at_least_s: float) -> None:
        """Note an attempt of `courier`, begun at `started_s`, that failed; the next comes after a rest.

        Attempts that were under way together count once.
        """
        now_s = time.monotonic()
        if started_s >= self._last_failure_s:
            self.failures += 1
            self._last_failure_s = now_s
            self._rests_until_s = now_s + max(backoff_s(self.failures), at_least_s)
        self.leave(worker)

    def leave(self, worker: EndpointUser) -> None:
        """Let the next have its turn: this one is gone, or goes to the end of the queue."""
        if worker in self._queue:
            self._queue.remove(worker)
        if self._prober is worker:
            self._prober = self._queue.popleft() if self._queue else None
            if self._prober is not None:
                self._prober.wake()


def backoff_s(failures: int) -> float:
    """Return how long to wait after so many failures, some more or less so that not all come together."""
    return backoff_delay_s(failures, INITIAL_BACKOFF_S, MAX_BACKOFF_S)
