"""Faults of signals are found in time, and no value of a faulty signal passes as a good one."""

import copy
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.human_state.drivers.monitor import SignalMonitor
from services.human_state.model.features import FeatureName, Status
from services.human_state.model.signals import (
    ClockKind,
    Samples,
    SensorFault,
    SensorReport,
    SignalInfo,
    SignalKind,
)
from services.human_state.processing.guard import SignalGuard
from services.human_state.processing.pipeline import SignalPipeline, pipeline_for, processors_for
from services.human_state.processing.synthesis import (
    FAULTS,
    FaultName,
    acceleration_of,
    ecg_of,
    packets_of,
    synthetic_beats,
    with_fault,
)

ECG = SignalInfo(SignalKind.ECG, "D82", 130.0, min_value=-20_000, max_value=20_000)
ACCELERATION = SignalInfo(SignalKind.ACCELERATION, "MSK", 100.0, ("x", "y", "z"), -80, 80)
BEGIN_S = 1_700_000_000.0
WARM = 36
TRUE_BPM = 72.0


@cache
def warm_ecg() -> tuple[SignalPipeline, list[Samples]]:
    """Return a pipeline that has seen 20 s, and the packets of 30 s."""
    ecg = 1000 * ecg_of(synthetic_beats(34, TRUE_BPM, seed=3), 34, 130.0)
    packets = packets_of(
        ECG, (ecg + np.random.default_rng(1).normal(0, 8, len(ecg)))[:, None], "h10", BEGIN_S, 73
    )
    pipeline = pipeline_for(ECG)
    features = [feature for packet in packets[:WARM] for feature in pipeline.feed(packet)]
    assert features[-1].status is Status.VALID
    assert pipeline.take_reports() == []
    return pipeline, packets


def silence_after(packets: list[Samples], at_s: float) -> SensorReport:
    """Return what the monitor of the driver reports when nothing follows these packets until `at_s`."""
    monitor = SignalMonitor("sensor", packets[0].info)
    for packet in packets:
        monitor.take(packet, packet.end_s)
    report = monitor.silence(at_s)
    assert report is not None
    return report


@settings(max_examples=120, deadline=None)
@given(name=st.sampled_from(FAULTS), seed=st.integers(0, 10_000))
def test_a_fault_of_an_ecg_is_found_within_a_second_and_no_wrong_rate_follows(
    name: FaultName, seed: int
) -> None:
    warm, packets = warm_ecg()
    pipeline = copy.deepcopy(warm)
    faulty, begin_s = with_fault(packets, name, WARM, seed)
    found_after_s = None
    features = []
    for number, packet in enumerate(faulty[WARM:]):
        # A packet arrives when its samples have passed; a gap is seen by the clock before the next packet.
        arrival_s = packets[WARM].start_s + (number + 1) * 73 / 130
        silence = silence_after(packets[:WARM], begin_s + 1.0) if name == "gap" and not number else None
        new = [*(() if silence is None else pipeline.report(silence)), *pipeline.feed(packet)]
        features += new
        if found_after_s is None and (pipeline.take_reports() or silence is not None):
            found_after_s = min(arrival_s - begin_s, 1.0 if name == "gap" else np.inf)
            assert any(f.name is FeatureName.HEART_RATE and f.status is not Status.VALID for f in new)
    assert found_after_s is not None
    assert found_after_s <= (1.2 if name in {"rateOfOldest", "quiet"} else 1.0)
    for feature in features:
        if (
            feature.name is FeatureName.HEART_RATE
            and feature.status is Status.VALID
            and feature.quality >= 0.5
        ):
            assert feature.value == pytest.approx(TRUE_BPM, abs=8)


@settings(max_examples=60, deadline=None)
@given(
    name=st.sampled_from([f for f in FAULTS if f not in {"quiet", "clipped"}]), seed=st.integers(0, 10_000)
)
def test_a_fault_of_an_accelerometer_is_found_within_a_second(name: FaultName, seed: int) -> None:
    activity = ("rest", "sit", "walk", "run")[seed % 4]
    packets = packets_of(ACCELERATION, acceleration_of(activity, 12, 100.0, seed)[0], "imu", BEGIN_S, 36)
    guard = SignalGuard(ACCELERATION)
    faulty, begin_s = with_fault(packets, name, 15, seed)
    for packet in faulty[:15]:
        assert guard.check(packet).samples is packet
    reports = [silence_after(faulty[:15], begin_s + 1.0)] if name == "gap" else []
    for packet in faulty[15:18]:
        reports += guard.check(packet).faults
    assert reports
    if name not in {"gap", "jump"}:
        assert all(guard.check(packet).samples is None for packet in faulty[18:] if "rate" not in name)


def test_a_silent_slow_sensor_is_reported_within_two_periods() -> None:
    info = SignalInfo(SignalKind.HEART_RATE, "BPM", None)
    monitor = SignalMonitor("radar", info)
    for number in range(5):
        at_s = BEGIN_S + 3 * number
        samples = Samples("radar", info, at_s, np.array([[70.0]]), np.array([at_s]))
        assert monitor.take(samples, at_s).reports == ()
    last_s = BEGIN_S + 12
    assert monitor.silence(last_s + 5.5) is None
    found = monitor.silence(last_s + 5.9)
    assert found is not None
    assert found.fault is SensorFault.GAP
    assert monitor.silence(last_s + 9) is None


