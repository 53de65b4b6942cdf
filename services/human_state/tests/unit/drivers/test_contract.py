"""Every driver keeps the contract of sensor drivers, against its peripheral."""

import json
import os
import pty
import socket
import time
import tty
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from handover_body.driver_contract import Device, SensorDriverContract
from handover_body.drivers.base import SENSOR_DRIVERS, SensorDriver
from handover_body.drivers.brainflow.driver import BrainFlowDriver, BrainFlowSettings
from handover_body.drivers.heart_rate_strap import protocol as strap
from handover_body.drivers.heart_rate_strap.driver import (
    HEART_RATE_MEASUREMENT,
    HEART_RATE_SERVICE,
    HeartRateStrapDriver,
)
from handover_body.drivers.max30100.driver import Max30100Driver, Max30100Settings
from handover_body.drivers.metamotion import protocol as metamotion
from handover_body.drivers.metamotion.driver import MetaMotionDriver
from handover_body.drivers.polar_h10 import protocol as h10
from handover_body.drivers.polar_h10.driver import PolarH10Driver
from handover_body.drivers.recording.driver import RecordingDriver, RecordingSettings
from handover_body.drivers.seeed_radar import protocol as radar
from handover_body.drivers.seeed_radar.driver import RadarDriver, RadarSettings
from handover_body.drivers.sensomative import protocol as mat
from handover_body.drivers.sensomative.driver import SensomativeDriver
from handover_body.drivers.simulated.driver import SimulatedDriver, SimulatedSettings
from tests.kit.bluetooth import Peripheral

Y2000_S = 946_684_800


def test_every_driver_is_registered_and_can_be_loaded() -> None:
    for name in SENSOR_DRIVERS.names():
        kind = SENSOR_DRIVERS.load(name)
        assert issubclass(kind, SensorDriver), name
        assert kind.settings_model.__doc__, name


def driver_of(kind: type[SensorDriver], peripheral: Peripheral) -> SensorDriver:
    mine = type(kind.__name__, (kind,), peripheral.backends())
    return mine("sensor-1", kind.settings_model())


class TestHeartRateStrap(SensorDriverContract):
    @pytest.fixture
    def device(self) -> Device:
        one = Peripheral("HRM", {HEART_RATE_SERVICE: (HEART_RATE_MEASUREMENT,)})
        data = strap.build(strap.HeartRateMeasurement(70, (0.857,), True))
        return Device(
            driver_of(HeartRateStrapDriver, one),
            lambda: one.notify(HEART_RATE_MEASUREMENT, data),
            lambda: one.notify(HEART_RATE_MEASUREMENT, b"\xff\xff"),
            one.drop,
        )


class TestPolarH10(SensorDriverContract):
    @pytest.fixture
    def device(self) -> Device:
        one = Peripheral(
            "Polar H10 1",
            {
                HEART_RATE_SERVICE: (HEART_RATE_MEASUREMENT,),
                h10.PMD_SERVICE: (h10.PMD_CONTROL, h10.PMD_DATA),
            },
        )
        one.on_write = lambda uuid, data: one.notify(h10.PMD_CONTROL, bytes([0xF0, data[0], data[1], 0]))

        def send() -> None:
            values = np.array([[100.0], [-50.0]])
            frame = h10.Frame(h10.Measurement.ECG, time.time() - Y2000_S, values)
            one.notify(h10.PMD_DATA, h10.build(frame))

        driver = driver_of(PolarH10Driver, one)
        return Device(driver, send, lambda: one.notify(h10.PMD_DATA, b"\x00" * 11), one.drop)


class TestMetaMotion(SensorDriverContract):
    @pytest.fixture
    def device(self) -> Device:
        one = Peripheral("MetaWear", {metamotion.SERVICE: (metamotion.COMMAND, metamotion.NOTIFY)})
        data = metamotion.build(np.array([0.1, 0.2, 9.8]), 4)
        return Device(
            driver_of(MetaMotionDriver, one),
            lambda: one.notify(metamotion.NOTIFY, data),
            lambda: one.notify(metamotion.NOTIFY, b"\x03\x04\x01"),
            one.drop,
        )


class TestSensomative(SensorDriverContract):
    @pytest.fixture
    def device(self) -> Device:
        one = Peripheral("Mat", {mat.SERVICE: (mat.CELLS_UUID,)})

        def send() -> None:
            one.values[mat.CELLS_UUID] = os.urandom(12)

        send()

        def send_rubbish() -> None:
            one.values[mat.CELLS_UUID] = b"?"

        return Device(driver_of(SensomativeDriver, one), send, send_rubbish, one.drop)


class TestRadar(SensorDriverContract):
    @pytest.fixture
    def device(self) -> Iterator[Device]:
        ours, theirs = pty.openpty()
        tty.setraw(theirs)
        driver = RadarDriver("radar", RadarSettings(port=os.ttyname(theirs)))
        data = radar.build(radar.RadarFrame(0x85, 0x02, b"\x46"))
        yield Device(driver, lambda: _write(ours, data), lambda: _write(ours, b"\x53\x59\x01" * 9))
        os.close(theirs)
        os.close(ours)


class TestMax30100(SensorDriverContract):
    @pytest.fixture
    def device(self) -> Iterator[Device]:
        driver = Max30100Driver("stick", Max30100Settings(port=0))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stick:

            def send_data(data: bytes) -> None:
                if driver.port:
                    stick.sendto(data, ("127.0.0.1", driver.port))

            def send() -> None:
                content = {"ms": time.monotonic() * 1000, "ir": 50_000, "red": 48_000, "hr": 70}
                send_data(json.dumps(content).encode())

            yield Device(driver, send, lambda: send_data(b"{"))


class TestSimulated(SensorDriverContract):
    @pytest.fixture
    def device(self) -> Device:
        return Device(SimulatedDriver("person", SimulatedSettings(packet_s=0.05)), lambda: None)


class TestRecording(SensorDriverContract):
    @pytest.fixture
    def device(self, tmp_path: Path) -> Device:
        path = tmp_path / "made.csv"
        rows = [f"{at / 100},{np.sin(at)}\n" for at in range(500)]
        path.write_text("time,ecg [mV]\n" + "".join(rows))
        settings = RecordingSettings(path=path, loop=True, packet_s=0.05)
        return Device(RecordingDriver("file", settings), lambda: None)


class TestBrainFlow(SensorDriverContract):
    @pytest.fixture
    def device(self) -> Device:
        return Device(BrainFlowDriver("board", BrainFlowSettings()), lambda: None)


def _write(descriptor: int, data: bytes) -> None:
    with suppress(BlockingIOError):
        os.write(descriptor, data)
