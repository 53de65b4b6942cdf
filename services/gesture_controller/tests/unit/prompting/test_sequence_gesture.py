"""Two gestures in turn count when both were held, the second soon after the first, and never otherwise."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_gloves.prompting.sequence_gesture import SequenceProgress
from handover_gloves.recognition.gestures import SequenceGesture
from handover_gloves.recognition.hold import Hold, HoldEvent, HoldTiming

TIMING = HoldTiming(500, 1500, 250, 100, within_ms=3000)
A_B, A_A = SequenceGesture("A", "B"), SequenceGesture("A", "A")
Frame = tuple[float, str | None]


@dataclass
class Hand:
    """Shows gestures at 50 Hz and notes the moments at which the sequence counted."""

    asked: SequenceGesture
    now_s: float = 10.0
    hold: Hold = field(default_factory=Hold)
    turn: SequenceProgress = field(default_factory=SequenceProgress)

    def frame(self, gesture: str | None, at_s: float) -> HoldEvent:
        self.now_s = at_s
        self.hold = self.hold.after(gesture, at_s, TIMING)
        self.turn = self.turn.after(self.asked, self.hold, at_s, TIMING)
        return self.turn.last

    def show(self, gesture: str | None, seconds: float) -> list[HoldEvent]:
        events = []
        for _ in range(round(seconds * 50)):
            event = self.frame(gesture, round(self.now_s + 0.02, 3))
            if event is not HoldEvent.NONE:
                events.append(event)
        return events


ANNOUNCED, CONFIRMED = HoldEvent.ANNOUNCED, HoldEvent.CONFIRMED


def test_the_first_and_then_the_second_count() -> None:
    hand = Hand(A_B)
    assert hand.show("A", 0.6) == [ANNOUNCED]
    assert hand.turn.step == 1
    assert hand.show(None, 0.3) == []
    assert hand.show("B", 0.98) == []
    assert hand.turn.held_ms == pytest.approx(960)
    assert hand.show("B", 0.1) == [CONFIRMED]
    assert hand.turn.step == 0
    assert hand.show("B", 3) == []


def test_the_second_alone_or_the_wrong_way_round_never_counts() -> None:
    hand = Hand(A_B)
    assert hand.show("B", 5) == []
    assert hand.show("A", 5) == [ANNOUNCED]
    assert CONFIRMED not in hand.show(None, 3.1) + hand.show("B", 5)


def test_the_time_for_the_second_runs_from_letting_the_first_go() -> None:
    hand = Hand(A_B)
    hand.show("A", 10)
    hand.show(None, 2.9)
    assert hand.show("B", 1.1) == [CONFIRMED]


def test_another_gesture_held_in_between_begins_it_again() -> None:
    hand = Hand(A_B)
    hand.show("A", 0.6)
    hand.show("C", 0.4)  # only passed through
    assert hand.show("B", 1.1) == [CONFIRMED]
    hand.show(None, 0.3)
    hand.show("A", 0.6)
    hand.show("C", 0.6)
    assert hand.turn.step == 0
    assert hand.show("B", 3) == []


def test_the_same_gesture_twice_must_be_let_go_in_between() -> None:
    hand = Hand(A_A)
    assert hand.show("A", 5) == [ANNOUNCED]
    hand.show(None, 0.06)  # a flicker
    assert hand.show("A", 5) == []
    hand.show(None, 0.3)
    assert hand.show("A", 1.02) == [CONFIRMED]


def test_the_first_may_be_shown_again() -> None:
    hand = Hand(A_B)
    hand.show("A", 0.6)
    hand.show(None, 2.0)
    hand.show("A", 0.6)
    hand.show(None, 2.0)
    assert hand.show("B", 1.1) == [CONFIRMED]


STEPS = st.lists(
    st.tuples(
        st.sampled_from(["A", "B", "C", None]), st.integers(1, 90), st.sampled_from([20, 20, 20, 60, 240])
    ),
    max_size=14,
)


def runs(frames: Sequence[Frame]) -> list[tuple[str | None, float, float]]:
    """What was shown, from when to when, as one would write it down; more than 250 ms part it."""
    made: list[tuple[str | None, float, float]] = []
    for at_s, gesture in frames:
        if made and made[-1][0] == gesture and round((at_s - made[-1][2]) * 1000) <= 250:
            made[-1] = (gesture, made[-1][1], at_s)
        else:
            made.append((gesture, at_s, at_s))
    return made


@given(STEPS, st.sampled_from([A_B, A_A]))
def test_whatever_a_hand_does_what_counts_was_held_as_long_as_a_single_gesture(
    steps: list[tuple[str | None, int, int]], asked: SequenceGesture
) -> None:
    hand, frames = Hand(asked), list[Frame]()
    for gesture, count, step_ms in steps:
        for _ in range(count):
            at_s = round(hand.now_s + step_ms / 1000, 3)
            frames.append((at_s, gesture))
            if hand.frame(gesture, at_s) is not CONFIRMED:
                continue
            shown = runs(frames)
            second = shown[-1]
            assert second[0] == asked.second
            assert round((second[2] - second[1]) * 1000) >= 1000
            firsts = [run for run in shown[:-1] if run[0] == asked.first]
            assert any(round((run[2] - run[1]) * 1000) >= 500 for run in firsts)
            assert round((second[1] - firsts[-1][2]) * 1000) <= 3000


@given(STEPS, st.integers(1, 40))
def test_a_clock_that_jumps_begins_it_again(steps: list[tuple[str | None, int, int]], back: int) -> None:
    hand = Hand(A_B)
    for gesture, count, step_ms in steps:
        for _ in range(count):
            hand.frame(gesture, round(hand.now_s + step_ms / 1000, 3))
    hand.frame("B", hand.now_s - back)
    assert hand.turn.step == 0
