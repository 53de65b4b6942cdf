"""Parsers: what was built is read back, and other bytes are refused with the error of packets."""

import contextlib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_body.drivers.base import PacketError
from handover_body.drivers.beats import REMOVED_S, BeatClock, ContactWatch
from handover_body.drivers.corsano import protocol as corsano
from handover_body.drivers.heart_rate_strap import protocol as strap
from handover_body.drivers.metamotion import protocol as metamotion
from handover_body.drivers.polar_h10 import protocol as h10
from handover_body.drivers.sensomative import protocol as mat

PARSERS: dict[str, Callable[[bytes], Any]] = {
    "strap": strap.parse,
    "h10": h10.parse,
    "h10 answer": lambda data: h10.check_answer(data, h10.Measurement.ECG),
    "mat": mat.parse,
    "corsano record": corsano.parse_record,
    "corsano answer": corsano.parse_size,
    "corsano stream": lambda data: corsano.RecordStream().feed(data),
    "metamotion": lambda data: metamotion.parse(data, 4),
}


@pytest.mark.parametrize("name", PARSERS)
@given(data=st.binary(max_size=300))
def test_any_bytes_are_read_or_refused_with_the_error_of_packets(name: str, data: bytes) -> None:
    with contextlib.suppress(PacketError):
        PARSERS[name](data)


measurements = st.builds(
    strap.HeartRateMeasurement,
    heart_rate_bpm=st.integers(0, 65_535),
    intervals_s=st.lists(st.integers(0, 65_535).map(lambda one: one / 1024), max_size=9).map(tuple),
    has_contact=st.sampled_from([None, True, False]),
    energy_kj=st.none() | st.integers(0, 65_535),
)


@given(measured=measurements, cut=st.integers(1, 60))
def test_a_heart_rate_is_read_back_and_a_cut_one_gives_no_value_it_has_not(
    measured: strap.HeartRateMeasurement, cut: int
) -> None:
    data = strap.build(measured)
    assert strap.parse(data) == measured
    try:
        read = strap.parse(data[:-cut])
    except PacketError:
        return
    assert read.heart_rate_bpm == measured.heart_rate_bpm
    assert read.intervals_s == measured.intervals_s[: len(read.intervals_s)]


def test_a_heart_rate_without_intervals_is_kept() -> None:
    assert strap.parse(bytes([0x00, 72])) == strap.HeartRateMeasurement(72)


@given(
    microvolts=st.lists(st.integers(-(2**23), 2**23 - 1), min_size=1, max_size=73),
    end_ns=st.integers(0, 2**63),
)
def test_an_ecg_frame_is_read_back(microvolts: list[int], end_ns: int) -> None:
    values = np.array(microvolts, dtype=np.float64)[:, None]
    data = h10.build(h10.Frame(h10.Measurement.ECG, end_ns * 1e-9, values))
    read = h10.parse(data)
    assert np.array_equal(read.values, values)
    with pytest.raises(PacketError):
        h10.parse(data[:-1])


@given(st.lists(st.tuples(*[st.integers(-8000, 8000)] * 3), min_size=1, max_size=36))
def test_an_acceleration_frame_is_read_back_in_metres(milli_g: list[tuple[int, int, int]]) -> None:
    values = np.array(milli_g, dtype=np.float64) * h10.GRAVITY / 1000
    read = h10.parse(h10.build(h10.Frame(h10.Measurement.ACCELERATION, 1.0, values)))
    assert read.values == pytest.approx(values)


def test_the_commands_of_an_h10_are_those_of_its_documents() -> None:
    assert h10.start_command(h10.Measurement.ECG) == bytes.fromhex("02000001820001010E00")
    acceleration = h10.start_command(h10.Measurement.ACCELERATION, 200, 8)
    assert acceleration == bytes.fromhex("02020001C8000101100002010800")
    h10.check_answer(bytes.fromhex("F0020000"), h10.Measurement.ECG)
    h10.check_answer(bytes.fromhex("F0020006"), h10.Measurement.ECG)
    with pytest.raises(PacketError, match="charging"):
        h10.check_answer(bytes.fromhex("F002000D"), h10.Measurement.ECG)


def test_the_checksum_is_that_of_the_catalogue() -> None:
    """CRC-8 with 0x07 and 0xFF gives FB for "123456789" (CRC catalogue of Greg Cook)."""
    assert corsano.crc8(b"123456789") == 0xFB


