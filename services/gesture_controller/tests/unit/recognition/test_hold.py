"""A gesture is announced at 500 ms and counts at 1500 ms, once, and never sooner."""

from hypothesis import given, settings
from hypothesis import strategies as st

from handover_gloves.recognition.hold import Hold, HoldEvent, HoldTiming

TIMING = HoldTiming()
UP, HORNS = "Thumbs up", "Horns"


def held(gesture: str | None, hold: Hold, from_s: float, to_s: float, step_s: float = 0.02) -> list[Hold]:
    """Return every hold while `gesture` is shown from `from_s` until `to_s`."""
    steps = []
    for count in range(round((to_s - from_s) / step_s) + 1):
        hold = hold.after(gesture, from_s + count * step_s, TIMING)
        steps.append(hold)
    return steps


def events(steps: list[Hold]) -> list[tuple[HoldEvent, float]]:
    return [(step.last, step.held_ms) for step in steps if step.last is not HoldEvent.NONE]


def test_a_gesture_is_announced_at_500_ms_and_counts_at_1500_ms() -> None:
    assert events(held(UP, Hold(), 7, 9)) == [(HoldEvent.ANNOUNCED, 500), (HoldEvent.CONFIRMED, 1500)]


def test_a_gesture_held_for_1480_ms_does_not_count() -> None:
    assert events(held(UP, Hold(), 0, 1.48)) == [(HoldEvent.ANNOUNCED, 500)]


def test_a_hold_counts_only_once_however_long_it_lasts() -> None:
    assert len(events(held(UP, Hold(), 0, 60))) == 2


def test_letting_go_begins_again_from_zero() -> None:
    steps = held(UP, Hold(), 0, 1.4)
    steps += held(None, steps[-1], 1.42, 1.42)
    steps += held(UP, steps[-1], 1.44, 2.9)
    assert [event for event, _ in events(steps)] == [HoldEvent.ANNOUNCED, HoldEvent.ANNOUNCED]


def test_changing_the_gesture_begins_again_from_zero() -> None:
    steps = held(UP, Hold(), 0, 1.4)
    steps += held(HORNS, steps[-1], 1.42, 2.9)
    assert all(step.last is not HoldEvent.CONFIRMED for step in steps)


def test_a_gap_between_frames_breaks_the_hold() -> None:
    steps = held(UP, Hold(), 0, 1.4)
    after_gap = steps[-1].after(UP, 1.4 + 0.251, TIMING)
    assert after_gap.held_ms == 0
    assert steps[-1].after(UP, 1.4 + 0.25, TIMING).held_ms == 1650


def test_a_clock_that_runs_backwards_breaks_the_hold() -> None:
    steps = held(UP, Hold(), 100, 101.4)
    back = steps[-1].after(UP, 50, TIMING)
    assert (back.since_s, back.last) == (50, HoldEvent.NONE)


def test_what_was_held_before_a_task_does_not_count_for_it() -> None:
    steps = held(UP, Hold(), 0, 1.4)
    assert events(held(UP, steps[-1].restarted(), 1.42, 2.9)) == [(HoldEvent.ANNOUNCED, 500)]
    assert events(held(UP, steps[-1].restarted(), 1.42, 2.94))[-1] == (HoldEvent.CONFIRMED, 1500)


def test_a_spent_hold_does_not_count_again_until_the_hand_has_let_go() -> None:
    spent = held(UP, Hold(), 0, 1.5)[-1].mark_spent()
    still = held(UP, spent.restarted(), 1.52, 6)
    assert not events(still)
    flicker = held(None, still[-1], 6.02, 6.02)
    assert not events(held(UP, flicker[-1], 6.04, 9))
    away = held(None, still[-1], 6.02, 6.14)
    assert [event for event, _ in events(held(UP, away[-1], 6.16, 8))] == [
        HoldEvent.ANNOUNCED,
        HoldEvent.CONFIRMED,
    ]


def test_a_gap_is_no_letting_go() -> None:
    spent = held(UP, Hold(), 0, 1.5)[-1].mark_spent()
    assert not events(held(UP, spent, 30, 33))


def test_another_gesture_counts_while_one_is_spent() -> None:
    spent = held(UP, Hold(), 0, 1.5)[-1].mark_spent()
    assert [event for event, _ in events(held(HORNS, spent, 1.52, 3.1))] == [
        HoldEvent.ANNOUNCED,
        HoldEvent.CONFIRMED,
    ]


FRAMES = st.lists(
    st.tuples(
        st.sampled_from([UP, HORNS, None]),
        st.one_of(st.floats(0.0, 0.3), st.floats(-5.0, 5.0), st.just(0.02)),
        st.integers(1, 120),
    ),
    max_size=30,
)


@given(FRAMES, st.booleans())
@settings(max_examples=4 * settings.default.max_examples)
def test_whatever_a_hand_does_nothing_counts_before_its_time(
    runs: list[tuple[str | None, float, int]], spends: bool
) -> None:
    hold, at_s = Hold(), 0.0
    history: list[tuple[str | None, float]] = []
    counted_at = None
    for gesture, step_s, times in runs:
        for _ in range(times):
            at_s += step_s
            history.append((gesture, at_s))
            hold = hold.after(gesture, at_s, TIMING)
            if hold.last is HoldEvent.CONFIRMED:
                kept = kept_ms(history)
                assert gesture is not None
                assert kept >= TIMING.confirm_ms - 0.001
                if counted_at is not None and spends:
                    assert let_go_since(history, counted_at, gesture)
                counted_at = len(history)
                hold = hold.mark_spent() if spends else hold
            elif hold.last is HoldEvent.ANNOUNCED:
                assert kept_ms(history) >= TIMING.announce_ms - 0.001


def kept_ms(history: list[tuple[str | None, float]]) -> float:
    """Say, by looking back, for how long the last gesture has been kept without gap or step back."""
    gesture, until_s = history[-1]
    from_s = until_s
    for earlier, at_s in reversed(history):
        if earlier != gesture or at_s > from_s or (from_s - at_s) * 1000 > TIMING.gap_ms:
            break
        from_s = at_s
    return (until_s - from_s) * 1000


def let_go_since(history: list[tuple[str | None, float]], since: int, gesture: str) -> bool:
    """Say whether another gesture than what now counts counted before, or the hand was away since."""
    if history[since - 1][0] != gesture:
        return True
    return any(earlier != gesture for earlier, _ in history[since:])
