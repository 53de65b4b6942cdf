"""The heart of simulated people follows effort as measured on treadmills, and stays within its bounds."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_body.model.cardiovascular import (
    RECOVERY_S,
    RISE_S,
    Heart,
    Physiology,
    cadence_hz,
    maximum_of_age,
)

efforts = st.floats(0, 1)


def after(heart: Heart, effort: float, seconds: float, body: Physiology, step_s: float = 0.5) -> Heart:
    for _ in range(round(seconds / step_s)):
        heart = heart.step(effort, step_s, body)
    return heart


def mean_lag_s(start: Heart, effort: float, body: Physiology) -> float:
    """Return the area between a step and its answer, divided by its size: the sum of the time constants."""
    area, heart = 0.0, start
    size = abs(effort - start.second)
    for _ in range(1200):
        area += abs(effort - heart.second) * 0.5
        heart = heart.step(effort, 0.5, body)
    return area / size


def test_the_lag_is_that_of_published_treadmill_experiments() -> None:
    body = Physiology()
    assert mean_lag_s(Heart(), 0.4, body) == pytest.approx(RISE_S, rel=0.02)
    assert mean_lag_s(Heart.steady(0.4), 0.0, body) == pytest.approx(RECOVERY_S, rel=0.02)


def test_the_gain_of_a_walk_lies_in_the_published_range() -> None:
    """24.2 bpm for each m/s, standard deviation 8.3."""
    body = Physiology.of_age(55)
    rate = after(Heart(), body.walking_effort(1.0), 400, body).rate_bpm(body)
    assert 24.2 - 8.3 < rate - body.rest_bpm < 24.2 + 8.3
    assert body.speed_at(body.rest_bpm + 10) == pytest.approx(0.4, abs=0.1)


def test_long_work_lets_the_rate_drift_upwards() -> None:
    body = Physiology()
    early = after(Heart(), 0.5, 360, body).rate_bpm(body)
    late = after(Heart(), 0.5, 3600, body).rate_bpm(body)
    assert 125 < early < 130
    assert late - early == pytest.approx(0.10 * 60 * 0.7, abs=1.5)


@given(
    st.lists(st.tuples(st.floats(-1, 2), st.floats(0, 600)), max_size=12), st.integers(14, 90), st.booleans()
)
def test_no_effort_takes_the_rate_out_of_its_range(
    work: list[tuple[float, float]], age: int, is_active: bool
) -> None:
    body, heart = Physiology.of_age(age, is_active=is_active), Heart()
    for effort, seconds in work:
        heart = heart.step(effort, seconds, body)
        assert body.rest_bpm <= heart.rate_bpm(body) <= body.max_bpm
        assert 0 <= heart.first <= 1
        assert 0 <= heart.second <= 1


@given(efforts, efforts, st.floats(1, 300))
def test_more_effort_never_beats_slower(less: float, more: float, seconds: float) -> None:
    body = Physiology()
    less, more = min(less, more), max(less, more)
    slow, fast = (after(Heart.steady(0.3), effort, seconds, body, 1.0) for effort in (less, more))
    assert slow.rate_bpm(body) <= fast.rate_bpm(body) + 1e-9


@given(efforts, efforts, st.floats(0.2, 5))
def test_the_length_of_the_steps_matters_little(start: float, effort: float, step_s: float) -> None:
    body = Physiology()
    coarse = after(Heart.steady(start), effort, 60, body, 60 / round(60 / step_s))
    fine = after(Heart.steady(start), effort, 60, body, 0.05)
    assert coarse.rate_bpm(body) == pytest.approx(fine.rate_bpm(body), abs=4.0)


def test_the_cadence_of_a_usual_walk_is_usual() -> None:
    assert cadence_hz(1.3) == pytest.approx(1.83, abs=0.05)
    assert cadence_hz(-1.0) == 0.0


def test_a_grade_costs_as_the_equation_says() -> None:
    body = Physiology(vo2_max=38.5)
    assert body.walking_effort(1.0, 0.0) == pytest.approx(6.0 / 35.0)
    assert body.walking_effort(1.0, 0.05) == pytest.approx(11.4 / 35.0)
    assert body.walking_effort(20.0) == 1.0


def test_a_person_who_cannot_be_is_refused() -> None:
    assert maximum_of_age(40) == 180
    with pytest.raises(ValueError, match="14 to 90 years"):
        Physiology.of_age(7)
    with pytest.raises(ValueError, match="vo2_max is 3"):
        Physiology(vo2_max=3)
    with pytest.raises(ValueError, match="rest below maximum"):
        Physiology(rest_bpm=200)
    with pytest.raises(ValueError, match="1 to 600 s"):
        Physiology(rise_s=0)
