"""Retries: delays double up to a limit, with jitter, and an operation is repeated until it succeeds."""

import asyncio

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover.runtime.retry import JITTER, Backoff, backoff_delay_s, retry


@given(st.integers(1, 10_000), st.floats(0.001, 10.0), st.floats(0.001, 600.0))
def test_a_delay_stays_within_the_jitter_of_its_nominal_value(
    failures: int, initial_s: float, max_s: float
) -> None:
    nominal_s = min(initial_s * 2.0 ** min(failures - 1, 1000), max_s)
    delay_s = backoff_delay_s(failures, initial_s, max_s)
    assert nominal_s * (1 - JITTER) <= delay_s <= nominal_s * (1 + JITTER)


def test_delays_double_up_to_the_limit_and_start_again_after_a_success() -> None:
    backoff = Backoff(0.1, 0.5, jitter=0.0)
    assert [backoff.next_delay_s() for _ in range(5)] == [0.1, 0.2, 0.4, 0.5, 0.5]
    backoff.reset()
    assert backoff.next_delay_s() == 0.1


async def test_an_operation_is_repeated_until_it_succeeds() -> None:
    attempts = 0
    reported: list[Exception] = []

    async def operation() -> str:
        nonlocal attempts
        attempts += 1
        if attempts < 4:
            raise ConnectionError(f"attempt {attempts}")
        return "done"

    result = await retry(
        operation, on=ConnectionError, on_failure=reported.append, backoff=Backoff(0.001, 0.002)
    )
    assert result == "done"
    assert [str(error) for error in reported] == ["attempt 1", "attempt 2", "attempt 3"]


async def test_another_exception_propagates_at_once() -> None:
    attempts = 0

    async def operation() -> None:
        nonlocal attempts
        attempts += 1
        raise ValueError("a defect")

    with pytest.raises(ValueError, match="a defect"):
        await retry(operation, on=ConnectionError)
    assert attempts == 1


async def test_a_retry_can_be_cancelled() -> None:
    failed = asyncio.Event()

    async def operation() -> None:
        failed.set()
        raise ConnectionError

    task = asyncio.create_task(retry(operation, on=ConnectionError, backoff=Backoff(3600, 3600)))
    await failed.wait()
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
