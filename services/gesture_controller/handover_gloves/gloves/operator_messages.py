"""The messages to the person who wears a glove.

Each message is short and says what to do; a differing finger is named with the direction in which it must
move. Each message also has a key and values, so that a screen can translate it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from handover_datamodels.states import Outcome
from handover_gloves.recognition.finger_states import STRAIGHT
from handover_gloves.recognition.thresholds import FINGERS

_TEXTS = {Outcome.OK: "Good", Outcome.NOT_GOOD: "Not good", Outcome.PROBLEM: "Problem"}
_KEYS = {Outcome.OK: "Ok", Outcome.NOT_GOOD: "NotGood", Outcome.PROBLEM: "Problem"}


@dataclass(frozen=True, slots=True)
class OperatorMessage:
    """A message: its `key` and `values` for translation, and its English text."""

    key: str
    text: str
    values: Mapping[str, str | float | list[str]] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Return it as in the view of a glove."""
        return {"key": self.key, "values": dict(self.values), "text": self.text}


@dataclass(frozen=True, slots=True)
class Advice:
    """The fingers to stretch and the fingers to bend."""

    stretch: tuple[str, ...]
    bend: tuple[str, ...]

    def __str__(self) -> str:
        """Return it as half a sentence such as "bend your thumb"."""
        parts = (("stretch", self.stretch), ("bend", self.bend))
        return ", ".join(f"{verb} your {_listed([_called(f) for f in some])}" for verb, some in parts if some)

    def as_dict(self) -> dict[str, list[str]]:
        """Return it as values of a message."""
        return {"stretch": list(self.stretch), "bend": list(self.bend)}


MAX_ALMOST_FINGERS: Final = 2
"""Up to so many fingers that differ, a hand is almost the gesture."""


def differing(states: str, code: str) -> list[str]:
    """Return the fingers, thumb first, whose state in `states` differs from `code`."""
    return [
        finger for finger, state, requested in zip(FINGERS, states, code, strict=True) if state != requested
    ]


def advice(fingers: Sequence[str], code: str) -> Advice:
    """Return how `fingers` must move to show `code`."""
    requested = dict(zip(FINGERS, code, strict=True))
    return Advice(
        tuple(finger for finger in fingers if requested[finger] == STRAIGHT),
        tuple(finger for finger in fingers if requested[finger] != STRAIGHT),
    )


def show(gesture: str) -> OperatorMessage:
    """Return the prompt for a single gesture."""
    return OperatorMessage("show", f"Show: {gesture}.", {"gesture": gesture})


def differs(gesture: str, hint: Advice) -> OperatorMessage:
    """Return the prompt if more fingers differ than are almost the gesture; it names them all."""
    return OperatorMessage(
        "differs", f"Show: {gesture}. Not yet: {hint}.", {"gesture": gesture, **hint.as_dict()}
    )


def almost(gesture: str, hint: Advice) -> OperatorMessage:
    """Return the prompt if one or two fingers differ."""
    return OperatorMessage(
        "almost", f"Show: {gesture}. Almost: {hint}.", {"gesture": gesture, **hint.as_dict()}
    )


def hold_on(confirm_in_ms: float) -> OperatorMessage:
    """Return the message after the right gesture has been announced."""
    seconds = confirm_in_ms / 1000
    rest = "another second" if seconds == 1 else f"another {seconds:g} seconds"
    return OperatorMessage("holdOn", f"Right. Hold it for {rest} to confirm.", {"seconds": seconds})


def hold_on_to(outcome: Outcome, confirm_in_ms: float) -> OperatorMessage:
    """Return the message after a gesture for another outcome than `ok` has been announced."""
    seconds = confirm_in_ms / 1000
    rest = "another second" if seconds == 1 else f"another {seconds:g} seconds"
    text = f"{_TEXTS[outcome]}? Hold it for {rest} to report it."
    return OperatorMessage(f"holdOn{_KEYS[outcome]}", text, {"seconds": seconds})


def wrong(shown: str, hint: Advice) -> OperatorMessage:
    """Return the message while a wrong gesture is held."""
    text = f"That is {shown}, not the requested gesture: {hint}."
    return OperatorMessage("wrong", text, {"shown": shown, **hint.as_dict()})


def show_with(gesture: str, hand: str) -> OperatorMessage:
    """Return the prompt for one hand of a two-hand gesture."""
    key = f"showWith{hand.capitalize()}"
    return OperatorMessage(key, f"Show with your {hand} hand: {gesture}.", {"gesture": gesture, "hand": hand})


def show_both(left: str, right: str) -> OperatorMessage:
    """Return the prompt for a two-hand gesture."""
    text = f"Show with both hands: {left} with the left, {right} with the right."
    return OperatorMessage("showBoth", text, {"left": left, "right": right})


