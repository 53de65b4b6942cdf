"""Faults of signals are found in time, and no value of a faulty signal passes as a good one."""

import copy
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_body.checks.monitor import SignalMonitor
from handover_body.drivers.runner import WATCH_S
from handover_body.model.features import Feature, FeatureName, Status
from handover_body.model.signals import (
    ClockKind,
    Samples,
    SensorFault,
    SensorReport,
    SignalInfo,
    SignalKind,
)
from handover_body.processing.pipeline import SignalPipeline, pipeline_for, processors_for
from handover_body.processing.synthesis import (
    FAULTS,
    FaultName,
    Faulty,
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


class Checks:
    """What the service does with a signal: the monitor, then the pipeline."""

    def __init__(self, info: SignalInfo) -> None:
        self.monitor = SignalMonitor("sensor", info, stamps_oldest=True)
        self.pipeline = pipeline_for(info)
        self.faults: list[SensorFault | None] = []
        self.used: list[bool] = []
        """Whether the packets have quality."""

    def take(self, packet: Samples, arrival_s: float) -> list[Feature]:
        checked = self.monitor.take(packet, arrival_s)
        features = self.report(checked.reports)
        self.used.append(checked.samples is not None and checked.samples.quality > 0)
        return features if checked.samples is None else [*features, *self.pipeline.feed(checked.samples)]

    def report(self, reports: Sequence[SensorReport]) -> list[Feature]:
        self.faults += [report.fault for report in reports]
        return [feature for report in reports for feature in self.pipeline.report(report)]

    def run(self, faulty: Faulty, first: int, seed: int) -> tuple[float, list[Feature]]:
        """Take the packets from `first` on as they arrive; return when the fault was found, and features."""
        random = np.random.default_rng(seed)
        found_s, features = np.inf, []
        looked_s = faulty.begin_s - random.uniform(0, WATCH_S)
        for packet, sent_s in list(zip(faulty.packets, faulty.sent_s, strict=True))[first:]:
            arrival_s = sent_s + random.uniform(0.005, 0.03)
            while looked_s + WATCH_S < arrival_s:
                looked_s += WATCH_S
                silence = self.monitor.silence(looked_s)
                features += [] if silence is None else self.report([silence])
                found_s = min(found_s, looked_s if self.faults else np.inf)
            features += self.take(packet, arrival_s)
            found_s = min(found_s, arrival_s if self.faults else np.inf)
        return found_s - faulty.begin_s, features


@cache
def warm_ecg() -> tuple[Checks, list[Samples]]:
    """Return checks that have seen 20 s, and the packets of 30 s."""
    ecg = 1000 * ecg_of(synthetic_beats(34, TRUE_BPM, seed=3), 34, 130.0)
    packets = packets_of(
        ECG, (ecg + np.random.default_rng(1).normal(0, 8, len(ecg)))[:, None], "h10", BEGIN_S, 73
    )
    checks = Checks(ECG)
    random = np.random.default_rng(2)
    features = [
        feature
        for packet in packets[:WARM]
        for feature in checks.take(packet, packet.end_s + random.uniform(0.005, 0.03))
    ]
    assert features[-1].status is Status.VALID
    assert checks.faults == []
    return checks, packets


@pytest.mark.nightly
@settings(max_examples=120, deadline=None)
@given(name=st.sampled_from(FAULTS), seed=st.integers(0, 10_000))
def test_a_fault_of_an_ecg_is_found_within_a_second_and_no_wrong_rate_follows(
    name: FaultName, seed: int
) -> None:
    warm, packets = warm_ecg()
    checks = copy.deepcopy(warm)
    found_after_s, features = checks.run(with_fault(packets, name, WARM, seed), WARM, seed)
    assert found_after_s <= 1.0
    rates = [feature for feature in features if feature.name is FeatureName.HEART_RATE]
    assert any(rate.status is not Status.VALID for rate in rates)
    for rate in rates:
        if rate.status is Status.VALID and rate.quality >= 0.5:
            assert rate.value == pytest.approx(TRUE_BPM, abs=8)


@settings(max_examples=60, deadline=None)
@given(
    name=st.sampled_from([f for f in FAULTS if f not in {"quiet", "clipped"}]), seed=st.integers(0, 10_000)
)
def test_a_fault_of_an_accelerometer_is_found_within_a_second(name: FaultName, seed: int) -> None:
    activity = ("rest", "sit", "walk", "run")[seed % 4]
    packets = packets_of(ACCELERATION, acceleration_of(activity, 20, 100.0, seed)[0], "imu", BEGIN_S, 36)
    faulty = with_fault(packets, name, 40, seed)
    checks = Checks(ACCELERATION)
    for packet, sent_s in zip(faulty.packets[:40], faulty.sent_s, strict=False):
        checks.take(packet, sent_s)
    assert all(checks.used)
    found_after_s, _ = checks.run(faulty, 40, seed)
    assert found_after_s <= 1.0
    if name not in {"gap", "jump"}:
        assert not any(checks.used[42:]), "nothing is used while the fault lasts"


@pytest.mark.nightly
@pytest.mark.parametrize(("bpm", "share"), [(42, 0.04), (50, 0.0), (60, 0.04), (72, 0.04), (110, 0.04)])
def test_pauses_of_a_heart_are_no_lost_contact(bpm: float, share: float) -> None:
    for seed in range(3):
        ecg = ecg_of(synthetic_beats(240, bpm, seed, ectopic_share=share), 240, 130.0)
        ecg += np.random.default_rng(seed).normal(0, 0.006, len(ecg))
        checks = Checks(ECG)
        for packet in packets_of(ECG, 1000 * ecg[:, None], "h10", BEGIN_S, 73):
            checks.take(packet, packet.end_s)
        assert checks.faults == []


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
    checked = SignalMonitor("strap", info).take(
        Samples("strap", info, BEGIN_S, np.array([[value]]), np.array([BEGIN_S])), BEGIN_S
    )
    assert checked.samples is not None
    assert checked.samples.quality == 0
    is_measured = value > 0  # devices send 0 until they have measured
    assert len(checked.reports) == is_measured


def test_each_packet_without_a_value_ends_the_value_before() -> None:
    info = SignalInfo(SignalKind.HEART_RATE, "BPM", None)
    monitor = SignalMonitor("strap", info)
    found = []
    for number, value in enumerate((70.0, 0.0, 71.0, 0.0, 72.0)):
        at_s = BEGIN_S + 0.3 * number
        found.append(
            len(
                monitor.take(
                    Samples("strap", info, at_s, np.array([[value]]), np.array([at_s])), at_s
                ).reports
            )
        )
    assert found == [0, 1, 0, 1, 0]


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
    checks = copy.deepcopy(warm)
    checks.report([SensorReport("h10", packets[WARM].start_s, has_contact=False)])
    later = [f for packet in packets[WARM:] for f in checks.take(packet, packet.end_s + 0.01)]
    assert later[-1].status is Status.VALID
    assert later[-1].value == pytest.approx(TRUE_BPM, abs=4)


def test_a_fault_of_one_signal_does_not_end_the_values_of_another() -> None:
    warm, packets = warm_ecg()
    pipeline = copy.deepcopy(warm.pipeline)
    at_s = packets[WARM].start_s
    other = SensorReport("h10", at_s, fault=SensorFault.SATURATED, kind=SignalKind.ACCELERATION)
    assert pipeline.report(other) == []
    assert pipeline.report(replace(other, kind=SignalKind.ECG)) != []


def test_a_pipeline_in_a_pipeline_has_its_processors_once() -> None:
    outer = SignalPipeline(ECG, processors_for(ECG))
    assert [type(each).__name__ for each in outer.processors] == ["EcgProcessor"]


@pytest.mark.parametrize("packet", [13, 33, 73])
@pytest.mark.parametrize("bpm", [38, 65, 150])
def test_a_clean_ecg_has_no_fault_at_any_rate_and_size_of_packets(bpm: float, packet: int) -> None:
    ecg = 1000 * ecg_of(synthetic_beats(60, bpm, seed=4), 60, 130.0)
    ecg = np.round(ecg + np.random.default_rng(1).normal(0, 4, len(ecg)))
    monitor = SignalMonitor("h10", ECG)
    for each in packets_of(ECG, ecg[:, None], "h10", BEGIN_S, packet):
        assert monitor.take(each, each.end_s).reports == ()


class BrokenProcessor:
    def feed(self, samples: Samples) -> list[Feature]:
        raise ZeroDivisionError("division by zero")

    def report(self, report: SensorReport) -> list[Feature]:
        return []


def test_a_processor_that_fails_is_dropped_by_name() -> None:
    pipeline = SignalPipeline(ECG, [BrokenProcessor()])
    _, packets = warm_ecg()
    assert pipeline.feed(packets[0]) == []
    assert "BrokenProcessor of ecg failed" in pipeline.take_reports()[0].text
    pipeline.feed(packets[1])
    assert pipeline.take_reports() == []


PACKAGE = """
from handover_body.model.features import Feature, FeatureName
from handover_body.model.signals import SignalKind


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
