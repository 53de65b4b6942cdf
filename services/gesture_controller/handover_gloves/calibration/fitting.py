"""Fitting: converts calibrations to the JSON values of a stored fit, and back."""

import math
from collections.abc import Mapping
from typing import Any

from handover_gloves.recognition.levels import Calibration, CalibrationSample, FingerLevels
from handover_gloves.recognition.thresholds import FINGERS, Thresholds

LEVELS, SAMPLES, OFFERED = "levels", "samples", "offered"
"""The topics of a fit."""


def learnt_from(calibration: Calibration) -> dict[str, Any]:
    """Return `calibration` as JSON values by topic."""
    samples = {
        sample.code: {"shares": list(sample.shares), "noise": list(sample.noise)}
        for sample in calibration.samples
    }
    return {LEVELS: calibration.as_dict(), SAMPLES: samples}


def calibration_from(learnt: Mapping[str, Any], thresholds: Thresholds) -> Calibration | None:
    """Return the calibration in `learnt`; None if there is none, or if it is invalid or
    shows another direction of a sensor than `thresholds`.
    """
    try:
        levels = tuple(
            FingerLevels(
                float(learnt[LEVELS][finger]["fist"]),
                float(learnt[LEVELS][finger]["open"]),
                float(learnt[LEVELS][finger]["noise"]),
            )
            for finger in FINGERS
        )
        samples = tuple(
            CalibrationSample(code, _five(frames["shares"]), _five(frames["noise"]))
            for code, frames in learnt.get(SAMPLES, {}).items()
        )
    except (KeyError, TypeError, ValueError, AttributeError):
        return None
    sound = all(
        math.isfinite(level.noise) and 0 < (-level.span if threshold.inverted else level.span) < math.inf
        for level, threshold in zip(levels, thresholds.fingers, strict=True)
    )
    return Calibration(thresholds, levels, samples) if sound else None


def _five(values: Any) -> tuple[float, ...]:
    five = tuple(float(value) for value in values)
    if len(five) != len(FINGERS) or not all(map(math.isfinite, five)):
        raise ValueError(f"five finite numbers are needed, not {values}")
    return five