def other_hand(gesture: str, hand: str) -> OperatorMessage:
    """Return the message while this hand is right and the other one is not."""
    text = f"Right. Now your {hand} hand as well: {gesture}."
    return OperatorMessage(f"otherHand{hand.capitalize()}", text, {"gesture": gesture, "hand": hand})


def begin_together(gesture: str) -> OperatorMessage:
    """Return the message if one hand began too long before the other."""
    text = f"Let go, then show {gesture} with both hands at the same time."
    return OperatorMessage("beginTogether", text, {"gesture": gesture})


def wear_both(gesture: str, hand: str, person: str | None) -> OperatorMessage:
    """Return the message if a two-hand gesture lacks the other glove."""
    choice = f"assign it to {person}" if person else "choose who wears both"
    text = (
        f"{gesture} needs both hands. Also put on the {hand} glove and {choice}, "
        "or complete the task on the screen."
    )
    return OperatorMessage(f"wearBoth{hand.capitalize()}", text, {"gesture": gesture, "hand": hand})


def first(gesture: str, part: str) -> OperatorMessage:
    """Return the prompt for the first gesture of a sequence."""
    return OperatorMessage("first", f"Show {gesture}. First: {part}.", {"whole": gesture, "gesture": part})


def then(part: str) -> OperatorMessage:
    """Return the prompt for the second gesture of a sequence."""
    return OperatorMessage("then", f"Right. Now: {part}.", {"gesture": part})


def unfiltered() -> OperatorMessage:
    """Return the warning while filtering is off."""
    text = (
        "Filtering is off: every gesture with a command is sent as soon as it is held, even if no task "
        "asks for it. Switch filtering on before starting work."
    )
    return OperatorMessage("unfiltered", text)


def let_go(gesture: str) -> OperatorMessage:
    """Return the message while a gesture that has counted is still held."""
    text = f"Already counted. Let go, then show {gesture} again."
    return OperatorMessage("letGo", text, {"gesture": gesture})


def confirmed(gesture: str) -> OperatorMessage:
    """Return the confirmation of a gesture."""
    return OperatorMessage("confirmed", f"Confirmed: {gesture}.", {"gesture": gesture})


def answered(outcome: Outcome) -> OperatorMessage:
    """Return the confirmation of another outcome than `ok`."""
    return OperatorMessage(f"answered{_KEYS[outcome]}", f"Reported: {_TEXTS[outcome].lower()}.")


def by_screen(operator: str) -> OperatorMessage:
    """Return the confirmation of an answer on the screen."""
    return OperatorMessage("byScreen", f"Completed on the screen by {operator}.", {"operator": operator})


def testing(shown: str | None) -> OperatorMessage:
    """Return the message in testing mode."""
    if shown is None:
        return OperatorMessage("testing", "Test mode: nothing is sent. Try a gesture.")
    return OperatorMessage("testingShown", f"Test mode: nothing is sent. This is {shown}.", {"shown": shown})


def paused_on_screen() -> OperatorMessage:
    """Return the message while the wearer has paused the work."""
    return OperatorMessage("pausedOnScreen", "Paused on the screen. Gestures do not count until you resume.")


def paused_by_process() -> OperatorMessage:
    """Return the message while somebody else has paused the work."""
    text = "Paused by someone else. Gestures do not count until the process resumes."
    return OperatorMessage("pausedByProcess", text)


def needs_pin() -> OperatorMessage:
    """Return the message while a Task waits for the PIN of the person."""
    return OperatorMessage("needsPin", "This task needs your PIN. Enter it on the screen.")


def put_on(glove: str) -> OperatorMessage:
    """Return the message if a Task waits for a glove that is not connected."""
    text = f"Put on {glove} and switch it on, or complete the task on the screen."
    return OperatorMessage("putOn", text, {"glove": glove})


def silent(glove: str) -> OperatorMessage:
    """Return the message if the glove stopped sending during a Task."""
    text = f"No data from {glove}; the task is waiting. Check that it is on and in range, or use the screen."
    return OperatorMessage("silent", text, {"glove": glove})


def nothing_to_do(glove: str, connected: bool) -> OperatorMessage:
    """Return the message without a Task."""
    if connected:
        return OperatorMessage("nothingToDo", "No task for you.")
    return OperatorMessage("notConnected", f"{glove} is not connected.", {"glove": glove})


def _called(finger: str) -> str:
    return finger if finger == "thumb" else f"{finger} finger"


def _listed(fingers: Sequence[str]) -> str:
    if len(fingers) == 1:
        return fingers[0]
    return f"{', '.join(fingers[:-1])} and {fingers[-1]}"
