"""Drivers over a serial line, UDP, LSL and BrainFlow, each against a real other end."""

import asyncio
import contextlib
import json
import os
import pty
import socket
import tty
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover.errors import UsageError
from handover_body.checks.monitor import SignalMonitor
from handover_body.drivers.base import PacketError, SensorDriver
from handover_body.drivers.brainflow.driver import BrainFlowDriver, BrainFlowSettings
from handover_body.drivers.lsl.driver import LslDriver, LslSettings
from handover_body.drivers.max30100 import protocol as oximeter
from handover_body.drivers.max30100.driver import Max30100Driver, Max30100Settings
from handover_body.drivers.runner import RunnerTiming, SensorRunner
from handover_body.drivers.seeed_radar import protocol as radar
from handover_body.drivers.seeed_radar.driver import RadarDriver, RadarSettings
from handover_body.model.signals import (
    LinkState,
    Samples,
    SensorFault,
    SensorReport,
    SignalKind,
)
from tests.kit.ports import next_free_port
from tests.kit.waiting import until

SHORT = RunnerTiming(0.01, 0.05, 0.01)


class Received:
    def __init__(self, runner: SensorRunner, items: list[Samples | SensorReport]) -> None:
        self.runner, self.items = runner, items

    def samples(self, kind: SignalKind) -> list[Samples]:
        return [one for one in self.items if isinstance(one, Samples) and one.info.kind is kind]

    def texts(self) -> str:
        return " | ".join(one.text for one in self.items if isinstance(one, SensorReport))


@asynccontextmanager
async def serving(driver: SensorDriver) -> AsyncIterator[Received]:
    items: list[Samples | SensorReport] = []
    received = Received(SensorRunner(driver, items.append, timing=SHORT), items)
    task = asyncio.create_task(received.runner.run())
    try:
        yield received
    finally:
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task


# The radar

frames = st.builds(radar.RadarFrame, st.integers(0, 255), st.integers(0, 255), st.binary(max_size=20))


@given(sent=st.lists(frames, max_size=6), pieces=st.integers(1, 30))
def test_frames_are_found_in_any_pieces(sent: list[radar.RadarFrame], pieces: int) -> None:
    data = b"".join(map(radar.build, sent))
    reader = radar.FrameReader()
    found = [one for at in range(0, len(data), pieces) for one in reader.feed(data[at : at + pieces])]
    assert found == sent
    assert reader.skipped == 0


@given(st.lists(st.binary(max_size=400), max_size=10))
def test_any_bytes_of_a_radar_give_no_error_and_memory_is_bounded(chunks: list[bytes]) -> None:
    reader = radar.FrameReader()
    for chunk in chunks:
        for frame in reader.feed(chunk):
            with contextlib.suppress(PacketError):
                radar.read(frame)
        assert len(reader._buffer) < 9 + radar.MAX_DATA


@given(sent=frames, noise=st.binary(max_size=30).filter(lambda data: b"\x53" not in data))
def test_a_frame_after_noise_is_found(sent: radar.RadarFrame, noise: bytes) -> None:
    assert radar.FrameReader().feed(noise + radar.build(sent)) == [sent]


def test_a_rate_of_zero_is_no_value_of_a_radar() -> None:
    assert radar.read(radar.RadarFrame(0x85, 0x02, b"\x00")) is None
    assert radar.read(radar.RadarFrame(0x81, 0x02, b"\x00")) is None
    assert radar.read(radar.RadarFrame(0x85, 0x02, b"\x48")) == radar.Reading("heart", (72.0,))


@pytest.fixture
def terminal() -> Iterator[tuple[int, str]]:
    """A pseudo-terminal: what is written to the first is read from the port with the name."""
    ours, theirs = pty.openpty()
    tty.setraw(theirs)
    try:
        yield ours, os.ttyname(theirs)
    finally:
        os.close(theirs)
        with suppress(OSError):
            os.close(ours)


