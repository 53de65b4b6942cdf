"""The motion of a picture: from an open hand to the gesture, which then stays long enough to be copied."""

from dataclasses import dataclass
from typing import Literal

from services.gesture_controller.pictures.hand import bends_of

Hand = Literal["left", "right"]
Motion = Literal["loop", "once", "none"]

OPEN_S = 0.7
"""How long the open hand is seen first."""
MOVE_S = 0.7
STAY_S = 2.6
WHOLE_S = OPEN_S + MOVE_S + STAY_S
MOVING_STEPS = 10


@dataclass(frozen=True, slots=True)
class Moment:
    """How far each finger is bent `at_s` seconds after the beginning."""

    at_s: float
    bends: tuple[float, ...]


def moments(states: str) -> tuple[Moment, ...]:
    """Return the way from an open hand to `states`: evenly spaced in time, slow at both ends."""
    aim = bends_of(states)
    return tuple(
        Moment(
            OPEN_S + MOVE_S * step / MOVING_STEPS,
            tuple(bend * _eased(step / MOVING_STEPS) for bend in aim),
        )
        for step in range(MOVING_STEPS + 1)
    )


def _eased(part: float) -> float:
    return part * part * (3 - 2 * part)