@pytest.mark.parametrize("value", [0.0, 700.0, float("nan"), -5.0])
def test_a_rate_that_no_body_has_is_not_used(value: float) -> None:
    info = SignalInfo(SignalKind.HEART_RATE, "BPM", None)
    checked = SignalGuard(info).check(
        Samples("strap", info, BEGIN_S, np.array([[value]]), np.array([BEGIN_S]))
    )
    assert checked.samples is None
    assert len(checked.faults) == 1


def test_the_jitter_of_arrivals_is_no_fault() -> None:
    random = np.random.default_rng(2)
    guard = SignalGuard(ECG)
    ecg = 1000 * ecg_of(synthetic_beats(60, 72, seed=3), 60, 130.0) + random.normal(0, 5, 60 * 130)
    for packet in packets_of(ECG, ecg[:, None], "h10", BEGIN_S, 73):
        late = replace(packet, clock=ClockKind.ARRIVAL, start_s=packet.start_s + random.uniform(0, 0.1))
        assert guard.check(late).faults == ()


def test_a_rate_that_is_five_percent_wrong_is_found_with_arrival_times() -> None:
    monitor = SignalMonitor("h10", ECG)
    ecg = 1000 * ecg_of(synthetic_beats(60, 72, seed=3), 60, 130.0)
    ecg += np.random.default_rng(1).normal(0, 5, len(ecg))
    faults = []
    for number, packet in enumerate(packets_of(ECG, ecg[:, None], "h10", BEGIN_S, 73)):
        arrival_s = BEGIN_S + (number + 1) * 73 / 130 * 1.05
        late = replace(packet, clock=ClockKind.ARRIVAL, start_s=arrival_s - 72 / 130)
        faults += [report.fault for report in monitor.take(late, arrival_s).reports]
    assert SensorFault.RATE in faults


def test_values_return_after_a_fault() -> None:
    warm, packets = warm_ecg()
    pipeline = copy.deepcopy(warm)
    pipeline.report(SensorReport("h10", packets[WARM].start_s, has_contact=False))
    later = [f for packet in packets[WARM:] for f in pipeline.feed(packet)]
    assert later[-1].status is Status.VALID
    assert later[-1].value == pytest.approx(TRUE_BPM, abs=4)


def test_a_pipeline_in_a_pipeline_has_one_guard_and_memory_for_few_reports() -> None:
    _, packets = warm_ecg()
    outer = SignalPipeline(ECG, processors_for(ECG))
    assert [type(each).__name__ for each in outer.processors] == ["EcgProcessor"]
    for number in range(300):
        late = packets[number % 2]
        outer.feed(replace(late, start_s=BEGIN_S + 10 * number, has_contact=bool(number % 2)))
    assert 0 < len(outer.take_reports()) <= 64


@pytest.mark.parametrize("packet", [13, 33, 73])
@pytest.mark.parametrize("bpm", [38, 65, 150])
def test_a_clean_ecg_has_no_fault_at_any_rate_and_size_of_packets(bpm: float, packet: int) -> None:
    ecg = 1000 * ecg_of(synthetic_beats(60, bpm, seed=4), 60, 130.0)
    ecg = np.round(ecg + np.random.default_rng(1).normal(0, 4, len(ecg)))
    guard = SignalGuard(ECG)
    for each in packets_of(ECG, ecg[:, None], "h10", BEGIN_S, packet):
        assert guard.check(each).faults == ()


class BrokenProcessor:
    def feed(self, samples: Samples) -> list:
        raise ZeroDivisionError("division by zero")

    def report(self, report: SensorReport) -> list:
        return []


def test_a_processor_that_fails_is_dropped_by_name() -> None:
    pipeline = SignalPipeline(ECG, [BrokenProcessor()])
    _, packets = warm_ecg()
    assert pipeline.feed(packets[0]) == []
    assert "BrokenProcessor of ecg failed" in pipeline.take_reports()[0].text
    pipeline.feed(packets[1])
    assert pipeline.take_reports() == []


PACKAGE = """
from services.human_state.model.features import Feature, FeatureName
from services.human_state.model.signals import SignalKind


class Blinks:
    def feed(self, samples):
        return [Feature(FeatureName.MOVEMENT, samples.source, 0.5, samples.end_s, 1.0, method="blinks")]

    def report(self, report):
        return []


def processor_for(info):
    return Blinks() if info.kind is SignalKind.EOG else None
"""


def test_a_package_adds_a_processor(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "blink_package.py").write_text(PACKAGE)
    metadata = tmp_path / "blink_package-1.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: blink-package\nVersion: 1\n")
    (metadata / "entry_points.txt").write_text(
        "[handover.signal_processors]\nblinks = blink_package:processor_for\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    eog = SignalInfo(SignalKind.EOG, "D82", 100.0)
    (processor,) = processors_for(eog)
    (packet,) = packets_of(eog, np.random.default_rng(1).normal(size=(20, 1)), "eog", BEGIN_S, 20)
    assert [feature.method for feature in processor.feed(packet)] == ["blinks"]
    assert len(processors_for(ECG)) == 1
