import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover.errors import HandoverError
from handover_robots.model.faults import Unreachable
from handover_robots.model.obstacles import Attached, Box, Obstacle, World
from handover_robots.model.poses import Pose, pointing_down
from handover_robots.planning.planner import NoPath, Options, Plan, Planner
from handover_robots.planning.tilt import Tilt
from handover_robots.robots import ROBOTS

EVERY_S = 0.001


@pytest.fixture(scope="module", params=["ur10", "ur5e", "panda"])
def planner(request: pytest.FixtureRequest, cell: World) -> Planner:
    return Planner(ROBOTS.load(request.param), world=cell, options=Options(optimise_s=0.0))


@pytest.fixture(scope="module")
def free_planner() -> Planner:
    return Planner(ROBOTS.load("ur10"), options=Options(optimise_s=0.0))


def assert_valid(planner: Planner, plan: Plan) -> None:
    """Check every millisecond: the limits of positions, velocity, acceleration and jerk, and no contact."""
    trajectory = plan.trajectory
    assert not list(trajectory.violations(planner.limits))
    for joints in trajectory.positions(EVERY_S):
        assert planner.arm.is_within(joints, 1e-6)
        assert planner.collisions.is_free(joints)


def over_the_bin(height_m: float) -> Pose:
    return pointing_down((0.5, 0.0, height_m), 0.3)


@pytest.mark.nightly
def test_random_motions_are_free_and_within_the_limits(planner: Planner) -> None:
    random = np.random.default_rng(7)
    here = planner.model.home
    planned = 0
    while planned < 25:
        angle, radius = random.uniform(-math.pi, math.pi), random.uniform(0.35, 0.65)
        pose = pointing_down(
            (radius * math.cos(angle), radius * math.sin(angle), random.uniform(0.15, 0.5)),
            random.uniform(-3, 3),
        )
        try:
            planner.goals(pose, np.array(here))
        except HandoverError:
            continue
        plan = planner.to_pose(here, pose)
        assert plan.trajectory.start == pytest.approx(here, abs=1e-9)
        assert planner.arm.tool_pose(plan.target).distance_m(pose) < 1e-5
        assert_valid(planner, plan)
        here = plan.target
        planned += 1


def test_the_way_leads_around_an_obstacle(planner: Planner) -> None:
    left, right = pointing_down((0.25, 0.4, 0.3)), pointing_down((0.45, 0.3, 0.3))
    start = tuple(planner.goals(left, np.array(planner.model.home))[0].tolist())
    assert_valid(planner, planner.to_pose(start, right))


def test_a_target_in_reach_is_reached_by_joints_as_they_are_given(planner: Planner) -> None:
    target = list(planner.model.home)
    target[0] -= 0.7
    plan = planner.to_joints(planner.model.home, tuple(target))
    assert plan.target == pytest.approx(target)
    assert_valid(planner, plan)


def test_a_motion_to_the_present_position_takes_no_time(planner: Planner) -> None:
    plan = planner.to_joints(planner.model.home, planner.model.home)
    assert plan.trajectory.duration_s < 0.01


