"""Recorded gestures: the code that a second of frames shows, or the reason why it is unclear."""

from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from statistics import median

from handover_gloves.people.person import Sample
from handover_gloves.recognition.finger_states import BETWEEN, finger_states
from handover_gloves.recognition.thresholds import FINGERS, Thresholds

MIN_FRAMES = 10
MIN_STEADY_SHARE = 0.8
"""The share of the frames that must show the same code."""
_MAD_TO_SIGMA = 1.4826


class UnclearSample(ValueError):
    """The frames do not show one clear gesture; the message names the finger and the remedy."""


def read_sample(glove: str, frames: Sequence[Sequence[float]], thresholds: Thresholds) -> tuple[str, Sample]:
    """Return the code that `frames` (five raw values each, thumb first) show, and the sample.

    Raises `UnclearSample` if there are too few frames, or if the hand moved.
    """
    if len(frames) < MIN_FRAMES:
        raise UnclearSample(
            f"{len(frames)} frames are too few for a gesture; hold it until there are {MIN_FRAMES} or more"
        )
    if any(len(frame) != len(FINGERS) for frame in frames):
        raise UnclearSample("a frame has not five values, one a finger, thumb first")
    codes = Counter(finger_states(frame, thresholds) for frame in frames)
    code, times = codes.most_common(1)[0]
    levels = tuple(median(values) for values in zip(*frames, strict=True))
    if times < MIN_STEADY_SHARE * len(frames):
        raise UnclearSample(_unsteady(codes, len(frames)))
    between = [place for place, state in enumerate(code) if state == BETWEEN]
    if between:
        raise UnclearSample("; ".join(_neither(place, levels[place], thresholds) for place in between))
    return code, Sample(glove, levels, tuple(_noise(values) for values in zip(*frames, strict=True)))


def _unsteady(codes: Counter[str], total: int) -> str:
    moved = []
    for place, finger in enumerate(FINGERS):
        states: Counter[str] = Counter()
        for code, times in codes.items():
            states[code[place]] += times
        if states.most_common(1)[0][1] < MIN_STEADY_SHARE * total:
            moved.append(finger)
    who = " and ".join([", ".join(moved[:-1]), moved[-1]] if moved[1:] else moved) or "more than one finger"
    share = round(100 * codes.most_common(1)[0][1] / total)
    return (
        f"the hand moved: {who} changed, and the code seen most often fills only {share} % of the sample; "
        "make the gesture first, then record it while the hand keeps still"
    )


def _neither(place: int, level: float, thresholds: Thresholds) -> str:
    finger, threshold = FINGERS[place], thresholds.fingers[place]
    return (
        f"the {finger} is neither bent nor straight ({level:g}, between {threshold.lower:g} and "
        f"{threshold.upper:g}); bend or stretch it fully, or calibrate the glove"
    )


def _noise(values: Sequence[float]) -> float:
    """Return the noise (1 sigma) from frame to frame, without slow drift."""
    steps = [abs(after - before) for before, after in pairwise(values)]
    return round(_MAD_TO_SIGMA * median(steps) / 2**0.5, 3)
