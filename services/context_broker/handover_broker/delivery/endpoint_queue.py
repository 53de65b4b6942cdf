"""The queue of one endpoint, shared by all subscriptions that notify it.

While the endpoint answers, every subscription sends at its own pace. After a failure all wait, with
exponential backoff; then one subscription sends a single notification as a probe. So a hundred subscriptions
to a dead endpoint cost one attempt at a time. The pending notifications are bounded, in memory and on disk.
"""

import time
from collections import deque
from dataclasses import dataclass, field
from typing import Final, Protocol

from prometheus_client import Gauge

from handover.runtime.retry import backoff_delay_s

WINDOW: Final = 256
"""Maximum notifications of one endpoint in memory; the others wait on disk."""
MAX_HELD_BYTES: Final = 64 * 1024 * 1024
"""Maximum bytes of all notifications in memory."""
INITIAL_BACKOFF_S: Final = 0.1
MAX_BACKOFF_S: Final = 15.0
SHED: Final = 0.05
"""Part of the limit of an endpoint that is dropped at once when it is exceeded."""

WAITING: Final = Gauge(
    "handover_broker_notifications_pending",
    "Pending notifications: in memory to be sent next, on disk, or throttled",
    ["state"],
)


class EndpointUser(Protocol):
    """A delivery worker, as its endpoint queue uses it."""

    pending_bytes: int
    """Bytes of pending notifications, on disk and in memory."""

    @property
    def held(self) -> int:
        """How many notifications are in memory."""

    @property
    def on_disk(self) -> int:
        """How many notifications are on disk only."""

    @property
    def throttled(self) -> int:
        """How many entities wait for the end of their throttling."""

    def wake(self) -> None:
        """Check again whether a notification may be sent."""


@dataclass(slots=True)
class MemoryBudget:
    """Bytes of notifications in memory, of all endpoints together."""

    held_bytes: int = 0


@dataclass(eq=False)
class EndpointQueue:
    """The queue of one endpoint. Times are of the monotonic clock."""

    memory_budget: MemoryBudget
    max_pending_bytes: int
    """Maximum bytes of pending notifications, on disk and in memory."""
    workers: set[EndpointUser] = field(default_factory=set)
    failures: int = 0
    """Failures in a row."""
    held: int = 0
    pending_bytes: int = 0
    is_shedding: bool = False
    _backoff_until_s: float = 0.0
    _last_failure_s: float = float("-inf")
    _prober: EndpointUser | None = None
    _queue: deque[EndpointUser] = field(default_factory=deque)

    def take(self, size: int) -> None:
        """Count a notification of `size` bytes that is now in memory."""
        self.held += 1
        self.memory_budget.held_bytes += size

    def release(self, size: int) -> None:
        """Count a notification of `size` bytes that has left memory."""
        self.held -= 1
        self.memory_budget.held_bytes -= size

    @property
    def room(self) -> int:
        """How many more notifications may be loaded into memory."""
        return WINDOW - self.held if self.memory_budget.held_bytes < MAX_HELD_BYTES else 0

    @property
    def has_too_much(self) -> bool:
        """Return whether the limit of pending bytes is exceeded."""
        return self.pending_bytes > self.max_pending_bytes

    def join(self, worker: EndpointUser) -> None:
        """Add a delivery worker with its pending notifications."""
        self.workers.add(worker)
        self.pending_bytes += worker.pending_bytes

    def part(self, worker: EndpointUser) -> None:
        """Remove a delivery worker."""
        self.workers.discard(worker)
        self.pending_bytes -= worker.pending_bytes
        self.leave(worker)

    # Probing after a failure

    def wait_s(self, worker: EndpointUser) -> float | None:
        """Return how long a worker has to wait before it sends; None until it is woken."""
        if not self.failures:
            return 0.0
        if self._prober is None:
            self._prober = worker
        if self._prober is not worker:
            if worker not in self._queue:
                self._queue.append(worker)
            return None
        return max(0.0, self._backoff_until_s - time.monotonic())

    def succeeded(self) -> None:
        """Record a delivery: all workers may send."""
        if self.failures:
            self.failures = 0
            self._prober = None
            waiting, self._queue = self._queue, deque()
            for worker in waiting:
                worker.wake()

    def failed(self, worker: EndpointUser, started_s: float, at_least_s: float) -> None:
        """Record a failed attempt of a worker that began at `started_s`; the next one comes after a backoff.

        Attempts that overlap count once.
        """
        now_s = time.monotonic()
        if started_s >= self._last_failure_s:
            self.failures += 1
            self._last_failure_s = now_s
            self._backoff_until_s = now_s + max(backoff_s(self.failures), at_least_s)
        self.leave(worker)

    def leave(self, worker: EndpointUser) -> None:
        """Let the next worker probe: this one has stopped, or goes to the end of the queue."""
        if worker in self._queue:
            self._queue.remove(worker)
        if self._prober is worker:
            self._prober = self._queue.popleft() if self._queue else None
            if self._prober is not None:
                self._prober.wake()


def backoff_s(failures: int) -> float:
    """Return the backoff after so many failures, with jitter."""
    return backoff_delay_s(failures, INITIAL_BACKOFF_S, MAX_BACKOFF_S)
