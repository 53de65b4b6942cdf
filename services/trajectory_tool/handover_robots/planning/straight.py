"""Straight motion of the tool: its tip on a line, its orientation turned evenly from start to end."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from handover_robots.planning.arm import Arm, Array
from handover_robots.planning.inverse import Inverse

STEP_M = 0.005
STEP_RAD = 0.03
MAX_STEP_RAD = 0.25
"""A joint that turns farther within one step of the tool passes a singularity, or jumps."""

MIN_SINGULAR_VALUE = 0.01
"""Below this singular value of the Jacobian, slow motion of the tool needs fast joints."""


@dataclass(frozen=True, slots=True)
class ToolLine:
    """The joints along a straight motion; `at` is the way of the tool in m (a pure turn: 0.1 m a rad)."""

    at: Array
    joints: Array


@dataclass(frozen=True, slots=True)
class Obstructed:
    """Why the tool cannot move straight: after which share of the way, with the joints until there."""

    share: float
    joints: Array
    is_singular: bool


def tool_line(arm: Arm, inverse: Inverse, start: Array, target: Any) -> ToolLine | Obstructed:
    """Return the joints along the straight motion of the tool from `start` to the `pinocchio.SE3` target."""
    begins = arm.tool(start)
    way = target.translation - begins.translation
    turn = pin.log3(begins.rotation.T @ target.rotation)
    distance_m, angle_rad = float(np.linalg.norm(way)), float(np.linalg.norm(turn))
    length = max(distance_m, 0.1 * angle_rad)
    if length < 1e-9:
        return ToolLine(np.array([0.0]), start[None, :])
    count = max(int(np.ceil(max(distance_m / STEP_M, angle_rad / STEP_RAD))), 4)
    path = [start]
    for share in np.linspace(0.0, 1.0, count + 1)[1:].tolist():
        pose = pin.SE3(begins.rotation @ pin.exp3(share * turn), begins.translation + share * way)
        guess = path[-1] if len(path) < 2 else 2 * path[-1] - path[-2]
        joints = inverse.converge(pose, guess)
        if joints is None or float(np.abs(joints - path[-1])[arm.is_turning].max(initial=0.0)) > MAX_STEP_RAD:
            singular = arm.manipulability(path[-1]) < MIN_SINGULAR_VALUE * 5
            return Obstructed(share, path[-1], singular)
        if arm.manipulability(joints) < MIN_SINGULAR_VALUE:
            return Obstructed(share, joints, True)
        path.append(joints)
    return ToolLine(np.linspace(0.0, length, count + 1), np.array(path))
