"""Drivers of Bluetooth LE sensors against peripherals: what they send arrives, and lost links come back."""

import asyncio
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from typing import Any

import numpy as np
import pytest

from handover_body.drivers.bluetooth import BluetoothDriver
from handover_body.drivers.corsano import protocol as corsano
from handover_body.drivers.corsano.driver import CorsanoDriver, CorsanoSettings
from handover_body.drivers.heart_rate_strap import protocol as strap
from handover_body.drivers.heart_rate_strap.driver import (
    HEART_RATE_MEASUREMENT,
    HEART_RATE_SERVICE,
    HeartRateStrapDriver,
)
from handover_body.drivers.metamotion import protocol as metamotion
from handover_body.drivers.metamotion.driver import MetaMotionDriver, MetaMotionSettings
from handover_body.drivers.polar_h10 import protocol as h10
from handover_body.drivers.polar_h10.driver import PolarH10Driver, PolarH10Settings
from handover_body.drivers.runner import RunnerTiming, SensorRunner
from handover_body.drivers.sensomative import protocol as mat
from handover_body.drivers.sensomative.driver import SensomativeDriver, SensomativeSettings
from handover_body.model.signals import (
    LinkState,
    Samples,
    SensorFault,
    SensorReport,
    SignalKind,
)
from tests.kit.bluetooth import Peripheral
from tests.kit.waiting import until

SHORT = RunnerTiming(0.01, 0.02, 0.01)


class Received:
    """What a runner passed on."""

    def __init__(self, runner: SensorRunner, items: list[Samples | SensorReport]) -> None:
        self.runner, self.items = runner, items

    def samples(self, kind: SignalKind) -> list[Samples]:
        return [one for one in self.items if isinstance(one, Samples) and one.info.kind is kind]

    def reports(self) -> list[SensorReport]:
        return [one for one in self.items if isinstance(one, SensorReport)]

    def texts(self) -> str:
        return " | ".join(one.text for one in self.reports())


@asynccontextmanager
async def serving(
    driver_class: type[BluetoothDriver], peripheral: Peripheral, timing: RunnerTiming = SHORT, **settings: Any
) -> AsyncIterator[Received]:
    mine = type(driver_class.__name__, (driver_class,), peripheral.backends())
    driver = mine("sensor-1", driver_class.settings_model.model_validate(settings))
    items: list[Samples | SensorReport] = []
    received = Received(SensorRunner(driver, items.append, timing=timing), items)
    task = asyncio.create_task(received.runner.run())
    try:
        yield received
    finally:
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task
        assert peripheral.client is None, "the connection is closed"


def a_strap(name: str = "HRM-1") -> Peripheral:
    return Peripheral(name, {HEART_RATE_SERVICE: (HEART_RATE_MEASUREMENT,)})


def an_h10() -> Peripheral:
    one = Peripheral(
        "Polar H10 ABCD",
        {HEART_RATE_SERVICE: (HEART_RATE_MEASUREMENT,), h10.PMD_SERVICE: (h10.PMD_CONTROL, h10.PMD_DATA)},
    )
    one.on_write = lambda uuid, data: one.notify(h10.PMD_CONTROL, bytes([0xF0, data[0], data[1], 0, 0]))
    return one


def send(one: Peripheral, bpm: int, intervals: tuple[float, ...] = (), contact: bool | None = None) -> None:
    one.notify(HEART_RATE_MEASUREMENT, strap.build(strap.HeartRateMeasurement(bpm, intervals, contact)))


async def test_a_strap_gives_heart_rate_intervals_battery_and_contact() -> None:
    one = a_strap()
    async with serving(HeartRateStrapDriver, one) as received:
        await until(lambda: HEART_RATE_MEASUREMENT in one.subscribed)
        send(one, 72, (0.83, 0.84), True)
        send(one, 73)
        await until(lambda: len(received.samples(SignalKind.HEART_RATE)) == 2)
        assert [s.values[0, 0] for s in received.samples(SignalKind.HEART_RATE)] == [72, 73]
        (beats,) = received.samples(SignalKind.INTER_BEAT_INTERVAL)
        assert beats.values.ravel() == pytest.approx([830, 840], abs=1)
        assert beats.has_contact is True
        await until(lambda: received.runner.battery == 0.8)


