"""Acceleration to movement, activity, steps, posture and position of sleep.

| feature | how |
|---|---|
| movement | mean amplitude deviation of the last 5 s in g, 1 at most |
| activity | its cut points: below 16.7 mg `rest`, 91 mg `light`, 414 mg `moderate`, above `vigorous` |
| steps, cadence | the period of the last 5 s, 0.8 to 4 Hz, while the acceleration is periodic |
| posture | direction of gravity at the trunk: `upright`, `reclined` from 30 degrees, `lying` from 60 |
| sleepPosition | the side of the trunk that is up while lying: `supine`, `prone`, `left`, `right` |

Movement and activity: Vähä-Ypyä et al. 2015, Clin Physiol Funct Imaging 35:64. Posture needs a sensor at
the trunk whose axes are x to the right, y forwards and z upwards; the `method` of the signal says `chest`
or `trunk` then. Others give no posture.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import signal as dsp

from handover.messages import number_text
from handover_body.model.features import Feature, FeatureName, Status
from handover_body.model.signals import Samples, SensorReport, SignalInfo

Floats = NDArray[np.float64]

METHOD: Final = "acceleration-1"
GRAVITY: Final = {"MSK": 9.80665, "K40": 1.0}
WINDOW_S: Final = 5.0
EACH_S: Final = 1.0
WORKING_HZ: Final = 25.0
CUTS_G: Final = ((0.0167, "rest"), (0.091, "light"), (0.414, "moderate"))
RECLINED_DEG: Final = 30.0
LYING_DEG: Final = 60.0


def activity_of(deviation_g: float) -> str:
    """Return the class of a mean amplitude deviation in g."""
    return next((name for limit, name in CUTS_G if deviation_g < limit), "vigorous")


def posture_of(gravity: Floats) -> tuple[str, str | None]:
    """Return the posture and, while lying, the position of sleep, of gravity (x right, y forwards, z up)."""
    unit = gravity / max(float(np.linalg.norm(gravity)), 1e-9)
    tilt = float(np.degrees(np.arccos(np.clip(unit[2], -1, 1))))
    if tilt < RECLINED_DEG:
        return "upright", None
    if tilt < LYING_DEG:
        return "reclined", None
    right, forwards = float(unit[0]), float(unit[1])
    if abs(forwards) >= abs(right):
        return "lying", "supine" if forwards > 0 else "prone"
    return "lying", "left" if right > 0 else "right"


def step_rate(size_g: Floats, rate_hz: float) -> float:
    """Return the steps per second of a window, 0 where it is not walking."""
    wave = size_g - size_g.mean()
    power = float(np.mean(wave**2))
    if power < 0.03**2:
        return 0.0
    spectrum = np.fft.rfft(wave, 4 * len(wave))
    correlation = np.fft.irfft(np.abs(spectrum) ** 2)[: len(wave)]
    correlation /= correlation[0] * (1 - np.arange(len(wave)) / len(wave) + 1e-9)
    first, last = int(rate_hz / 4), min(len(wave) // 2, int(rate_hz / 0.8))
    peaks, _ = dsp.find_peaks(correlation[first : last + 1])
    if not len(peaks):
        return 0.0
    heights = correlation[peaks + first]
    if heights.max() < 0.4:  # also where all are negative: a motion that repeats nothing
        return 0.0
    top = int(peaks[np.flatnonzero(heights >= 0.85 * heights.max())[0]]) + first
    before, here, after = correlation[top - 1 : top + 2]
    curve = before - 2 * here + after
    shift = float(np.clip(0.5 * (before - after) / curve, -0.5, 0.5)) if curve < 0 else 0.0
    return rate_hz / (top + shift)


class AccelerationProcessor:
    """Three axes in m/s2 (MSK) or g (K40), 10 Hz or more."""

    def __init__(self, info: SignalInfo) -> None:
        if info.rate_hz is None or info.rate_hz < 10 or len(info.channels) != 3 or info.unit not in GRAVITY:
            raise ValueError(
                f"movement needs three axes in MSK or K40 at 10 Hz at least, not {len(info.channels)} in "
                f"{info.unit} at {number_text(info.rate_hz)} Hz"
            )
        self._unit: Final = GRAVITY[info.unit]
        self._step: Final = max(1, int(info.rate_hz // WORKING_HZ))
        self._rate_hz: Final = info.rate_hz / self._step
        self._is_trunk: Final = any(word in info.method.lower() for word in ("chest", "trunk"))
        self._steps = 0.0
        self._reset()

    def _reset(self) -> None:
        self._window = np.empty((0, 3))
        self._rest = np.empty((0, 3))
        self._due_s = -np.inf
        self._counted_s: float | None = None

    def feed(self, samples: Samples) -> Sequence[Feature]:
        """Take samples; return features once a second, after 2 s."""
        x = np.concatenate((self._rest, samples.values / self._unit))
        whole = len(x) // self._step * self._step
        self._rest = x[whole:]
        means = x[:whole].reshape(-1, self._step, 3).mean(axis=1)
        self._window = np.concatenate((self._window, means))[-round(WINDOW_S * self._rate_hz) :]
        at_s = samples.end_s
        if len(self._window) < 2 * self._rate_hz or at_s < self._due_s:
            return []
        self._due_s = at_s + EACH_S - 0.5 / self._rate_hz
        size = np.linalg.norm(self._window, axis=1)
        deviation_g = float(np.mean(np.abs(size - size.mean())))
        steps_hz = step_rate(size, self._rate_hz) if len(self._window) >= 3 * self._rate_hz else 0.0
        # Steps are counted by the rate: each second of walking adds what it held, and a miss costs no step.
        if self._counted_s is not None:
            self._steps += steps_hz * min(at_s - self._counted_s, 2.0)
        elif steps_hz:
            self._steps += steps_hz * len(self._window) / self._rate_hz
        self._counted_s = at_s if self._counted_s is not None or steps_hz else None
        values: list[tuple[FeatureName, float | str]] = [
            (FeatureName.MOVEMENT, min(1.0, deviation_g)),
            (FeatureName.ACTIVITY, activity_of(deviation_g)),
            (FeatureName.STEPS, float(int(self._steps))),
            (FeatureName.CADENCE, 60 * steps_hz),
        ]
        if self._is_trunk:
            posture, position = posture_of(np.median(self._window[-round(2 * self._rate_hz) :], axis=0))
            values.append((FeatureName.POSTURE, posture))
            if position is not None:
                values.append((FeatureName.SLEEP_POSITION, position))
        length_s = len(self._window) / self._rate_hz
        return [
            Feature(
                name, samples.source, value, at_s, samples.quality, Status.VALID, METHOD, length_s, EACH_S
            )
            for name, value in values
        ]

    def report(self, report: SensorReport) -> Sequence[Feature]:
        """Forget the signal before a fault. The steps counted so far stay: they were made."""
        if report.fault is not None or report.has_contact is False:
            self._reset()
        return []
