"""Recorded hearts by construction: one beat, repeated with the cycle length of the wanted rate, and faults.

Nothing here is used by the detector or by `synthesis`: a beat is a list of corners of straight lines.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from handover_body.checks.monitor import SignalMonitor
from handover_body.fusion.person_state import PersonState
from handover_body.model.features import Feature, FeatureName, Status
from handover_body.model.signals import ClockKind, Samples, SignalInfo, SignalKind
from handover_body.processing.pipeline import pipeline_for

Floats = NDArray[np.float64]
Rate = Callable[[float], float]

BEATS: dict[str, list[tuple[float, float]]] = {
    # seconds from the R peak, millivolts
    "normal": [(-0.2, 0), (-0.16, 0.12), (-0.11, 0), (-0.035, 0), (-0.02, -0.15), (0, 1.2), (0.02, -0.25),
               (0.04, 0), (0.14, 0.02), (0.24, 0.2), (0.32, 0)],
    "tall T": [(-0.2, 0), (-0.16, 0.15), (-0.11, 0), (-0.035, 0), (-0.02, -0.1), (0, 1.0), (0.02, -0.2),
               (0.04, 0), (0.14, 0.1), (0.26, 0.9), (0.36, 0)],
    "deep S": [(-0.18, 0), (-0.15, 0.1), (-0.1, 0), (-0.03, 0), (-0.012, 0.35), (0, 0.3), (0.018, -1.4),
               (0.045, 0), (0.15, 0), (0.22, 0.15), (0.3, 0)],
    "wide": [(-0.06, 0), (-0.02, 0.7), (0, 0.9), (0.025, 0.8), (0.07, -0.2), (0.1, 0), (0.2, -0.2), (0.3, 0)],
}  # fmt: skip
BEGIN_S = 1_000_000_000.0


@dataclass(frozen=True)
class Heart:
    """An ECG in mV with the rate that it has at each time, in bpm."""

    ecg: Floats
    rate_hz: float
    bpm: Rate


def heart(
    bpm: float | Rate,
    duration_s: float,
    *,
    rate_hz: float = 360.0,
    beat: str = "normal",
    seed: int = 1,
    jitter: float = 0.01,
    noise_mv: float = 0.02,
    second: float = 1.0,
) -> Heart:
    """Return a heart; the T wave of a fast one comes earlier, and is cut off by the next beat.

    Every second beat has the height `second`.
    """
    random = np.random.default_rng(seed)
    rate: Rate = bpm if callable(bpm) else lambda _: float(bpm)
    at_s, values = np.array(BEATS[beat]).T
    ecg = random.normal(0, noise_mv, round(duration_s * rate_hz))
    time_s = np.arange(len(ecg)) / rate_hz
    peak_s, height = 0.4, 1.0
    while peak_s < duration_s:
        cycle_s = 60 / rate(peak_s)
        scale = np.where(np.abs(at_s) > 0.05, np.clip(np.sqrt(cycle_s), 0.55, 1.15), 1.0)
        near = (time_s > peak_s - 0.4) & (time_s < peak_s + 0.6 * min(1.0, 1.3 * cycle_s))
        ecg[near] += np.interp(time_s[near] - peak_s, at_s * scale, height * values, left=0, right=0)
        height = second if height == 1.0 else 1.0
        peak_s += cycle_s * (1 + jitter * random.normal())
    return Heart(ecg, rate_hz, rate)


def with_fault(given: Heart, kind: str, at_s: float, seconds: float, seed: int = 2) -> Heart:
    """Return a heart with a fault: `nan`, `flat`, `noise`, `movement`, or `gap`, where nothing is sent."""
    random = np.random.default_rng(seed)
    ecg = given.ecg.copy()
    part = slice(round(at_s * given.rate_hz), round((at_s + seconds) * given.rate_hz))
    count = len(ecg[part])
    if kind in {"nan", "gap"}:
        ecg[part] = np.nan if kind == "nan" else np.inf
    elif kind == "flat":
        ecg[part] = ecg[part.start]
    elif kind == "noise":
        ecg[part] = random.normal(0, 0.4, count)
    else:
        ecg[part] += np.cumsum(random.normal(0, 0.15, count))
    return Heart(ecg, given.rate_hz, given.bpm)


def heart_rates(given: Heart, packet_s: float = 0.25) -> list[Feature]:
    """Return the heart rates that the service would show, with times from the beginning."""
    info = SignalInfo(SignalKind.ECG, "2Z", given.rate_hz)
    monitor, pipeline, state = SignalMonitor("ecg", info), pipeline_for(info), PersonState()
    size = max(1, round(packet_s * given.rate_hz))
    shown: list[Feature] = []
    for first in range(0, len(given.ecg), size):
        values = given.ecg[first : first + size]
        at_s = BEGIN_S + first / given.rate_hz
        now_s = at_s + len(values) / given.rate_hz
        if np.isinf(values).any():  # nothing is sent
            silence = monitor.silence(now_s)
            reports, samples = (silence,) if silence else (), None
        else:
            packet = Samples("ecg", info, at_s, values[:, None], clock=ClockKind.RECORDING)
            checked = monitor.take(packet, now_s)
            reports, samples = checked.reports, checked.samples
        features: list[Feature] = []
        for report in reports:
            state.report(report)
            features += pipeline.report(report)
        if samples is not None:
            features += pipeline.feed(samples)
        shown += [
            taken for feature in features
            if feature.name is FeatureName.HEART_RATE and (taken := state.take(feature, now_s)) is not None
        ]  # fmt: skip
    assert pipeline.take_reports() == []
    return shown


@dataclass(frozen=True)
class Course:
    """What a reader of the status sees, ten times a second: the valid rate, NaN without one."""

    at_s: Floats
    bpm: Floats
    true_bpm: Floats

    def longest_low_s(self) -> float:
        """Return for how long at most a valid rate was more than 10 bpm too low."""
        longest = run = 0
        for is_low in self.bpm < self.true_bpm - 10:
            run = run + 1 if is_low else 0
            longest = max(longest, run)
        return longest / 10

    def valid_again_s(self, from_s: float) -> float:
        """Return after how many s there was a valid rate within 10 bpm."""
        good = (np.abs(self.bpm - self.true_bpm) <= 10) & (self.at_s >= from_s)
        return float(self.at_s[np.argmax(good)] - from_s) if good.any() else np.inf


def course(given: Heart, features: list[Feature]) -> Course:
    """Return what a reader sees of the features of a heart."""
    at_s = np.arange(0, len(given.ecg) / given.rate_hz, 0.1)
    times_s = np.array([feature.at_s - BEGIN_S for feature in features])
    bpm = np.full(len(at_s), np.nan)
    for number, now_s in enumerate(at_s):
        newest = int(np.searchsorted(times_s, now_s, side="right")) - 1
        if newest >= 0 and features[newest].status is Status.VALID and now_s - times_s[newest] <= 3.0:
            bpm[number] = float(features[newest].value)
    return Course(at_s, bpm, np.array([given.bpm(float(now_s)) for now_s in at_s]))
