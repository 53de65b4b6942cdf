"""The limiter under random commands: every limit holds at each sample of 1 ms."""

import math
import random
import re
from dataclasses import replace
from itertools import pairwise
from typing import Any

import pytest

from handover_robots.limits.guards import (
    CollisionGuard,
    ToolSpeedGuard,
    TorqueGuard,
    tool_speed_mps,
)
from handover_robots.limits.jog import Jog
from handover_robots.limits.limiter import JointLimiter, WayToRest
from handover_robots.model.faults import RobotFault
from handover_robots.model.joints import Joints
from handover_robots.model.obstacles import Box, Obstacle, World
from handover_robots.model.poses import Pose
from handover_robots.model.trajectory import Course, Limits, Setpoint
from handover_robots.planning import is_available
from handover_robots.robots import ROBOTS

CYCLE_S = 0.001
UPRIGHT = (0.0, 0.0, 0.0, 1.0)
UR10 = ROBOTS.load("ur10")
RANGES = [(joint.lower, joint.upper) for joint in UR10.joints]


def limiter_of(*guards: object) -> JointLimiter:
    return JointLimiter(UR10.limits, RANGES, guards)  # type: ignore[arg-type]


def require_limits(setpoints: list[Setpoint], exact: float = 1 + 1e-6) -> None:
    """Require the limits of each setpoint, and those of the change from one to the next."""
    limits = UR10.limits
    for setpoint in setpoints:
        for number, (lower, upper) in enumerate(RANGES):
            assert lower is None or setpoint.positions[number] >= lower - 1e-6
            assert upper is None or setpoint.positions[number] <= upper + 1e-6
            assert abs(setpoint.velocities[number]) <= limits.velocity[number] * exact
            assert abs(setpoint.accelerations[number]) <= limits.acceleration[number] * exact
    for setpoint, following in pairwise(setpoints):
        for limit, before, after in (
            (limits.velocity, setpoint.positions, following.positions),
            (limits.acceleration, setpoint.velocities, following.velocities),
            (limits.jerk, setpoint.accelerations, following.accelerations),
        ):
            for most, a, b in zip(limit, before, after, strict=True):
                assert abs(b - a) <= most * CYCLE_S * exact + 1e-9


def random_velocity(chance: random.Random) -> Joints:
    """Return a command: moderate, beyond every limit, zero, or along one joint."""
    match chance.randrange(4):
        case 0:
            return (0.0,) * 6
        case 1:
            return tuple(chance.uniform(-20, 20) for _ in range(6))
        case 2:
            return tuple(chance.uniform(-1, 1) for _ in range(6))
        case _:
            number = chance.randrange(6)
            return tuple(chance.choice([-3.0, 3.0]) if joint == number else 0.0 for joint in range(6))


def jogged(limiter: JointLimiter, chance: random.Random, seconds: float) -> list[Setpoint]:
    """Return the setpoints of random commands with changes of the pace, to rest at the end."""
    command: list[Joints] = [(0.0,) * 6]
    now_s, ends_s, changes_s, pace = 5.0, 5.0 + seconds, 0.0, 1.0
    jog = Jog(UR10.home, lambda: command[0], lambda: now_s >= ends_s, limiter)
    limiter.start(UR10.home, now_s)
    setpoints = []
    while True:
        if now_s >= changes_s:
            command[0], changes_s = random_velocity(chance), now_s + chance.uniform(0.001, 0.8)
            pace = chance.choice([1.0, 1.0, 0.5, 0.02])
        setpoints.append(limiter.limit(jog.at(now_s, pace=pace), now_s))
        if jog.is_over(now_s):
            return setpoints
        now_s += CYCLE_S


@pytest.mark.parametrize("seed", range(12))
def test_jogging_never_violates_a_limit(seed: int) -> None:
    setpoints = jogged(limiter_of(), random.Random(seed), 4.0)
    require_limits(setpoints)
    assert setpoints[-1].is_at_rest
    assert max(abs(a - b) for a, b in zip(setpoints[-1].positions, UR10.home, strict=True)) > 0.01


