"""Wording: what the controller says to the person who wears the glove.

Short, calm, and always with what to do; a finger that differs is named together with the way it should go.
Each message has a key and its values as well, so that a screen can say it in its own language.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from datamodels.states import Outcome
from services.gesture_controller.finger_states import STRAIGHT
from services.gesture_controller.thresholds import FINGERS

_SAID = {Outcome.OK: "Good", Outcome.NOT_GOOD: "Not good", Outcome.PROBLEM: "Problem"}
_KEYED = {Outcome.OK: "Ok", Outcome.NOT_GOOD: "NotGood", Outcome.PROBLEM: "Problem"}


@dataclass(frozen=True, slots=True)
class Message:
    """Something said: what it is (`key`), of what (`values`), and the same as an English sentence."""

    key: str
    text: str
    values: Mapping[str, str | float | list[str]] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Return it as it stands in the view of a glove."""
        return {"key": self.key, "values": dict(self.values), "text": self.text}


@dataclass(frozen=True, slots=True)
class Advice:
    """How a hand must change: which fingers to stretch, and which to bend."""

    stretch: tuple[str, ...]
    bend: tuple[str, ...]

    def __str__(self) -> str:
        """Return it as half a sentence, as in "bend your thumb"."""
        parts = (("stretch", self.stretch), ("bend", self.bend))
        return ", ".join(f"{verb} your {_listed([_called(f) for f in some])}" for verb, some in parts if some)

    def as_dict(self) -> dict[str, list[str]]:
        """Return it as values of a message."""
        return {"stretch": list(self.stretch), "bend": list(self.bend)}


def differing(states: str, asked: str) -> list[str]:
    """Return the fingers, thumb first, whose state in `states` is not that of the code `asked`."""
    return [finger for finger, seen, wanted in zip(FINGERS, states, asked, strict=True) if seen != wanted]


def advice(fingers: Sequence[str], asked: str) -> Advice:
    """Return how `fingers` must move to make the code `asked`."""
    wanted = dict(zip(FINGERS, asked, strict=True))
    return Advice(
        tuple(finger for finger in fingers if wanted[finger] == STRAIGHT),
        tuple(finger for finger in fingers if wanted[finger] != STRAIGHT),
    )


def show(gesture: str) -> Message:
    """Return the invitation to show what the Task asks for."""
    return Message("show", f"Show: {gesture}.", {"gesture": gesture})


def almost(gesture: str, hint: Advice) -> Message:
    """Return the invitation when the hand is nearly there."""
    return Message("almost", f"Show: {gesture}. Almost: {hint}.", {"gesture": gesture, **hint.as_dict()})


def hold_on(confirm_in_ms: float) -> Message:
    """Return what is said when the right gesture has been announced."""
    seconds = confirm_in_ms / 1000
    rest = "another second" if seconds == 1 else f"another {seconds:g} seconds"
    return Message("holdOn", f"Right. Hold it for {rest} to confirm.", {"seconds": seconds})


def hold_on_to(outcome: Outcome, confirm_in_ms: float) -> Message:
    """Return what is said when a gesture for another outcome than `ok` has been announced."""
    seconds = confirm_in_ms / 1000
    rest = "another second" if seconds == 1 else f"another {seconds:g} seconds"
    text = f"{_SAID[outcome]}? Hold it for {rest} to report it."
    return Message(f"holdOn{_KEYED[outcome]}", text, {"seconds": seconds})


def wrong(shown: str, hint: Advice) -> Message:
    """Return what is said when another gesture than the asked one is held."""
    text = f"That is {shown}, not the requested gesture: {hint}."
    return Message("wrong", text, {"shown": shown, **hint.as_dict()})


def show_with(gesture: str, hand: str) -> Message:
    """Return the invitation to show with one hand its part of a gesture of both."""
    key = f"showWith{hand.capitalize()}"
    return Message(key, f"Show with your {hand} hand: {gesture}.", {"gesture": gesture, "hand": hand})


def show_both(left: str, right: str) -> Message:
    """Return the invitation to show a gesture of both hands."""
    text = f"Show with both hands: {left} with the left, {right} with the right."
    return Message("showBoth", text, {"left": left, "right": right})


