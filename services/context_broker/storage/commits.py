"""Commits in groups: what one turn of the event loop brings, or comes during a flush, is written together.

So an acknowledgement costs its share of a disk flush, not a flush of its own. Where the disk is quick the
event loop writes by itself, since to hand a group to a thread and back takes longer than the flush; else a
thread writes. When the disk refuses, the whole group is refused, and with it everything that was queued
behind it and may build on it. Completion is guarded for each write by itself: one that raises fails alone.
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
from services.context_broker.storage.entries import Entries
from services.context_broker.storage.journal import Journal, NotStored
from services.context_broker.storage.tally import TalliedMetric

log = get_logger(__name__)

Failed = Callable[[Exception], None]
"""Takes `NotStored` when nothing of a write is kept, `NotCompleted` when it is, and what follows failed."""

MAX_GROUP = 2000
MAX_FLUSH_S = 0.0005
"""What the event loop waits for a disk at most: as long as two or three requests take."""
HANDING_OVER_S = 0.0001
"""What it costs a write to go to a thread and back, most of it waiting for the interpreter."""
REMEMBERED = 16
"""Turns of the event loop."""
IDLE_S = 0.005
"""Where writes come less often than this, nothing else waits for the event loop."""
RETRY_S = 1.0
"""How long bookkeeping that the disk refused waits for its next chance."""
REFUSED = Counter("handover_broker_commits_refused_total", "Commits that the disk did not take")
NOT_COMPLETED = Counter(
    "handover_broker_completions_failed_total", "Writes that are stored, and whose completion raised an error"
)
GROUPS = TalliedMetric(
    "handover_broker_commit_group_writes", "Writes in one commit", (1, 2, 4, 8, 16, 32, 64, 256, 1024)
)


class NotCompleted(Exception):
    """A write is stored, but what had to follow in memory failed; the log has the traceback."""


@dataclass(slots=True, eq=False)
class Write:
    """Something to be made durable, and whom to tell; `era` counts how often the disk has refused before."""

    entries: Entries
    era: int
    done: Callable[[], None]
    failed: Failed


class Commits(Protocol):
    """Where writes go."""

    def submit(self, entries: Entries, done: Callable[[], None], failed: Failed) -> None:
        """Queue a write; `done` or `failed` is called on the loop when its fate is known."""

    async def store(self, entries: Entries) -> None:
        """Write `entries` and return when they are safe; raise `NotStored` if the disk refuses."""

    def store_later(self, entries: Entries, within_s: float = 0.2) -> None:
        """Write `entries` with the next commit, or after `within_s`; for bookkeeping only, nobody is told."""


class CommitQueue:
    """Takes writes on the event loop, commits them, and tells their makers on the loop, in order.

    `on_refusal` is called on the loop, before any maker is told, when the disk has refused.
    """

    def __init__(self, journal: Journal, on_refusal: Callable[[], None]) -> None:
        self._journal = journal
        self._on_refusal = on_refusal
        self._queue: queue.SimpleQueue[list[Write] | None] = queue.SimpleQueue()
        self._gathered: list[Write] = []
        self._sent_s = 0.0
        self._usual = 1.0
        """How many writes a turn of the event loop has brought of late."""
        self._under_way = 0
        """Writes on their way: handed over, and their makers not told yet."""
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread = threading.Thread(target=self._work, name="journal", daemon=True)
        self._era = 0
        self._refused_era = -1
        self._later = Entries()
        self._later_due: asyncio.TimerHandle | None = None

    def start(self) -> None:
        """Begin to commit; call it on the event loop."""
        self._loop = asyncio.get_running_loop()
        self._thread.start()

    async def stop(self) -> None:
        """Commit what is queued, and end."""
        self._send_later()
        self._send()
        self._queue.put(None)
        await asyncio.to_thread(self._thread.join)

    def submit(self, entries: Entries, done: Callable[[], None], failed: Failed) -> None:
        """Queue a write; `done` or `failed` is called on the loop when its fate is known."""
        if self._later_due is not None:
            self._later_due.cancel()
            self._later_due = None
            later, self._later = self._later, Entries()
            failed = self._kept_for_later(later, failed)
            together = Entries()
            together.add(later)
            together.add(entries)
            entries = together
        if not self._gathered:
            asyncio.get_running_loop().call_soon(self._send)
        self._gathered.append(Write(entries, self._era, done, failed))

    def _send(self) -> None:
        """Hand over what one turn of the event loop has brought.

        One by one, the first write would wake the thread and be committed alone, and the others wait for it.
        """
        if self._gathered:
            writes, self._gathered = self._gathered, []
            thread_is_idle = not self._under_way
            self._under_way += len(writes)
            is_quick = self._is_quick(len(writes))
            if not (thread_is_idle and is_quick and self._commit_at_once(writes)):
                self._queue.put(writes)

    def _is_quick(self, count: int) -> bool:
        """Say whether the event loop loses less by a flush than by handing so many writes over, as a rule."""
        flush_s, before_s, self._sent_s = self._journal.flush_s, self._sent_s, time.monotonic()
        self._usual += (count - self._usual) / REMEMBERED
        if flush_s > MAX_FLUSH_S:
            return False
        # Each write is handed over, and each then waits for all of them.
        return flush_s < self._usual**2 * HANDING_OVER_S or self._sent_s - before_s > IDLE_S

    def _commit_at_once(self, writes: list[Write]) -> bool:
        """Commit what has come and return true, if that is quick; the thread does nothing meanwhile."""
        if writes[0].era <= self._refused_era:
            return False
        entries = together(writes)
        try:
            if not self._journal.commit_at_once(entries):
                return False
        except NotStored as error:
            self._refused_era = writes[-1].era
            REFUSED.inc()
            self._on_failure(writes, error)
            return True
        except Exception:
            log.exception("a group of writes cannot be committed together", writes=len(writes))
            return False  # the thread finds the write that is to blame
        GROUPS.tally.note(len(writes))
        self._report_success(writes)
        return True

    async def store(self, entries: Entries) -> None:
        """Write `entries` and return when they are safe; raise `NotStored` if the disk refuses."""
        await stored(self, entries)

    def store_later(self, entries: Entries, within_s: float = 0.2) -> None:
        """Write `entries` with the next commit, or after `within_s`; for bookkeeping only, nobody is told."""
        self._later.add(entries)
        if self._later_due is None:
            self._later_due = asyncio.get_running_loop().call_later(within_s, self._send_later)

    def _send_later(self) -> None:
        if self._later_due is not None:
            self.submit(Entries(), lambda: None, lambda _: None)

    def _kept_for_later(self, later: Entries, failed: Failed) -> Failed:
        """Return what tells `failed`, and sees that `later` is written with another commit."""

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
            one = self._queue.get()
            while one is not None:
                group += one
                if len(group) >= MAX_GROUP:
                    break
                try:
                    one = self._queue.get_nowait()
                except queue.Empty:
                    break
            else:
                open_for_more = False
            if group:
                self._commit(group)

    def _commit(self, group: list[Write]) -> None:
        built_on_sand = [write for write in group if write.era <= self._refused_era]
        if built_on_sand:
            self._report_failure(
                built_on_sand, NotStored("an earlier change that it may build on was not stored")
            )
        firm = [write for write in group if write.era > self._refused_era]
        if not firm:
            return
        try:
            self._journal.commit(together(firm))
        except NotStored as error:
            self._refuse(firm, error)
        except Exception as error:  # what ends this thread would let every later write wait for ever
            log.exception("a group of writes cannot be committed", writes=len(firm))
            if len(firm) > 1:
                for write in firm:
                    self._commit([write])
            else:
                self._refuse(firm, NotStored(f"{type(error).__name__}: {error}"))
        else:
            GROUPS.tally.note(len(firm))
            self._call(self._report_success, firm)

    def _refuse(self, writes: list[Write], error: NotStored) -> None:
        self._refused_era = max(write.era for write in writes)
        REFUSED.inc()
        self._report_failure(writes, error)

    def _report_failure(self, writes: list[Write], error: NotStored) -> None:
        self._call(self._on_failure, writes, error)

    def _call(self, function: Callable[..., None], *arguments: object) -> None:
        assert self._loop is not None  # noqa: S101 - start() has set it
        self._loop.call_soon_threadsafe(function, *arguments)

    # On the loop

    def _report_success(self, writes: list[Write]) -> None:
        self._under_way -= len(writes)
        for write in writes:
            try:
                write.done()
            except Exception as error:
                NOT_COMPLETED.inc()
                log.exception("completion of a stored write failed")
                _call_failed(write, NotCompleted(f"{type(error).__name__}: {error}"))

    def _on_failure(self, writes: list[Write], error: NotStored) -> None:
        log.error("the disk does not take changes", error=str(error), writes=len(writes))
        self._under_way -= len(writes)
        if writes[-1].era == self._era:
            self._era += 1
            self._on_refusal()
        for write in writes:
            _call_failed(write, error)


def _call_failed(write: Write, error: Exception) -> None:
    """Call `failed` of a write; what it raises concerns no other write of the group."""
    try:
        write.failed(error)
    except Exception:
        log.exception("handling of a failed write failed")


def together(writes: list[Write]) -> Entries:
    """Return what several writes write."""
    entries = Entries()
    for write in writes:
        entries.add(write.entries)
    return entries


async def stored(commits: Commits, entries: Entries) -> None:
    """Submit a write and return when it is safe; raise `NotStored` if the disk refuses."""
    outcome: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    def done() -> None:
        if not outcome.done():
            outcome.set_result(None)

    def failed(error: Exception) -> None:
        if not outcome.done():
            outcome.set_exception(error)

    commits.submit(entries, done, failed)
    await outcome