def test_a_joint_whose_brake_motion_ends_at_rest_but_for_rounding_can_stop() -> None:
    accelerations = (15.0, -7.5, -10.0, 12.5, -15.0, 20.0, 20.0)
    limits = Limits(
        (2.0,) * 7,
        tuple(map(abs, accelerations)),
        tuple(500 * abs(acceleration) for acceleration in accelerations),
    )
    limiter = JointLimiter(limits)
    velocities = tuple(
        -math.copysign(acceleration * acceleration / 2 / (500 * abs(acceleration)), acceleration)
        for acceleration in accelerations
    )
    rounded = tuple(velocity + math.copysign(4.4e-15, velocity) for velocity in velocities)
    limiter.resume(Setpoint((0.0,) * 7, rounded, accelerations), 0.0)
    assert limiter.step((0.0,) * 7, 0.1).velocities == (0.0,) * 7
    assert limiter.brake(0.2).velocities == (0.0,) * 7


@pytest.mark.parametrize("seed", range(3))
def test_the_box_of_a_way_to_rest_has_the_whole_way(seed: int) -> None:
    chance, limiter = random.Random(seed), limiter_of()
    for _ in range(300):
        still = [chance.random() < 0.3 for _ in range(6)]
        fastest = chance.choice([2.0, 0.1, 0.01])
        velocities = tuple(0.0 if rests else chance.uniform(-fastest, fastest) for rests in still)
        accelerations = tuple(0.0 if rests else chance.uniform(-8, 8) for rests in still)
        start = Setpoint(tuple(chance.uniform(-3, 3) for _ in range(6)), velocities, accelerations)
        profile = limiter._to_velocity(start)
        way = WayToRest(start, profile, UR10.limits.jerk)
        lower, upper = way.box
        for number in range(101):
            positions = profile.at_time(profile.duration * number / 100)[0]
            for low, position, high in zip(lower, positions, upper, strict=True):
                assert low - 1e-9 <= position <= high + 1e-9
        assert way[0] is start
        assert list(way)[-1].is_at_rest
        assert way[::2] == [way[0], way[2], way[4], way[6]]
        for low, high, velocity in zip(lower, upper, velocities, strict=True):
            assert high - low < 1e-3 + 4 * profile.duration * (abs(velocity) + 1), "it is not much larger"


def test_a_joint_that_is_jogged_to_its_end_stops_there() -> None:
    limiter = limiter_of()
    limiter.start(UR10.home, 0.0)
    setpoints = []
    for cycle in range(8000):
        now_s = cycle * CYCLE_S
        setpoints.append(limiter.limit(limiter.step((0.0, 0.0, 3.0, 0.0, 0.0, 0.0), now_s), now_s))
    require_limits(setpoints)
    upper = RANGES[2][1]
    assert upper is not None
    assert upper - 0.05 < setpoints[-1].positions[2] <= upper + 1e-6
    assert abs(setpoints[-1].velocities[2]) < 0.05


@pytest.mark.parametrize("seed", range(4))
def test_the_tool_is_slow_in_reduced_mode(seed: int) -> None:
    limiter = limiter_of(ToolSpeedGuard(UR10, lambda: 0.25))
    setpoints = jogged(limiter, random.Random(seed), 1.5)
    require_limits(setpoints)
    assert 0.02 < max(tool_speed_mps(UR10, setpoint) for setpoint in setpoints) <= 0.25


@pytest.mark.skipif(not is_available(), reason="the extra motion has no wheels here")
@pytest.mark.parametrize("seed", range(4))
def test_jogging_never_touches_the_table_or_the_robot(seed: int) -> None:
    import numpy as np

    from handover_robots.planning.arm import Arm
    from handover_robots.planning.collision import Collisions

    world = World(
        (
            Obstacle("table", Box((3.0, 3.0, 0.05)), Pose((0.0, 0.0, -0.03), UPRIGHT)),
            Obstacle("wall", Box((0.05, 3.0, 2.0)), Pose((-0.9, 0.0, 1.0), UPRIGHT)),
        ),
    )
    setpoints = jogged(limiter_of(CollisionGuard(UR10, lambda: world)), random.Random(seed), 3.0)
    require_limits(setpoints)
    collisions = Collisions(Arm(UR10), world)
    assert all(collisions.is_free(np.array(setpoint.positions)) for setpoint in setpoints)


