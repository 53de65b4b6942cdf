"""Group commit: the writes of one iteration of the event loop, or of the time of a flush, are written
together.

So an acknowledgement costs a share of a disk flush. If the disk is fast the event loop writes itself, because
passing a group to a thread and back takes longer than the flush; else a thread writes. When the disk refuses
a group, everything queued behind it is refused too, because it may depend on it. Each write is completed
separately: an error in one does not affect the others.
"""

import asyncio
import queue
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from prometheus_client import Counter

from handover.telemetry import get_logger
from handover_broker.storage.entries import Entries
from handover_broker.storage.journal import Journal, NotStored
from handover_broker.storage.tally import TalliedMetric

log = get_logger(__name__)

Failed = Callable[[Exception], None]
"""Receives `NotStored` when nothing of a write is stored, `NotCompleted` when it is and a later step
failed."""

MAX_GROUP = 2000
MAX_FLUSH_S = 0.0005
"""Maximum flush time for which the event loop writes itself: as long as two or three requests take."""
THREAD_COST_S = 0.0001
"""The cost of passing a write to a thread and back, most of it waiting for the interpreter."""
SAMPLES = 16
"""Iterations of the event loop in the moving average."""
IDLE_S = 0.005
"""If writes are further apart than this, nothing else waits for the event loop."""
RETRY_S = 1.0
"""Delay before writes of `store_later` are tried again after the disk refused them."""
REFUSED = Counter("handover_broker_commits_refused_total", "Commits that the disk refused")
NOT_COMPLETED = Counter(
    "handover_broker_completions_failed_total", "Writes that are stored, but whose completion raised an error"
)
GROUPS = TalliedMetric(
    "handover_broker_commit_group_writes", "Writes in one commit", (1, 2, 4, 8, 16, 32, 64, 256, 1024)
)


class NotCompleted(Exception):
    """A write is stored, but a later step in memory failed; the log has the traceback."""


@dataclass(slots=True, eq=False)
class Write:
    """A write to be made durable, with its callbacks; `era` counts the refusals of the disk before it."""

    entries: Entries
    era: int
    done: Callable[[], None]
    failed: Failed


class Commits(Protocol):
    """Where writes go."""

    def submit(self, entries: Entries, done: Callable[[], None], failed: Failed) -> None:
        """Queue a write; `done` or `failed` is called on the event loop when its result is known."""

    async def store(self, entries: Entries) -> None:
        """Write `entries` and return when they are durable; raise `NotStored` if the disk refuses."""

    def store_later(self, entries: Entries, within_s: float = 0.2) -> None:
        """Write `entries` with the next commit, or after `within_s`; for statistics, without a callback."""