def other_hand(gesture: str, hand: str) -> Message:
    """Return what is said when this hand is right, and the other one is not yet."""
    text = f"Right. Now your {hand} hand as well: {gesture}."
    return Message(f"otherHand{hand.capitalize()}", text, {"gesture": gesture, "hand": hand})


def begin_together(gesture: str) -> Message:
    """Return what is said when one hand began too long before the other."""
    text = f"Let go, then show {gesture} with both hands at the same time."
    return Message("beginTogether", text, {"gesture": gesture})


def wear_both(gesture: str, hand: str, person: str | None) -> Message:
    """Return what is said when a gesture takes both hands and the other one has no glove."""
    choice = f"assign it to {person}" if person else "choose who wears both"
    text = (
        f"{gesture} needs both hands. Also put on the {hand} glove and {choice}, "
        "or complete the task on the screen."
    )
    return Message(f"wearBoth{hand.capitalize()}", text, {"gesture": gesture, "hand": hand})


def first(gesture: str, part: str) -> Message:
    """Return the invitation to begin a sequence."""
    return Message("first", f"Show {gesture}. First: {part}.", {"whole": gesture, "gesture": part})


def then(part: str) -> Message:
    """Return what is said when the first of a sequence has been shown."""
    return Message("then", f"Right. Now: {part}.", {"gesture": part})


def unfiltered() -> Message:
    """Return the warning that goes with filtering switched off."""
    text = (
        "Filtering is off: every gesture with a command is sent as soon as it is held, even if no task "
        "asks for it. Switch filtering on before starting work."
    )
    return Message("unfiltered", text)


def let_go(gesture: str) -> Message:
    """Return what is said when a gesture that has counted already is still held."""
    text = f"Already counted. Let go, then show {gesture} again."
    return Message("letGo", text, {"gesture": gesture})


def confirmed(gesture: str) -> Message:
    """Return the thanks."""
    return Message("confirmed", f"Confirmed: {gesture}.", {"gesture": gesture})


def answered(outcome: Outcome) -> Message:
    """Return what is said when another outcome than `ok` has been answered."""
    return Message(f"answered{_KEYED[outcome]}", f"Reported: {_SAID[outcome].lower()}.")


def by_screen(operator: str) -> Message:
    """Return the thanks to the person who pressed the button."""
    return Message("byScreen", f"Completed on the screen by {operator}.", {"operator": operator})


def testing(shown: str | None) -> Message:
    """Return what is said in testing mode."""
    if shown is None:
        return Message("testing", "Test mode: nothing is sent. Try a gesture.")
    return Message("testingShown", f"Test mode: nothing is sent. This is {shown}.", {"shown": shown})


def paused_on_screen() -> Message:
    """Return what is said while the wearer's own screen has paused the work."""
    return Message("pausedOnScreen", "Paused on the screen. Gestures do not count until you resume.")


def paused_by_process() -> Message:
    """Return what is said while somebody else has paused the work."""
    text = "Paused by someone else. Gestures do not count until the process resumes."
    return Message("pausedByProcess", text)


def put_on(glove: str) -> Message:
    """Return what is said when a Task waits for a glove that is not there."""
    text = f"Put on {glove} and switch it on, or complete the task on the screen."
    return Message("putOn", text, {"glove": glove})


def silent(glove: str) -> Message:
    """Return what is said when the glove has stopped sending in the middle of a Task."""
    text = f"No data from {glove}; the task is waiting. Check that it is on and in range, or use the screen."
    return Message("silent", text, {"glove": glove})


def nothing_to_do(glove: str, connected: bool) -> Message:
    """Return what is said when no Task is there."""
    if connected:
        return Message("nothingToDo", "No task for you.")
    return Message("notConnected", f"{glove} is not connected.", {"glove": glove})


def _called(finger: str) -> str:
    return finger if finger == "thumb" else f"{finger} finger"


def _listed(fingers: Sequence[str]) -> str:
    if len(fingers) == 1:
        return fingers[0]
    return f"{', '.join(fingers[:-1])} and {fingers[-1]}"
