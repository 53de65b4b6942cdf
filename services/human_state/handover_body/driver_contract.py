"""What every sensor driver does, as tests: those of a driver subclass `SensorDriverContract`.

    class TestMyBelt(SensorDriverContract):
        @pytest.fixture
        async def device(self):
            async with a_simulated_belt() as belt:
                yield Device(BeltDriver("belt-1", BeltSettings(port=belt.port)), belt.send, belt.send_rubbish)

They need pytest with pytest-asyncio in its mode `auto`.
"""

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass

import numpy as np
import pytest
from pydantic import ValidationError

from handover_body.checks.monitor import MAX_AHEAD_S
from handover_body.drivers.base import DriverSettings, SensorDriver
from handover_body.drivers.runner import RunnerTiming, SensorRunner
from handover_body.model.signals import ClockKind, LinkState, Samples, SensorReport

MAX_WAIT_S = 300.0
POLL_S = 0.02
SHORT = RunnerTiming(0.01, 0.05, 0.01)


@dataclass(frozen=True, slots=True)
class Device:
    """A driver, and the other end of it.

    `send` makes the device send something that is valid, newer each time; `send_rubbish` sends bytes that
    are not of its protocol, `lose` ends its connection; None where a device cannot.
    """

    driver: SensorDriver
    send: Callable[[], None]
    send_rubbish: Callable[[], None] | None = None
    lose: Callable[[], None] | None = None


class Served:
    """What the runner of a device has passed on so far."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self.items: list[Samples | SensorReport] = []
        self.runner = SensorRunner(device.driver, self.items.append, timing=SHORT)

    @property
    def samples(self) -> list[Samples]:
        """Return the samples."""
        return [item for item in self.items if isinstance(item, Samples)]

    async def until_samples(self, count: int = 1) -> None:
        """Let the device send until there are `count` packets more."""
        wanted = len(self.samples) + count
        ends_s = time.monotonic() + MAX_WAIT_S
        while len(self.samples) < wanted:
            assert time.monotonic() < ends_s, f"no samples; reports: {self.items[-5:]}"
            self.device.send()
            await asyncio.sleep(POLL_S)


@contextlib.asynccontextmanager
async def serving(device: Device) -> AsyncIterator[Served]:
    """Run the driver of `device` as the service does."""
    served = Served(device)
    task = asyncio.create_task(served.runner.run())
    try:
        yield served
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task


class SensorDriverContract:
    """The tests; a subclass has the fixture `device`."""

    def test_the_settings_refuse_what_they_do_not_know(self, device: Device) -> None:
        model = type(device.driver).settings_model
        assert issubclass(model, DriverSettings)
        with pytest.raises(ValidationError):
            model.model_validate({**device.driver.settings.model_dump(), "no-such-setting": 1})

    def test_the_signals_are_known_before_there_is_a_device(self, device: Device) -> None:
        signals = device.driver.signals
        assert signals
        assert len(set(signals)) == len(signals)
        assert signals == device.driver.signals, "they do not change"
        assert all(info.unit for info in signals)

    async def test_samples_are_of_the_listed_signals_in_order_with_times_of_ours(
        self, device: Device
    ) -> None:
        async with serving(device) as served:
            await served.until_samples(3)
            newest_s: dict[object, float] = {}
            for samples in served.samples:
                assert samples.source == device.driver.source
                assert samples.info in device.driver.signals
                times_s = samples.sample_times_s()
                assert np.isfinite(times_s).all()
                assert times_s[0] > newest_s.get(samples.info, -np.inf)
                newest_s[samples.info] = float(times_s[-1])
                if samples.clock is not ClockKind.RECORDING:
                    assert times_s[-1] <= time.time() + MAX_AHEAD_S
                    assert samples.uncertainty_s > 0, "the uncertainty of a live time is stated"

    async def test_the_link_is_reported(self, device: Device) -> None:
        async with serving(device) as served:
            await served.until_samples()
            assert served.runner.link is LinkState.CONNECTED

    async def test_values_lie_in_the_range_that_is_stated_or_have_no_quality(self, device: Device) -> None:
        async with serving(device) as served:
            await served.until_samples(3)
            for samples in served.samples:
                finite = samples.values[np.isfinite(samples.values)]
                inside = (finite >= samples.info.min_value) & (finite <= samples.info.max_value)
                assert samples.quality == 0 or inside.all()

    async def test_rubbish_ends_nothing(self, device: Device) -> None:
        if device.send_rubbish is None:
            return  # nothing comes from outside
        async with serving(device) as served:
            await served.until_samples()
            for _ in range(20):
                device.send_rubbish()
            await served.until_samples()
            assert LinkState.FAULT not in [
                item.link for item in served.items if isinstance(item, SensorReport)
            ]

    async def test_a_lost_device_is_opened_again(self, device: Device) -> None:
        if device.lose is None:
            return  # there is no connection
        async with serving(device) as served:
            await served.until_samples()
            device.lose()
            ends_s = time.monotonic() + MAX_WAIT_S
            while served.runner.connections < 2:
                assert time.monotonic() < ends_s, "it was not opened again"
                device.send()
                await asyncio.sleep(POLL_S)

    async def test_a_driver_that_is_cancelled_ends_and_can_run_again(self, device: Device) -> None:
        for _ in range(2):
            async with serving(device) as served:
                await served.until_samples()

    async def test_a_search_gives_a_list(self, device: Device) -> None:
        devices = await type(device.driver).discover(0.01)
        assert all(discovered.address for discovered in devices)
