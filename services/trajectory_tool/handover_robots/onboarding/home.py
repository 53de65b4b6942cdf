"""The home position of a robot that is added: the tool down, near the middle of the joints, with room.

From random positions the tool is turned down by Gauss-Newton steps, while the rest of each step leads to the
middle of the joints. Of the positions on these ways whose tool is down, whose tip is above the root and from
which the tool moves well in all directions, the one nearest to the middle that is free counts. An arm without
one has the free position that is nearest to the middle, with the joints at 0 before all others.

The distance to the middle is the norm of the shares of the range of each joint.
"""

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from handover.errors import UsageError
from handover_robots.model.joints import Joints
from handover_robots.model.obstacles import World
from handover_robots.planning.arm import Arm, Array
from handover_robots.planning.collision import Collisions

CLEARANCES_M = (0.03, 0.02, 0.01, 0.005, 0.0025)
"""The largest one that some position has. A motion needs 2 mm at its start, see `Options.margins_m`."""

DEXTERITY_SHARE = 0.3
"""Of the best sampled manipulability: at less, the tool is nearly stuck in some direction."""

SAMPLES, STARTS, STEPS = 500, 40, 40
MAX_TILT_RAD = 1e-3
MAX_STEP_RAD, TO_MIDDLE, DAMPING = 0.3, 0.2, 1e-6
INSET = 1e-3
"""How far within the limits of the joints a position ends, as a share of their ranges."""
MIN_OFFSET_M = 1e-3
DOWN = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True, slots=True)
class HomePosition:
    """A home position, and whether the tool points down there."""

    joints: Joints
    is_tool_down: bool


def find_home(arm: Arm, seed: int) -> HomePosition:
    """Return a home position. Raises `UsageError` that names what touches where no position is free."""
    collisions, random = Collisions(arm, World()), np.random.default_rng(seed)
    middle = (arm.lower + arm.upper) / 2
    half = np.minimum((arm.upper - arm.lower) / 2, math.pi)  # a full turn leads to the same place

    def distance(joints: Array) -> float:
        return float(np.linalg.norm((joints - middle) / half))

    spread = sorted(random.uniform(middle - half, middle + half, (SAMPLES, arm.n)), key=distance)
    zero = np.zeros(arm.n)
    tries: list[Array] = [*([zero] if arm.is_within(zero) else []), middle, *spread]
    dexterity = [arm.manipulability(joints) for joints in tries]
    enough = DEXTERITY_SHARE * max(dexterity)
    ways = (_turned_down(arm, start, middle, half) for start in (middle, *spread[:: SAMPLES // STARTS]))
    turned = [joints for way in ways for joints in way if arm.manipulability(joints) >= enough]
    down = sorted(turned, key=distance)
    dexterous = [joints for joints, value in zip(tries, dexterity, strict=True) if value >= enough]
    for candidates, is_down in ((down, True), (dexterous, False), (tries, False)):
        for clearance_m in CLEARANCES_M:
            for joints in candidates:
                if collisions.is_free(joints, clearance_m):
                    return HomePosition(tuple(joints.tolist()), is_down)
    raise UsageError(_what_touches(collisions, tries))


def _turned_down(arm: Arm, start: Array, middle: Array, half: Array) -> Iterator[Array]:
    """Yield positions with the tool down and the tip above the root, on the way to the middle."""
    axis, joints = _tool_axis(arm, start), start
    low, high = arm.lower + INSET * half, arm.upper - INSET * half
    for _ in range(STEPS):
        tool = arm.tool(joints)
        points = tool.rotation @ axis
        across = np.cross(points, DOWN)
        sine, cosine = float(np.linalg.norm(across)), float(points @ DOWN)
        angle = math.atan2(sine, cosine)
        if angle < MAX_TILT_RAD and tool.translation[2] > float(arm.model.base.position[2]):
            yield joints
        way = across / sine if sine > 1e-9 else np.array([1.0, 0.0, 0.0])
        turning = (np.eye(3) - np.outer(points, points)) @ arm.jacobian(joints)[3:]
        inverse = turning.T @ np.linalg.inv(turning @ turning.T + DAMPING * np.eye(3))
        step = inverse @ (angle * way)
        step += (np.eye(arm.n) - inverse @ turning) @ (TO_MIDDLE * (middle - joints))
        step *= min(1.0, MAX_STEP_RAD / max(float(np.abs(step).max()), 1e-9))
        joints = np.clip(joints + step, low, high)


def _tool_axis(arm: Arm, joints: Array) -> Array:
    """Return the direction of the tool in the frame of the tip: along the axis of the last turning joint.

    It points from that joint to the tip; where the tip is at the joint, as the z axis of the tip does.
    """
    turning = np.flatnonzero(arm.is_turning)
    if not len(turning):
        return np.array([0.0, 0.0, 1.0])
    tool, jacobian = arm.tool(joints), arm.jacobian(joints)
    axis = np.asarray(tool.rotation.T @ jacobian[3:, turning[-1]])
    joint = arm.data.oMi[int(turning[-1]) + 1].translation
    along = float(tool.rotation.T @ (tool.translation - joint) @ axis)
    sign = along if abs(along) >= MIN_OFFSET_M else float(axis[2])
    return axis if sign >= 0 else -axis


def _what_touches(collisions: Collisions, tries: list[Array]) -> str:
    """Return which pairs touch in most positions."""
    touching = Counter(
        (contact.first, contact.second)
        for joints in tries
        for contact in collisions.contacts(joints, CLEARANCES_M[-1])
    )
    pairs = "; ".join(
        f"{first} and {second} in {100 * count / len(tries):.0f} % of the positions"
        for (first, second), count in touching.most_common(3)
    )
    return (
        f"no position of the joints is free of contact: {pairs} touch; make their collision shapes smaller, "
        "or disable a pair in an SRDF if it may touch: --srdf FILE"
    )