async def test_a_radar_on_a_serial_port_gives_its_values(terminal: tuple[int, str]) -> None:
    ours, name = terminal
    async with serving(RadarDriver("radar", RadarSettings(port=name))) as received:
        await until(lambda: received.runner.link is LinkState.CONNECTED)
        sent = (
            radar.RadarFrame(0x80, 0x01, b"\x01"),
            radar.RadarFrame(0x80, 0x04, b"\x00\x78"),
            radar.RadarFrame(0x81, 0x02, b"\x0e"),
            radar.RadarFrame(0x81, 0x05, bytes([128, 138, 148, 138, 128])),
            radar.RadarFrame(0x85, 0x02, b"\x45"),
        )
        os.write(ours, b"noise" + b"".join(map(radar.build, sent)))
        await until(lambda: received.samples(SignalKind.HEART_RATE))
        assert received.samples(SignalKind.HEART_RATE)[0].values[0, 0] == 69
        assert received.samples(SignalKind.DISTANCE)[0].values[0, 0] == 120
        assert received.samples(SignalKind.RESPIRATION)[0].values[:, 0].tolist() == [0, 10, 20, 10, 0]
        assert "belong to no frame" in received.texts()


async def test_a_radar_that_is_unplugged_is_opened_again(terminal: tuple[int, str]) -> None:
    ours, name = terminal
    async with serving(RadarDriver("radar", RadarSettings(port=name))) as received:
        await until(lambda: received.runner.link is LinkState.CONNECTED)
        os.close(ours)
        await until(
            lambda: "serial port failed" in received.texts() or "cannot be opened" in received.texts()
        )


async def test_a_serial_port_that_does_not_exist_is_named() -> None:
    async with serving(RadarDriver("radar", RadarSettings(port="/dev/no-such-port"))) as received:
        await until(lambda: "/dev/no-such-port cannot be opened" in received.texts())


# The pulse oximeter


@given(st.one_of(st.binary(max_size=200), st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(
        st.sampled_from(["id", "ms", "ir", "red", "hr", "spo2", "battery", "seq"]), inner),
).map(lambda value: json.dumps(value).encode())))  # fmt: skip
def test_any_datagram_is_read_or_refused(data: bytes) -> None:
    try:
        reading = oximeter.parse(data)
    except PacketError:
        return
    assert reading.spo2_percent is None or 0 < reading.spo2_percent <= 100
    assert reading.heart_rate_bpm is None or 0 < reading.heart_rate_bpm <= 1000


def test_a_datagram_of_nested_brackets_is_refused() -> None:
    with pytest.raises(PacketError):
        oximeter.parse(b"[" * 2000)


async def test_a_stick_over_udp_gives_its_values_and_strangers_do_not() -> None:
    driver = Max30100Driver("stick", Max30100Settings(port=0, device_id="m5-1"))
    async with serving(driver) as received:
        await until(lambda: driver.port != 0)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stick:

            def send(content: object) -> None:
                data = content if isinstance(content, bytes) else json.dumps(content).encode()
                stick.sendto(data, ("127.0.0.1", driver.port))

            send({"id": "m5-2", "ms": 1, "hr": 190})
            send(b"\xff\x00 rubbish")
            send(
                {"id": "m5-1", "ms": 1000, "ir": 51000, "red": 49000, "hr": 71.5, "spo2": 97, "battery": 0.8}
            )
            send({"id": "m5-1", "ms": 950, "hr": 180})  # late
            send({"id": "m5-1", "ms": 1100, "ir": 300, "hr": 0})
            await until(lambda: len(received.samples(SignalKind.PPG)) == 2)
        assert [s.values[0, 0] for s in received.samples(SignalKind.HEART_RATE)] == [71.5]
        assert received.samples(SignalKind.SPO2)[0].values[0, 0] == 97
        first, last = received.samples(SignalKind.PPG)
        assert first.has_contact is True
        assert (last.has_contact, last.quality) == (False, 0.0)
        await until(lambda: received.runner.battery == 0.8)
        assert "no JSON" in received.texts()


async def test_a_udp_port_in_use_is_named() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        port = other.getsockname()[1]
        async with serving(Max30100Driver("stick", Max30100Settings(port=port))) as received:
            await until(lambda: f"UDP port {port}" in received.texts())


# LSL and BrainFlow


