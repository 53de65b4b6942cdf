"""Exercises with a humanoid: catches, difficulty, pauses, reports."""

from datetime import UTC, datetime
from typing import Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_humanoid.model.kinematics import Array
from handover_humanoid.patterns.ballistics import position_after, release_velocity
from handover_humanoid.patterns.regions import Side
from handover_humanoid.sessions.catching import CatchDetector, CatchRules, HandSample, Outcome
from handover_humanoid.sessions.difficulty import CatchingSpace, Difficulty, DifficultyRules
from handover_humanoid.sessions.exercise import (
    EndReason,
    Exercise,
    Goal,
    PauseReason,
    SessionError,
    State,
)
from handover_humanoid.sessions.report import SessionFigures, juggling_report, progress
from handover_humanoid.sessions.walking import WalkFigures

START, FLIGHT_S = np.array([0.1, 0.0, 0.7]), 0.5
CAUGHT = Outcome("caught", 0.5, "left", 0.02, 0.2)
MISSED = Outcome("missed", 0.7, "right", 0.3, np.nan)


def watched(
    landing: Array, hand: Array, rate_hz: float, rules: CatchRules | None = None, grip: float = 0.0
) -> Outcome:
    """Return the outcome of a throw past a hand that is held still."""
    velocity = release_velocity(START, landing, FLIGHT_S)
    detector = CatchDetector(0.0, rules)
    for step in range(1, 1000):
        time_s = step / rate_hz
        ball = position_after(START, velocity, time_s)
        outcome = detector.update(time_s, ball, {"left": HandSample(hand, grip)})
        if outcome is not None:
            return outcome
    raise AssertionError("the throw has no end")


@given(
    st.floats(0.6, 1.0), st.floats(-0.3, 0.3), st.floats(0.3, 0.9), st.floats(0.0, 0.3), st.floats(20, 120)
)
def test_a_ball_is_caught_exactly_if_it_comes_near_enough_at_any_rate(
    x: float, y: float, z: float, offset: float, rate_hz: float
) -> None:
    landing = np.array([x, y, z])
    hand = landing + np.array([0.0, offset, 0.0])
    velocity = release_velocity(START, landing, FLIGHT_S)
    way = [position_after(START, velocity, t) for t in np.linspace(0, 0.9, 4000)]
    nearest = min(float(np.linalg.norm(ball - hand)) for ball in way if ball[2] > 0.05)
    outcome = watched(landing, hand, rate_hz)
    if abs(nearest - 0.12) > 0.02:  # a straight line between two samples is off by g dt² / 8
        assert (outcome.result == "caught") == (nearest < 0.12)


def test_a_hand_that_must_close_does_so_near_the_contact() -> None:
    landing, rules = np.array([0.8, 0.1, 0.6]), CatchRules(needs_grip=True)
    assert watched(landing, landing, 60, rules, grip=1.0).result == "caught"
    assert watched(landing, landing, 60, rules, grip=0.2).result == "missed"


def test_a_gap_in_the_tracking_is_not_bridged() -> None:
    detector = CatchDetector(0.0)
    above, below = np.array([0.8, 0.0, 1.2]), np.array([0.8, 0.0, 0.2])
    hand = HandSample(np.array([0.8, 0.0, 0.7]))
    assert detector.update(0.1, above, {"left": hand}) is None
    assert detector.update(0.2, above, {}) is None
    assert detector.update(0.3, below, {"left": hand}) is None
    whole = CatchDetector(0.0)
    assert whole.update(0.1, above, {"left": hand}) is None
    caught = whole.update(0.2, below, {"left": hand})
    assert caught is not None
    assert caught.result == "caught"
    assert caught.after_s == pytest.approx(0.15)


@pytest.mark.parametrize("position", [[np.nan, 0, 0], [np.inf, 0, 0]])
def test_values_that_are_not_finite_neither_catch_nor_end(position: list[float]) -> None:
    detector = CatchDetector(0.0)
    bad = np.array(position, dtype=np.float64)
    good = np.array([0.8, 0.0, 0.7])
    assert detector.update(0.1, bad, {"left": HandSample(good)}) is None
    assert detector.update(0.2, good, {"left": HandSample(bad)}) is None
    assert detector.update(0.3, good, {"left": HandSample(good, np.nan)}) is None


def test_a_ball_that_leaves_the_room_is_lost() -> None:
    outcome = CatchDetector(0.0).update(0.1, np.array([9.0, 0.0, 1.0]), {})
    assert outcome is not None
    assert (outcome.result, outcome.side) == ("lost", None)


@given(st.lists(st.booleans(), max_size=200), st.integers(0, 1000), st.sampled_from(["left", "right", None]))
def test_every_throw_is_within_the_space_of_the_patient(
    outcomes: list[bool], seed: int, weak: Side | None
) -> None:
    space = CatchingSpace()
    difficulty = Difficulty(space, DifficultyRules(weak_side=weak), seed)
    for outcome in outcomes:
        throw = difficulty.next_throw()
        away = np.abs(throw.target - np.array(space.centre))
        assert away[0] == 0
        assert away[1] <= space.side_m
        assert away[2] <= space.height_m
        assert space.shortest_s <= throw.flight_s <= space.longest_s
        before = difficulty.level
        difficulty.learn(outcome)
        assert 0 <= difficulty.level <= 1
        assert difficulty.level >= before if outcome else difficulty.level <= before


def test_the_staircase_settles_where_the_wanted_share_is_caught() -> None:
    random = np.random.default_rng(1)
    difficulty = Difficulty(rules=DifficultyRules(start=0.0, wanted_share=0.7))
    caught = []
    for _ in range(4000):
        is_caught = bool(random.random() < 1.1 - difficulty.level)  # a patient for whom 0.4 makes 70 %
        difficulty.learn(is_caught)
        caught.append(is_caught)
    assert np.mean(caught[500:]) == pytest.approx(0.7, abs=0.03)


