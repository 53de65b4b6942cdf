"""Calibration: a person makes a fist and opens the hand, and the glove learns its thresholds.

Bent fingers are dragged upwards by their neighbours more than straight ones sag. So the band between the
thresholds lies in the upper half of the span from fist to open hand, where fingers that hold something or are
half bent stand too. (`make bench-gestures` says how well recorded hands are read.)
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from statistics import median

from handover.messages import message
from services.gesture_controller.thresholds import FINGERS, Threshold, Thresholds

BENT_BELOW = (0.45, 0.55, 0.55, 0.55, 0.50)
STRAIGHT_ABOVE = (0.60, 0.80, 0.80, 0.80, 0.60)
"""Where the thresholds stand in the span from fist (0) to open hand (1), thumb first.

A finger that is dragged along counts as bent up to three standard deviations above where such fingers stand
(0.2 ± 0.12, `population.py`). A thumb or a little finger that is stretched alone falls short of the open
hand, the others hardly do. The thumb's thresholds are where it is as likely bent as straight: the lower
beside a bent index finger, the upper beside a straight one.
"""

LEAST_FRAMES = 10
READ_RIGHT = 0.9
"""The share of the calibration's own frames that its thresholds must read right."""

_MAD_TO_SIGMA = 1.4826


class CalibrationFailed(ValueError):
    """No thresholds follow from these frames; the message names the finger and what to do."""


@dataclass(frozen=True, slots=True)
class FingerLevels:
    """What a finger's sensor shows: its level in the fist and in the open hand, and the larger noise."""

    fist: float
    open: float
    noise: float

    @property
    def span(self) -> float:
        """Return how far the sensor moves, in raw units."""
        return self.open - self.fist

    def at(self, share: float) -> float:
        """Return the sensor value at `share` of the span."""
        return round(self.fist + share * self.span, 2)


@dataclass(frozen=True, slots=True)
class Sample:
    """How a person shows the gesture with `code`: where each finger stands, and its noise, as shares."""

    code: str
    shares: tuple[float, ...]
    noise: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Calibration:
    """Thresholds, and the levels of the five fingers that they were made from."""

    thresholds: Thresholds
    levels: tuple[FingerLevels, ...]
    samples: tuple[Sample, ...] = ()
    """Gestures that the person has shown besides."""

    def as_dict(self) -> dict[str, dict[str, float]]:
        """Return the levels by finger."""
        return {
            finger: {"fist": level.fist, "open": level.open, "noise": level.noise}
            for finger, level in zip(FINGERS, self.levels, strict=True)
        }


def calibrate(fist: Sequence[Sequence[float]], open_hand: Sequence[Sequence[float]]) -> Calibration:
    """Return the calibration that follows from frames of a fist and of an open hand.

    Both are lists of frames, each five raw values, thumb first. Raises `CalibrationFailed`.
    """
    for what, frames in (("fist", fist), ("open hand", open_hand)):
        if len(frames) < LEAST_FRAMES:
            raise CalibrationFailed(
                message(
                    "calibration.too_few_frames",
                    "{frames} frames of the {what} are too few; hold it until there are {least} or more",
                    frames=len(frames),
                    what=what,
                    least=LEAST_FRAMES,
                )
            )
        if any(len(frame) != len(FINGERS) for frame in frames):
            raise CalibrationFailed(
                message(
                    "calibration.frame_incomplete",
                    "a frame of the {what} has not five values, one a finger, thumb first",
                    what=what,
                )
            )
    made = [
        _finger(finger, [frame[place] for frame in fist], [frame[place] for frame in open_hand])
        for place, finger in enumerate(FINGERS)
    ]
    doubts = list(_doubts(made))
    if doubts:
        raise CalibrationFailed(doubts[0] if len(doubts) == 1 else "; ".join(doubts))
    return Calibration(Thresholds(tuple(one.threshold for one in made)), tuple(one.levels for one in made))


@dataclass(frozen=True, slots=True)
class _Finger:
    name: str
    levels: FingerLevels
    threshold: Threshold
    bent_share: float
    straight_share: float


def levels_of(fist: Sequence[float], open_hand: Sequence[float]) -> FingerLevels:
    """Return the levels of a finger by its raw values in a fist and in an open hand."""
    return FingerLevels(median(fist), median(open_hand), round(max(_noise(fist), _noise(open_hand)), 2))


def _finger(name: str, fist: Sequence[float], open_hand: Sequence[float]) -> _Finger:
    levels = levels_of(fist, open_hand)
    place = FINGERS.index(name)
    threshold = Threshold(levels.at(STRAIGHT_ABOVE[place]), levels.at(BENT_BELOW[place]))
    bent = sum(value < threshold.lower for value in fist) / len(fist)
    straight = sum(value > threshold.upper for value in open_hand) / len(open_hand)
    return _Finger(name, levels, threshold, bent, straight)


def _noise(values: Sequence[float]) -> float:
    middle = median(values)
    return _MAD_TO_SIGMA * median(abs(value - middle) for value in values)


def _doubts(made: Sequence[_Finger]) -> Iterator[str]:
    for finger in made:
        levels = finger.levels
        fist, opened, noise = f"{levels.fist:g}", f"{levels.open:g}", f"{levels.noise:g}"
        if levels.span <= 0:
            yield message(
                "calibration.sensor_does_not_rise",
                "{finger}: the sensor does not rise when the hand opens ({fist} in the fist, {open} in the "
                "open hand, noise {noise}); check that fist and open hand are not exchanged and that the "
                "sensor lies along the finger, then calibrate again",
                finger=finger.name,
                fist=fist,
                open=opened,
                noise=noise,
            )
        elif finger.bent_share < READ_RIGHT:
            yield message(
                "calibration.fist_unclear",
                "{finger}: cannot be told bent from straight in the fist ({fist} in the fist, {open} in the "
                "open hand, noise {noise}); bend the {finger} fully, keep it still, and calibrate again",
                finger=finger.name,
                fist=fist,
                open=opened,
                noise=noise,
            )
        elif finger.straight_share < READ_RIGHT:
            yield message(
                "calibration.open_hand_unclear",
                "{finger}: cannot be told straight from bent in the open hand ({fist} in the fist, {open} in "
                "the open hand, noise {noise}); stretch the {finger} fully, keep it still, and calibrate "
                "again",
                finger=finger.name,
                fist=fist,
                open=opened,
                noise=noise,
            )
