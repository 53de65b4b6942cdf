"""The gait of a simulated person: joints, their moments, a shank, the parameters of each stride.

Curves over a stride, from one heel strike to the next one of the same leg, are sums of a cosine and of
Gaussians after the normal walk of adults (Winter 1991, "The biomechanics and motor control of human gait"):
hip from 30 degrees flexed to 10 extended, knee 18 degrees in stance and 60 in swing, ankle from 10 degrees up
to 18 down at toe-off; moments for a mass of 75 kg. They grow with the root of the speed. Both legs are alike,
half a stride apart. Who does not walk has the angles of the posture, and no moments.
"""

import math
from typing import Final

import numpy as np

from handover_body.drivers.simulated.beat_waves import Floats
from handover_body.drivers.simulated.person import Posture, SimulatedPerson

JOINTS: Final = ("hip_left", "knee_left", "ankle_left", "hip_right", "knee_right", "ankle_right")
MASS_KG: Final = 75.0
USUAL_MPS: Final = 1.3
"""The speed for which the curves are drawn."""
STANCE: Final = 0.62
STANCE_PER_MPS: Final = -0.04
"""The share of the stride on the ground at 1.3 m/s, and how it changes with the speed."""
MAX_STRIDE_S: Final = 5.0
"""Longer ones were interrupted."""
STRIDE_RAD: Final = 2 * math.tau
"""Of the phase of the gait, in which a turn is a step."""
_BENT: Final[dict[Posture, tuple[float, float, float]]] = {
    "sitting": (85.0, 90.0, 0.0),
    "lyingLeft": (40.0, 45.0, -5.0),
    "lyingRight": (40.0, 45.0, -5.0),
}
"""Hip, knee and ankle in degrees; all 0 in other postures."""
_SLOPE: Final = 1e-4
"""The part of a stride over which a slope is computed."""


def joint_angles(person: SimulatedPerson, times_s: Floats, random: np.random.Generator) -> Floats:
    """Return flexion of hips and knees and dorsiflexion of ankles, in degrees."""
    noise = random.normal(0, 0.3, (len(times_s), len(JOINTS)))
    if not person.is_walking:
        return np.array(2 * _BENT.get(person.posture, (0.0, 0.0, 0.0))) + noise
    stride = _stride(person, times_s)
    legs = (_angles(stride), _angles(stride + 0.5))
    return _size(person) * np.column_stack([joint for leg in legs for joint in leg]) + noise


def joint_moments(person: SimulatedPerson, times_s: Floats, random: np.random.Generator) -> Floats:
    """Return the moments of extensors of hips and knees and of plantarflexors, in N m."""
    noise = random.normal(0, 0.5, (len(times_s), len(JOINTS)))
    if not person.is_walking:
        return noise
    stride = _stride(person, times_s)
    legs = (_moments(stride), _moments(stride + 0.5))
    return MASS_KG * _size(person) * np.column_stack([joint for leg in legs for joint in leg]) + noise


def shank_velocity(person: SimulatedPerson, times_s: Floats, random: np.random.Generator) -> Floats:
    """Return the angular velocity of the left shank in rad/s; y is the axis across, forwards above 0."""
    velocity = random.normal(0, 0.02, (len(times_s), 3))
    if person.is_walking:
        stride = _stride(person, times_s)
        turned_deg = _shank_deg(stride + _SLOPE / 2) - _shank_deg(stride - _SLOPE / 2)
        velocity[:, 1] += _size(person) * np.radians(turned_deg) / _SLOPE * person.steps_hz / 2
    return velocity


def steps(person: SimulatedPerson, times_s: Floats, random: np.random.Generator) -> Floats:
    """Return the steps since the sensor was started."""
    return np.floor(person.gait_at(times_s) / math.tau)[:, None]


def strides(person: SimulatedPerson, begin_s: float, end_s: float) -> list[tuple[float, ...]]:
    """Return the end of each stride, and its `GAIT_CHANNELS`."""
    if not person.is_walking:
        return []
    turns = person.gait_at(np.array([begin_s, end_s])) / STRIDE_RAD
    ends = np.arange(math.ceil(turns[0]), math.ceil(turns[1]))
    speed_mps = person.gait_mps
    stance = STANCE + STANCE_PER_MPS * (speed_mps - USUAL_MPS)
    shares = (stance, 2 * stance - 1, 0.0)
    walked: list[tuple[float, ...]] = []
    for end in ends[ends > 0]:
        began_s, ended_s = person.gait_times_s(STRIDE_RAD * np.array([end - 1, end]))
        lasted_s = float(ended_s - began_s)
        if lasted_s <= MAX_STRIDE_S:
            step_m = speed_mps * lasted_s / 2
            walked.append((float(ended_s), speed_mps, 120 / lasted_s, step_m, lasted_s, *shares))
    return walked


def _stride(person: SimulatedPerson, times_s: Floats) -> Floats:
    stride: Floats = person.gait_at(times_s) / STRIDE_RAD
    return stride


def _size(person: SimulatedPerson) -> float:
    return min(math.sqrt(person.gait_mps / USUAL_MPS), 1.3)


def _bump(stride: Floats, at: float, width: float) -> Floats:
    """Return a Gaussian around a part of each stride, 1 high."""
    away = np.mod(stride - at + 0.5, 1.0) - 0.5
    bump: Floats = np.exp(-0.5 * (away / width) ** 2)
    return bump


def _angles(stride: Floats) -> tuple[Floats, Floats, Floats]:
    hip = 10 + 20 * np.cos(math.tau * stride)
    knee = 4 + 14 * _bump(stride, 0.14, 0.06) + 56 * _bump(stride, 0.72, 0.085)
    ankle = -5 * _bump(stride, 0.07, 0.03) + 10 * _bump(stride, 0.42, 0.12) - 22 * _bump(stride, 0.63, 0.05)
    return hip, knee, ankle


def _moments(stride: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the moments in N m a kg."""
    hip = 0.6 * _bump(stride, 0.08, 0.06) - 0.7 * _bump(stride, 0.52, 0.09) + 0.3 * _bump(stride, 0.93, 0.05)
    knee = (
        0.5 * _bump(stride, 0.15, 0.05) - 0.2 * _bump(stride, 0.42, 0.07) - 0.25 * _bump(stride, 0.92, 0.05)
    )
    ankle = 1.5 * _bump(stride, 0.47, 0.09)
    return hip, knee, ankle


def _shank_deg(stride: Floats) -> Floats:
    hip, knee, _ = _angles(stride)
    return hip - knee
