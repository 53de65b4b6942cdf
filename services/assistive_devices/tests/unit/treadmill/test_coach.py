"""The coach decides every 30 s by the heart rate and its trend."""

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_cases.machines.treadmill.coach import (
    ZONES,
    Advice,
    Coach,
    Decision,
    Intensity,
    Reason,
    Zone,
)

LIGHT = ZONES[Intensity.LIGHT]


def coached(*course: float, is_at_limit: bool = False) -> Decision:
    """Return the first decision after one heart rate a second; the last ends at 30 s."""
    coach = Coach(LIGHT, 0.0)
    for number, bpm in enumerate(course):
        coach = coach.take(bpm, 30.0 - len(course) + number + 1)
    _, decision = coach.decide(30.0, is_at_limit=is_at_limit)
    assert decision is not None
    return decision


def line(start: float, end: float) -> list[float]:
    return [start + (end - start) * number / 20 for number in range(21)]


@pytest.mark.parametrize(
    ("course", "advice", "reason"),
    [
        (line(75, 75), Advice.FASTER, Reason.BELOW),
        (line(70, 80), Advice.KEEP, Reason.RISING),
        (line(90, 90), Advice.KEEP, Reason.INSIDE),
        (line(84, 93), Advice.SLOWER, Reason.RISING),
        (line(93, 87), Advice.FASTER, Reason.FALLING),
        (line(102, 102), Advice.SLOWER, Reason.ABOVE),
        (line(108, 100), Advice.KEEP, Reason.FALLING),
        (line(101, 100), Advice.SLOWER, Reason.ABOVE),
        ([], Advice.SLOWER, Reason.NO_SIGNAL),
    ],
)
def test_advice_follows_from_the_rate_and_its_trend(
    course: list[float], advice: Advice, reason: Reason
) -> None:
    found = coached(*course)
    assert (found.advice, found.reason) == (advice, reason)


def test_a_belt_at_its_limit_asks_nobody_to_go_faster() -> None:
    found = coached(*line(75, 75), is_at_limit=True)
    assert (found.advice, found.reason) == (Advice.KEEP, Reason.AT_LIMIT)
    assert coached(*line(105, 105), is_at_limit=True).advice is Advice.SLOWER


def test_a_heart_rate_that_is_old_or_none_counts_as_no_signal() -> None:
    coach = Coach(LIGHT, 0.0).take(90, 20.0).take(math.nan, 29.0).take(0.0, 29.5).take(300, 29.8)
    assert coach.rates == ((20.0, 90),)
    _, decision = coach.decide(30.0, is_at_limit=False)
    assert decision == Decision(Advice.SLOWER, Reason.NO_SIGNAL, 30.0)


def test_ten_minutes_have_twenty_interventions_and_a_pause_makes_up_for_none() -> None:
    coach, found = Coach(LIGHT, 0.0), []
    for number in range(6001):
        at_s = number / 10
        coach, decision = coach.take(90, at_s).decide(at_s, is_at_limit=False)
        found += [] if decision is None else [decision.at_s]
    assert found == [30.0 * number for number in range(1, 21)]
    coach, decision = coach.decide(1000.0, is_at_limit=False)
    assert decision is not None
    assert coach.decide(1001.0, is_at_limit=False)[1] is None


@given(st.lists(st.tuples(st.floats(30, 220), st.floats(0, 40)), max_size=60), st.booleans())
def test_nobody_above_the_zone_is_asked_to_go_faster(
    course: list[tuple[float, float]], is_at_limit: bool
) -> None:
    coach, at_s = Coach(LIGHT, 0.0), 0.0
    for bpm, pause_s in course:
        at_s += pause_s
        coach = coach.take(bpm, at_s)
        coach, decision = coach.decide(at_s, is_at_limit=is_at_limit)
        assert len(coach.rates) <= 64
        if decision is not None and bpm > LIGHT.high_bpm and pause_s > 0:
            assert decision.advice is not Advice.FASTER


def test_the_zones_lie_side_by_side_and_the_light_one_is_that_of_the_paper() -> None:
    assert Zone(85, 95) == LIGHT
    assert 85 in LIGHT
    assert 95.1 not in LIGHT
    for less, more in itertools.pairwise(ZONES.values()):
        assert less.high_bpm == more.low_bpm
