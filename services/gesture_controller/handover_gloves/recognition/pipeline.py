"""The pipeline: frame > drift correction > finger states and gesture > hold > verdict.

`process_frame` applies the first four steps to a frame; `judge` decides what the hold means for the Task.
Both are pure functions of their arguments.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from handover_datamodels.states import Outcome
from handover_gloves.recognition.drift import Drift, DriftBounds
from handover_gloves.recognition.finger_states import BETWEEN
from handover_gloves.recognition.frames import Frame
from handover_gloves.recognition.gestures import Commands, Gestures, Part
from handover_gloves.recognition.hold import Hold, HoldEvent, HoldTiming
from handover_gloves.recognition.levels import Calibration
from handover_gloves.recognition.recognizer import (
    CannotRecognize,
    HandContext,
    Recognition,
    Recognizer,
)
from handover_gloves.recognition.registry import THRESHOLDS, UnknownRecognizer, factory_of
from handover_gloves.recognition.thresholds import Thresholds

MIN_SETTLED_S = 0.5
"""Finger states that are unchanged for this time are used to follow drift."""


@dataclass(frozen=True, slots=True)
class RecognitionConfig:
    """Everything that recognition needs: thresholds, gestures, timing, calibration and recognizer.

    `in_use` holds the codes that this person may be asked for or gives commands with. `recognizer_name` is
    the chosen recognizer; if it cannot work, `recognizer` is the one by thresholds and `missing` says why.
    """

    thresholds: Thresholds
    gestures: Gestures
    timing: HoldTiming = field(default_factory=HoldTiming)
    calibration: Calibration | None = None
    recognizer_name: str = THRESHOLDS
    in_use: frozenset[str] = frozenset()
    failure: str | None = None
    """The error that the chosen recognizer raised; it is then not used again."""
    recognizer: Recognizer[Any] = field(init=False, repr=False, compare=False)
    missing: str | None = field(init=False, default=None)
    drift_bounds: DriftBounds | None = field(init=False, default=None, repr=False, compare=False)
    """The expected range of each finger; None until the hand is calibrated."""

    def __post_init__(self) -> None:
        context = HandContext(self.thresholds, self.gestures, self.calibration, self.in_use)
        try:
            recognizer = factory_of(THRESHOLDS if self.failure else self.recognizer_name)(context)
            missing = self.failure
        except (CannotRecognize, UnknownRecognizer) as error:
            recognizer, missing = factory_of(THRESHOLDS)(context), str(error)
        object.__setattr__(self, "recognizer", recognizer)
        if self.calibration is not None:
            object.__setattr__(self, "drift_bounds", DriftBounds(self.calibration, self.thresholds))
        object.__setattr__(self, "missing", missing)


@dataclass(frozen=True, slots=True)
class PipelineState:
    """The result of the last frame: finger states and since when, the gesture if any, hold and drift."""

    states: str = ""
    states_since_s: float = 0.0
    gesture: str | None = None
    hold: Hold = field(default_factory=Hold)
    recognition: Recognition | None = None
    drift: Drift = field(default_factory=Drift)


@dataclass(frozen=True, slots=True)
class Rules:
    """What counts at this moment; `expected` is the gesture that the Task asks for, if there is a Task."""

    expected: str | None
    commands: Commands
    filtering: bool = True
    open: bool = True
    """False in testing mode and while paused: nothing counts."""
    answers: Mapping[Outcome, Part] = field(default_factory=dict)
    """The gestures that answer the Task with another outcome than `ok`."""


class Verdict(Enum):
    """The meaning of a hold."""

    NOTHING = "nothing"
    ANNOUNCE = "announce"
    WRONG = "wrong"
    COMMAND = "command"
    COMPLETE = "complete"
    """The expected gesture, or the gesture of another answer, was held long enough."""


def process_frame(before: PipelineState, frame: Frame, config: RecognitionConfig) -> PipelineState:
    """Return the state after `frame`."""
    drift, corrected = before.drift, frame
    if config.drift_bounds is not None:
        drift = drift.after(frame.bend, frame.t_s, _settled_states(before), config.drift_bounds)
        corrected = Frame(frame.t_s, drift.corrected(frame.bend), frame.battery)
    seen = config.recognizer.see(before.recognition, corrected)
    hold = before.hold.after(seen.gesture, frame.t_s, config.timing)
    since_s = before.states_since_s if seen.states == before.states else frame.t_s
    return PipelineState(seen.states, since_s, seen.gesture, hold, seen, drift)


def _settled_states(state: PipelineState) -> str | None:
    """Return the finger states if they are settled and certain, else None."""
    seen = state.recognition
    if seen is None or seen.at_s - state.states_since_s < MIN_SETTLED_S or BETWEEN in seen.states:
        return None
    if seen.unclear_fingers:
        return None  # following drift here would make the fingers clearer than the person shows them
    return seen.states if seen.certainty > 0.5 else None


def judge(hold: Hold, rules: Rules) -> Verdict:
    """Return what the last event of `hold` means under `rules`."""
    if hold.last is HoldEvent.NONE or hold.gesture is None or not rules.open:
        return Verdict.NOTHING
    is_right = hold.gesture == rules.expected or any(
        part.gesture == hold.gesture for part in rules.answers.values()
    )
    if hold.last is HoldEvent.CONFIRMED:
        if is_right:
            return Verdict.COMPLETE
        return (
            Verdict.NOTHING if rules.filtering or hold.gesture not in rules.commands.ids else Verdict.COMMAND
        )
    if is_right:
        return Verdict.ANNOUNCE
    return Verdict.NOTHING if rules.expected is None else Verdict.WRONG
