"""From frame to command: what a hand shows, and what it means."""

import pytest

from handover_gloves.recognition.frames import Frame
from handover_gloves.recognition.gestures import M2O2P_GESTURES, Commands, Gestures
from handover_gloves.recognition.hold import Hold, HoldEvent
from handover_gloves.recognition.pipeline import (
    PipelineState,
    RecognitionConfig,
    Rules,
    Verdict,
    judge,
    process_frame,
)
from handover_gloves.recognition.thresholds import Threshold, Thresholds

CONFIG = RecognitionConfig(Thresholds((Threshold(600, 400),) * 5), Gestures(M2O2P_GESTURES))
COMMANDS = Commands({3: "Thumbs up", 8: "Horns"})
ANNOUNCED, CONFIRMED = HoldEvent.ANNOUNCED, HoldEvent.CONFIRMED


def test_every_one_of_the_21_gestures_is_recognised() -> None:
    for name, code in M2O2P_GESTURES.items():
        bend = [700.0 if state == "0" else 300.0 for state in code]
        state = process_frame(PipelineState(), Frame(1.0, bend), CONFIG)
        assert (state.states, state.gesture) == (code, name)


def test_a_shape_that_is_no_gesture_has_no_name() -> None:
    for bend in ([700.0] * 5, [300.0] * 5, [500.0] * 5):
        assert process_frame(PipelineState(), Frame(1.0, bend), CONFIG).gesture is None


def test_how_long_a_shape_has_been_kept_is_known_even_without_a_name() -> None:
    state = PipelineState()
    for t_s in (1.0, 1.1, 1.2):
        state = process_frame(state, Frame(t_s, [500.0] * 5), CONFIG)
    assert state.states_since_s == 1.0
    assert process_frame(state, Frame(1.3, [700.0] * 5), CONFIG).states_since_s == 1.3


@pytest.mark.parametrize(
    ("gesture", "event", "rules", "verdict"),
    [
        ("Horns", ANNOUNCED, Rules("Horns", COMMANDS), Verdict.ANNOUNCE),
        ("Horns", CONFIRMED, Rules("Horns", COMMANDS), Verdict.COMPLETE),
        ("Horns", CONFIRMED, Rules("Horns", COMMANDS, filtering=False), Verdict.COMPLETE),
        ("Horns", ANNOUNCED, Rules("Thumbs up", COMMANDS), Verdict.WRONG),
        ("Horns", CONFIRMED, Rules("Thumbs up", COMMANDS), Verdict.NOTHING),
        ("Horns", CONFIRMED, Rules("Thumbs up", COMMANDS, filtering=False), Verdict.COMMAND),
        ("Horns", CONFIRMED, Rules(None, COMMANDS, filtering=False), Verdict.COMMAND),
        ("Horns", ANNOUNCED, Rules(None, COMMANDS), Verdict.NOTHING),
        ("Horns", CONFIRMED, Rules(None, COMMANDS), Verdict.NOTHING),
        ("Ring straight", CONFIRMED, Rules(None, COMMANDS, filtering=False), Verdict.NOTHING),
        ("Horns", CONFIRMED, Rules("Horns", COMMANDS, open=False), Verdict.NOTHING),
        ("Horns", CONFIRMED, Rules(None, COMMANDS, filtering=False, open=False), Verdict.NOTHING),
        ("Horns", HoldEvent.NONE, Rules("Horns", COMMANDS), Verdict.NOTHING),
        (None, CONFIRMED, Rules(None, COMMANDS), Verdict.NOTHING),
    ],
)
def test_what_a_hold_means(gesture: str | None, event: HoldEvent, rules: Rules, verdict: Verdict) -> None:
    assert judge(Hold(gesture, last=event), rules) is verdict
