"""A training as a whole: the walker is coached into the zone; what is wrong slows or stops the belt."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover.errors import UsageError
from handover_cases.machines.treadmill.belt import BeltState, StopReason
from handover_cases.machines.treadmill.coach import Advice, Intensity, Reason
from handover_cases.machines.treadmill.figures import figures_of
from handover_cases.machines.treadmill.report import compare
from handover_cases.machines.treadmill.simulation import Habits, SimulatedWalker
from handover_cases.machines.treadmill.training import Plan, Training
from handover_cases.trial import Trial
from handover_cell.cases.case import print_study

STEP_S = 0.05
FREE = 1.3


def trained(
    training: Training, seconds: float, bpm: float | None = 80.0, allowed_mps: float = FREE
) -> Training:
    """Let a training run with a heart rate; the walker follows the advice."""
    now_s = training.belt.at_s
    for number in range(1, round(seconds / STEP_S) + 1):
        at_s = now_s + number * STEP_S
        heart = None if bpm is None else (bpm, at_s)
        decision = training.step(at_s, STEP_S, heart, allowed_mps)
        if decision is not None:
            training.follow(decision.advice)
    return training


def begun(plan: Plan | None = None, *, seed: int = 1, pace_mps: float = 0.8) -> Training:
    training = Training(SimulatedWalker(seed, Habits(pace_mps, compliance=1.0)))
    assert training.start(plan or Plan(), 0.0)
    return training


def test_who_is_asked_to_go_faster_does_and_the_belt_follows() -> None:
    training = begun()
    slow = trained(training, 29).belt.speed_mps
    fast = trained(training, 100, bpm=80.0).belt.speed_mps
    assert [one.advice for one in training.decisions] == [Advice.FASTER] * 4
    assert fast > slow + 0.25
    eased = trained(training, 100, bpm=120.0)
    assert training.decisions[-1].advice is Advice.SLOWER
    assert eased.belt.speed_mps < fast - 0.15
    assert eased.belt.state is BeltState.FOLLOWING


def test_the_training_ends_at_its_time_and_can_be_repeated() -> None:
    training = trained(begun(Plan(60.0, Intensity.GENTLE)), 65)
    assert (training.belt.state, training.belt.reason) == (BeltState.STOPPED, StopReason.TIME)
    assert training.time_left_s(training.belt.at_s) == 0
    assert len(training.decisions) == 1
    assert training.start(Plan(), training.belt.at_s)
    assert training.decisions == []
    assert training.time_left_s(training.belt.at_s) == 600
    assert not training.start(Plan(), training.belt.at_s), "it runs already"


def test_without_a_heart_rate_the_advice_is_slower_and_the_aged_limit_stops_the_belt() -> None:
    training = trained(begun(), 20)
    trained(training, 12, bpm=None)
    assert (training.decisions[-1].advice, training.decisions[-1].reason) == (Advice.SLOWER, Reason.NO_SIGNAL)
    slow = trained(training, 5, bpm=None, allowed_mps=0.25 * FREE)
    assert slow.belt.speed_mps == pytest.approx(0.25 * FREE, abs=0.01)
    assert slow.belt.state is BeltState.FOLLOWING, "the walker adapts to a belt that is slow"
    stopped = trained(training, 3, bpm=None, allowed_mps=0.0)
    assert (stopped.belt.state, stopped.belt.reason) == (BeltState.STOPPED, StopReason.LIMIT)


def test_a_person_stops_it_at_any_time_and_stays_on_the_belt() -> None:
    training = trained(begun(pace_mps=1.2), 30)
    training.stop(StopReason.PERSON)
    trained(training, 4)
    assert (training.belt.state, training.belt.reason) == (BeltState.STOPPED, StopReason.PERSON)
    assert abs(training.walker.place_m) < 0.5


@settings(max_examples=15)
@given(
    st.integers(0, 1000),
    st.lists(st.tuples(st.floats(0, 1.3), st.one_of(st.none(), st.floats(40, 180))), min_size=1, max_size=6),
)
def test_the_belt_never_exceeds_what_is_allowed_by_more_than_its_ramp(
    seed: int, course: list[tuple[float, float | None]]
) -> None:
    training = begun(seed=seed)
    trained(training, 10)
    for allowed_mps, bpm in course:
        before_mps = training.belt.speed_mps
        trained(training, 3.0, bpm, allowed_mps)
        assert training.belt.speed_mps <= max(allowed_mps, before_mps - 0.5 * 3.0) + 1e-9


def test_the_figures_are_those_of_the_record() -> None:
    training = trained(begun(Plan(120.0)), 125, bpm=90.0)
    found = training.figures()
    assert found.duration_s == pytest.approx(120, abs=0.5)
    assert (found.in_zone, found.first_in_zone_s, found.valid) == pytest.approx((1.0, 0.25, 1.0))
    assert found.interventions == 3
    assert found.advice == (0, 3, 0)
    assert len(found.profile_mps) == 2
    assert found.distance_m == pytest.approx(sum(60 * speed for speed in found.profile_mps), rel=0.02)
    assert found.highest_mps == max(one.belt_mps for one in training.record)
    other = figures_of(list(training.record), training.decisions, Plan(intensity=Intensity.BRISK).zone)
    assert (other.in_zone, other.first_in_zone_s) == (0.0, None)
    with pytest.raises(ValueError, match="less than two lines"):
        figures_of([], [], Plan().zone)


def test_a_session_that_missed_the_zone_or_an_intervention_is_no_success() -> None:
    training = trained(begun(Plan(300.0), pace_mps=0.5), 305, bpm=120.0)
    trial = Trial(300.0)
    compare(trial, training.figures(), training.plan, training.belt.reason)
    assert [one.name for one in trial.figures if one.passed is False] == ["time within 85 to 95 bpm"]
    training.decisions.pop()
    other = Trial(300.0)
    compare(other, training.figures(), training.plan, StopReason.LOST, "a name")
    assert [one.name for one in other.figures if one.passed is False][:2] == [
        "a name: session",
        "a name: interventions",
    ]


@pytest.mark.parametrize(
    ("pace_mps", "why"), [(1.4, "the belt was at its limit"), (0.5, "0 % once reached (never)")]
)
def test_a_person_who_was_never_in_the_zone_is_no_success_whatever_the_reason(
    pace_mps: float, why: str
) -> None:
    training = trained(begun(Plan(300.0), pace_mps=pace_mps), 305, bpm=80.0)
    trial = Trial(300.0)
    compare(trial, training.figures(), training.plan, training.belt.reason)
    trial.is_running = False
    zone = next(one for one in trial.figures if one.name.startswith("time within"))
    assert zone.passed is False
    assert zone.ours.startswith("0 %")
    assert why in zone.ours
    assert not trial.passed
    with pytest.raises(UsageError, match="time within 85 to 95 bpm"):
        print_study("treadmill", trial, lambda _: None)


def test_a_short_session_says_that_its_share_decides_nothing() -> None:
    training = trained(begun(Plan(60.0), pace_mps=0.5), 65, bpm=80.0)
    trial = Trial(60.0)
    compare(trial, training.figures(), training.plan, training.belt.reason)
    zone = next(one for one in trial.figures if one.name.startswith("time within"))
    assert zone.passed is None
    assert "not judged below 5 min" in zone.ours


@pytest.mark.parametrize(
    ("changes", "problem"),
    [({"duration_s": 5.0}, "must be 30 to 3600"), ({"language": "xx"}, "there are en, de, fi")],
)
def test_a_plan_that_cannot_be_is_refused(changes: dict[str, object], problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        Plan(**changes)  # type: ignore[arg-type]
