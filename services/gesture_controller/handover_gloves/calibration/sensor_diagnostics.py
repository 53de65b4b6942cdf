"""Sensor diagnostics: finds unreliable sensors in a calibration, with advice for the person."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from statistics import median

from handover_gloves.recognition.levels import (
    Calibration,
    FingerLevels,
    inverted_fingers,
    levels_of,
)
from handover_gloves.recognition.thresholds import FINGERS

MIN_RELATIVE_SPAN = 0.3
"""A span below this share of the median span of all fingers is small."""

MAX_NOISE = 0.12
"""Noise above this share of the span makes a finger unreliable."""

MIN_SATURATED_SHARE = 0.5
"""A sensor that shows exactly its extreme value in this share of the frames is saturated."""

SATURATION_VALUES = (0.0, 1023.0, 4095.0, 65535.0)
"""The ends of 10, 12 and 16 bit converters."""


class FaultKind(Enum):
    """What is wrong with a sensor."""

    DEAD = "dead"
    SATURATED = "saturated"
    WRONG_WAY = "wrongWay"
    SMALL_SPAN = "smallSpan"
    NOISY = "noisy"


_ADVICE = {
    FaultKind.DEAD: "its sensor shows the same value whatever you do; check its plug and cable, or ask the "
    "person who maintains the glove",
    FaultKind.SATURATED: "its sensor is at its stop; loosen the glove at this finger, or have its "
    "amplifier adjusted",
    FaultKind.WRONG_WAY: "its sensor falls when the hand opens; make a fist first and open the hand then, or "
    "have the sensor turned round",
    FaultKind.SMALL_SPAN: "it hardly moved; bend it fully in the fist, stretch it fully in the open hand, "
    "and check that the sensor lies along it",
    FaultKind.NOISY: "it trembles or its sensor is loose; keep it still, tighten the glove, and "
    "calibrate again",
}


@dataclass(frozen=True, slots=True)
class SensorFault:
    """An unreliable sensor."""

    finger: str
    kind: FaultKind

    def as_dict(self) -> dict[str, str]:
        """Return it as it stands in REST responses and views."""
        return {"finger": self.finger, "why": self.kind.value, "advice": _ADVICE[self.kind]}


def find_sensor_faults(
    fist: Sequence[Sequence[float]], open_hand: Sequence[Sequence[float]]
) -> list[SensorFault]:
    """Return the faults that frames (five raw values each, thumb first) of fist and open hand show."""
    levels = [
        levels_of([frame[place] for frame in fist], [frame[place] for frame in open_hand])
        for place in range(len(FINGERS))
    ]
    sensors = [[frame[place] for frame in (*fist, *open_hand)] for place in range(len(FINGERS))]
    return list(_faults(levels, sensors))


def find_lasting_faults(calibration: Calibration) -> list[SensorFault]:
    """Return the faults that the spans and noise of a stored calibration show."""
    return list(_faults(calibration.levels, [[]] * len(FINGERS)))


def _faults(levels: Sequence[FingerLevels], sensors: Sequence[Sequence[float]]) -> Iterator[SensorFault]:
    usual_span, inverted = median(abs(level.span) for level in levels), inverted_fingers(levels)
    for place, (finger, level, values) in enumerate(zip(FINGERS, levels, sensors, strict=True)):
        span = -level.span if place in inverted else level.span
        if values and min(values) == max(values):
            is_saturated = values[0] in SATURATION_VALUES
            yield SensorFault(finger, FaultKind.SATURATED if is_saturated else FaultKind.DEAD)
        elif values and _is_saturated(values):
            yield SensorFault(finger, FaultKind.SATURATED)
        elif span < -max(MIN_RELATIVE_SPAN * usual_span, level.noise):
            yield SensorFault(finger, FaultKind.WRONG_WAY)
        elif span < MIN_RELATIVE_SPAN * usual_span or span <= 0:
            yield SensorFault(finger, FaultKind.SMALL_SPAN)
        elif level.noise > MAX_NOISE * span:
            yield SensorFault(finger, FaultKind.NOISY)


def _is_saturated(values: Sequence[float]) -> bool:
    """Return True if the sensor is saturated in the fist or in the open hand."""
    return any(
        stop in SATURATION_VALUES and values.count(stop) >= MIN_SATURATED_SHARE * len(values) / 2
        for stop in (min(values), max(values))
    )
