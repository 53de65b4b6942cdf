"""The motion of a picture: from an open hand to the gesture, which then stays long enough to be copied.

Of two gestures in turn, the first stays for a moment before the hand goes on to the second.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

from services.gesture_controller.pictures.hand import bends_of

Hand = Literal["left", "right"]
Motion = Literal["loop", "once", "none"]

OPEN_S = 0.7
"""How long the open hand is seen first."""
MOVE_S = 0.7
BETWEEN_S = 1.2
"""How long the first of two gestures is seen before the second."""
STAY_S = 2.6
MOVING_STEPS = 10
OPEN_HAND = "00000"


@dataclass(frozen=True, slots=True)
class Pose:
    """What one hand of a picture shows: five finger states, thumb first, or several such in turn."""

    hand: Hand
    states: tuple[str, ...]

    @property
    def mark(self) -> str:
        """What its parts are called in a file: two hands of one picture never have the same."""
        return "".join((self.hand, *self.states))


@dataclass(frozen=True, slots=True)
class Moment:
    """How far each finger is bent `at_s` seconds after the beginning."""

    at_s: float
    bends: tuple[float, ...]


def moments(*shown: str) -> tuple[Moment, ...]:
    """Return the way from an open hand to each of `shown` in turn: evenly spaced, slow at both ends.

    Between two that are the same the hand opens, or nobody would see that there are two.
    """
    way: list[Moment] = []
    start_s, before = OPEN_S, bends_of(OPEN_HAND)
    for states in _stations(shown):
        aim = bends_of(states)
        way += [
            Moment(start_s + MOVE_S * step / MOVING_STEPS, _between(before, aim, _eased(step / MOVING_STEPS)))
            for step in range(MOVING_STEPS + 1)
        ]
        start_s, before = start_s + MOVE_S + BETWEEN_S, aim
    return tuple(way)


def whole_s(way: Sequence[Moment]) -> float:
    """Return how long a picture takes that goes `way` and stays at its end."""
    return way[-1].at_s + STAY_S


def _stations(shown: Sequence[str]) -> Iterator[str]:
    before = None
    for states in shown:
        if states == before:
            yield OPEN_HAND
        yield (before := states)


def _between(before: Sequence[float], aim: Sequence[float], part: float) -> tuple[float, ...]:
    return tuple(start + (end - start) * part for start, end in zip(before, aim, strict=True))


def _eased(part: float) -> float:
    return part * part * (3 - 2 * part)
