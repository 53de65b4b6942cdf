import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from handover.control.speed_limits import (
    MAX_SOURCES,
    RAISE_PER_S,
    RefusedReport,
    SpeedLimits,
)
from handover_datamodels.streams import SpeedLimitReport

WALL_S = 1_700_000_000.0


def report(fraction: float, at_s: float, **more: Any) -> SpeedLimitReport:
    values = {"source": "heart", "stamp": WALL_S + at_s, "fraction": fraction, "reason": "heart rate", **more}
    return SpeedLimitReport.model_validate(values)


def limits_after(*reports: tuple[float, float]) -> SpeedLimits:
    """Return limits with reports of (time, fraction)."""
    limits = SpeedLimits([], 0.0)
    for at_s, fraction in reports:
        limits.receive(report(fraction, at_s), at_s, WALL_S + at_s)
    return limits


def fraction(limits: SpeedLimits, now_s: float) -> float:
    return min((each.fraction for each in limits.allowed(now_s)), default=1.0)


def test_without_a_source_nothing_is_limited() -> None:
    assert fraction(SpeedLimits([], 0.0), 1e6) == 1.0


def test_a_lower_limit_takes_effect_at_once() -> None:
    assert fraction(limits_after((0.0, 0.9), (1.0, 0.4)), 1.0) == 0.4


def test_a_higher_limit_takes_effect_by_five_percent_a_second() -> None:
    limits = limits_after((0.0, 0.4), (1.0, 1.0))
    assert fraction(limits, 1.0) == pytest.approx(0.4)
    assert fraction(limits, 3.0) == pytest.approx(0.5)


def test_a_silent_source_ramps_to_a_quarter_and_stops_within_ten_seconds() -> None:
    limits = limits_after((0.0, 0.8))
    assert fraction(limits, 3.0) == 0.8
    assert 0.25 < fraction(limits, 4.0) < 0.8
    assert fraction(limits, 6.5) == pytest.approx(0.25)
    assert fraction(limits, 9.99) == pytest.approx(0.25)
    assert fraction(limits, 10.0) == 0.0


def test_a_radar_may_be_silent_for_twenty_seconds() -> None:
    limits = SpeedLimits([], 0.0)
    limits.receive(report(0.8, 0.0, period=3.0, timeout=20.0), 0.0, WALL_S)
    assert fraction(limits, 9.0) == 0.8
    assert fraction(limits, 19.9) == pytest.approx(0.25)
    assert fraction(limits, 20.0) == 0.0


@pytest.mark.parametrize("stop", [[(0.0, 0.0)], [(0.0, 0.8), (11.0, 0.8)]])
def test_a_stop_needs_a_reset_and_then_rises_slowly(stop: list[tuple[float, float]]) -> None:
    limits = limits_after(*stop, (12.0, 0.8))
    assert fraction(limits, 12.5) == 0.0
    (allowed,) = limits.allowed(12.5)
    assert allowed.needs_reset
    assert limits.reset(12.5) == []
    assert fraction(limits, 13.5) == pytest.approx(RAISE_PER_S)


def test_a_reset_while_the_reason_lasts_changes_nothing() -> None:
    limits = limits_after((0.0, 0.0))
    assert limits.reset(1.0) == ["heart"]
    assert fraction(limits, 1.0) == 0.0
    silent = limits_after((0.0, 0.8))
    assert silent.reset(11.0) == ["heart"]
    assert fraction(silent, 11.0) == 0.0


def test_a_required_source_that_was_never_received_stops_the_robot_until_it_reports() -> None:
    limits = SpeedLimits(["heart"], 0.0)
    assert fraction(limits, 1.0) == 0.25
    assert fraction(limits, 10.0) == 0.0
    limits.receive(report(0.7, 11.0), 11.0, WALL_S + 11.0)
    assert fraction(limits, 11.0) == 0.7


def test_a_source_is_required_until_it_is_removed() -> None:
    limits = limits_after((0.0, 0.8))
    assert fraction(limits, 100.0) == 0.0
    assert limits.remove("heart")
    assert not limits.remove("heart")
    assert fraction(limits, 100.0) == 1.0


@pytest.mark.parametrize("stamp", [WALL_S + 1.0, WALL_S + 0.5, WALL_S - 100, WALL_S + 100, 0.0])
def test_reversed_and_odd_times_are_refused_and_change_nothing(stamp: float) -> None:
    limits = limits_after((1.0, 0.5))
    with pytest.raises(RefusedReport, match="stamp"):
        limits.receive(report(1.0, 0.0).model_copy(update={"stamp": stamp}), 1.5, WALL_S + 1.5)
    assert fraction(limits, 1.5) == 0.5


def test_a_source_too_many_is_refused() -> None:
    limits = SpeedLimits([f"source-{number}" for number in range(MAX_SOURCES)], 0.0)
    with pytest.raises(RefusedReport, match="remove one"):
        limits.receive(report(1.0, 0.0), 0.0, WALL_S)


@pytest.mark.parametrize(
    "fault",
    [
        {"fraction": math.nan},
        {"fraction": -0.1},
        {"fraction": 1.1},
        {"fraction": "fast"},
        {"maxSpeed": 0.0},
        {"maxSpeed": math.inf},
        {"stamp": math.nan},
        {"source": ""},
        {"source": "a b"},
        {"reason": ""},
        {"period": 5.0},
        {"timeout": 21.0},
        {"timeout": 2.0},
        {"speed": 1.0},
    ],
)
def test_a_malformed_report_is_refused(fault: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        report(0.5, 0.0, **{key: value for key, value in fault.items() if key != "fraction"}) if (
            "fraction" not in fault
        ) else report(fault["fraction"], 0.0)


def seconds(low: float, high: float) -> st.SearchStrategy[float]:
    """Times in 1/64 s, whose sums and differences are exact: a report is then exactly 10 s old."""
    return st.integers(round(low * 64), round(high * 64)).map(lambda nth: nth / 64)


@settings(deadline=None)
@given(st.lists(st.tuples(seconds(1 / 64, 15.0), st.floats(0, 1)), max_size=12), seconds(0, 20))
def test_a_limit_never_exceeds_the_last_report_and_is_never_higher_when_older(
    steps: list[tuple[float, float]], age_s: float
) -> None:
    now_s, limits = 0.0, SpeedLimits([], 0.0)
    for pause_s, value in steps:
        now_s += pause_s
        limits.receive(report(value, now_s), now_s, WALL_S + now_s)
        assert fraction(limits, now_s) <= value
    if steps:
        assert fraction(limits, now_s + age_s) <= steps[-1][1]
        assert fraction(limits, now_s + 10.0) == 0.0
        if age_s > 3.0:
            assert fraction(limits, now_s + age_s + 0.1) <= fraction(limits, now_s + age_s)