async def test_an_lsl_stream_is_found_pulled_and_found_again() -> None:
    import pylsl

    name = f"handover-{os.getpid()}-{np.random.default_rng().integers(1 << 30)}"

    def outlet() -> pylsl.StreamOutlet:
        info = pylsl.StreamInfo(name, "ECG", 1, 100, "double64", name)
        return pylsl.StreamOutlet(info)

    settings = LslSettings(kind="ecg", unit="D82", rate_hz=100, name=name, scale=1e6, search_s=2)
    async with serving(LslDriver("stream", settings)) as received:
        for connection in (1, 2):
            stream = outlet()
            await until(stream.have_consumers)
            while received.runner.connections < connection:
                stream.push_chunk([[0.001], [0.002]])
                await asyncio.sleep(0.02)
            del stream
        first = received.samples(SignalKind.ECG)[0]
        assert set(first.values.ravel()) <= {1000.0, 2000.0}, "volts became microvolts"
        assert first.uncertainty_s > 0


@pytest.mark.parametrize(
    ("channels", "form", "reason"), [(1, "string", "has texts"), (3, "double64", "has 3 channels")]
)
async def test_an_lsl_stream_that_is_no_such_signal_is_refused_by_name(
    channels: int, form: str, reason: str
) -> None:
    import pylsl

    name = f"handover-{os.getpid()}-{np.random.default_rng().integers(1 << 30)}"
    outlet = pylsl.StreamOutlet(pylsl.StreamInfo(name, "ECG", channels, 100, form, name))
    settings = LslSettings(kind="ecg", unit="D82", rate_hz=100, name=name, search_s=2)
    async with serving(LslDriver("stream", settings)) as received:
        await until(lambda: reason in received.texts())
        assert received.samples(SignalKind.ECG) == []
    del outlet


@given(st.lists(st.floats(), min_size=1, max_size=20), st.floats(), st.sampled_from([None, 100.0]))
def test_whatever_an_lsl_stream_sends_passes_the_checks_or_not_at_all(
    numbers: list[float], stamp_s: float, rate_hz: float | None
) -> None:
    driver = LslDriver("stream", LslSettings(kind="ecg", unit="D82", rate_hz=rate_hz, name="any"))
    (info,) = driver.signals
    stamps_s = stamp_s + np.arange(len(numbers)) / 100
    samples = driver._samples(info, [[one] for one in numbers], stamps_s)
    checked = SignalMonitor("stream", info).take(samples, 1_700_000_000.0)
    if checked.samples is not None and checked.samples.quality > 0:
        assert np.isfinite(checked.samples.values).all()
        assert np.isfinite(checked.samples.sample_times_s()).all()


async def test_an_lsl_stream_that_is_absent_is_named() -> None:
    settings = LslSettings(kind="ecg", unit="D82", rate_hz=100, source_id="nobody-has-this", search_s=0.05)
    async with serving(LslDriver("stream", settings)) as received:
        await until(lambda: "nobody-has-this" in received.texts())


async def test_the_synthetic_board_of_brainflow_gives_its_signals() -> None:
    driver = BrainFlowDriver("board", BrainFlowSettings(signals=("ecg", "emg", "eda", "ppg")))
    async with serving(driver) as received:
        await until(lambda: all(len(received.samples(info.kind)) > 5 for info in driver.signals))
        assert {info.rate_hz for info in driver.signals} == {250.0}
        assert received.samples(SignalKind.ECG)[0].info.unit == "D82"
    faults = {one.fault for one in received.items if isinstance(one, SensorReport)}
    assert SensorFault.UNIT not in faults


def test_a_board_without_the_signal_is_refused() -> None:
    with pytest.raises(UsageError, match="no signal of a board"):
        BrainFlowDriver("board", BrainFlowSettings(signals=("mood",)))
    with pytest.raises(UsageError, match="choose others"):
        BrainFlowDriver("board", BrainFlowSettings(board_id=-99))


async def test_a_search_finds_the_sticks_that_send() -> None:
    port = next_free_port()
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    async def is_found() -> bool:
        search = asyncio.create_task(Max30100Driver.discover(0.3, port))
        for _ in range(3):
            await asyncio.sleep(0.05)
            sender.sendto(b'{"id": "m5-1", "hr": 71}', ("127.0.0.1", port))
            sender.sendto(b"rubbish", ("127.0.0.1", port))
        return [(one.address, one.name) for one in await search] == [("127.0.0.1", "m5-1")]

    await until(is_found)
    sender.close()
