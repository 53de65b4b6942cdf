"""Latest values: the newest value of each key is written in the background once the broker accepts it."""

import asyncio

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover.broker import (
    MAX_FAULTS,
    BrokerError,
    BrokerFault,
    BrokerUnavailable,
    BrokerUnreachable,
    latest_value_writer,
)
from handover.broker.latest_value_writer import LatestValueWriter, Write

UNREACHABLE = BrokerUnreachable(503, "Broker unavailable", "it does not answer")
UNAVAILABLE = BrokerUnavailable(503, "Service unavailable", "its database is away")
FAULT = BrokerFault(500, "Internal error", "it fails at this entity")
REFUSED = BrokerError(400, "Bad request", "no such attribute")


class Target:
    """Stores what is written; the next writes raise `errors`."""

    def __init__(self, *errors: Exception) -> None:
        self.values: dict[str, int] = {}
        self.writes: list[tuple[str, int]] = []
        self.attempts = asyncio.Semaphore(0)
        self._errors = list(errors)
        self._changed = asyncio.Condition()

    def write(self, key: str, value: int) -> Write:
        async def act() -> None:
            self.attempts.release()
            if self._errors:
                raise self._errors.pop(0)
            self.writes.append((key, value))
            self.values[key] = value
            async with self._changed:
                self._changed.notify_all()

        return act

    async def wait_for(self, values: dict[str, int]) -> None:
        async with asyncio.timeout(120), self._changed:
            await self._changed.wait_for(lambda: self.values == values)


async def test_of_values_that_wait_only_the_latest_is_written() -> None:
    target = Target()
    async with LatestValueWriter() as writer:
        for value in range(100):
            writer.put("lamp", target.write("lamp", value))
        await target.wait_for({"lamp": 99})
    assert target.writes == [("lamp", 99)]


async def test_a_newer_value_replaces_one_that_the_unavailable_broker_has_not_accepted() -> None:
    target = Target(UNAVAILABLE)
    async with LatestValueWriter() as writer:
        writer.put("lamp", target.write("lamp", 1))
        await target.attempts.acquire()
        writer.put("lamp", target.write("lamp", 2))
        await target.wait_for({"lamp": 2})
    assert target.writes == [("lamp", 2)]


async def test_a_rejected_value_is_reported_and_the_next_key_is_written() -> None:
    target = Target(REFUSED)
    rejected: list[tuple[str, Exception]] = []
    async with LatestValueWriter(on_rejected=lambda *one: rejected.append(one)) as writer:
        writer.put("lamp", target.write("lamp", 1))
        writer.put("fan", target.write("fan", 2))
        await target.wait_for({"fan": 2})
    assert rejected == [("lamp", REFUSED)]


@pytest.mark.parametrize("error", [UNAVAILABLE, UNREACHABLE, FAULT])
async def test_a_key_that_waits_does_not_let_others_wait(error: BrokerError) -> None:
    target = Target()

    async def never() -> None:
        raise error

    async with LatestValueWriter() as writer:
        writer.put("lamp", never)
        for number in range(10):
            writer.put(f"fan {number}", target.write(f"fan {number}", number))
        await target.wait_for({f"fan {number}": number for number in range(10)})


async def test_a_key_at_which_the_broker_fails_is_tried_three_times(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(latest_value_writer, "fault_delay_s", lambda _: 0.0)
    target = Target(*[FAULT] * MAX_FAULTS)
    rejected = asyncio.Queue[str]()
    async with LatestValueWriter(on_rejected=lambda key, _: rejected.put_nowait(key)) as writer:
        writer.put("lamp", target.write("lamp", 1))
        assert await asyncio.wait_for(rejected.get(), 120) == "lamp"
        assert target.writes == []
        writer.put("lamp", target.write("lamp", 2))  # a later value is written
        await target.wait_for({"lamp": 2})


@pytest.mark.nightly
@settings(deadline=None, max_examples=30)
@given(
    st.lists(st.tuples(st.sampled_from("abc"), st.booleans()), max_size=30),
    st.lists(st.sampled_from([UNAVAILABLE, UNREACHABLE]), max_size=3),
)
def test_after_any_sequence_each_key_has_its_latest_value(
    steps: list[tuple[str, bool]], errors: list[BrokerError]
) -> None:
    async def check() -> None:
        target = Target(*errors)
        latest: dict[str, int] = {}
        async with LatestValueWriter() as writer:
            for number, (key, yields) in enumerate(steps):
                latest[key] = number
                writer.put(key, target.write(key, number))
                if yields:
                    await asyncio.sleep(0)
            await target.wait_for(latest)

    asyncio.run(check())
