"""The pipeline: frame ► finger states ► gesture ► hold ► command.

`see` takes a frame through the first four; `judge` says what the hold means for the Task. Both are pure:
everything they know is in their arguments.
"""

from dataclasses import dataclass, field
from enum import Enum

from services.gesture_controller.finger_states import finger_states
from services.gesture_controller.frames import Frame
from services.gesture_controller.gestures import Commands, Gestures
from services.gesture_controller.hold import Hold, HoldEvent, HoldTiming
from services.gesture_controller.thresholds import Thresholds


@dataclass(frozen=True, slots=True)
class Senses:
    """What is needed to read a hand: its thresholds, the gestures there are, and how long is a hold."""

    thresholds: Thresholds
    gestures: Gestures
    timing: HoldTiming = field(default_factory=HoldTiming)


@dataclass(frozen=True, slots=True)
class Sight:
    """What the last frame showed: states of the fingers (and since when), gesture if any, and the hold."""

    states: str = ""
    states_since_s: float = 0.0
    gesture: str | None = None
    hold: Hold = field(default_factory=Hold)


@dataclass(frozen=True, slots=True)
class Rules:
    """What counts at this moment. `asked` is the gesture that the Task asks for, if there is one."""

    asked: str | None
    commands: Commands
    filtering: bool = True
    open: bool = True
    """False while nothing counts: in testing mode, or paused."""


class Verdict(Enum):
    """What a hold means."""

    NOTHING = "nothing"
    HOLD_ON = "hold on"
    WRONG = "wrong"
    COMMAND = "command"
    COMPLETE = "complete"


def see(before: Sight, frame: Frame, senses: Senses) -> Sight:
    """Return what `frame` shows, given what was seen before it."""
    states = finger_states(frame.bend, senses.thresholds)
    gesture = senses.gestures.names.get(states)
    hold = before.hold.after(gesture, frame.t_s, senses.timing)
    since_s = before.states_since_s if states == before.states else frame.t_s
    return Sight(states, since_s, gesture, hold)


def judge(hold: Hold, rules: Rules) -> Verdict:
    """Return what the last frame means: announced, told to be wrong, a command, or the Task's end."""
    if hold.last is HoldEvent.NONE or hold.gesture is None or not rules.open:
        return Verdict.NOTHING
    right = hold.gesture == rules.asked
    if hold.last is HoldEvent.CONFIRMED:
        if right:
            return Verdict.COMPLETE
        return (
            Verdict.NOTHING if rules.filtering or hold.gesture not in rules.commands.ids else Verdict.COMMAND
        )
    if right:
        return Verdict.HOLD_ON
    return Verdict.NOTHING if rules.asked is None else Verdict.WRONG
