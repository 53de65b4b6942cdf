"""Wording: what the controller says to the person who wears the glove.

Short, calm, and always with what to do; a finger that differs is named together with the way it should go.
"""

from collections.abc import Sequence

from services.gesture_controller.finger_states import STRAIGHT
from services.gesture_controller.thresholds import FINGERS


def differing(states: str, asked: str) -> list[str]:
    """Return the fingers, thumb first, whose state in `states` is not that of the code `asked`."""
    return [finger for finger, seen, wanted in zip(FINGERS, states, asked, strict=True) if seen != wanted]


def advice(fingers: Sequence[str], asked: str) -> str:
    """Return how `fingers` must move to make the code `asked`, as in "bend your thumb"."""
    wanted = dict(zip(FINGERS, asked, strict=True))
    stretch = [_called(finger) for finger in fingers if wanted[finger] == STRAIGHT]
    bend = [_called(finger) for finger in fingers if wanted[finger] != STRAIGHT]
    parts = [f"{verb} your {_listed(some)}" for verb, some in (("stretch", stretch), ("bend", bend)) if some]
    return ", ".join(parts)


def show(gesture: str) -> str:
    """Return the invitation to show what the Task asks for."""
    return f"Show: {gesture}."


def almost(gesture: str, hint: str) -> str:
    """Return the invitation when the hand is nearly there."""
    return f"Show: {gesture}. Almost: {hint}."


def hold_on(confirm_in_ms: float) -> str:
    """Return what is said when the right gesture has been announced."""
    seconds = confirm_in_ms / 1000
    rest = "another second" if seconds == 1 else f"another {seconds:g} seconds"
    return f"Right. Hold it for {rest} to confirm."


def wrong(shown: str, hint: str) -> str:
    """Return what is said when another gesture than the asked one is held."""
    return f"{shown} is not the gesture this Task asks for: {hint}."


def let_go(gesture: str) -> str:
    """Return what is said when a gesture that has counted already is still held."""
    return f"This counted already. Let go, then show {gesture} again."


def confirmed(gesture: str) -> str:
    """Return the thanks."""
    return f"Confirmed: {gesture}."


def by_screen(operator: str) -> str:
    """Return the thanks to whoever pressed the button."""
    return f"Completed on the screen by {operator}."


def testing(shown: str | None) -> str:
    """Return what is said in testing mode."""
    return f"Testing, nothing is sent. {f'This is {shown}.' if shown else 'Try a gesture.'}"


def paused(reason: str) -> str:
    """Return what is said while the work is paused by `reason`."""
    return f"Paused {reason}. Nothing you show counts until the work goes on."


def put_on(glove: str) -> str:
    """Return what is said when a Task waits for a glove that is not there."""
    return f"Put on {glove} and switch it on: a Task waits for it. Or complete it on the screen."


def silent(glove: str) -> str:
    """Return what is said when the glove has stopped sending in the middle of a Task."""
    return f"{glove} is silent, the Task waits. Check that it is on and near, or use the screen."


def nothing_to_do(glove: str, connected: bool) -> str:
    """Return what is said when no Task is there."""
    return (
        "No Task for you at the moment." if connected else f"{glove} is not connected. No Task waits for it."
    )


def _called(finger: str) -> str:
    return finger if finger == "thumb" else f"{finger} finger"


def _listed(fingers: Sequence[str]) -> str:
    if len(fingers) == 1:
        return fingers[0]
    return f"{', '.join(fingers[:-1])} and {fingers[-1]}"
