"""Levels: the sensor values of a fist and of an open hand, and the thresholds calculated from them.

Neighbours lift bent fingers more than they lower straight ones. So the band between the thresholds lies in
the upper half of the span from fist to open hand; half-bent fingers and fingers around an object are there
too. `make bench-gestures` measures the recognition of recorded hands.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from statistics import median

from handover.messages import message
from handover_gloves.recognition.thresholds import FINGERS, Threshold, Thresholds

BENT_BELOW = (0.45, 0.55, 0.55, 0.55, 0.50)
STRAIGHT_ABOVE = (0.60, 0.80, 0.80, 0.80, 0.60)
"""The thresholds as shares of the span from fist (0) to open hand (1), thumb first.

A finger lifted by its neighbour counts as bent up to three standard deviations above its usual position
(0.2 ± 0.12, `population.py`). A thumb or little finger that is stretched alone does not reach the open hand;
the others nearly do. The thumb's thresholds are where bent and straight are equally likely: the lower one
beside a bent index finger, the upper one beside a straight one.
"""

MIN_FRAMES = 10
MIN_CORRECT_SHARE = 0.9
"""The share of the calibration frames that the thresholds must classify correctly."""

MAX_INVERTED = 2
"""If the sensors of more fingers fall when the hand opens, fist and open hand were exchanged."""

MIN_INVERTED_SPAN = 0.3
"""An inverted sensor falls by this share of the median span of all fingers; less is no movement."""

_MAD_TO_SIGMA = 1.4826


class CalibrationFailed(ValueError):
    """No thresholds can be calculated from these frames; the message names the finger and the remedy."""


@dataclass(frozen=True, slots=True)
class FingerLevels:
    """The level of a finger's sensor in the fist and in the open hand, and the larger noise of both."""

    fist: float
    open: float
    noise: float

    @property
    def span(self) -> float:
        """The range of the sensor, in raw units; negative for an inverted finger."""
        return self.open - self.fist

    def at(self, share: float) -> float:
        """Return the sensor value at `share` of the span."""
        return round(self.fist + share * self.span, 2)


@dataclass(frozen=True, slots=True)
class CalibrationSample:
    """A person's gesture with `code`: position and noise of each finger as shares of the span."""

    code: str
    shares: tuple[float, ...]
    noise: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Calibration:
    """Thresholds, and the levels of the five fingers that they were calculated from."""

    thresholds: Thresholds
    levels: tuple[FingerLevels, ...]
    samples: tuple[CalibrationSample, ...] = ()
    """Samples of gestures."""

    def as_dict(self) -> dict[str, dict[str, float]]:
        """Return the levels by finger."""
        return {
            finger: {"fist": level.fist, "open": level.open, "noise": level.noise}
            for finger, level in zip(FINGERS, self.levels, strict=True)
        }


def calibrate(fist: Sequence[Sequence[float]], open_hand: Sequence[Sequence[float]]) -> Calibration:
    """Return the calibration from frames of a fist and of an open hand.

    Both are lists of frames, each five raw values, thumb first. Raises `CalibrationFailed`.
    """
    for what, frames in (("fist", fist), ("open hand", open_hand)):
        if len(frames) < MIN_FRAMES:
            raise CalibrationFailed(
                message(
                    "calibration.too_few_frames",
                    "{frames} frames of the {what} are too few; hold it until there are {least} or more",
                    frames=len(frames),
                    what=what,
                    least=MIN_FRAMES,
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
    fingers = [
        _finger(finger, [frame[place] for frame in fist], [frame[place] for frame in open_hand])
        for place, finger in enumerate(FINGERS)
    ]
    faults = list(_faults(fingers))
    if faults:
        raise CalibrationFailed(faults[0] if len(faults) == 1 else "; ".join(faults))
    thresholds = Thresholds(tuple(finger.threshold for finger in fingers))
    return Calibration(thresholds, tuple(finger.levels for finger in fingers))


@dataclass(frozen=True, slots=True)
class _Finger:
    name: str
    levels: FingerLevels
    threshold: Threshold
    bent_share: float
    straight_share: float


def levels_of(fist: Sequence[float], open_hand: Sequence[float]) -> FingerLevels:
    """Return the levels of a finger from its raw values in a fist and in an open hand."""
    return FingerLevels(median(fist), median(open_hand), round(max(_noise(fist), _noise(open_hand)), 2))


def _finger(name: str, fist: Sequence[float], open_hand: Sequence[float]) -> _Finger:
    levels = levels_of(fist, open_hand)
    place = FINGERS.index(name)
    bounds = levels.at(BENT_BELOW[place]), levels.at(STRAIGHT_ABOVE[place])
    threshold = Threshold(max(bounds), min(bounds), levels.span < 0)
    bent = sum(threshold.bent_margin(value) > 0 for value in fist) / len(fist)
    straight = sum(threshold.straight_margin(value) > 0 for value in open_hand) / len(open_hand)
    return _Finger(name, levels, threshold, bent, straight)


def inverted_fingers(levels: Sequence[FingerLevels]) -> frozenset[int]:
    """Return the places of the fingers whose sensors fall clearly when the hand opens.

    There is none if so many fall that fist and open hand were exchanged.
    """
    falling = [place for place, level in enumerate(levels) if level.span < 0]
    if len(falling) > MAX_INVERTED:
        return frozenset()
    usual_span = median(abs(level.span) for level in levels)
    return frozenset(
        place
        for place in falling
        if -levels[place].span >= max(MIN_INVERTED_SPAN * usual_span, levels[place].noise)
    )


def _noise(values: Sequence[float]) -> float:
    middle = median(values)
    return _MAD_TO_SIGMA * median(abs(value - middle) for value in values)


def _faults(fingers: Sequence[_Finger]) -> Iterator[str]:
    inverted = inverted_fingers([finger.levels for finger in fingers])
    for place, finger in enumerate(fingers):
        levels = finger.levels
        fist, opened, noise = f"{levels.fist:g}", f"{levels.open:g}", f"{levels.noise:g}"
        if levels.span <= 0 and place not in inverted:
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
        elif finger.bent_share < MIN_CORRECT_SHARE:
            yield message(
                "calibration.fist_unclear",
                "{finger}: bent and straight cannot be separated in the fist ({fist} in the fist, {open} in "
                "the open hand, noise {noise}); bend the {finger} fully, keep it still, and calibrate again",
                finger=finger.name,
                fist=fist,
                open=opened,
                noise=noise,
            )
        elif finger.straight_share < MIN_CORRECT_SHARE:
            yield message(
                "calibration.open_hand_unclear",
                "{finger}: straight and bent cannot be separated in the open hand ({fist} in the fist, "
                "{open} in the open hand, noise {noise}); stretch the {finger} fully, keep it still, and "
                "calibrate again",
                finger=finger.name,
                fist=fist,
                open=opened,
                noise=noise,
            )
