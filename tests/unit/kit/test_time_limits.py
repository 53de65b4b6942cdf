"""Time limits of tests grow with the load of the machine."""

import os
import signal
from collections.abc import Iterator
from typing import Any

import pytest

from tests.kit import waiting
from tests.kit.time_limits import SAMPLE_S, scale_alarm
from tests.kit.waiting import Bound


class Clock:
    """The time and the load of a machine."""

    def __init__(self) -> None:
        self.now_s = 1000.0
        self.load = 0.0


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(waiting.time, "monotonic", lambda: made.now_s)
    monkeypatch.setattr(waiting.os, "getloadavg", lambda: (made.load, 0.0, 0.0))
    return made


@pytest.fixture
def expired() -> Iterator[list[int]]:
    """The alarms that reached the handler which was set first; the alarm of this test is restored."""
    handler, (left_s, _) = signal.getsignal(signal.SIGALRM), signal.getitimer(signal.ITIMER_REAL)
    numbers: list[int] = []
    signal.signal(signal.SIGALRM, lambda number, _: numbers.append(number))
    yield numbers
    signal.signal(signal.SIGALRM, handler)
    signal.setitimer(signal.ITIMER_REAL, left_s)


def ring() -> None:
    handler: Any = signal.getsignal(signal.SIGALRM)
    handler(signal.SIGALRM, None)


def test_a_limit_is_exceeded_after_its_time_on_an_idle_machine(clock: Clock, expired: list[int]) -> None:
    scale_alarm(20.0)
    clock.now_s += 19.0
    ring()
    assert expired == []
    assert 0 < signal.getitimer(signal.ITIMER_REAL)[0] <= 1.0
    clock.now_s += 1.0
    ring()
    assert expired == [signal.SIGALRM]


def test_a_limit_grows_with_the_load(clock: Clock, expired: list[int]) -> None:
    clock.load = 10.0 * (os.cpu_count() or 1)
    scale_alarm(60.0)
    assert signal.getitimer(signal.ITIMER_REAL)[0] <= SAMPLE_S
    clock.now_s += 599.0
    ring()
    assert expired == []
    clock.now_s += 2.0
    ring()
    assert expired == [signal.SIGALRM]


def test_only_the_time_under_load_is_scaled(clock: Clock) -> None:
    bound = Bound(60.0)
    clock.now_s += 40.0
    assert bound.remaining_s() == 20.0
    clock.load = 4.0 * (os.cpu_count() or 1)
    clock.now_s += 40.0
    assert bound.remaining_s() == 10.0


def test_the_time_limit_of_a_test_is_scaled() -> None:
    handler = signal.getsignal(signal.SIGALRM)
    assert callable(handler)
    assert handler.__module__ == scale_alarm.__module__
