"""Robots that people move at the same time keep apart, whatever is commanded."""

import random
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from handover_robots.limits.jog import Jog
from handover_robots.limits.limiter import JointLimiter
from handover_robots.limits.neighbours import CLEARANCE_M, MovingRobots, NeighbourGuard
from handover_robots.model.joints import Joints
from handover_robots.model.obstacles import Attached, Box, World
from handover_robots.model.poses import Pose
from handover_robots.model.robot_model import RobotModel
from handover_robots.planning import is_available
from handover_robots.robots import ROBOTS

pytestmark = pytest.mark.skipif(not is_available(), reason="the extra motion has no wheels here")

CYCLE_S = 0.008
UR10 = ROBOTS.load("ur10")
INWARDS = (0.0, -1.2, 1.2, -1.57, -1.57, 0.0)
PART = (Attached("part", Box((0.04, 0.04, 0.2)), Pose((0.0, 0.0, 0.1), (0.0, 0.0, 0.0, 1.0))),)


def at(x: float) -> RobotModel:
    return UR10.mounted(Pose((x, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)).frame())


class Pair:
    """Two robots that face each other, both moved by hand; the first carries a part."""

    def __init__(self, apart_m: float, starts: Sequence[Joints]) -> None:
        self.models = (at(0.0), at(apart_m))
        self.robots = MovingRobots()
        self.arms: list[Any] = []
        self.joints = list(starts)
        self.limiters = []
        for number, model in enumerate(self.models):
            name = f"ur10-{number + 1}"
            self.robots.add(
                name, model, lambda number=number: self.joints[number], lambda number=number: PART[number:]
            )
            ranges = [(joint.lower, joint.upper) for joint in model.joints]
            self.limiters.append(JointLimiter(model.limits, ranges, [NeighbourGuard(name, self.robots)]))

    def distance_m(self) -> float:
        """Return the exact distance of the robots, from a model of its own."""
        from handover_robots.planning.arm import Arm
        from handover_robots.planning.collision import Collisions
        from handover_robots.planning.volumes import occupied

        self.arms = self.arms or [Arm(model) for model in self.models]
        other = tuple(occupied("other", self.arms[1], self.joints[1], (), 0.0))
        clearances = Collisions(self.arms[0], World(other, PART)).distances(np.array(self.joints[0]))
        return min(
            clearance.distance_m
            for clearance in clearances
            if {clearance.first[:5], clearance.second[:5]} & {"other"}
        )

    def run(self, commands: list[Joints], seconds: float, chance: random.Random | None = None) -> list[float]:
        """Move both; return the distances of some cycles. `chance` delays the cycles of one of them."""
        now_s, ends_s = 5.0, 5.0 + seconds
        jogs = [
            Jog(start, lambda number=number: commands[number], lambda: now_s >= ends_s, self.limiters[number])
            for number, start in enumerate(self.joints)
        ]
        for limiter, start in zip(self.limiters, self.joints, strict=True):
            limiter.start(start, now_s)
        distances_m, cycle = [], 0
        while not all(jog.is_over(now_s) for jog in jogs):
            for number, jog in enumerate(jogs):
                if chance is not None and chance.random() < 0.2:
                    continue  # this cycle is late
                setpoint = self.limiters[number].limit(jog.at(now_s), now_s)
                self.joints[number] = setpoint.positions
            if chance is not None and cycle % 20 == 0:
                commands[chance.randrange(2)] = tuple(chance.uniform(-1.5, 1.5) for _ in range(6))
            if cycle % 25 == 0:
                distances_m.append(self.distance_m())
            now_s, cycle = now_s + CYCLE_S, cycle + 1
        return distances_m


@pytest.mark.parametrize("seed", range(3))
def test_robots_that_are_moved_at_random_never_come_nearer_than_the_clearance(seed: int) -> None:
    pair = Pair(1.1, (INWARDS, INWARDS))
    distances_m = pair.run([(0.0,) * 6, (0.0,) * 6], 4.0, random.Random(seed))
    assert min(distances_m) > CLEARANCE_M - 0.001
    assert max(distances_m) - min(distances_m) > 0.05, "they have moved"


@pytest.mark.nightly
def test_robots_that_are_moved_towards_each_other_come_near_and_can_be_moved_apart() -> None:
    towards: Joints = (0.0, 0.5, 0.0, 0.0, 0.0, 0.0)
    pair = Pair(1.95, ((3.14, *INWARDS[1:]), INWARDS))
    begin_m = pair.distance_m()
    near_m = pair.run([towards, towards], 5.0)[-1]
    assert CLEARANCE_M - 0.001 < near_m < min(begin_m - 0.05, 0.25)
    away: Joints = (0.0, -0.5, 0.0, 0.0, 0.0, 0.0)
    assert pair.run([away, (0.0,) * 6], 1.5)[-1] > near_m + 0.1


def test_robots_that_are_too_near_may_only_move_apart() -> None:
    pair = Pair(1.7, ((3.14, *INWARDS[1:]), INWARDS))  # as somebody has pushed them
    near_m = pair.distance_m()
    assert 0 < near_m < CLEARANCE_M
    towards: Joints = (0.0, 0.3, 0.0, 0.0, 0.0, 0.0)
    assert pair.run([towards, towards], 1.0)[-1] >= near_m - 0.001
    away: Joints = (0.0, -0.3, 0.0, 0.0, 0.0, 0.0)
    assert pair.run([away, (0.0,) * 6], 2.0)[-1] > near_m + 0.05


def test_robots_that_cannot_reach_each_other_are_not_compared() -> None:
    pair = Pair(5.0, (INWARDS, INWARDS))
    for limiter in pair.limiters:
        limiter.start(INWARDS, 0.0)
    assert [robot.neighbours for robot in pair.robots._robots.values()] == [(), ()]


def test_capsules_contain_the_links() -> None:
    import pinocchio as pin

    from handover_robots.planning.capsules import LinkCapsules

    chance = np.random.default_rng(5)
    for name in ("ur10", "panda"):
        model = ROBOTS.load(name)
        capsules = LinkCapsules(model)
        arm = capsules._arm
        for _ in range(20):
            lower = np.array([max(joint.lower or -3.0, -3.0) for joint in model.joints])
            upper = np.array([min(joint.upper or 3.0, 3.0) for joint in model.joints])
            middle = chance.uniform(lower, upper)
            half = chance.uniform(0.0, 0.1, len(lower))
            starts, ends, radii = capsules.within(middle - half, middle + half)
            joints = middle + chance.uniform(-1, 1, len(lower)) * half
            pin.forwardKinematics(arm.pin_model, arm.data, joints)
            for number, item in enumerate(arm.geometry.geometryObjects):
                item.geometry.computeLocalAABB()
                centre = (arm.data.oMi[item.parentJoint] * item.placement).act(
                    np.array(item.geometry.aabb_center)
                )
                way = ends[number] - starts[number]
                share = np.clip((centre - starts[number]) @ way / max(way @ way, 1e-12), 0, 1)
                assert np.linalg.norm(centre - starts[number] - share * way) <= radii[number] + 1e-9
                assert np.linalg.norm(centre - capsules.centre) <= capsules.reach_m + 1e-9
