"""The simulated operator does what Tasks ask for, as people do: not at once, not always right at first."""

from dataclasses import dataclass, field
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from glove_sdk_bridge.simulation.glove_operator import (
    MAX_REACTION_S,
    MIN_REACTION_S,
    Attempt,
    Movement,
    SimulatedOperator,
    Stage,
    View,
)
from glove_sdk_bridge.simulation.hand import AT_REST, FIST, OPEN_HAND, SENSORS, SimulatedHand, level
from handover_gloves.recognition.frames import Frame
from handover_gloves.recognition.gestures import M2O2P_GESTURES, Gestures
from handover_gloves.recognition.hold import HoldEvent
from handover_gloves.recognition.levels import calibrate
from handover_gloves.recognition.pipeline import PipelineState, RecognitionConfig, process_frame
from handover_gloves.recognition.thresholds import Threshold, Thresholds

CONFIG = RecognitionConfig(
    Thresholds(tuple(Threshold(upper=level(sensor, 0.6), lower=level(sensor, 0.45)) for sensor in SENSORS)),
    Gestures(M2O2P_GESTURES),
)
LOOKS_EVERY = 10
"""Readings of the glove from one look at the screen to the next: 0.2 s at 50 Hz."""


@dataclass
class Bench:
    """An operator, a hand and the controller's pipeline, on a clock that runs as fast as it can."""

    operator: SimulatedOperator
    hand: SimulatedHand
    now_s: float = 0.0
    state: PipelineState = field(default_factory=PipelineState)
    view: View = field(default_factory=View)
    confirmed: list[str] = field(default_factory=list)
    attempts: list[Attempt] = field(default_factory=list)
    longest_wrong_ms: float = 0.0
    readings: int = 0
    task: str | None = None
    task_since_s: float = 0.0
    config: RecognitionConfig = CONFIG

    def step(self, task: str | None, code: str = "") -> None:
        """One reading of the glove while the screen asks for `task`."""
        if self.readings % LOOKS_EVERY == 0:
            self.view = View(task, code, self.state.states)
        self.readings += 1
        self.now_s += 1 / self.hand.rate_hz
        stage = self.operator.stage
        movement = self.operator.look(self.view, self.now_s)
        if movement is not None:
            self.hand.move(movement.to, movement.duration_s)
        if stage is not Stage.SHOWING and self.operator.stage is Stage.SHOWING:
            self.attempts.append(self.operator.attempt)
        self.state = process_frame(self.state, Frame(self.now_s, list(self.hand.read())), self.config)
        hold = self.state.hold
        begun_meanwhile = task == self.task and hold.since_s >= self.task_since_s
        if task != self.task:
            self.task, self.task_since_s = task, self.now_s
        if hold.gesture is not None and M2O2P_GESTURES[hold.gesture] != code and begun_meanwhile:
            self.longest_wrong_ms = max(self.longest_wrong_ms, hold.held_ms)
        if hold.last is HoldEvent.CONFIRMED and hold.gesture is not None:
            self.confirmed.append(hold.gesture)

    def do(self, task: str, gesture: str, within_s: float = 60.0) -> float:
        """Ask for a gesture until it is confirmed; return how long that took, in seconds."""
        began_s, before = self.now_s, len(self.confirmed)
        while len(self.confirmed) == before:
            self.step(task, M2O2P_GESTURES[gesture])
            assert self.now_s - began_s < within_s, f"{gesture} was never confirmed"
        return self.now_s - began_s


def bench(seed: int, mistakes: float = 0.0, speed: float = 1.0) -> Bench:
    return Bench(SimulatedOperator(seed, mistakes, speed), SimulatedHand(seed))


@pytest.mark.parametrize("gesture", M2O2P_GESTURES)
def test_every_gesture_is_confirmed_and_no_other(gesture: str) -> None:
    for seed in range(3):
        tried = bench(seed)
        took_s = tried.do("task-1", gesture)
        assert tried.confirmed == [gesture]
        assert took_s > MIN_REACTION_S + 1.5


@pytest.mark.nightly
def test_an_operator_who_has_calibrated_once_confirms_every_gesture_while_the_sensors_drift() -> None:
    for seed in range(3):
        hand = SimulatedHand(seed)
        levels = []
        for posture in (FIST, OPEN_HAND):
            hand.move(posture, 0.4)
            levels.append([list(hand.read()) for _ in range(80)][40:])
        config = RecognitionConfig(calibrate(*levels).thresholds, Gestures(M2O2P_GESTURES))
        tried = Bench(SimulatedOperator(seed, 0.15), hand, config=config)
        times_s = [
            tried.do(f"task-{number}", gesture) for number, gesture in enumerate([*M2O2P_GESTURES] * 3)
        ]
        assert tried.confirmed == [*M2O2P_GESTURES] * 3
        assert max(times_s) < 30


