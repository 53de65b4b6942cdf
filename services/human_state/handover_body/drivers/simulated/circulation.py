"""What the heart of a simulated person pumps, and what follows from it: impedance, recoil, intervals.

- Impedance of the thorax: by Kubicek's equation (1966, Aerosp Med 37:1208), `SV = rho (L / Z0)^2 LVET dZ/dt`
  with rho 135 ohm cm, L 30 cm, Z0 25 ohm and LVET 0.30 s at 60 bpm, its greatest change gives back the stroke
  volume. It falls while the heart ejects, and rises with the breath.
- Ballistocardiogram of a bed or a scale: the waves H to L, with J 0.22 s after the R peak and 1.5 N at 75 ml,
  sizes as Inan et al. 2015 (IEEE J Biomed Health Inform 19:1414) review them. Movement covers it.
"""

from itertools import pairwise
from typing import Final

import numpy as np

from handover_body.drivers.simulated.beat_waves import BeatWave, Floats, beat_waves
from handover_body.drivers.simulated.person import SimulatedPerson

RESISTIVITY_OHM_CM: Final = 135.0
THORAX_CM: Final = 30.0
BASE_OHM: Final = 25.0
EJECTION_S: Final = 0.30
RISE_S: Final = 0.08
"""The width of the wave of ejection; its steepest point is `RISE_S` before its peak, 0.15 s after R."""
_IMPEDANCE_WAVES: Final[tuple[BeatWave, ...]] = ((1.0, 0.23, RISE_S, True), (0.3, 0.42, 0.09, True))
_STEEPEST: Final = np.exp(-0.5) / RISE_S
"""The greatest slope of a Gaussian of height 1, in 1/s."""
OHM_PER_ML: Final = 1 / (RESISTIVITY_OHM_CM * (THORAX_CM / BASE_OHM) ** 2 * EJECTION_S * _STEEPEST)
_RECOIL_WAVES: Final[tuple[BeatWave, ...]] = (
    (0.25, 0.10, 0.018, False),
    (-0.6, 0.155, 0.018, False),
    (1.0, 0.22, 0.020, False),
    (-0.7, 0.29, 0.022, False),
    (0.35, 0.36, 0.025, False),
)
"""H, I, J, K, L."""
NEWTON_PER_ML: Final = 1.5 / 75
MIN_INTERVALS: Final = 4
"""Fewer differences give no variability."""


def impedance(person: SimulatedPerson, times_s: Floats, random: np.random.Generator) -> Floats:
    """Return the impedance of the thorax in ohm."""
    pumped = OHM_PER_ML * person.stroke_volume_ml * beat_waves(person, times_s, _IMPEDANCE_WAVES)
    noise = random.normal(0, 0.0005 * (1 + 3 * person.effort), len(times_s))
    ohm: Floats = BASE_OHM - pumped + 0.15 * person.breath_at(times_s) + noise
    return ohm[:, None]


def recoil(person: SimulatedPerson, times_s: Floats, random: np.random.Generator) -> Floats:
    """Return the force of the body along its axis in newton."""
    wave = NEWTON_PER_ML * person.stroke_volume_ml * beat_waves(person, times_s, _RECOIL_WAVES)
    noise = random.normal(0, 0.05 + 6.0 * person.effort, len(times_s))
    return (wave + 0.4 * person.breath_at(times_s) + noise)[:, None]


def stroke_volume(person: SimulatedPerson, times_s: Floats, random: np.random.Generator) -> Floats:
    """Return ml a beat."""
    return person.stroke_volume_ml + random.normal(0, 2.0, (len(times_s), 1))


def cardiac_output(person: SimulatedPerson, times_s: Floats, random: np.random.Generator) -> Floats:
    """Return litres a minute: stroke volume times heart rate."""
    litres = person.stroke_volume_ml * person.heart_rate_bpm / 1000
    return litres * (1 + random.normal(0, 0.02, (len(times_s), 1)))


def variability(person: SimulatedPerson, times_s: Floats, random: np.random.Generator) -> Floats:
    """Return the RMSSD of the last beats in ms, as a strap computes it."""
    beats = np.array([beat for beat in person.beats_s if beat <= times_s[-1]])
    changes_s = np.diff(beats, 2)
    enough = len(changes_s) >= MIN_INTERVALS
    return np.full((len(times_s), 1), 1000 * np.sqrt(np.mean(changes_s**2)) if enough else np.nan)


def intervals(person: SimulatedPerson, begin_s: float, end_s: float) -> list[tuple[float, ...]]:
    """Return the time of each beat, and the interval before it in ms."""
    beats = list(person.beats_s)
    return [(beat, 1000 * (beat - before)) for before, beat in pairwise(beats) if begin_s <= beat < end_s]
