"""Planned motions keep the torque of each joint, with a payload, or say which joint is too weak."""

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_robots.model.faults import NoPath
from handover_robots.model.joint_trajectory import JointTrajectory
from handover_robots.model.obstacles import World
from handover_robots.model.robot_model import RobotModel
from handover_robots.planning import timing
from handover_robots.planning.arm import Arm
from handover_robots.planning.planner import Planner
from handover_robots.planning.torques import Overload, Torques
from handover_robots.robots import ROBOTS

EVERY_S = 0.001
NAMES = ("ur10", "ur5e", "panda")
MODELS = {name: ROBOTS.load(name) for name in NAMES}
EFFORT = re.compile(r'effort="[^"]*"')


def shares(
    model: RobotModel, payload_kg: float, trajectory: JointTrajectory, every_s: float = EVERY_S
) -> Any:
    """Return the torques at equal times as fractions of the limits, by a model made here."""
    arm = Arm(model)
    tip = arm.pin_model.frames[arm.tip]
    load = pin.Inertia(payload_kg, tip.placement.translation, np.zeros((3, 3)))
    arm.pin_model.inertias[tip.parentJoint] += load
    data = arm.pin_model.createData()
    times = np.arange(0.0, trajectory.duration_s, every_s)
    states = zip(*(trajectory.derivative(times, order) for order in range(3)), strict=True)
    torques = np.array([pin.rnea(arm.pin_model, data, *state) for state in states])
    return torques / arm.pin_model.effortLimit


@given(st.sampled_from(NAMES), st.floats(0.0, 14.0), st.integers(0, 10_000))
def test_a_planned_motion_keeps_every_torque_or_names_the_joint(
    name: str, payload_kg: float, seed: int
) -> None:
    model = MODELS[name]
    planner = Planner(model, world=World(payload_kg=payload_kg), checks_payload=False)
    random = np.random.default_rng(seed)
    low, high = np.maximum(planner.arm.lower, -2.0), np.minimum(planner.arm.upper, 2.0)
    start, target = random.uniform(low, high, (2, planner.arm.n))
    if not (planner.collisions.is_free(start, 0.01) and planner.collisions.is_free(target, 0.01)):
        return
    line = timing.line(start, target, model.limits)
    allowed = Torques(planner.arm, payload_kg).allowed_speed(line)
    if isinstance(allowed, Overload):
        assert allowed.joint in model.joint_names
        slowest = shares(model, payload_kg, line.slowed(0.001), every_s=1.0)
        assert np.abs(slowest[:, model.joint_names.index(allowed.joint)]).max() > 1
        return
    plan = planner.to_joints(tuple(start.tolist()), tuple(target.tolist()))
    # Torques are limited at the knots of the motion; between them they bend by millionths.
    assert np.abs(shares(model, payload_kg, plan.trajectory)).max() <= 1 + 1e-4


def test_a_heavy_part_slows_a_motion_and_a_heavier_one_is_refused() -> None:
    model = MODELS["ur5e"]
    start, target = (0.0, -0.5, 0.8, -1.5, -1.5, 0.0), (1.0, -0.9, 0.4, -1.5, -1.5, 0.0)
    durations = {
        payload_kg: Planner(model, world=World(payload_kg=payload_kg), checks_payload=False).to_joints(
            start, target
        )
        for payload_kg in (0.0, 5.0, 9.5)
    }
    empty, light, heavy = (plan.trajectory.duration_s for plan in durations.values())
    assert empty == light < heavy
    assert np.abs(shares(model, 9.5, durations[9.5].trajectory)).max() == pytest.approx(1.0, abs=0.02)
    planner = Planner(model, world=World(payload_kg=30.0), checks_payload=False)
    with pytest.raises(NoPath, match=r"wrist_1_joint needs \d+ Nm to hold the arm and 30 kg on the way"):
        planner.to_joints(start, target)


def test_the_payload_changes_with_the_world() -> None:
    planner = Planner(MODELS["ur5e"], checks_payload=False)
    start, target = (0.0, -0.5, 0.8, -1.5, -1.5, 0.0), (1.0, -0.9, 0.4, -1.5, -1.5, 0.0)
    fast = planner.to_joints(start, target).trajectory.duration_s
    planner.world = World(payload_kg=9.5)
    assert planner.to_joints(start, target).trajectory.duration_s > fast
    planner.world = World()
    assert planner.to_joints(start, target).trajectory.duration_s == fast


@pytest.mark.parametrize(
    ("urdf", "reason"),
    [
        (
            re.sub(r"<inertial>.*</inertial>", "", MODELS["ur10"].urdf),
            "no inertia for what shoulder_pan_joint",
        ),
        (EFFORT.sub('effort="0"', MODELS["ur10"].urdf), "no limit of effort for any joint"),
    ],
)
def test_a_robot_without_inertia_or_limits_is_planned_and_says_why_it_is_not_checked(
    urdf: str, reason: str
) -> None:
    model = replace(MODELS["ur10"], urdf=urdf)
    torques = Torques(Arm(model), 500.0)
    assert torques.unchecked is not None
    assert reason in torques.unchecked
    target = tuple(angle + 0.3 for angle in model.home)
    fast = Planner(MODELS["ur10"]).to_joints(model.home, target)
    plan = Planner(model, world=World(payload_kg=500.0), checks_payload=False).to_joints(model.home, target)
    assert plan.trajectory.duration_s == fast.trajectory.duration_s


def test_a_joint_without_a_limit_of_effort_is_not_limited() -> None:
    first = EFFORT.search(MODELS["ur10"].urdf)
    assert first is not None
    model = replace(MODELS["ur10"], urdf=MODELS["ur10"].urdf.replace(first.group(), 'effort="0"', 1))
    torques = Torques(Arm(model))
    assert torques.unchecked is None
    assert torques.limits[0] == np.inf
    assert np.isfinite(torques.limits[1:]).all()