async def test_a_strap_that_is_lost_is_subscribed_again() -> None:
    one = a_strap()
    async with serving(HeartRateStrapDriver, one) as received:
        for connection in range(1, 4):
            await until(lambda: HEART_RATE_MEASUREMENT in one.subscribed)
            send(one, 70 + connection)
            await until(lambda: received.runner.connections == connection)  # noqa: B023
            one.drop()
        await until(lambda: one.connections == 4)
        assert [r.fault for r in received.reports()].count(SensorFault.RECONNECTED) == 2
        assert "closed the connection" in received.texts()


async def test_a_strap_that_is_not_there_is_searched_until_it_is() -> None:
    one = a_strap()
    one.is_near = False
    async with serving(HeartRateStrapDriver, one, search_s=0.02) as received:
        await until(lambda: "worn, charged and near" in received.texts())
        one.is_near = True
        await until(lambda: received.runner.link is LinkState.CONNECTED)


async def test_hostile_notifications_are_reported_and_the_link_stays() -> None:
    one = a_strap()
    async with serving(HeartRateStrapDriver, one) as received:
        await until(lambda: HEART_RATE_MEASUREMENT in one.subscribed)
        for _ in range(200):
            one.notify(HEART_RATE_MEASUREMENT, b"\xff")
        send(one, 71)
        await until(lambda: received.samples(SignalKind.HEART_RATE))
        assert one.connections == 1
        assert 1 <= [r.fault for r in received.reports()].count(SensorFault.ARTEFACT) < 20


async def test_straps_are_found_by_their_service_and_by_name_and_address() -> None:
    one = a_strap()
    mine = type("Mine", (HeartRateStrapDriver,), one.backends())
    (found,) = await mine.discover(0.02)
    assert (found.address, found.name, found.rssi_dbm) == (one.address, "HRM-1", -60)
    assert await type("Other", (PolarH10Driver,), one.backends()).discover(0.02) == []
    async with serving(HeartRateStrapDriver, one, name="Other", search_s=0.02) as received:
        await until(lambda: "no Other" in received.texts())
    async with serving(HeartRateStrapDriver, one, address=one.address.lower()) as received:
        await until(lambda: received.runner.link is LinkState.CONNECTED)


def ecg_frame(number: int, count: int = 73) -> bytes:
    values = np.round(1000 * np.random.default_rng(number).normal(0, 0.3, (count, 1)))
    return h10.build(h10.Frame(h10.Measurement.ECG, 600_000_000 + (number + 1) * count / 130, values))


async def test_an_h10_gives_ecg_on_its_clock_and_acceleration_in_metres() -> None:
    one = an_h10()
    async with serving(PolarH10Driver, one) as received:
        await until(lambda: len(one.written) == 2)
        assert one.written[0] == (h10.PMD_CONTROL, bytes.fromhex("02000001820001010E00"))
        for number in range(4):
            one.notify(h10.PMD_DATA, ecg_frame(number))
        upright = np.tile([0.0, 0.0, 9.80665], (36, 1))
        one.notify(h10.PMD_DATA, h10.build(h10.Frame(h10.Measurement.ACCELERATION, 600_000_001, upright)))
        await until(lambda: received.samples(SignalKind.ACCELERATION))
        ecg = received.samples(SignalKind.ECG)
        assert sum(len(s.values) for s in ecg) >= 73
        assert all(s.uncertainty_s > 0 for s in ecg)
        (still,) = received.samples(SignalKind.ACCELERATION)
        assert still.values[0] == pytest.approx([0, 0, 9.80665], abs=0.01)


async def test_an_h10_that_drops_is_started_again() -> None:
    """Straps close the connection after 150 s on some hosts: everything must be started again."""
    one = an_h10()
    async with serving(PolarH10Driver, one, acceleration_hz=None) as received:
        for connection in range(1, 4):
            await until(lambda: len(one.written) == connection)  # noqa: B023
            one.notify(h10.PMD_DATA, ecg_frame(connection))
            await until(lambda: received.runner.connections == connection)  # noqa: B023
            one.drop()
        await until(lambda: len(one.written) == 4)
        assert {data for _, data in one.written} == {h10.start_command(h10.Measurement.ECG)}


