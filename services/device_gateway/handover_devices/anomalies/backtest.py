"""Backtest: what a rule would have found in the values of the history."""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from handover_devices.anomalies.detectors import Alarm, Baseline, Seasonal, Silence, Verdict, detector_of
from handover_devices.anomalies.rules import Rule


@dataclass(slots=True)
class Finding:
    """An Alert that would have been raised; `end` is None if it would still be active."""

    begin: float
    end: float | None
    measured: float
    limit: float


def findings(
    rule: Rule, samples: Iterable[tuple[float, float]], end: float, baseline: Baseline | None = None
) -> list[Finding]:
    """Return what `rule` finds in samples (time, value) in the order of time, until `end`."""
    detector, alarm = detector_of(rule), Alarm(rule.for_s, rule.clear_after_s)
    if isinstance(detector, Seasonal):
        detector.baseline = baseline
    results: list[Finding] = []

    def apply(t: float, verdict: Verdict) -> None:
        if alarm.update(t, verdict.judgement):
            if alarm.is_on:
                results.append(Finding(t, None, verdict.measured, verdict.limit))
            else:
                results[-1].end = t

    last = math.inf
    for t, value in samples:
        if isinstance(detector, Silence):
            _judge_gap(detector, last, t, apply)
        apply(t, detector.judge(t, value))
        last = t
    if isinstance(detector, Silence):
        _judge_gap(detector, last, end, apply)
    return results


def _judge_gap(detector: Silence, last: float, now: float, apply: Callable[[float, Verdict], None]) -> None:
    """Judge a gap when it becomes a silence, and at its end."""
    after = last + detector.check.after_s
    if now > after:
        apply(after, detector.judge_silence(math.nextafter(detector.check.after_s, math.inf)))
        apply(now, detector.judge_silence(now - last))
