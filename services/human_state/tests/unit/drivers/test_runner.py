"""A sensor is served until nobody wants it: lost links, silence, faults of drivers, clocks that are set."""

import asyncio
import itertools
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress

import numpy as np
import pytest

from handover_body.drivers.base import DriverSettings, LinkLost, SensorDriver, Sink
from handover_body.drivers.runner import RunnerTiming, SensorRunner
from handover_body.model.signals import (
    ClockKind,
    LinkState,
    Samples,
    SensorFault,
    SensorReport,
    SignalInfo,
    SignalKind,
)
from tests.kit.waiting import until

RATE = SignalInfo(SignalKind.HEART_RATE, "BPM", None)
SHORT = RunnerTiming(initial_reconnect_s=0.01, max_reconnect_s=0.02, watch_s=0.01)

Connection = Callable[[Sink], object]


class Belt(SensorDriver):
    """Each connection does what the next function of `connections` says, then stays open."""

    settings_model = DriverSettings

    def __init__(self, *connections: Connection) -> None:
        super().__init__("belt", DriverSettings())
        self.connections = itertools.chain(connections, itertools.repeat(lambda sink: None))
        self.runs = 0
        self.closed = 0

    @property
    def signals(self) -> tuple[SignalInfo, ...]:
        return (RATE,)

    async def run(self, sink: Sink) -> None:
        self.runs += 1
        try:
            if next(self.connections)(sink) == "end":
                return
            await asyncio.Event().wait()
        finally:
            self.closed += 1


def beat(sink: Sink) -> None:
    sink(Samples("belt", RATE, 100.0, np.array([[70.0]]), np.array([100.0]), ClockKind.RECORDING))


def beat_and_lose(sink: Sink) -> None:
    beat(sink)
    raise LinkLost("the belt is out of reach")


def fail(sink: Sink) -> None:
    raise KeyError("a defect of the driver")


@asynccontextmanager
async def running(
    driver: SensorDriver, **options: object
) -> AsyncIterator[tuple[SensorRunner, list[object]]]:
    items: list[object] = []
    runner = SensorRunner(driver, items.append, **{"timing": SHORT, **options})  # type: ignore[arg-type]
    task = asyncio.create_task(runner.run())
    try:
        yield runner, items
    finally:
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task


def faults(items: list[object]) -> list[SensorFault]:
    return [item.fault for item in items if isinstance(item, SensorReport) and item.fault]


def links(items: list[object]) -> list[LinkState]:
    return [item.link for item in items if isinstance(item, SensorReport) and item.link]


async def test_a_lost_link_is_opened_again_and_reported() -> None:
    driver = Belt(beat_and_lose, beat)
    async with running(driver) as (runner, items):
        await until(lambda: runner.connections == 2)
        assert driver.runs == 2
        assert links(items) == [
            LinkState.SEARCHING, LinkState.CONNECTED, LinkState.LOST, LinkState.SEARCHING, LinkState.CONNECTED
        ]  # fmt: skip
        assert faults(items) == [SensorFault.RECONNECTED]
        lost = next(item for item in items if isinstance(item, SensorReport) and item.link is LinkState.LOST)
        assert "out of reach" in lost.text
    assert driver.closed == driver.runs


async def test_a_connection_that_is_silent_is_closed_and_opened_again() -> None:
    driver = Belt(beat, beat)
    timing = RunnerTiming(0.01, 0.02, 0.01, max_silence_s=0.1)
    async with running(driver, timing=timing) as (runner, items):
        await until(lambda: runner.connections == 2)
        assert any(isinstance(item, SensorReport) and "silent" in item.text for item in items)
        assert driver.closed >= 1


async def test_a_driver_that_fails_is_a_fault_and_is_run_again() -> None:
    driver = Belt(fail, fail, beat)
    async with running(driver) as (runner, items):
        await until(lambda: runner.connections == 1)
        assert links(items).count(LinkState.FAULT) == 2
        assert any(isinstance(item, SensorReport) and "KeyError" in item.text for item in items)


async def test_a_driver_that_returns_has_ended() -> None:
    def one_beat(sink: Sink) -> str:
        beat(sink)
        return "end"

    items: list[object] = []
    await SensorRunner(Belt(one_beat), items.append, timing=SHORT).run()
    assert links(items)[-1] is LinkState.LOST


async def test_a_clock_of_ours_that_is_set_is_a_clock_jump() -> None:
    ahead_s = 0.0
    clock = asyncio.get_running_loop().time
    async with running(
        Belt(beat), wall_s=lambda: clock() + ahead_s, monotonic_s=clock
    ) as (runner, items):  # fmt: skip
        await until(lambda: runner.connections == 1)
        ahead_s = -3600.0
        await until(lambda: SensorFault.CLOCK_JUMP in faults(items))


async def test_battery_and_contact_are_kept_and_nonsense_is_not() -> None:
    def reports(sink: Sink) -> None:
        sink(SensorReport("belt", 1.0, battery=0.4, has_contact=True))
        sink(SensorReport("belt", 2.0, battery=42.0))

    async with running(Belt(reports)) as (runner, _):
        await until(lambda: runner.battery is not None)
        assert runner.battery == 0.4
        assert runner.has_contact is True


async def test_a_signal_that_the_driver_does_not_list_is_its_fault() -> None:
    def unlisted(sink: Sink) -> None:
        info = SignalInfo(SignalKind.ECG, "D82", 130.0)
        sink(Samples("belt", info, 1.0, np.zeros((1, 1))))

    async with running(Belt(unlisted)) as (_, items):
        await until(lambda: LinkState.FAULT in links(items))


@pytest.mark.parametrize("text", ["x" * 10_000])
async def test_a_long_text_of_a_device_is_cut(text: str) -> None:
    async with running(Belt(lambda sink: sink(SensorReport("belt", 1.0, text=text)))) as (_, items):
        await until(lambda: any(isinstance(item, SensorReport) and item.text for item in items))
        assert all(len(item.text) <= 500 for item in items if isinstance(item, SensorReport))