async def test_an_h10_that_was_taken_off_has_no_contact_though_its_ecg_continues(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    at_s = [time.time() - 60]
    monkeypatch.setattr("handover_body.drivers.polar_h10.driver.now_s", lambda: at_s[0])
    one = an_h10()
    async with serving(PolarH10Driver, one, acceleration_hz=None) as received:
        await until(lambda: len(one.written) == 1)
        send(one, 70, (0.85,))
        one.notify(h10.PMD_DATA, ecg_frame(0, 2))
        await until(lambda: received.samples(SignalKind.ECG))
        assert received.samples(SignalKind.ECG)[-1].has_contact is True
        at_s[0] += 6.0
        send(one, 70)  # the last value, without beats: it must not count
        one.notify(h10.PMD_DATA, ecg_frame(1, 2))
        await until(lambda: len(received.samples(SignalKind.ECG)) == 2)
        assert SensorFault.NO_CONTACT in [r.fault for r in received.reports()]
        last = received.samples(SignalKind.ECG)[-1]
        assert (last.has_contact, last.quality) == (False, 0.0)


async def test_an_h10_that_refuses_says_why() -> None:
    one = an_h10()
    one.on_write = lambda uuid, data: one.notify(h10.PMD_CONTROL, bytes([0xF0, data[0], data[1], 13]))
    async with serving(PolarH10Driver, one) as received:
        await until(lambda: "charging" in received.texts())


async def test_a_mat_is_read_at_its_rate() -> None:
    one = Peripheral("Sensomative", {mat.SERVICE: (mat.CELLS_UUID,)})
    one.values[mat.CELLS_UUID] = bytes(range(12))
    async with serving(SensomativeDriver, one, rate_hz=25) as received:
        await until(lambda: len(received.samples(SignalKind.PRESSURE_MAP)) > 2)
        assert received.samples(SignalKind.PRESSURE_MAP)[0].values[0].tolist() == list(range(12))
        one.values[mat.CELLS_UUID] = b"short"
        await until(lambda: "12 cells" in received.texts())
    assert SensomativeSettings().rate_hz == 10


async def test_a_bracelet_is_read_as_its_file_grows() -> None:
    one = Peripheral("CardioWatch", {corsano.SERVICE: (corsano.WRITE, corsano.FILE, corsano.ANSWER)})
    record = corsano.ActivityRecord(1_700_000_000, 66, 1.0, 3, 97, 0.5, 14.0, 0.75, 0.7, 33.5, True)
    file = bytearray(corsano.build_record(record) * 30)

    def answer(uuid: str, data: bytes) -> None:
        if data[0] == corsano.GET_SIZE:
            body = bytes([corsano.GET_SIZE, 2]) + len(file).to_bytes(4, "little")
            one.notify(corsano.ANSWER, body + bytes([corsano.crc8(body)]))
        else:
            size, offset = int.from_bytes(data[2:6], "little"), int.from_bytes(data[6:10], "little")
            for at in range(offset, offset + size, 20):
                one.notify(corsano.FILE, bytes(file[at : min(at + 20, offset + size)]))

    one.on_write = answer
    async with serving(CorsanoDriver, one, poll_s=0.02) as received:
        await until(lambda: received.samples(SignalKind.SKIN_TEMPERATURE))
        rates = received.samples(SignalKind.HEART_RATE)
        assert len(rates) == 1, "the same second ten times is one value"
        assert rates[0].values[0, 0] == 66
        assert received.samples(SignalKind.SPO2)[0].quality == 0.5
        assert received.runner.battery == 0.7
        file += corsano.build_record(
            corsano.ActivityRecord(1_700_000_001, None, 0, 0, None, 0, None, 0, None, None, False)
        )
        await until(lambda: received.runner.has_contact is False)
        assert len(received.samples(SignalKind.HEART_RATE)) == 1, "0 bpm is no value"
    assert CorsanoSettings().poll_s == 1


async def test_a_metamotion_is_configured_and_gives_metres_per_second_squared() -> None:
    one = Peripheral("MetaWear", {metamotion.SERVICE: (metamotion.COMMAND, metamotion.NOTIFY)})
    async with serving(MetaMotionDriver, one) as received:
        await until(lambda: len(one.written) == 4)
        assert [data for _, data in one.written] == metamotion.start_commands(50, 4)
        one.notify(metamotion.NOTIFY, metamotion.build(np.array([0, 0, 9.80665]), 4))
        await until(lambda: received.samples(SignalKind.ACCELERATION))
        sample = received.samples(SignalKind.ACCELERATION)[0].values[0]
        assert sample == pytest.approx([0, 0, 9.80665], abs=0.01)
    assert MetaMotionSettings().range_g == 4
    assert PolarH10Settings().ecg


async def test_a_silent_peripheral_is_connected_again() -> None:
    one = a_strap()
    async with serving(HeartRateStrapDriver, one, RunnerTiming(0.01, 0.02, 0.01, 0.05)) as received:
        await until(lambda: one.connections > 1)
        assert "silent" in received.texts()