def test_the_weak_side_of_the_patient_gets_more_throws() -> None:
    difficulty = Difficulty(rules=DifficultyRules(start=1.0, is_adaptive=False, weak_side="left"))
    aside = [difficulty.next_throw().target[1] for _ in range(400)]
    assert sum(y < 0 for y in aside) > 220  # the patient's left is at the robot's right


def test_a_session_ends_with_its_goal_and_counts_points_by_difficulty() -> None:
    session = Exercise("juggling", Goal(throws=3), 100.0)
    assert session.add(CAUGHT, 0.0, 101.0) == 10
    assert session.add(MISSED, 0.5, 102.0) == 0
    assert session.state is State.RUNNING
    assert session.add(CAUGHT, 1.0, 103.0) == 20
    assert (session.state, session.ended_by) == (State.ENDED, EndReason.GOAL)
    report = juggling_report(session, 200.0)
    assert (report.throws, report.caught, report.score, report.longest_run) == (3, 2, 30, 1)
    assert report.exercised_s == pytest.approx(3.0)
    assert report.share_caught == pytest.approx(2 / 3)
    assert (report.left.caught, report.right.throws) == (2, 1)
    assert report.median_reaction_s == pytest.approx(0.2)


def test_a_session_goes_on_only_by_a_person_and_without_a_cause_of_the_pause() -> None:
    session = Exercise("juggling", Goal(seconds=60), 0.0)
    session.pause(PauseReason.TRACKING_LOST, 10.0)
    with pytest.raises(SessionError, match="not tracked"):
        session.resume(11.0)
    session.clear(PauseReason.TRACKING_LOST)
    assert session.state is State.PAUSED
    session.resume(20.0)
    assert session.exercised_s(25.0) == pytest.approx(15.0)
    session.check(70.0)
    assert session.ended_by is EndReason.GOAL
    with pytest.raises(SessionError, match="ended"):
        session.resume(71.0)


Act = Literal["pause", "clear", "resume", "end", "throw", "check"]


@given(st.lists(st.tuples(st.sampled_from(Act.__args__), st.sampled_from(PauseReason), st.floats(0, 10))))  # type: ignore[attr-defined]
def test_a_session_never_runs_with_a_cause_of_a_pause_nor_after_its_end(
    acts: list[tuple[Act, PauseReason, float]],
) -> None:
    session, now_s, exercised_s = Exercise("juggling", Goal(throws=10, seconds=40), 0.0), 0.0, 0.0
    for act, reason, later_s in acts:
        was_running, has_ended = session.state is State.RUNNING, session.state is State.ENDED
        now_s += later_s
        exercised_s += later_s if was_running else 0.0
        if act == "pause":
            session.pause(reason, now_s)
        elif act == "clear":
            session.clear(reason)
        elif act == "resume":
            try:
                session.resume(now_s)
            except SessionError:
                assert session.state is not State.RUNNING
        elif act == "end":
            session.end(EndReason.PERSON, now_s)
        elif act == "throw":
            session.add(CAUGHT, 0.5, now_s)
        else:
            session.check(now_s)
        assert not has_ended or session.state is State.ENDED
        assert session.state is not State.RUNNING or not session.reasons
        assert session.exercised_s(now_s) == pytest.approx(exercised_s)


@pytest.mark.parametrize("goal", [{}, {"throws": 0}, {"seconds": float("inf")}, {"catches": -1}])
def test_a_goal_that_cannot_be_reached_is_refused(goal: dict[str, int]) -> None:
    with pytest.raises(ValueError, match="above 0 and finite"):
        Goal(**goal)


def test_progress_is_by_the_weeks_of_iso_8601() -> None:
    days = [
        datetime(2026, 12, 31, tzinfo=UTC),
        datetime(2027, 1, 3, tzinfo=UTC),
        datetime(2027, 1, 4, tzinfo=UTC),
    ]
    figures = [SessionFigures(day, 10, index, index * 10, 60.0, index / 10) for index, day in enumerate(days)]
    weeks = progress(reversed(figures))
    assert [(week.week, week.sessions, week.caught) for week in weeks] == [
        ("2026-W53", 2, 1),
        ("2027-W01", 1, 2),
    ]
    assert weeks[0].best_level == pytest.approx(0.1)


def test_the_figures_of_a_walk_leave_gaps_and_nan_out() -> None:
    figures = WalkFigures()
    ahead, aside = np.array([0.1, 0.0]), np.array([0.0, 0.1])
    for step in range(11):
        figures.update(step * 0.1, ahead * step * 0.1, ahead, ahead, 5.0)
    figures.update(1.05, np.array([np.nan, 0.0]), ahead, ahead, 500.0)
    figures.update(100.0, np.array([9.0, 0.0]), ahead, ahead, 7.0)
    figures.update(101.0, np.array([9.0, 0.0]), aside, ahead, 7.0)
    assert figures.distance_m == pytest.approx(0.1)
    assert figures.walked_s == pytest.approx(1.0)
    assert figures.mean_direction_error_rad == pytest.approx(0.0)
    assert figures.highest_force_n == 7.0
    figures.update(101.2, np.array([9.0, 0.02]), aside, ahead, 7.0)
    assert figures.mean_direction_error_rad == pytest.approx(0.2 / 1.2 * np.pi / 2)
    walked_m = figures.distance_m
    for step in range(20):  # it stands, and its estimate is noisy
        place = np.array([9.0 + 0.002 * (-1) ** step, 0.02])
        figures.update(101.21 + 0.01 * step, place, 0 * ahead, ahead, 7.0)
    assert figures.distance_m == walked_m
