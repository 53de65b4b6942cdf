"""Commits, on the event loop and in a thread: each writer is called back once, in order."""

import asyncio
import math
import sqlite3
import threading
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_broker.storage import commits
from handover_broker.storage.commits import CommitQueue, NotCompleted
from handover_broker.storage.database import NotStored, SqliteDatabase
from handover_broker.storage.entries import EntityRow, Entries
from handover_broker.storage.journal import Journal
from handover_broker.storage.write_ahead_log.checkpoint import MAX_INLINE_BYTES

QUICK, SLOW = 0.00001, 1.0


class OnDisks(Journal):
    """A journal on a disk of configured speed, which records the committing threads."""

    def __init__(self, folder: Path) -> None:
        super().__init__(SqliteDatabase(folder / "broker.db"))
        self.took_s = QUICK
        self.committed_by: list[str] = []

    def commit(self, entries: Entries) -> None:
        self.committed_by.append(threading.current_thread().name)
        super().commit(entries)

    @property
    def flush_s(self) -> float:
        return self.took_s

    def commit_at_once(self, entries: Entries) -> bool:
        done = super().commit_at_once(entries)
        if done:
            self.committed_by.append(threading.current_thread().name)
        return done


def entity(place: int, size: int = 20) -> Entries:
    return Entries(entities={place: EntityRow("", f"urn:{place}", b"x" * size)})


def run(folder: Path, steps: Callable[[OnDisks, CommitQueue], object]) -> OnDisks:
    journal = OnDisks(folder)
    journal.open()

    async def whole() -> None:
        queue = CommitQueue(journal, lambda: None)
        queue.start()
        await steps(journal, queue)  # type: ignore[misc]  # a coroutine function
        await queue.stop()

    asyncio.run(whole())
    return journal


@pytest.mark.parametrize(("is_quick", "who"), [(True, "MainThread"), (False, "journal")])
def test_the_event_loop_writes_to_a_quick_disk_and_a_thread_to_a_slow_one(
    tmp_path: Path, is_quick: bool, who: str
) -> None:
    async def steps(journal: OnDisks, queue: CommitQueue) -> None:
        journal.took_s = QUICK if is_quick else SLOW
        await asyncio.gather(*(queue.store(entity(place)) for place in range(1, 9)))
        assert journal.last_sequence() == 8

    assert run(tmp_path, steps).committed_by == [who]  # and all of one turn are one commit


@pytest.mark.parametrize(
    ("idle_s", "who"), [(math.inf, ["journal", "MainThread"]), (-1.0, ["MainThread"] * 2)]
)
def test_few_writes_are_worth_a_flush_on_the_loop_only_where_it_has_nothing_else_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, idle_s: float, who: list[str]
) -> None:
    monkeypatch.setattr(commits, "IDLE_S", idle_s)

    async def steps(journal: OnDisks, queue: CommitQueue) -> None:
        journal.took_s = 2 * commits.THREAD_COST_S
        await queue.store(entity(1))
        await asyncio.gather(*(queue.store(entity(place)) for place in range(2, 40)))

    assert run(tmp_path, steps).committed_by == who


def test_large_writes_are_committed_by_the_thread(tmp_path: Path) -> None:
    async def steps(journal: OnDisks, queue: CommitQueue) -> None:
        await queue.store(entity(1, MAX_INLINE_BYTES))
        await queue.store(entity(2))

    assert run(tmp_path, steps).committed_by[0] == "journal"


@settings(max_examples=10, deadline=None)
@given(turns=st.lists(st.tuples(st.booleans(), st.integers(1, 5), st.booleans()), max_size=12))
def test_writers_are_called_back_once_and_in_order_on_any_disk(
    tmp_path_factory: pytest.TempPathFactory, turns: list[tuple[bool, int, bool]]
) -> None:
    result: list[int] = []
    made = 0

    async def steps(journal: OnDisks, queue: CommitQueue) -> None:
        nonlocal made
        for is_quick, writes, waits in turns:
            journal.took_s = QUICK if is_quick else SLOW
            for _ in range(writes):
                made += 1
                queue.submit(entity(made), lambda place=made: result.append(place), lambda _: None)  # type: ignore[misc]
            if waits:
                await queue.store(Entries())
            else:
                await asyncio.sleep(0)

    journal = run(tmp_path_factory.mktemp("turns"), steps)
    assert result == list(range(1, made + 1))
    assert journal.last_sequence() == made
    journal.close()


@pytest.mark.parametrize("is_quick", [True, False])
def test_a_refused_write_does_not_block_later_ones(tmp_path: Path, is_quick: bool) -> None:
    failures: list[str] = []

    async def steps(journal: OnDisks, queue: CommitQueue) -> None:
        journal.took_s = QUICK if is_quick else SLOW
        with closing(sqlite3.connect(tmp_path / "broker.db", isolation_level=None)) as other:
            other.execute("ALTER TABLE entities RENAME TO out_of_reach")
            place = 0
            while not failures and place < 1000:  # until the log is full
                place += 1
                try:
                    await queue.store(entity(place, 50_000))
                except NotStored as error:
                    failures.append(str(error))
            other.execute("ALTER TABLE out_of_reach RENAME TO entities")
        await queue.store(entity(1000))
        assert journal.last_sequence() == 1000
        assert len(list(journal.entities())) == place

    run(tmp_path, steps).close()
    assert len(failures) == 1
    assert "no such table" in failures[0]


@pytest.mark.parametrize("is_quick", [True, False])
def test_a_completion_that_raises_fails_alone(tmp_path: Path, is_quick: bool) -> None:
    """The whole group is on disk by then: the others are completed, and the queue continues."""
    completed: list[int] = []
    failures: list[Exception] = []

    def raises() -> None:
        raise ZeroDivisionError("in the completion of one write")

    async def steps(journal: OnDisks, queue: CommitQueue) -> None:
        journal.took_s = QUICK if is_quick else SLOW
        for place in range(1, 6):
            done = raises if place == 2 else lambda place=place: completed.append(place)  # type: ignore[misc]
            queue.submit(entity(place), done, failures.append)
        await queue.store(entity(6))
        assert completed == [1, 3, 4, 5]
        await queue.store(entity(7))
        assert journal.last_sequence() == 7

    run(tmp_path, steps)
    (failure,) = failures
    assert isinstance(failure, NotCompleted)
    assert "ZeroDivisionError" in str(failure)


@pytest.mark.parametrize("is_quick", [True, False])
def test_a_write_that_cannot_be_encoded_ends_nothing_else(tmp_path: Path, is_quick: bool) -> None:
    failures: list[Exception] = []
    completed: list[str] = []

    async def steps(journal: OnDisks, queue: CommitQueue) -> None:
        journal.took_s = QUICK if is_quick else SLOW
        queue.submit(entity(1), lambda: completed.append("before"), failures.append)
        unencodable = Entries(entities={2: EntityRow("", "\ud800", b"x")})
        queue.submit(unencodable, lambda: completed.append("never"), failures.append)
        while len(failures) + len(completed) < 2:
            await asyncio.sleep(0.01)
        await queue.store(entity(3))

    journal = run(tmp_path, steps)
    assert completed == ["before"]
    assert len(failures) == 1
    assert sorted(journal.entities()) == [("", b"x" * 20)] * 2
