"""Background tasks: a failure is reported and ends no other task; the end of the context ends all tasks."""

import asyncio

import pytest

from handover.runtime.background_tasks import BackgroundTasks


async def test_a_failed_task_is_reported_and_the_others_continue() -> None:
    failures: list[Exception] = []
    may_finish = asyncio.Event()
    finished = asyncio.Event()

    async def fail() -> None:
        raise ValueError("a defect")

    async def finish() -> None:
        await may_finish.wait()
        finished.set()

    async with BackgroundTasks("test", on_failure=failures.append) as tasks:
        tasks.start(finish)
        await tasks.start(fail)
        assert [str(error) for error in failures] == ["a defect"]
        may_finish.set()
        async with asyncio.timeout(120):
            await finished.wait()


async def test_the_end_of_the_context_cancels_all_tasks_and_waits_for_them() -> None:
    ended: list[str] = []
    started = asyncio.Semaphore(0)

    async def run(name: str) -> None:
        try:
            started.release()
            await asyncio.Event().wait()
        finally:
            await asyncio.sleep(0)
            ended.append(name)

    async with BackgroundTasks("test") as tasks:
        tasks.start(run, "first")
        tasks.start(run, name="second")
        await started.acquire()
        await started.acquire()
    assert sorted(ended) == ["first", "second"]


async def test_a_task_that_is_cancelled_alone_ends_no_other() -> None:
    may_finish = asyncio.Event()

    async with BackgroundTasks("test") as tasks:
        cancelled = tasks.start(asyncio.Event().wait)
        other = tasks.start(may_finish.wait)
        cancelled.cancel()
        with pytest.raises(asyncio.CancelledError):
            await cancelled
        may_finish.set()
        async with asyncio.timeout(120):
            await other
        assert not other.cancelled()


async def test_a_task_that_fails_is_started_again() -> None:
    attempts = 0
    has_succeeded = asyncio.Event()

    async def fail_twice() -> None:
        nonlocal attempts
        attempts += 1
        if attempts < 3:
            raise ConnectionError
        has_succeeded.set()
        await asyncio.Event().wait()

    async with BackgroundTasks("test") as tasks:
        tasks.start_restarting(fail_twice)
        async with asyncio.timeout(120):
            await has_succeeded.wait()
    assert attempts == 3


async def test_after_the_end_nothing_is_started() -> None:
    has_run = False

    async def run() -> None:
        nonlocal has_run
        has_run = True

    tasks = BackgroundTasks("test")
    async with tasks:
        pass
    late = tasks.start(run)
    with pytest.raises(asyncio.CancelledError):
        await late
    assert not has_run


async def test_an_exception_in_the_context_propagates_and_cancels_the_tasks() -> None:
    started: list[asyncio.Task[None]] = []

    async def fail_in_context() -> None:
        async with BackgroundTasks("test") as tasks:
            started.append(tasks.start(asyncio.Event().wait))
            raise ValueError("in the context")

    with pytest.raises(ValueError, match="in the context"):
        await fail_in_context()
    assert started[0].cancelled()
