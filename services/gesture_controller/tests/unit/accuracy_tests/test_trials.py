"""Trials: what counts as recognized, as a problem, as missed; whatever a hand and a clock may do."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_gloves.accuracy_tests.trials import (
    FIST,
    OPEN_HAND,
    REST_MS,
    Observation,
    Outcome,
    Phase,
    Plan,
    Progress,
    Trial,
    draw_order,
)
from handover_gloves.recognition.gestures import M2O2P_GESTURES

NAMES = {code: name for name, code in M2O2P_GESTURES.items()}
THREE = {name: M2O2P_GESTURES[name] for name in ("Thumbs up", "Horns", "Ring straight")}


@dataclass
class Participant:
    """Shows five finger states for a while, and keeps what the test made of it."""

    plan: Plan
    progress: Progress = field(default_factory=Progress)
    now_s: float = 100.0
    trials: list[Trial] = field(default_factory=list)

    def show(self, states: str, ms: float, hz: float = 50) -> None:
        for _ in range(round(ms * hz / 1000)):
            self.now_s += 1 / hz
            look = Observation(self.now_s, states, NAMES.get(states))
            self.progress, trial = self.progress.after(look, self.plan)
            if trial is not None:
                self.trials.append(trial)
                self.progress = self.progress.noted(self.plan)

    @property
    def asked(self) -> str:
        return self.plan.codes[self.plan.asked[self.progress.done]]

    def rest(self) -> None:
        self.show(OPEN_HAND, REST_MS + 100)
        assert self.progress.phase is Phase.ASKED


def plan_of(rounds: int = 1, codes: dict[str, str] = THREE, *, breaks: bool = True) -> Plan:
    return Plan(codes, draw_order(codes, rounds, 7), 7, breaks=breaks)


@pytest.fixture
def participant() -> Participant:
    return Participant(plan_of())


def test_each_round_asks_for_every_gesture_once() -> None:
    for one_round in draw_order(M2O2P_GESTURES, 10, 1):
        assert sorted(one_round) == sorted(M2O2P_GESTURES)


def test_the_same_seed_gives_the_same_order_and_another_seed_another() -> None:
    assert draw_order(M2O2P_GESTURES, 3, 5) == draw_order(M2O2P_GESTURES, 3, 5)
    assert draw_order(M2O2P_GESTURES, 3, 5) != draw_order(M2O2P_GESTURES, 3, 6)
    first, second, _ = draw_order(M2O2P_GESTURES, 3, 5)
    assert first != second


def test_nothing_is_asked_before_the_hand_has_opened(participant: Participant) -> None:
    participant.show("02222", 5000)
    assert participant.progress.phase is Phase.REST
    participant.show(OPEN_HAND, REST_MS - 100)
    assert participant.progress.phase is Phase.REST
    participant.show(OPEN_HAND, 200)
    assert participant.progress.phase is Phase.ASKED


def test_the_gesture_asked_for_is_recognized_once_it_was_kept(participant: Participant) -> None:
    participant.rest()
    asked = participant.asked
    participant.show(OPEN_HAND, 400)
    participant.show(asked, 480)
    assert participant.trials == []
    participant.show(asked, 60)
    (trial,) = participant.trials
    assert trial.outcome is Outcome.RIGHT
    assert trial.recognized_ms == pytest.approx(400 + 500 + 100, abs=45)  # 100: the hand rested on, asked


def test_another_gesture_first_is_a_problem_even_if_it_is_put_right(participant: Participant) -> None:
    participant.rest()
    asked = participant.asked
    participant.show("20022", 700)
    participant.show(asked, 700)
    (trial,) = participant.trials
    assert trial.outcome is Outcome.CORRECTED
    assert [one.gesture for one in trial.tries] == ["Index and middle straight", trial.asked]


def test_a_finger_that_needs_readjustment_is_a_problem(participant: Participant) -> None:
    participant.rest()
    asked = participant.asked
    participant.show(f"{asked[:3]}1{asked[4:]}", 700)  # the ring finger, half way
    participant.show(asked, 700)
    (trial,) = participant.trials
    assert trial.outcome is Outcome.CORRECTED
    assert trial.first is not None
    assert trial.first.gesture is None


@pytest.mark.parametrize("shape", [OPEN_HAND, FIST, "11111"])
def test_a_hand_that_rests_or_thinks_makes_no_try(participant: Participant, shape: str) -> None:
    participant.rest()
    participant.show(shape, 3000)
    participant.show(participant.asked, 700)
    assert participant.trials[0].outcome is Outcome.RIGHT


def test_a_shape_in_passing_is_no_try(participant: Participant) -> None:
    participant.rest()
    asked = participant.asked
    participant.show("20022", 450)
    participant.show(asked, 700)
    assert participant.trials[0].outcome is Outcome.RIGHT


def test_nothing_within_the_limit_is_missed_and_the_next_is_asked(participant: Participant) -> None:
    participant.rest()
    participant.show(OPEN_HAND, 10_500)
    (trial,) = participant.trials
    assert (trial.outcome, trial.first, trial.recognized_ms) == (Outcome.MISSED, None, None)
    assert participant.progress.done == 1


def test_a_trial_in_which_the_glove_fell_silent_begins_again(participant: Participant) -> None:
    participant.rest()
    asked = participant.asked
    participant.show("20022", 700)
    participant.now_s += 3
    participant.rest()
    assert participant.asked == asked
    participant.show(asked, 700)
    (trial,) = participant.trials
    assert trial.outcome is Outcome.RIGHT
    assert trial.repeats == 1


def test_the_glove_is_taken_off_between_rounds_and_the_next_waits_for_word() -> None:
    participant = Participant(plan_of(rounds=2))
    for _ in THREE:
        participant.rest()
        participant.show(participant.asked, 700)
    assert participant.progress.phase is Phase.BREAK
    participant.show(OPEN_HAND, 2000)
    assert participant.progress.phase is Phase.BREAK
    participant.progress = participant.progress.resumed()
    for _ in THREE:
        participant.rest()
        participant.show(participant.asked, 700)
    assert participant.progress.phase is Phase.FINISHED
    assert [trial.round for trial in participant.trials] == [0, 0, 0, 1, 1, 1]


def test_without_breaks_the_rounds_follow_each_other() -> None:
    participant = Participant(plan_of(rounds=2, breaks=False))
    for _ in range(6):
        participant.rest()
        participant.show(participant.asked, 700)
    assert participant.progress.phase is Phase.FINISHED


def test_an_interrupted_test_takes_nothing_until_it_goes_on(participant: Participant) -> None:
    participant.rest()
    participant.progress = participant.progress.interrupted("lunch")
    participant.show("20022", 2000)
    assert (participant.progress.phase, participant.progress.reason) == (Phase.INTERRUPTED, "lunch")
    participant.progress = participant.progress.resumed()
    participant.rest()
    participant.show(participant.asked, 700)
    assert participant.trials[0].outcome is Outcome.RIGHT


def test_what_is_over_stays_over(participant: Participant) -> None:
    stopped = participant.progress.stopped()
    assert stopped.phase is Phase.STOPPED
    assert stopped.resumed() == stopped
    assert stopped.interrupted("too late") == stopped


@st.composite
def hands(draw: st.DrawFn) -> list[tuple[str, float, float]]:
    """Shapes, each for some ms, with the clock leaping (even backwards) in between."""
    shape = st.sampled_from([OPEN_HAND, FIST, *THREE.values(), "20022", "11111", "02212"])
    leap_s = st.sampled_from([0.0, 0.0, 0.0, 0.1, 1.0, -0.5])
    return draw(st.lists(st.tuples(shape, st.floats(20, 2500), leap_s), max_size=40))


@given(hands(), st.sampled_from([20.0, 50.0, 200.0]))
def test_whatever_a_hand_does_the_trials_keep_the_plan(
    shown: list[tuple[str, float, float]], hz: float
) -> None:
    participant = Participant(Plan(THREE, draw_order(THREE, 3, 1), 1, limit_ms=3000, breaks=False))
    for states, ms, leap_s in shown:
        participant.now_s += leap_s
        participant.show(states, ms, hz)
    trials = participant.trials
    assert [trial.asked for trial in trials] == list(participant.plan.asked[: len(trials)])
    assert participant.progress.done == len(trials)
    for trial in trials:
        assert (trial.outcome is Outcome.MISSED) == (trial.recognized_ms is None)
        ends_right = bool(trial.tries) and trial.tries[-1].gesture == trial.asked
        assert ends_right == (trial.outcome is not Outcome.MISSED)
        assert not any(one.gesture == trial.asked for one in trial.tries[:-1])
        assert all(0 <= one.at_ms <= 3000 + 1000 / hz for one in trial.tries)
        assert list(times_of(trial)) == sorted(times_of(trial))
        if trial.recognized_ms is not None:
            assert trial.recognized_ms >= 500


def times_of(trial: Trial) -> Iterator[float]:
    return (one.at_ms for one in trial.tries)