class CommitQueue:
    """Takes writes on the event loop, commits them, and calls back on the loop, in order.

    `on_refusal` is called on the loop when the disk has refused, before any `failed`.
    """

    def __init__(self, journal: Journal, on_refusal: Callable[[], None]) -> None:
        self._journal = journal
        self._on_refusal = on_refusal
        self._queue: queue.SimpleQueue[list[Write] | None] = queue.SimpleQueue()
        self._collected: list[Write] = []
        self._last_send_s = 0.0
        self._usual_group = 1.0
        """Recent average of writes in one iteration of the event loop."""
        self._unfinished = 0
        """Writes that were passed on and not called back yet."""
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread = threading.Thread(target=self._work, name="journal", daemon=True)
        self._era = 0
        self._refused_era = -1
        self._refused_as: type[NotStored] = NotStored
        """Why: what depends on a refused write is refused for the same reason."""
        self._later = Entries()
        self._later_due: asyncio.TimerHandle | None = None

    def start(self) -> None:
        """Start to commit; call it on the event loop."""
        self._loop = asyncio.get_running_loop()
        self._thread.start()

    async def stop(self) -> None:
        """Commit what is queued, and stop."""
        self._send_later()
        self._send()
        self._queue.put(None)
        await asyncio.to_thread(self._thread.join)

    def submit(self, entries: Entries, done: Callable[[], None], failed: Failed) -> None:
        """Queue a write; `done` or `failed` is called on the event loop when its result is known."""
        if self._later_due is not None:
            self._later_due.cancel()
            self._later_due = None
            later, self._later = self._later, Entries()
            failed = self._kept_for_later(later, failed)
            together = Entries()
            together.add(later)
            together.add(entries)
            entries = together
        if not self._collected:
            asyncio.get_running_loop().call_soon(self._send)
        self._collected.append(Write(entries, self._era, done, failed))

    def _send(self) -> None:
        """Pass on the writes of one iteration of the event loop.

        One by one, the first write would wake the thread and be committed alone, and the others would wait
        for it.
        """
        if self._collected:
            writes, self._collected = self._collected, []
            thread_is_idle = not self._unfinished
            self._unfinished += len(writes)
            is_quick = self._is_quick(len(writes))
            if not (thread_is_idle and is_quick and self._commit_at_once(writes)):
                self._queue.put(writes)

    def _is_quick(self, count: int) -> bool:
        """Return whether a flush on the event loop costs less than passing so many writes to the thread."""
        flush_s, before_s, self._last_send_s = self._journal.flush_s, self._last_send_s, time.monotonic()
        self._usual_group += (count - self._usual_group) / SAMPLES
        if flush_s > MAX_FLUSH_S:
            return False
        # Each write is passed on, and each then waits for all of them.
        return flush_s < self._usual_group**2 * THREAD_COST_S or self._last_send_s - before_s > IDLE_S

    def _commit_at_once(self, writes: list[Write]) -> bool:
        """Commit writes on the event loop and return true if that is fast; the thread is idle meanwhile."""
        if writes[0].era <= self._refused_era:
            return False
        entries = together(writes)
        try:
            if not self._journal.commit_at_once(entries):
                return False
        except NotStored as error:
            self._refused_era, self._refused_as = writes[-1].era, type(error)
            REFUSED.inc()
            self._on_failure(writes, error)
            return True
        except Exception:
            log.exception("a group of writes cannot be committed together", writes=len(writes))
            return False  # the thread finds the write that failed
        GROUPS.tally.note(len(writes))
        self._report_success(writes)
        return True

    async def store(self, entries: Entries) -> None:
        """Write `entries` and return when they are durable; raise `NotStored` if the disk refuses."""
        await stored(self, entries)

    def store_later(self, entries: Entries, within_s: float = 0.2) -> None:
        """Write `entries` with the next commit, or after `within_s`; for statistics, without a callback."""
        self._later.add(entries)
        if self._later_due is None:
            self._later_due = asyncio.get_running_loop().call_later(within_s, self._send_later)

    def _send_later(self) -> None:
        if self._later_due is not None:
            self.submit(Entries(), lambda: None, lambda _: None)

    def _kept_for_later(self, later: Entries, failed: Failed) -> Failed:
        """Return a callback that calls `failed` and queues `later` again."""

        def failed_and_kept(error: Exception) -> None:
            if isinstance(error, NotStored):
                self.store_later(later, RETRY_S)
            failed(error)

        return failed_and_kept

    # In the thread

    def _work(self) -> None:
        open_for_more = True
        while open_for_more:
            group: list[Write] = []
            writes = self._queue.get()
            while writes is not None:
                group += writes
                if len(group) >= MAX_GROUP:
                    break
                try:
                    writes = self._queue.get_nowait()
                except queue.Empty:
                    break
            else:
                open_for_more = False
            if group:
                self._commit(group)

    def _commit(self, group: list[Write]) -> None:
        dependent = [write for write in group if write.era <= self._refused_era]
        if dependent:
            self._report_failure(
                dependent, self._refused_as("an earlier change that it may depend on was not stored")
            )
        writable = [write for write in group if write.era > self._refused_era]
        if not writable:
            return
        try:
            self._journal.commit(together(writable))
        except NotStored as error:
            self._refuse(writable, error)
        except Exception as error:  # if this thread ended, every later write would wait for ever
            log.exception("a group of writes cannot be committed", writes=len(writable))
            if len(writable) > 1:
                for write in writable:
                    self._commit([write])
            else:
                self._refuse(writable, NotStored(f"{type(error).__name__}: {error}"))
        else:
            GROUPS.tally.note(len(writable))
            self._call(self._report_success, writable)

    def _refuse(self, writes: list[Write], error: NotStored) -> None:
        self._refused_era, self._refused_as = max(write.era for write in writes), type(error)
        REFUSED.inc()
        self._report_failure(writes, error)

    def _report_failure(self, writes: list[Write], error: NotStored) -> None:
        self._call(self._on_failure, writes, error)

    def _call(self, function: Callable[..., None], *arguments: object) -> None:
        assert self._loop is not None  # noqa: S101 - start() has set it
        self._loop.call_soon_threadsafe(function, *arguments)

    # On the event loop

    def _report_success(self, writes: list[Write]) -> None:
        self._unfinished -= len(writes)
        for write in writes:
            try:
                write.done()
            except Exception as error:
                NOT_COMPLETED.inc()
                log.exception("completion of a stored write failed")
                _call_failed(write, NotCompleted(f"{type(error).__name__}: {error}"))

    def _on_failure(self, writes: list[Write], error: NotStored) -> None:
        log.error("the database refuses changes", error=str(error))
        self._unfinished -= len(writes)
        if writes[-1].era == self._era:
            self._era += 1
            self._on_refusal()
        for write in writes:
            _call_failed(write, error)


def _call_failed(write: Write, error: Exception) -> None:
    """Call `failed` of a write; an error in it does not affect other writes of the group."""
    try:
        write.failed(error)
    except Exception:
        log.exception("handling of a failed write failed")


def together(writes: list[Write]) -> Entries:
    """Return the entries of several writes."""
    entries = Entries()
    for write in writes:
        entries.add(write.entries)
    return entries


async def stored(commits: Commits, entries: Entries) -> None:
    """Submit a write and return when it is durable; raise `NotStored` if the disk refuses."""
    outcome: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    def done() -> None:
        if not outcome.done():
            outcome.set_result(None)

    def failed(error: Exception) -> None:
        if not outcome.done():
            outcome.set_exception(error)

    commits.submit(entries, done, failed)
    await outcome
