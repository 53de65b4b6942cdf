"""The motion of a picture: from an open hand to the gesture, which is then shown long enough to be copied.

In a sequence, the first gesture is shown for a moment before the second.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

from handover_gloves.pictures.hand import bends_of

Hand = Literal["left", "right"]
Motion = Literal["loop", "once", "none"]

OPEN_S = 0.7
"""How long the open hand is shown first."""
MOVE_S = 0.7
BETWEEN_S = 1.2
"""How long the first of two gestures is shown."""
STAY_S = 2.6
MOVING_STEPS = 10
OPEN_HAND = "00000"


@dataclass(frozen=True, slots=True)
class Pose:
    """One hand of a picture: its finger states, thumb first; several for a sequence."""

    hand: Hand
    states: tuple[str, ...]

    @property
    def mark(self) -> str:
        """The prefix of its ids in a file; unique among the hands of a picture."""
        return "".join((self.hand, *self.states))


@dataclass(frozen=True, slots=True)
class Moment:
    """The bend of each finger at `at_s` seconds."""

    at_s: float
    bends: tuple[float, ...]


def moments(*shown: str) -> tuple[Moment, ...]:
    """Return the motion from an open hand to each of `shown` in order: evenly spaced, slow at both ends.

    The hand opens between two equal gestures, so that both are visible.
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
    """Return the duration of the motion `way`, including the time at its end."""
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