def test_a_careful_operator_takes_as_long_as_a_person() -> None:
    times_s = sorted(bench(seed).do("task-1", "Thumbs up") for seed in range(40))
    assert 2.3 < times_s[len(times_s) // 2] < 3.6


@pytest.mark.nightly
def test_a_careless_operator_tries_again_until_it_counts_and_no_wrong_gesture_ever_counts() -> None:
    kinds = set()
    for seed in range(4):
        tried = bench(seed, mistakes=1.0)
        for number, gesture in enumerate(M2O2P_GESTURES):
            tried.do(f"task-{number}", gesture)
        assert tried.confirmed == list(M2O2P_GESTURES)
        assert tried.longest_wrong_ms < 1500
        kinds |= set(tried.attempts)
        assert tried.attempts.count(Attempt.RIGHT) >= len(M2O2P_GESTURES)
        assert len(tried.attempts) > 2.5 * len(M2O2P_GESTURES)
    assert kinds == set(Attempt)


@pytest.mark.nightly
def test_mistakes_are_as_frequent_as_asked() -> None:
    tried = bench(3, mistakes=0.15)
    for number in range(200):
        tried.do(f"task-{number}", "Point with index")
    mistakes = sum(attempt is not Attempt.RIGHT for attempt in tried.attempts)
    assert 0.1 < mistakes / len(tried.attempts) < 0.2


def test_the_hand_relaxes_when_the_task_is_done() -> None:
    tried = bench(1)
    tried.do("task-1", "Horns")
    for _ in range(100):
        tried.step(None)
    assert tried.operator.stage is Stage.AT_REST
    assert tried.hand.posture == pytest.approx(AT_REST)


def test_the_same_gesture_twice_is_let_go_in_between() -> None:
    tried = bench(2)
    tried.do("task-1", "Thumbs up")
    gestures = set()
    before = len(tried.confirmed)
    while len(tried.confirmed) == before:
        tried.step("task-2", M2O2P_GESTURES["Thumbs up"])
        gestures.add(tried.state.gesture)
    assert None in gestures


def looked(
    operator: SimulatedOperator, view: View, from_s: float, until_s: float
) -> list[tuple[float, Movement]]:
    """When the hand moves, and how, while the screen shows `view`."""
    moves = []
    for tick in range(round(from_s * 50), round(until_s * 50)):
        movement = operator.look(view, tick / 50)
        if movement is not None:
            moves.append((tick / 50, movement))
    return moves


ASKED = View("task-1", "02222", "02222")


def test_nothing_moves_before_a_person_could_have_read_it() -> None:
    for seed in range(50):
        (at_s, movement), *_ = looked(SimulatedOperator(seed, 0.0), ASKED, 0, 3)
        assert MIN_REACTION_S <= at_s <= MAX_REACTION_S + 0.02
        assert 0.25 <= movement.duration_s <= 0.5


def test_a_quick_operator_reacts_sooner() -> None:
    (slow_s, _), *_ = looked(SimulatedOperator(5, 0.0), ASKED, 0, 3)
    (quick_s, _), *_ = looked(SimulatedOperator(5, 0.0, speed=4.0), ASKED, 0, 3)
    assert quick_s == pytest.approx(slow_s / 4, abs=0.03)


@pytest.mark.parametrize("waiting", [View(), View("task-1", "02222", "02222", waits=True)])
def test_a_hand_that_shows_something_relaxes_when_the_task_ends_or_waits(waiting: View) -> None:
    operator = SimulatedOperator(1, 0.0)
    looked(operator, ASKED, 0, 2.5)
    moves = looked(operator, waiting, 2.5, 10)
    assert [movement.to for _, movement in moves] == [AT_REST]
    assert moves[0][0] < 3.1
    again = looked(operator, ASKED, 10, 12)
    assert len(again) == 1


def test_nothing_is_shown_while_it_would_not_count() -> None:
    assert not looked(SimulatedOperator(1, 0.0), View("task-1", "02222", waits=True), 0, 10)


def test_a_finger_that_the_screen_sees_otherwise_is_moved_further() -> None:
    operator = SimulatedOperator(1, 0.0)
    (_, first), *_ = looked(operator, ASKED, 0, 2)
    corrections = looked(operator, View("task-1", "02222", "12222"), 2, 4)
    assert corrections
    assert corrections[-1][1].to[0] > first.to[0] + 0.1
    assert corrections[-1][1].to[1:] == first.to[1:]


def test_a_gesture_that_never_counts_is_let_go_and_shown_again() -> None:
    moves = looked(SimulatedOperator(1, 0.0), ASKED, 0, 20)
    assert [movement.to == AT_REST for _, movement in moves][:4] == [False, True, False, True]


json_like = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=6) | st.just("02222"),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(["id", "code", "confirmMs", "x"]), inner, max_size=4)
    ),
    max_leaves=8,
)