def test_a_straight_motion_stays_on_its_line_and_below_its_speed(planner: Planner) -> None:
    above, below = planner.approach(planner.model.home, over_the_bin(0.3), over_the_bin(0.08))
    down = planner.straight(above.target, over_the_bin(0.08), max_tool_speed_mps=0.2)
    assert below.target == pytest.approx(down.target, abs=1e-3)
    assert_valid(planner, above)
    assert_valid(planner, down)
    tool = planner.arm.tool_positions(down.trajectory.positions(EVERY_S))
    assert np.abs(tool[:, :2] - (0.5, 0.0)).max() < 0.001
    assert tool[-1] == pytest.approx((0.5, 0.0, 0.08), abs=1e-4)
    speeds = np.linalg.norm(np.diff(tool, axis=0), axis=1) / EVERY_S
    assert speeds.max() < 0.2 * 1.01
    turned = planner.arm.tool_pose(down.trajectory.positions(EVERY_S)[len(tool) // 2]).orientation
    assert abs(np.dot(turned, over_the_bin(0.3).orientation)) == pytest.approx(1.0, abs=1e-5)


def test_waypoints_are_passed_without_a_stop(planner: Planner) -> None:
    first, second = list(planner.model.home), list(planner.model.home)
    first[0] += 0.4
    second[0] += 0.8
    second[1] -= 0.2
    plan = planner.through(planner.model.home, [tuple(first), tuple(second)])
    assert_valid(planner, plan)
    speeds = np.abs(plan.trajectory.derivative(np.linspace(0.1, 0.9, 50) * plan.trajectory.duration_s, 1))
    assert speeds.max(axis=1).min() > 0.05


def test_a_constraint_keeps_the_tool_upright(planner: Planner) -> None:
    start = tuple(planner.goals(pointing_down((0.5, 0.0, 0.35)), np.array(planner.model.home))[0].tolist())
    tilt = Tilt(max_angle_rad=0.35)
    plan = planner.to_pose(start, pointing_down((0.2, -0.42, 0.35)), tilt)
    assert_valid(planner, plan)
    axes = np.array([planner.arm.tool(joints).rotation[:, 2] for joints in plan.path])
    assert (axes @ (0, 0, -1)).min() > math.cos(0.36)


def test_a_held_part_is_carried_clear_of_the_obstacles(planner: Planner) -> None:
    rod = Attached("rod", Box((0.02, 0.02, 0.1)), Pose((0.0, 0.0, 0.03), (0.0, 0.0, 0.0, 1.0)))
    before = planner.world
    planner.world = replace(before, attached=(rod,))
    try:
        plan = planner.to_pose(planner.model.home, over_the_bin(0.3))
        assert_valid(planner, plan)
        with pytest.raises(NoPath, match=r"rod (touches|is)"):
            planner.to_pose(planner.model.home, pointing_down((0.5, 0.16, 0.16)))
    finally:
        planner.world = before


def test_the_changed_world_is_avoided(planner: Planner) -> None:
    before = planner.world
    free = planner.to_pose(planner.model.home, over_the_bin(0.3))
    planner.world = with_a_crate_on(planner, free)
    try:
        with pytest.raises(NoPath, match="crate"):
            planner.check(free.trajectory, 0.002)
        assert_valid(planner, planner.to_pose(planner.model.home, over_the_bin(0.3)))
    finally:
        planner.world = before
    planner.check(free.trajectory, 0.002)


def with_a_crate_on(planner: Planner, plan: Plan) -> World:
    """Return the world with a crate on the way of the tool, clear of the arm at its start.

    How far the search came when its time was over decides about the way, and so about the place.
    """
    before = planner.world
    way = plan.trajectory.positions(0.01)
    try:
        for joints in sorted(way, key=lambda joints: np.abs(joints - way[len(way) // 2]).max()):
            crate = Obstacle("crate", Box((0.05, 0.05, 0.05)), planner.arm.tool_pose(joints))
            planner.world = replace(before, obstacles=(*before.obstacles, crate))
            if planner.collisions.is_free(way[0], 0.01):
                return planner.world
    finally:
        planner.world = before
    raise AssertionError("the whole way is near its start")


def test_a_pose_out_of_reach_is_refused_with_the_nearest_one(planner: Planner) -> None:
    with pytest.raises(Unreachable, match=r"cannot be at \(2\.000, .*nearest it reaches is .* m away"):
        planner.to_pose(planner.model.home, pointing_down((2.0, 0.0, 0.5)))


def test_a_pose_in_contact_is_refused_with_the_pair_and_the_nearest_free_one(planner: Planner) -> None:
    with pytest.raises(NoPath, match=r"(touches|mm from) (bin-1|table).*free is \(.*back along the tool"):
        planner.to_pose(planner.model.home, over_the_bin(-0.04))


def test_joints_in_contact_are_refused_with_the_pair(planner: Planner) -> None:
    here = tuple(planner.goals(over_the_bin(0.3), np.array(planner.model.home))[0].tolist())
    before = planner.world
    box = before.obstacles[0].__class__("crate", Box((0.1, 0.1, 0.1)), over_the_bin(0.3))
    planner.world = replace(before, obstacles=(*before.obstacles, box))
    try:
        with pytest.raises(NoPath, match=r"cannot be at the target: .* touches crate"):
            planner.to_joints(planner.model.home, here)
        with pytest.raises(NoPath, match=r"cannot start here: .* touches crate"):
            planner.to_joints(here, planner.model.home)
        assert "touches crate" in str(planner.why_not_free(here))
    finally:
        planner.world = before
    assert planner.why_not_free(here) is None


def test_a_way_that_is_not_found_in_time_is_refused_with_what_is_in_the_way() -> None:
    from services.trajectory_tool.tests.unit.planning.conftest import box, upright

    fences = [box("fence", (3.0, 0.02, 3.0), upright(0.0, side, 0.0)) for side in (-0.4, 0.4)]
    roof = box("roof", (3.0, 3.0, 0.02), upright(0.0, 0.0, 1.0))
    planner = Planner(
        ROBOTS.load("ur10"),
        world=World((*fences, roof)),
        options=Options(timeout_s=0.0, optimise_s=0.0),
    )
    start = planner.model.home
    turned = (math.pi, *start[1:])
    with pytest.raises(NoPath, match=r"no way to the target was found in 0 s; .* (fence|roof)"):
        planner.to_joints(start, turned)


@pytest.mark.parametrize("joint", [0, 3])
def test_joints_beyond_a_limit_are_refused(planner: Planner, joint: int) -> None:
    target: list[Any] = list(planner.model.home)
    target[joint] = 9.0
    with pytest.raises(Unreachable, match=r"cannot be at 9\.000 rad"):
        planner.to_joints(planner.model.home, tuple(target))


@given(
    at=st.lists(st.integers(0, 3), min_size=1, max_size=6),
    apart=st.lists(
        st.sampled_from((0.0, 1e-12, 1e-9, 2e-9, 1e-7, 9e-7, 1e-6, 2e-6, 1e-4)), min_size=6, max_size=6
    ),
)
@settings(max_examples=25, deadline=None)
def test_waypoints_may_be_at_the_start_the_target_or_their_neighbours(
    free_planner: Planner, at: list[int], apart: list[float]
) -> None:
    """Each of some places, repeated in any order, with differences of rounding or none."""
    home = np.array(free_planner.model.home)
    turns = ([0, 0, 0, 0, 0, 0], [0.3, 0, 0, 0, 0, 0], [0.3, 0.1, 0, 0, 0, 0], [-0.2, 0, 0, 0, 0, 0])
    places = [home + np.array(turn) for turn in turns]
    targets = [tuple((places[number] + moved).tolist()) for number, moved in zip(at, apart, strict=False)]
    plan = free_planner.through(tuple(home.tolist()), targets)
    assert plan.target == pytest.approx(targets[-1], abs=1e-9)
    assert not list(plan.trajectory.violations(free_planner.limits))
    for target in targets:
        nearest = np.abs(plan.trajectory.positions(0.002) - np.array(target)).max(axis=1).min()
        assert nearest < 0.15  # a corner is rounded
