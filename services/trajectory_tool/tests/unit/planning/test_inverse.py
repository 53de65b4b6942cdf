import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from handover_robots.model.poses import pointing_down
from handover_robots.planning.arm import Arm
from handover_robots.planning.inverse import Inverse
from handover_robots.robots import ROBOTS


@pytest.fixture(scope="module", params=["ur10", "ur10 without closed form", "ur5e", "panda"])
def inverse(request: pytest.FixtureRequest) -> Inverse:
    model = ROBOTS.load(request.param.split()[0])
    if "without" in request.param:
        model = dataclasses.replace(model, solutions=None)
    return Inverse(Arm(model))


def reachable(inverse: Inverse, count: int) -> Any:
    arm = inverse.arm
    low, high = np.maximum(arm.lower, -math.pi), np.minimum(arm.upper, math.pi)
    return np.random.default_rng(6).uniform(low, high, (count, arm.n))


def test_nearly_every_reachable_pose_is_solved_within_the_limits(inverse: Inverse) -> None:
    home = np.array(inverse.arm.model.home)
    poses = [inverse.arm.tool_pose(joints) for joints in reachable(inverse, 500)]
    solved = 0
    for pose in poses:
        solution = inverse.solve(pose, home)
        if solution is not None:
            solved += 1
            assert inverse.arm.is_within(solution)
            reached = inverse.arm.tool_pose(solution)
            assert reached.distance_m(pose) < 1e-5
            dot = abs(sum(a * b for a, b in zip(reached.orientation, pose.orientation, strict=True)))
            assert dot == pytest.approx(1.0, abs=1e-6)
    assert solved >= 0.996 * len(poses)


def test_several_solutions_are_distinct_and_the_nearest_comes_first(inverse: Inverse) -> None:
    home = np.array(inverse.arm.model.home)
    pose = inverse.arm.tool_pose(home + 0.1)
    solutions = inverse.several(pose, home, 4)
    assert len(solutions) > 1
    efforts = [float(np.abs(solution - home).max()) for solution in solutions]
    assert efforts == sorted(efforts)
    for number, solution in enumerate(solutions):
        assert all(np.abs(solution - other).max() > 1e-4 for other in solutions[:number])


def test_an_accepted_solution_is_asked_for(inverse: Inverse) -> None:
    home = np.array(inverse.arm.model.home)
    pose = inverse.arm.tool_pose(home)
    solution = inverse.solve(pose, home, lambda joints: float(np.abs(joints - home).max()) > 0.3)
    assert solution is not None
    assert float(np.abs(solution - home).max()) > 0.3
    assert inverse.arm.tool_pose(solution).distance_m(pose) < 1e-5


def test_an_unreachable_pose_has_no_solution_but_a_nearest_pose(inverse: Inverse) -> None:
    home = np.array(inverse.arm.model.home)
    far = pointing_down((2.0, 0.0, 0.5))
    assert inverse.solve(far, home) is None
    nearest = inverse.nearest(far, home)
    assert 0.5 < nearest.distance_m < 1.3
    assert nearest.pose.distance_m(far) == pytest.approx(nearest.distance_m)
    assert inverse.arm.is_within(nearest.joints)