@pytest.mark.skipif(not is_available(), reason="the extra motion has no wheels here")
def test_a_motion_into_the_table_is_a_fault_that_names_both() -> None:
    table = Obstacle("table", Box((3.0, 3.0, 0.05)), Pose((0.0, 0.0, -0.03), UPRIGHT))
    limiter = limiter_of(CollisionGuard(UR10, lambda: World((table,))))
    limiter.start(UR10.home, 0.0)
    course = Course(UR10.home, (0.0, 0.3, 0.0, -1.5, -1.5, 0.0), UR10.limits, UR10.limits, 0.0)

    def follow() -> None:
        for cycle in range(int(course.remaining_s(0.0) / CYCLE_S)):
            limiter.limit(course.at(cycle * CYCLE_S), cycle * CYCLE_S)

    with pytest.raises(RobotFault, match="would touch table"):
        follow()


@pytest.mark.parametrize("seed", range(20))
def test_a_motion_with_random_paces_and_a_stop_never_violates_a_limit(seed: int) -> None:
    chance = random.Random(seed)
    target = tuple(here + chance.uniform(-1.5, 1.5) for here in UR10.home)
    cruise = UR10.limits.slowed(chance.choice([0.3, 0.6, 1.0]))
    limiter = limiter_of()
    limiter.start(UR10.home, 0.0)
    course = Course(UR10.home, target, cruise, UR10.limits, 0.0)
    stops_s, now_s, changes_s, pace = chance.uniform(0.2, 4.0), 0.0, 0.0, 1.0
    setpoints = []
    while not setpoints or not course.is_over(now_s):
        if now_s >= changes_s:
            pace, changes_s = chance.uniform(0.05, 1.0), now_s + chance.uniform(0.001, 0.5)
        setpoints.append(limiter.limit(course.at(now_s, pace=0.0 if now_s > stops_s else pace), now_s))
        now_s += CYCLE_S
    require_limits(setpoints, exact=1.001)


@pytest.mark.parametrize(
    "setpoint",
    [
        Setpoint((math.nan, *UR10.home[1:]), (0.0,) * 6, (0.0,) * 6),
        Setpoint.at_rest((UR10.home[0] + 0.5, *UR10.home[1:])),
        Setpoint(UR10.home, (9.0, *(0.0,) * 5), (0.0,) * 6),
        Setpoint(UR10.home, (math.inf, *(0.0,) * 5), (0.0,) * 6),
        Setpoint(UR10.home, (0.0,) * 6, (90.0, *(0.0,) * 5)),
    ],
)
def test_a_setpoint_beyond_a_limit_is_a_fault_and_the_joints_brake(setpoint: Setpoint) -> None:
    limiter = limiter_of()
    limiter.start(UR10.home, 0.0)
    course = Course(UR10.home, (1.0, *UR10.home[1:]), UR10.limits, UR10.limits, 0.0)
    setpoints = [limiter.limit(course.at(cycle * CYCLE_S), cycle * CYCLE_S) for cycle in range(300)]
    with pytest.raises(RobotFault, match="joint 1"):
        limiter.limit(setpoint, 0.3)
    now_s = 0.3
    while not setpoints[-1].is_at_rest:
        setpoints.append(limiter.brake(now_s))
        now_s += CYCLE_S
    require_limits(setpoints)
    assert now_s < 1.0


def efforts_of(setpoints: list[Setpoint], payload_kg: float) -> Any:
    import numpy as np

    from handover_robots.planning.arm import Arm
    from handover_robots.planning.torques import Torques

    torques = Torques(Arm(UR10), payload_kg)
    return np.array(
        [torques.of(*map(np.array, setpoint.derivatives)) / torques.limits for setpoint in setpoints]
    )