@given(
    st.dictionaries(st.sampled_from(["task", "hold", "states", "paused", "testing"]), json_like, max_size=5)
)
def test_whatever_the_controller_says_is_taken_for_a_view(shown: dict[str, Any]) -> None:
    view = View.of(shown)
    assert view.confirm_s > 0
    assert view.task is None or len(view.code) == 5
    operator = SimulatedOperator(1)
    for tick in range(200):
        operator.look(view, tick / 20)


def test_the_controllers_words_are_understood() -> None:
    shown = {
        "glove": "glove-1",
        "task": {"id": "urn:t", "gesture": "Thumbs up", "code": "02222", "commandId": 1},
        "hold": {"gesture": None, "heldMs": 0, "announceMs": 500, "confirmMs": 1200},
        "states": "02221",
        "paused": False,
        "testing": True,
    }
    assert View.of(shown) == View("urn:t", "02222", "02221", 1.2, waits=True)


@pytest.mark.parametrize("code", ["00000", "22222", "11111", "01210"])
def test_a_gesture_of_ones_own_is_shown_and_mistaken_without_fail(code: str) -> None:
    for seed in range(20):
        assert looked(SimulatedOperator(seed, 1.0), View("task-1", code, code), 0, 8)


def guided(step: str, code: str, outcome: Any = None) -> View:
    """Return what the screen shows while a calibration asks for `step`."""
    return View.of({"testing": True, "calibration": {"step": step, "code": code, "outcome": outcome}})


def test_a_guided_operator_shows_what_is_asked_at_once_right_and_keeps_it_until_the_next_is_asked() -> None:
    operator = SimulatedOperator(seed=3, mistakes=1.0)
    fist, open_hand = guided("fist", "22222"), guided("open", "00000")
    moves = [(at_s / 10, operator.look(fist, at_s / 10)) for at_s in range(150)]
    shown = [(at_s, move) for at_s, move in moves if move is not None]
    assert len(shown) == 1  # neither a mistake nor a correction
    assert max(abs(share) for share in shown[0][1].to) < 0.2
    later = [operator.look(open_hand, 15 + at_s / 10) for at_s in range(60)]
    last = [move for move in later if move is not None][-1]
    assert min(last.to) > 0.8
    over = [operator.look(guided("open", "00000", {"applied": True}), 21 + at_s / 10) for at_s in range(40)]
    assert [move.to for move in over if move is not None] == [AT_REST]


def test_of_two_gestures_in_turn_the_second_is_shown_when_the_first_was_seen() -> None:
    def shown(first: str, second: str, code: str) -> View:
        parts = [{"state": first}, {"state": second}]
        return View.of({"task": {"id": "t1", "code": code, "parts": parts}, "connected": True})

    operator = SimulatedOperator(seed=1, mistakes=0)
    made: list[Movement] = []
    for look in range(60):
        view = shown("now", "next", "20222") if look < 25 else shown("done", "now", "20220")
        movement = operator.look(view, look * 0.2)
        if movement is not None:
            made.append(movement)
    postures = [tuple(round(share) for share in movement.to) for movement in made]
    assert postures[0] == (0, 1, 0, 0, 0)
    assert made[1].to == AT_REST
    assert postures[2] == (0, 1, 0, 0, 1)


def test_an_accuracy_test_is_answered_though_the_glove_is_tried_out() -> None:
    asked = {"id": 4, "done": 2, "asked": {"gesture": "Horns", "code": "20220"}}
    view = View.of({"testing": True, "accuracyTest": asked})
    assert (view.task, view.code, view.waits, view.keeps_still) == ("test 4 2", "20220", False, False)
    assert View.of({"testing": True, "accuracyTest": {**asked, "asked": None}}).task is None
