"""Which values each detector finds abnormal, and when an alarm begins and ends."""

import math
import random
import tracemalloc
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from handover_devices.anomalies.backtest import findings
from handover_devices.anomalies.detectors import (
    MAX_SAMPLES,
    Alarm,
    Baseline,
    Judgement,
    Rate,
    detector_of,
)
from handover_devices.anomalies.rules import Rule

NORMAL, BETWEEN, ABNORMAL = Judgement.NORMAL, Judgement.BETWEEN, Judgement.ABNORMAL


def rule(kind: str, for_s: float = 0, clear_after_s: float = 0, **check: Any) -> Rule:
    return Rule.model_validate(
        {"check": {"type": kind, **check}, "forS": for_s, "clearAfterS": clear_after_s}
    )


def found(one: Rule, values: list[float], end: float | None = None) -> list[tuple[float, float | None]]:
    """Return begin and end of what a rule finds in values of one a second."""
    samples = [(float(t), value) for t, value in enumerate(values)]
    return [(one.begin, one.end) for one in findings(one, samples, len(values) if end is None else end)]


def test_limits_have_a_hysteresis() -> None:
    one = rule("limits", minimum=0, maximum=10, hysteresis=2)
    assert found(one, [5, 11, 9, 10.5, 9, 8, 9, 11]) == [(1, 5), (7, None)]
    assert found(one, [5, -1, 1, 2, 1]) == [(1, 3)]


def test_an_alarm_goes_on_and_off_after_the_times_of_its_rule() -> None:
    alarm = Alarm(for_s=10, clear_after_s=5)
    steps = [(0, ABNORMAL), (4, ABNORMAL), (10, ABNORMAL), (12, NORMAL), (14, BETWEEN), (17, NORMAL)]
    assert [alarm.update(t, judgement) for t, judgement in steps] == [False, False, True, False, False, True]
    steps = [(20, ABNORMAL), (25, BETWEEN), (30, ABNORMAL), (39, ABNORMAL), (40, ABNORMAL), (41, NORMAL)]
    assert [alarm.update(t, judgement) for t, judgement in steps] == [False] * 4 + [True, False]
    assert not alarm.update(44, ABNORMAL)
    assert not alarm.update(50, NORMAL)  # the time began again
    assert alarm.is_on


def test_the_rate_of_change_ignores_noise_within_a_short_time() -> None:
    one = rule("rateOfChange", maxPerS=1, overS=10)
    assert found(one, [0, 3, 0, 3, 0, 3, 0, 3, 0, 3, 0, 3]) == []
    steep = found(one, [0.0] * 20 + [3.0 * n for n in range(20)] + [57.0] * 20)
    assert len(steep) == 1
    begin, end = steep[0]
    assert 20 < begin < 30
    assert end is not None
    assert 40 < end < 55


def test_silence_is_judged_without_values_and_ends_with_one() -> None:
    one = rule("silence", afterS=30)
    samples = [(0.0, 1.0), (20.0, 1.0), (100.0, 1.0), (110.0, 1.0)]
    assert [(f.begin, f.end) for f in findings(one, samples, 200.0)] == [(50.0, 100.0), (140.0, None)]


def test_a_z_score_finds_outliers_and_learns_a_new_level() -> None:
    numbers = random.Random(1)
    one = rule("zScore", threshold=6, window=100, minimumValues=50)
    usual = [numbers.gauss(20, 1) for _ in range(300)]
    assert found(one, usual) == []
    assert found(one, [*usual, 40, *usual[:50]]) == [(300, 301)]
    higher = found(one, [*usual, *(value + 20 for value in usual * 3)])
    assert higher[0][0] == 300
    assert higher[-1][1] is not None  # the level is usual in the end
    constant = found(one, [5.0] * 200 + [5.1] + [5.0] * 10)
    assert constant == [(200, 201)]
    assert found(rule("zScore", minimumDeviation=0.1), [5.0] * 200 + [5.1] + [5.0] * 10) == []


def test_what_a_detector_has_learned_is_stored_and_loaded() -> None:
    one = rule("zScore")
    first = detector_of(one)
    for n in range(200):
        first.judge(n, n % 7)
    again = detector_of(one, first.state())
    assert again.judge(200, 50) == first.judge(200, 50)
    assert again.state() == first.state()


def test_a_seasonal_baseline_knows_the_time_of_the_day() -> None:
    one = rule("seasonal", threshold=4, minimumPeriods=3)
    baseline = Baseline(86_400, 1800, {0: (10.0, 1.0, 5), 1: (30.0, 1.0, 5), 2: (30.0, 1.0, 2)})
    at = [(86_400.0 * 7 + 10, 30.0), (86_400.0 * 7 + 1810, 30.0), (86_400.0 * 7 + 3700, 99.0)]
    (only,) = findings(one, at, 86_400.0 * 8, baseline)
    assert (only.begin, only.end, only.measured) == (at[0][0], at[1][0], 20.0)
    assert findings(one, at, 86_400.0 * 8) == []  # without a baseline nothing is judged


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False, width=32), max_size=300))
def test_no_finite_value_breaks_a_detector(values: list[float]) -> None:
    for one in (
        rule("limits", maximum=1),
        rule("rateOfChange", maxPerS=1),
        rule("zScore", minimumValues=10),
        rule("silence", afterS=5),
    ):
        detector, alarm = detector_of(one), Alarm(0, 0)
        for t, value in enumerate(values):
            verdict = detector.judge(t, value)
            alarm.update(t, verdict.judgement)
            assert not math.isinf(verdict.measured)


def test_the_memory_of_a_detector_does_not_depend_on_the_rate() -> None:
    detector = detector_of(rule("rateOfChange", maxPerS=1, overS=60))
    assert isinstance(detector, Rate)
    tracemalloc.start()
    try:
        for n in range(100_000):
            detector.judge(n / 1000, n % 13)
        assert tracemalloc.get_traced_memory()[0] < 50_000
    finally:
        tracemalloc.stop()
    assert len(detector.samples) <= MAX_SAMPLES


@pytest.mark.parametrize(
    "check",
    [
        {"type": "limits"},
        {"type": "limits", "minimum": 1, "maximum": 2, "hysteresis": 1},
        {"type": "limits", "maximum": float("nan")},
        {"type": "rateOfChange", "maxPerS": 0},
        {"type": "guess"},
    ],
)
def test_a_rule_that_makes_no_sense_is_refused(check: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        Rule.model_validate({"check": check})