@pytest.mark.skipif(not is_available(), reason="the extra motion has no wheels here")
@pytest.mark.parametrize("seed", range(4))
def test_jogging_with_a_heavy_part_exceeds_no_torque(seed: int) -> None:
    guard = TorqueGuard(UR10, lambda: World(payload_kg=8.0))
    setpoints = jogged(limiter_of(guard), random.Random(seed), 2.0)
    require_limits(setpoints)
    assert 0.5 < abs(efforts_of(setpoints, 8.0)).max() <= 1.0


@pytest.mark.skipif(not is_available(), reason="the extra motion has no wheels here")
def test_a_motion_that_is_too_fast_for_its_payload_is_a_fault_that_names_the_joint() -> None:
    limiter = limiter_of(TorqueGuard(UR10, lambda: World(payload_kg=18.0)))
    start, target = (0.0, -0.3, 0.3, -1.5, -1.5, 0.0), (0.0, -1.5, 0.3, -1.5, -1.5, 0.0)
    limiter.start(start, 0.0)
    course = Course(start, target, UR10.limits, UR10.limits, 0.0)

    def follow() -> None:
        for cycle in range(int(course.remaining_s(0.0) / CYCLE_S)):
            limiter.limit(course.at(cycle * CYCLE_S), cycle * CYCLE_S)

    with pytest.raises(RobotFault, match=r"shoulder_lift_joint would need \d+ Nm, above its limit of 330 Nm"):
        follow()


@pytest.mark.skipif(not is_available(), reason="the extra motion has no wheels here")
def test_a_robot_without_inertia_is_not_stopped_for_its_torque(caplog: pytest.LogCaptureFixture) -> None:
    model = replace(UR10, urdf=re.sub(r"<inertial>.*</inertial>", "", UR10.urdf))
    limiter = limiter_of(TorqueGuard(model, lambda: World(payload_kg=500.0)))
    setpoints = jogged(limiter, random.Random(1), 0.5)
    assert not setpoints[len(setpoints) // 2].is_at_rest
    assert "torque not checked" in caplog.text


@pytest.mark.parametrize("name", ["ur10", "ur5e", "panda"])
def test_every_joint_of_every_robot_can_be_jogged_from_home(name: str) -> None:
    model = ROBOTS.load(name)
    limiter = JointLimiter(model.limits, [(joint.lower, joint.upper) for joint in model.joints])
    for number in range(len(model.joints)):
        limiter.start(model.home, 0.0)
        velocity = tuple(0.1 * (joint == number) for joint in range(len(model.joints)))
        for cycle in range(1, 201):
            reached = limiter.step(velocity, 0.002 * cycle)
            limiter.limit(reached, 0.002 * cycle)
        assert reached.positions[number] - model.home[number] == pytest.approx(0.04, abs=0.005)


@pytest.mark.skipif(not is_available(), reason="needs the extra motion")
def test_a_tool_that_was_jogged_to_a_wall_can_be_jogged_away_from_it() -> None:
    tip = UR10.tool_pose(UR10.home).position
    wall = Obstacle("wall", Box((2.0, 0.02, 2.0)), Pose((tip[0], tip[1] - 0.3, tip[2]), UPRIGHT))
    limiter = limiter_of(CollisionGuard(UR10, lambda: World((wall,))))
    limiter.start(UR10.home, 0.0)
    cycle, reached = 0, Setpoint.at_rest(UR10.home)
    for velocity, cycles in ((0.3, 1500), (-0.3, 500)):
        nearest = reached.positions[0]
        for _ in range(cycles):
            cycle += 1
            reached = limiter.step((velocity, 0.0, 0.0, 0.0, 0.0, 0.0), 0.002 * cycle)
            limiter.limit(reached, 0.002 * cycle)
        if velocity > 0:
            assert not any(reached.velocities), "it stopped before the wall"
    assert nearest - reached.positions[0] > 0.2
