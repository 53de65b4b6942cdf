"""Doubts: which finger of a calibration is not to be relied on, why, and what the person can do about it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from statistics import median

from services.gesture_controller.calibration.levels import Calibration, FingerLevels, levels_of
from services.gesture_controller.thresholds import FINGERS

SMALL = 0.3
"""A span below this share of the other fingers' is small."""

NOISY = 0.12
"""Noise above this share of the span makes a finger waver."""

AT_THE_STOP = 0.5
"""A sensor that shows its highest or lowest value in this share of the frames, exactly, is at its stop."""

STOPS = (0.0, 1023.0, 4095.0, 65535.0)
"""Where converters of 10, 12 and 16 bits end."""


class Why(Enum):
    """What is wrong with a finger."""

    DEAD = "dead"
    SATURATED = "saturated"
    WRONG_WAY = "wrongWay"
    SMALL_SPAN = "smallSpan"
    NOISY = "noisy"


_WHAT_TO_DO = {
    Why.DEAD: "its sensor shows the same value whatever you do; look at its plug and cable, or tell whoever "
    "looks after the glove",
    Why.SATURATED: "its sensor is at its stop; loosen the glove at this finger, or have the amplifier of "
    "the sensor adjusted",
    Why.WRONG_WAY: "its sensor falls when the hand opens; make a fist first and open the hand then, or have "
    "the sensor turned round",
    Why.SMALL_SPAN: "it hardly moved; bend it fully in the fist, stretch it fully in the open hand, and see "
    "that the sensor lies along it",
    Why.NOISY: "it trembles or its sensor is loose; keep it still, tighten the glove, and calibrate again",
}


@dataclass(frozen=True, slots=True)
class Doubt:
    """A finger that is doubtful."""

    finger: str
    why: Why

    def as_dict(self) -> dict[str, str]:
        """Return it as it stands in answers and views."""
        return {"finger": self.finger, "why": self.why.value, "advice": _WHAT_TO_DO[self.why]}


def doubts_about(fist: Sequence[Sequence[float]], open_hand: Sequence[Sequence[float]]) -> list[Doubt]:
    """Return the doubtful fingers by frames (five raw values each, thumb first) of fist and open hand."""
    levels = [
        levels_of([frame[place] for frame in fist], [frame[place] for frame in open_hand])
        for place in range(len(FINGERS))
    ]
    sensors = [[frame[place] for frame in (*fist, *open_hand)] for place in range(len(FINGERS))]
    return list(_doubts(levels, sensors))


def lasting_doubts(calibration: Calibration) -> list[Doubt]:
    """Return the fingers of a calibration that are doubtful by their spans and noise alone."""
    return list(_doubts(calibration.levels, [[]] * len(FINGERS)))


def _doubts(levels: Sequence[FingerLevels], sensors: Sequence[Sequence[float]]) -> Iterator[Doubt]:
    usual_span = median(abs(level.span) for level in levels)
    for finger, level, values in zip(FINGERS, levels, sensors, strict=True):
        if values and min(values) == max(values):
            at_stop = values[0] in STOPS
            yield Doubt(finger, Why.SATURATED if at_stop else Why.DEAD)
        elif values and _is_at_stop(values):
            yield Doubt(finger, Why.SATURATED)
        elif level.span < -max(SMALL * usual_span, level.noise):
            yield Doubt(finger, Why.WRONG_WAY)
        elif level.span < SMALL * usual_span or level.span <= 0:
            yield Doubt(finger, Why.SMALL_SPAN)
        elif level.noise > NOISY * level.span:
            yield Doubt(finger, Why.NOISY)


def _is_at_stop(values: Sequence[float]) -> bool:
    """Say whether a sensor is at its stop in one of the two halves, as a rule."""
    return any(
        stop in STOPS and values.count(stop) >= AT_THE_STOP * len(values) / 2
        for stop in (min(values), max(values))
    )