records = st.builds(
    corsano.ActivityRecord,
    device_s=st.integers(0, 2**32 - 1),
    heart_rate_bpm=st.none() | st.integers(1, 255),
    heart_rate_quality=st.integers(0, 4).map(lambda one: one / 4),
    steps=st.integers(0, 65_535),
    spo2_percent=st.none() | st.integers(1, 100),
    spo2_quality=st.integers(0, 4).map(lambda one: one / 4),
    breathing_rate=st.none() | st.integers(1, 255).map(lambda one: one / 4),
    breathing_quality=st.integers(0, 4).map(lambda one: one / 4),
    battery=st.none() | st.integers(0, 100).map(lambda one: one / 100),
    skin_temperature_c=st.none() | st.integers(1, 32_767).map(lambda one: one / 100),
    is_worn=st.booleans(),
)


@given(sent=st.lists(records, max_size=4), pieces=st.integers(1, 50), noise=st.binary(max_size=30))
def test_records_in_a_stream_are_found_after_damage_and_in_any_pieces(
    sent: list[corsano.ActivityRecord], pieces: int, noise: bytes
) -> None:
    data = noise + b"".join(map(corsano.build_record, sent))
    stream = corsano.RecordStream()
    found = [one for at in range(0, len(data), pieces) for one in stream.feed(data[at : at + pieces])]
    if not noise:
        assert found == sent
    else:  # noise may look like a record by chance, one in 256 positions, and hide the next
        assert len([one for one in found if one in sent]) >= len(sent) - 2
    assert len(stream._buffer) < corsano.RECORD_BYTES


@given(sent=records, at=st.integers(0, 37), bit=st.integers(0, 7))
def test_a_record_with_a_wrong_bit_is_refused(sent: corsano.ActivityRecord, at: int, bit: int) -> None:
    data = bytearray(corsano.build_record(sent))
    data[at] ^= 1 << bit
    with pytest.raises(PacketError, match="checksum"):
        corsano.parse_record(bytes(data))


def test_one_g_is_not_one() -> None:
    """Published drivers forget that the wire has g."""
    upright = np.array([0.0, 0.0, h10.GRAVITY])
    read = metamotion.parse(metamotion.build(upright, 4), 4)
    assert read is not None
    assert read[0] == pytest.approx(upright, abs=0.002)


@given(st.lists(st.integers(0, 255), min_size=12, max_size=12))
def test_a_mat_is_read_back(cells: list[int]) -> None:
    assert mat.parse(mat.build(np.array(cells, dtype=np.float64))).ravel().tolist() == cells


def test_times_of_beats_follow_their_intervals_not_the_jitter_of_packets() -> None:
    clock, random = BeatClock(), np.random.default_rng(1)
    intervals = random.normal(0.8, 0.03, 300)
    beats = 100 + np.cumsum(intervals)
    times: list[float] = []
    for packet in range(100):
        mine = intervals[3 * packet : 3 * packet + 3]
        arrival_s = beats[3 * packet + 2] + random.uniform(0.3, 1.0)
        times += clock.times(list(mine), arrival_s)
    steps = np.diff(times)
    assert np.mean(np.abs(steps - intervals[1:]) < 1e-6) > 0.97
    assert np.all(steps > 0)


@given(st.lists(st.tuples(st.floats(0.2, 3), st.lists(st.floats(0.25, 2.0), max_size=5)), max_size=30))
def test_no_beat_is_later_than_its_packet(packets: list[tuple[float, list[float]]]) -> None:
    clock, at_s = BeatClock(), 1000.0
    for passed_s, intervals in packets:
        at_s += passed_s
        times = clock.times(intervals, at_s)
        assert len(times) == len(intervals)
        assert all(one <= at_s + 1e-6 for one in times)


def test_a_strap_whose_beats_cease_is_not_worn() -> None:
    watch = ContactWatch()
    assert watch.update(reported=None, has_beats=False, at_s=0.0) is None, "a strap that never sends them"
    assert watch.update(reported=None, has_beats=True, at_s=1.0) is True
    assert watch.update(reported=True, has_beats=False, at_s=1.5 + REMOVED_S) is False
    assert watch.update(reported=True, has_beats=True, at_s=10.0) is True
    assert watch.update(reported=False, has_beats=True, at_s=11.0) is False
