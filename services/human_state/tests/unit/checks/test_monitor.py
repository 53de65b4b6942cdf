"""What leaves the monitor can be used, whatever a device sends."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_body.checks.monitor import MAX_AHEAD_S, Checked, SignalMonitor
from handover_body.model.signals import (
    ClockKind,
    Samples,
    SensorFault,
    SignalInfo,
    SignalKind,
)

ECG = SignalInfo(SignalKind.ECG, "D82", 130.0, min_value=-10_000, max_value=10_000)
ACCELERATION = SignalInfo(SignalKind.ACCELERATION, "MSK", 50.0, ("x", "y", "z"), -78.5, 78.5)
HEART_RATE = SignalInfo(SignalKind.HEART_RATE, "BPM", None, min_value=0, max_value=255)
NOW_S = 1_700_000_000.0
PACKET = 65  # half a second of the ECG


def wave(count: int, seed: int = 0, size: float = 1000.0) -> np.ndarray:
    return size * np.random.default_rng(seed).normal(0, 0.3, (count, 1)).clip(-3, 3)


class Feed:
    """A device with its own clock that sends packets of half a second."""

    def __init__(self, info: SignalInfo = ECG, clock: ClockKind = ClockKind.DEVICE) -> None:
        self.monitor = SignalMonitor("belt", info)
        self.info = info
        self.clock = clock
        self.device_s = 5000.0
        self.our_s = NOW_S
        self.faults: list[SensorFault] = []
        self.sent: list[Samples] = []

    def packet(
        self, values: np.ndarray | None = None, delay_s: float = 0.02, rate: float = 1.0, **changes: object
    ) -> Checked:
        count = round((self.info.rate_hz or 2.0) / 2)
        given = wave(count, len(self.sent)) if values is None else values
        start_s = self.device_s if self.clock is ClockKind.DEVICE else self.our_s + delay_s
        span_s = len(given) / ((self.info.rate_hz or 2.0) * rate)
        self.device_s += span_s
        self.our_s += span_s
        samples = Samples("belt", self.info, start_s, given, clock=self.clock, **changes)  # type: ignore[arg-type]
        checked = self.monitor.take(samples, self.our_s + delay_s)
        self.faults += [report.fault for report in checked.reports if report.fault]
        if checked.samples is not None:
            self.sent.append(checked.samples)
        return checked

    def run(self, seconds: float, **changes: object) -> None:
        for _ in range(round(2 * seconds)):
            self.packet(**changes)  # type: ignore[arg-type]


def test_a_device_with_jitter_and_drift_has_no_faults_and_no_gaps() -> None:
    feed = Feed()
    random = np.random.default_rng(4)
    for _ in range(600):
        feed.packet(delay_s=float(random.uniform(0.01, 0.4)))
    assert feed.faults == []
    times = np.concatenate([one.sample_times_s() for one in feed.sent])
    assert np.allclose(np.diff(times), 1 / 130, atol=0.0035)
    assert all(one.quality == 1.0 for one in feed.sent)
    assert abs(times[-1] - (feed.our_s - 1 / 130)) < feed.sent[-1].uncertainty_s + 0.02


def test_packets_that_waited_at_the_beginning_are_late_and_no_clock_jump() -> None:
    feed = Feed()
    for waited in range(4):  # all four arrive together, two seconds after the first was measured
        feed.packet(delay_s=2.0 - waited / 2)
    feed.run(20)
    assert set(feed.faults) == {SensorFault.LATE}
    times_s = np.concatenate([one.sample_times_s() for one in feed.sent])
    assert (np.diff(times_s) > 0).all()
    assert feed.our_s - times_s[-1] < 0.1


def test_packets_of_a_busy_machine_are_joined_and_only_the_uncertainty_grows() -> None:
    feed = Feed()
    feed.run(10)
    for _ in range(120):  # for a minute everything comes 1.5 s later
        feed.packet(delay_s=1.5)
    assert feed.faults == []
    assert feed.sent[-1].uncertainty_s > 1.0
    times_s = np.concatenate([one.sample_times_s() for one in feed.sent])
    assert np.diff(times_s) == pytest.approx(1 / 130, abs=0.8 / 130), "no sample is missing"


def test_relief_after_load_is_late_and_no_clock_jump() -> None:
    feed = Feed()
    for number in range(80):  # each packet waits a little less than the one before
        feed.monitor.delayed(feed.our_s, 0.3)
        feed.packet(delay_s=2.0 - number / 40)
    assert SensorFault.LATE in feed.faults
    assert SensorFault.CLOCK_JUMP not in feed.faults


def test_a_pause_of_this_machine_is_no_silence_and_no_gap_of_what_is_stamped_at_its_arrival() -> None:
    feed = Feed(clock=ClockKind.ARRIVAL)
    feed.run(10)
    paused_s = 3.0
    at_s = feed.our_s + paused_s
    feed.monitor.delayed(at_s, paused_s)
    assert feed.monitor.silence(at_s + 0.1) is None
    for waited in range(6):  # what waited is taken at once
        feed.packet(delay_s=paused_s - (waited + 1) / 2)
    feed.run(5)
    assert SensorFault.GAP not in feed.faults
    assert SensorFault.CLOCK_JUMP not in feed.faults
    assert feed.monitor.silence(feed.our_s + 1.5) is not None, "silence is found again afterwards"


def test_lost_packets_are_a_gap_of_their_length() -> None:
    feed = Feed()
    feed.run(5)
    feed.device_s += 3.0
    feed.our_s += 3.0
    checked = feed.packet()
    (report,) = checked.reports
    assert report.fault is SensorFault.GAP
    assert report.details["gap_s"] == pytest.approx(3.0, abs=0.01)


@pytest.mark.parametrize("jump_s", [-3600.0, -2.0, 4.0, 86_400.0])
def test_a_clock_that_jumps_is_found_at_once_and_times_stay_ours(jump_s: float) -> None:
    feed = Feed()
    feed.run(5)
    feed.device_s += jump_s
    checked = feed.packet()
    assert SensorFault.CLOCK_JUMP in {report.fault for report in checked.reports}
    feed.run(2)
    assert feed.sent[-1].end_s == pytest.approx(feed.our_s, abs=0.2)


def test_silence_is_reported_once_within_a_second() -> None:
    feed = Feed()
    feed.run(2)
    assert feed.monitor.silence(feed.our_s + 0.5) is None
    report = feed.monitor.silence(feed.our_s + 0.95)
    assert report is not None
    assert report.fault is SensorFault.GAP
    assert feed.monitor.silence(feed.our_s + 2.0) is None


@pytest.mark.parametrize("clock", [ClockKind.DEVICE, ClockKind.ARRIVAL, ClockKind.RECORDING])
@pytest.mark.parametrize("rate", [0.8, 1.25])
def test_a_rate_that_lies_is_found_and_its_samples_cannot_be_used(clock: ClockKind, rate: float) -> None:
    feed = Feed(clock=clock)
    feed.run(10, rate=rate)
    assert SensorFault.RATE in feed.faults
    assert feed.sent[-1].quality == 0.0


@pytest.mark.parametrize("clock", [ClockKind.DEVICE, ClockKind.ARRIVAL])
def test_a_rate_that_is_true_again_is_used_again(clock: ClockKind) -> None:
    feed = Feed(clock=clock)
    feed.run(6, rate=0.8)
    feed.run(30 if clock is ClockKind.DEVICE else 75)
    assert feed.sent[-1].quality == 1.0


def test_saturation_is_found_within_its_packet() -> None:
    feed = Feed()
    feed.run(2)
    values = wave(PACKET)
    values[10:20] = 10_000
    checked = feed.packet(values)
    assert [report.fault for report in checked.reports] == [SensorFault.SATURATED]
    assert checked.samples is not None
    assert checked.samples.quality == 0.0


def test_saturation_of_single_samples_in_many_packets_is_found() -> None:
    feed = Feed()
    values = wave(1)
    found = [feed.packet(np.full((1, 1), 10_000.0)).reports for _ in range(3)]
    assert found[0][0].fault is SensorFault.SATURATED
    assert feed.packet(values).samples is not None


def test_zeros_at_the_start_are_flat_and_no_slow_heart() -> None:
    feed = Feed()
    feed.run(3)
    feed.run(3, values=np.zeros((PACKET, 1)))
    assert SensorFault.FLAT in feed.faults
    assert feed.sent[-1].quality == 0.0
    feed.run(3)
    assert feed.sent[-1].quality == 1.0


def test_a_heart_rate_of_zero_is_not_a_value() -> None:
    monitor = SignalMonitor("belt", HEART_RATE)
    samples = Samples("belt", HEART_RATE, NOW_S, np.zeros((1, 1)), np.array([NOW_S]))
    checked = monitor.take(samples, NOW_S)
    assert checked.samples is not None
    assert np.isnan(checked.samples.values).all()


@pytest.mark.parametrize("factor", [1e-6, 1e-3, 1e3])
def test_an_ecg_in_another_unit_than_it_says_is_found(factor: float) -> None:
    info = SignalInfo(SignalKind.ECG, "D82", 130.0)
    feed = Feed(info)
    for number in range(10):
        feed.packet(wave(PACKET, number, 1000.0 * factor))
    assert SensorFault.UNIT in feed.faults
    assert feed.sent[-1].quality == 0.0


def test_units_that_change_on_the_way_are_found() -> None:
    info = SignalInfo(SignalKind.PPG, "C62", 100.0)
    feed = Feed(info)
    for number in range(10):
        feed.packet(wave(50, number))
    for number in range(16):
        feed.packet(wave(50, number, 1e6))
    assert SensorFault.UNIT in feed.faults
    assert feed.sent[-1].quality == 0.0


def test_an_acceleration_in_g_that_says_metres_is_found() -> None:
    feed = Feed(ACCELERATION)
    upright = np.tile([0.0, 0.0, 1.0], (25, 1)) + np.random.default_rng(0).normal(0, 0.01, (25, 3))
    for _ in range(6):
        feed.packet(upright)
    assert SensorFault.UNIT in feed.faults
    feed = Feed(ACCELERATION)
    for _ in range(6):
        feed.packet(9.81 * upright)
    assert feed.faults == []


def test_lost_contact_is_reported_and_its_samples_cannot_be_used() -> None:
    feed = Feed()
    feed.run(1)
    feed.run(2, has_contact=False)
    assert SensorFault.NO_CONTACT in feed.faults
    assert feed.sent[-1].quality == 0.0


def test_a_repeated_packet_is_dropped() -> None:
    feed = Feed()
    feed.run(1)
    again = Samples("belt", ECG, feed.device_s - 0.5, wave(PACKET), clock=ClockKind.DEVICE)
    assert feed.monitor.take(again, feed.our_s).samples is None


any_float = st.floats(allow_nan=True, allow_infinity=True)
any_stamp = st.one_of(st.floats(0, 10), st.floats(), st.floats(NOW_S - 10, NOW_S + 10))


@given(
    clock=st.sampled_from([ClockKind.DEVICE, ClockKind.ARRIVAL]),
    is_regular=st.booleans(),
    packets=st.lists(
        st.tuples(
            any_stamp,
            st.floats(0, 2),
            st.lists(any_float, min_size=0, max_size=40),
            any_float,
            st.sampled_from([None, True, False]),
        ),
        max_size=30,
    ),
)
def test_whatever_a_device_sends_leaves_in_order_and_never_from_the_future(
    clock: ClockKind,
    is_regular: bool,
    packets: list[tuple[float, float, list[float], float, bool | None]],
) -> None:
    info = ECG if is_regular else HEART_RATE
    monitor = SignalMonitor("belt", info)
    our_s, newest_s = NOW_S, -math.inf
    for start_s, passed_s, values, quality, has_contact in packets:
        our_s += passed_s
        array = np.array(values, dtype=np.float64).reshape(-1, 1)
        times_s = None if is_regular else start_s + np.arange(len(values)) * 0.5
        samples = Samples(
            "belt", info, start_s, array, times_s, clock=clock, quality=quality, has_contact=has_contact
        )
        checked = monitor.take(samples, our_s)
        if checked.samples is None:
            continue
        times_out = checked.samples.sample_times_s()
        assert len(times_out) == len(checked.samples.values) > 0
        assert np.isfinite(times_out).all()
        assert times_out[0] > newest_s
        assert (np.diff(times_out) > 0).all()
        assert times_out[-1] <= our_s + MAX_AHEAD_S + 1e-6
        newest_s = float(times_out[-1])
        assert 0 <= checked.samples.quality <= 1
        assert not np.isinf(checked.samples.values).any()
        assert set(checked.samples.values[np.isfinite(checked.samples.values)]) <= set(values)
        if has_contact is False:
            assert checked.samples.quality == 0
