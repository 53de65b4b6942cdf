"""The pipeline: frame ► drift taken away ► finger states and gesture ► hold ► command.

`see` takes a frame through all but the last; `judge` says what the hold means for the Task. Both are pure:
everything they know is in their arguments.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from datamodels.states import Outcome
from services.gesture_controller.calibration.drift import Drift, Rooms
from services.gesture_controller.calibration.levels import Calibration
from services.gesture_controller.finger_states import BETWEEN
from services.gesture_controller.frames import Frame
from services.gesture_controller.gestures import Commands, Gestures, Part
from services.gesture_controller.hold import Hold, HoldEvent, HoldTiming
from services.gesture_controller.recognition.recognizer import (
    CannotRecognize,
    Given,
    Recognition,
    Recognizer,
)
from services.gesture_controller.recognition.registry import THRESHOLDS, UnknownRecognizer, maker_of
from services.gesture_controller.thresholds import Thresholds

SETTLED_S = 0.5
"""Fingers that have stood so long in their states tell of drift."""


@dataclass(frozen=True, slots=True)
class Senses:
    """What is needed to read a hand: how it is calibrated, by which recognizer, and how long is a hold.

    `in_use` are the codes of the gestures that this person may be asked for or gives commands with. Where the
    chosen recognizer cannot work, thresholds do, and `missing` says what it lacks.
    """

    thresholds: Thresholds
    gestures: Gestures
    timing: HoldTiming = field(default_factory=HoldTiming)
    calibration: Calibration | None = None
    recognizer: str = THRESHOLDS
    in_use: frozenset[str] = frozenset()
    failure: str | None = None
    """How the chosen recognizer failed while it was used, if it did; it is not used again."""
    reader: Recognizer[Any] = field(init=False, repr=False, compare=False)
    missing: str | None = field(init=False, default=None)
    rooms: Rooms | None = field(init=False, default=None, repr=False, compare=False)
    """Where the fingers are expected, once the hand is calibrated."""

    def __post_init__(self) -> None:
        given = Given(self.thresholds, self.gestures, self.calibration, self.in_use)
        try:
            reader = maker_of(THRESHOLDS if self.failure else self.recognizer)(given)
            missing = self.failure
        except (CannotRecognize, UnknownRecognizer) as error:
            reader, missing = maker_of(THRESHOLDS)(given), str(error)
        object.__setattr__(self, "reader", reader)
        if self.calibration is not None:
            object.__setattr__(self, "rooms", Rooms(self.calibration, self.thresholds))
        object.__setattr__(self, "missing", missing)


@dataclass(frozen=True, slots=True)
class Sight:
    """What the last frame showed: states of the fingers (and since when), gesture if any, and the hold."""

    states: str = ""
    states_since_s: float = 0.0
    gesture: str | None = None
    hold: Hold = field(default_factory=Hold)
    recognition: Recognition | None = None
    drift: Drift = field(default_factory=Drift)


@dataclass(frozen=True, slots=True)
class Rules:
    """What counts at this moment. `asked` is the gesture that the Task asks for, if there is one."""

    asked: str | None
    commands: Commands
    filtering: bool = True
    open: bool = True
    """False while nothing counts: in testing mode, or paused."""
    answers: Mapping[Outcome, Part] = field(default_factory=dict)
    """The gestures that answer the Task otherwise than with `ok`."""


class Verdict(Enum):
    """What a hold means."""

    NOTHING = "nothing"
    HOLD_ON = "hold on"
    WRONG = "wrong"
    COMMAND = "command"
    COMPLETE = "complete"
    """The gesture that the Task asks for, or one of its other answers, has been held."""


def see(before: Sight, frame: Frame, senses: Senses) -> Sight:
    """Return what `frame` shows, given what was seen before it."""
    drift, as_calibrated = before.drift, frame
    if senses.rooms is not None:
        drift = drift.after(frame.bend, frame.t_s, _settled(before), senses.rooms)
        as_calibrated = Frame(frame.t_s, drift.corrected(frame.bend), frame.battery)
    seen = senses.reader.see(before.recognition, as_calibrated)
    hold = before.hold.after(seen.gesture, frame.t_s, senses.timing)
    since_s = before.states_since_s if seen.states == before.states else frame.t_s
    return Sight(seen.states, since_s, seen.gesture, hold, seen, drift)


def _settled(sight: Sight) -> str | None:
    """Return the states in which the fingers have stood for a while; None if they have not, or in doubt."""
    seen = sight.recognition
    if seen is None or seen.at_s - sight.states_since_s < SETTLED_S or BETWEEN in seen.states:
        return None
    if seen.doubtful:
        return None  # following would make the fingers clearer than the person does
    return seen.states if seen.certainty > 0.5 else None


def judge(hold: Hold, rules: Rules) -> Verdict:
    """Return what the last frame means: announced, told to be wrong, a command, or the Task's end."""
    if hold.last is HoldEvent.NONE or hold.gesture is None or not rules.open:
        return Verdict.NOTHING
    right = hold.gesture == rules.asked or any(p.gesture == hold.gesture for p in rules.answers.values())
    if hold.last is HoldEvent.CONFIRMED:
        if right:
            return Verdict.COMPLETE
        return (
            Verdict.NOTHING if rules.filtering or hold.gesture not in rules.commands.ids else Verdict.COMMAND
        )
    if right:
        return Verdict.HOLD_ON
    return Verdict.NOTHING if rules.asked is None else Verdict.WRONG
