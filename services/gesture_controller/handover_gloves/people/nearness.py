"""Nearness: how easily one gesture is confused with another.

The distance of two codes is the number of fingers that differ. One finger is not enough if its sensor is
unreliable. For a recorded gesture, the distance of each finger from its threshold is known in units of its
noise. Of the fingers that differ the most reliable one counts, since all of them must be misread at once.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from handover.messages import message
from handover_gloves.people.person import Sample
from handover_gloves.recognition.finger_states import STRAIGHT
from handover_gloves.recognition.gestures import RESTING
from handover_gloves.recognition.thresholds import FINGERS, Thresholds

MIN_SIGMAS = 4.0
"""A recorded gesture must be this many standard deviations of the noise away from every other gesture."""
MIN_NOISE = 0.5
"""In raw units: the resolution of a sensor that reads whole numbers."""


@dataclass(frozen=True, slots=True)
class Neighbour:
    """Another gesture and its distance; `sigmas` is None without a sample."""

    name: str
    code: str
    fingers: tuple[str, ...]
    sigmas: float | None = None

    @property
    def distance(self) -> int:
        """The number of fingers that differ."""
        return len(self.fingers)

    def __str__(self) -> str:
        """Return the distance in words."""
        if not self.fingers:
            return "no finger differs"
        words = "1 finger differs" if self.distance == 1 else f"{self.distance} fingers differ"
        noise = "" if self.sigmas is None else f", {self.sigmas:g} times the noise"
        return f"{words}: {', '.join(self.fingers)}{noise}"


def neighbours(
    code: str,
    others: Mapping[str, str],
    sample: Sample | None = None,
    thresholds: Thresholds | None = None,
    samples: Mapping[str, Sample] = MappingProxyType({}),
) -> list[Neighbour]:
    """Return `others` (codes by name), the nearest to `code` first.

    `sample` is a recording of `code`, and `samples` are recordings of some of the others with the same
    `thresholds`. Either gesture may be confused with the other, so the smaller distance counts.
    """
    near = [
        _neighbour(name, code, other, (sample, samples.get(name)), thresholds)
        for name, other in others.items()
    ]
    return sorted(near, key=lambda neighbour: (neighbour.distance, neighbour.sigmas or 0.0, neighbour.name))


@dataclass(frozen=True, slots=True)
class Rejection:
    """The reason with the remedy (half a sentence), and the gesture it is confused with, if any."""

    why: str
    other: Neighbour | None = None


def find_rejection(code: str, near: Collection[Neighbour], unreliable: Collection[str]) -> Rejection | None:
    """Return why a gesture with `code` is rejected, if it is; `unreliable` names unreliable fingers."""
    if code in RESTING:
        return Rejection(
            message(
                "gesture.resting",
                "{shape} is how a hand rests or carries and would be shown unmeant; take another, or use it "
                "as a part of a gesture of both hands or of a sequence",
                shape=RESTING[code],
            )
        )
    for neighbour in near:
        if neighbour.distance == 0:
            return Rejection(
                message(
                    "gesture.the_same",
                    'it is "{other}" (code {code}, {distance}); use that one, or take another',
                    other=neighbour.name,
                    code=code,
                    distance=str(neighbour),
                ),
                neighbour,
            )
        if neighbour.distance == 1 and neighbour.fingers[0] in unreliable:
            return Rejection(
                message(
                    "gesture.near_by_an_unreliable_finger",
                    'it is too near "{other}" (code {code}, {distance}): the sensor of the {finger} hardly '
                    "separates bent from straight; calibrate it, or use a gesture that differs elsewhere",
                    other=neighbour.name,
                    code=neighbour.code,
                    distance=str(neighbour),
                    finger=neighbour.fingers[0],
                ),
                neighbour,
            )
        if neighbour.sigmas is not None and neighbour.sigmas < MIN_SIGMAS:
            return Rejection(
                message(
                    "gesture.near_by_noise",
                    'it is too near "{other}" (code {code}, {distance}; {needed} are needed); record it '
                    "again with the fingers fully bent or stretched, or calibrate the glove",
                    other=neighbour.name,
                    code=neighbour.code,
                    distance=str(neighbour),
                    needed=f"{MIN_SIGMAS:g}",
                ),
                neighbour,
            )
    return None


def _neighbour(
    name: str,
    code: str,
    other: str,
    samples: tuple[Sample | None, Sample | None],
    thresholds: Thresholds | None,
) -> Neighbour:
    places = [place for place in range(len(FINGERS)) if code[place] != other[place]]
    fingers = tuple(FINGERS[place] for place in places)
    if thresholds is None or not places:
        return Neighbour(name, other, fingers)
    ways = [
        max(_sigmas(sample, place, shown_code[place], thresholds) for place in places)
        for sample, shown_code in zip(samples, (code, other), strict=True)
        if sample is not None
    ]
    return Neighbour(name, other, fingers, round(min(ways), 1) if ways else None)


def _sigmas(sample: Sample, place: int, state: str, thresholds: Thresholds) -> float:
    threshold, level = thresholds.fingers[place], sample.levels[place]
    margin = threshold.straight_margin(level) if state == STRAIGHT else threshold.bent_margin(level)
    return max(margin, 0.0) / max(sample.noise[place], MIN_NOISE)
