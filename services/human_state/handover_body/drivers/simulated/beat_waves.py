"""Waves that come with each beat: sums of Gaussians in the time after it.

McSharry, Clifford, Tarassenko, Smith, "A dynamical model for generating synthetic electrocardiogram signals",
IEEE TBME 50(3), 2003, without the integration, so that each sample depends on its time only and rates may
change at every beat. `neurokit2` has the integrated model, but for whole records at one rate; a test compares
what it detects with our beats.
"""

import numpy as np
from numpy.typing import NDArray

from handover_body.drivers.simulated.person import SimulatedPerson

Floats = NDArray[np.float64]
BeatWave = tuple[float, float, float, bool]
"""Amplitude; time after the R peak and width in s at 60 bpm; whether both grow with RR's root (Bazett)."""


def beat_waves(person: SimulatedPerson, times_s: Floats, waves: tuple[BeatWave, ...]) -> Floats:
    """Return the sum of the waves of all beats at `times_s`."""
    beats = np.array([beat for beat in person.beats_s if times_s[0] - 1.5 < beat < times_s[-1] + 0.5])
    value = np.zeros(len(times_s))
    if len(beats) == 0:
        return value
    intervals = np.diff(beats, append=beats[-1] + 60 / person.heart_rate_bpm)
    since_s = times_s[None, :] - beats[:, None]
    stretch = np.sqrt(np.clip(intervals, 0.25, 2.0))[:, None]
    for amplitude, offset_s, width_s, is_stretched in waves:
        scale = stretch if is_stretched else 1.0
        value += (amplitude * np.exp(-0.5 * ((since_s - offset_s * scale) / (width_s * scale)) ** 2)).sum(
            axis=0
        )
    return value
