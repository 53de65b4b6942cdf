"""Samples: one second of a gesture improves its recognition for this person."""

from collections.abc import Sequence
from statistics import median

from handover.messages import message
from handover_gloves.recognition.levels import (
    MIN_FRAMES,
    Calibration,
    CalibrationFailed,
    CalibrationSample,
    FingerLevels,
)
from handover_gloves.recognition.thresholds import FINGERS

MAX_SAMPLE_UNREST = 0.3
"""A finger with more noise than this share of its span was not kept still."""

_MAD_TO_SIGMA = 1.4826


def sample_of(
    code: str, frames: Sequence[Sequence[float]], levels: Sequence[FingerLevels]
) -> CalibrationSample:
    """Return the sample of the gesture with `code` from `frames` (five raw values each, thumb first).

    `levels` belong to the person's calibration. Raises `CalibrationFailed` if there are too few frames, or if
    a finger moved.
    """
    if len(frames) < MIN_FRAMES:
        raise CalibrationFailed(
            message(
                "calibration.too_few_gesture_frames",
                "{frames} frames of the gesture are too few; hold it until there are {least} or more",
                frames=len(frames),
                least=MIN_FRAMES,
            )
        )
    if any(len(frame) != len(FINGERS) for frame in frames):
        raise CalibrationFailed(
            message(
                "calibration.gesture_frame_incomplete",
                "a frame of the gesture has not five values, one a finger, thumb first",
            )
        )
    shares, noise = [], []
    for place, (finger, level) in enumerate(zip(FINGERS, levels, strict=True)):
        positions = [(frame[place] - level.fist) / level.span for frame in frames]
        usual = median(positions)
        unrest = _MAD_TO_SIGMA * median(abs(stand - usual) for stand in positions)
        if unrest > MAX_SAMPLE_UNREST:
            raise CalibrationFailed(
                message(
                    "calibration.finger_moved",
                    "{finger}: moved while the gesture was shown; keep the {finger} still for a "
                    "second, and show it again",
                    finger=finger,
                )
            )
        shares.append(round(usual, 4))
        noise.append(round(unrest, 4))
    return CalibrationSample(code, tuple(shares), tuple(noise))


def with_sample(calibration: Calibration, sample: CalibrationSample) -> Calibration:
    """Return `calibration` with `sample` in place of an older one of the same gesture."""
    others = tuple(other for other in calibration.samples if other.code != sample.code)
    return Calibration(calibration.thresholds, calibration.levels, (*others, sample))
