"""Shared control: a person and an autonomous motion move the tool together (IoHRT, equation 1).

    P_s(t) = [(1 - m) gamma V_h(t) + m V_r(t)] dt + P_s(t - 1)

`V_h` is the velocity that the person commands, `V_r` that of the autonomous motion to the predicted goal, `m`
from 0 (teleoperation) to 1 (autonomous). `P_s(t - 1)` is the pose that was commanded after the limiter:
velocities are blended, and the limiter integrates them, so that a limit leads to no wind-up. Orientations are
velocities of rotation (rotation vectors), never differences of angles.

Rules on `m`: it changes by `MAX_MIX_RATE` a second at most when it rises, and at once when it falls; a person
who steers or turns away from the goal gets full control, whatever `m` is asked for. When another goal is
predicted, `m` begins at 0.

The autonomous motion comes along the tool axis of its goal: beside the goal it keeps `clearance_m` before it,
and a tool that is deeper than that, as after a grip, withdraws before it moves sideways. Example: from 0.3 m
beside a part the tool moves to a point 0.08 m above it, and descends over the last centimetres.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from handover_robots.model.poses import Pose

Array = NDArray[np.float64]

MAX_MIX_RATE: Final = 1.0
"""How much `m` rises in a second."""
AWAY_COSINE: Final = -0.2
"""A commanded direction whose cosine to the way to the goal is below this steers away."""
MIN_STEERING: Final = (0.005, 0.02)
"""Velocities below these, in m/s and rad/s, count as none."""
AWAY_HORIZON_S: Final = 0.5
AWAY_SHARE: Final = 0.5
"""A command that, kept for `AWAY_HORIZON_S`, adds this share of its way to the distance steers away: at the
goal every direction does."""


@dataclass(frozen=True, slots=True)
class ApproachSpeeds:
    """How the autonomous motion approaches a goal."""

    max_linear_mps: float = 0.15
    max_angular_rps: float = 0.6
    gain_per_s: float = 2.0
    """Velocity for each m or rad of distance, near the goal."""
    clearance_m: float = 0.08
    """Between tool and goal along the tool axis, while the tool is beside the goal."""


BESIDE_FROM_M: Final = 0.01
BESIDE_AT_M: Final = 0.05
"""Sideways distances from the goal at which the clearance begins, and at which it is kept in full."""
DEEP_M: Final = 0.04
"""A tool that lacks this much of its clearance moves along the axis alone."""


def approach(here: Pose, goal: Pose, speeds: ApproachSpeeds) -> Array:
    """Return the twist (axes of the base) of the autonomous motion from `here` to `goal`."""
    way = np.subtract(goal.position, here.position)
    axis = np.array(goal.frame().rotation)[:, 2]
    along = float(way @ axis)
    across = way - along * axis
    beside = (float(np.linalg.norm(across)) - BESIDE_FROM_M) / (BESIDE_AT_M - BESIDE_FROM_M)
    clearance = speeds.clearance_m * min(max(beside, 0.0), 1.0)
    sideways = min(max(1.0 - (clearance - along) / DEEP_M, 0.0), 1.0)
    linear = ((along - clearance) * axis + sideways * across) * speeds.gain_per_s
    angular = rotation_vector(here, goal) * speeds.gain_per_s
    return np.concatenate(
        [_limited(linear, speeds.max_linear_mps), _limited(angular, speeds.max_angular_rps)]
    )


def rotation_vector(here: Pose, goal: Pose) -> Array:
    """Return the rotation from `here` to `goal` as axis times angle in rad, in axes of the base."""
    x1, y1, z1, w1 = goal.orientation
    x2, y2, z2, w2 = (-here.orientation[0], -here.orientation[1], -here.orientation[2], here.orientation[3])
    axis = np.array(
        [
            w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2,
            w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2,
            w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2,
        ]
    )
    w = w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2
    if w < 0:  # the shorter way round
        axis, w = -axis, -w
    length = float(np.linalg.norm(axis))
    if length < 1e-12:
        return np.zeros(3)
    return axis / length * (2 * math.atan2(length, w))


def blended(mix: float, gamma: float, human: Array, robot: Array) -> Array:
    """Return the velocity of equation 1."""
    return (1 - mix) * gamma * human + mix * robot


def steers_away(human: Array, here: Pose, goal: Pose) -> bool:
    """Return whether a commanded twist (axes of the base) leads or turns away from a goal."""
    ways = (np.subtract(goal.position, here.position), rotation_vector(here, goal))
    commanded = (human[:3], human[3:])
    return any(map(_leads_away, commanded, ways, MIN_STEERING))


def _leads_away(velocity: Array, way: Array, slowest: float) -> bool:
    speed, distance = float(np.linalg.norm(velocity)), float(np.linalg.norm(way))
    if speed < slowest:
        return False
    kept = float(np.linalg.norm(way - AWAY_HORIZON_S * velocity))
    return (
        float(velocity @ way) < AWAY_COSINE * speed * distance
        or kept > distance + AWAY_SHARE * AWAY_HORIZON_S * speed
    )


def arbitrated(asked: float, confidence: float, distance_m: float, effort: float) -> float:
    """Return the `m` that arbitration chooses, at most `asked`.

    It grows with the confidence in the predicted goal (0 to 1) and towards the goal, and falls with the
    effort of the person, the commanded fraction of the maximum speed: a person at rest is helped most near
    the goal.
    """
    nearness = 1 / (1 + distance_m / 0.15)
    return max(0.0, min(asked, confidence * (0.4 + 0.6 * nearness) * (1 - 0.5 * min(effort, 1.0))))


class Mixer:
    """The value of `m` over time."""

    def __init__(self) -> None:
        self.mix = 0.0

    def step(self, asked: float, dt_s: float, *, is_away: bool) -> float:
        """Return `m` after `dt_s` seconds; it rises slowly and falls at once."""
        target = 0.0 if is_away else min(max(asked, 0.0), 1.0)
        self.mix = min(target, self.mix + MAX_MIX_RATE * max(dt_s, 0.0))
        return self.mix


def _limited(vector: Array, maximum: float) -> Array:
    length = float(np.linalg.norm(vector))
    return vector if length <= maximum else vector * (maximum / length)
