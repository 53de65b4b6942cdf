"""The simulated cell: the servo, the gripper, parts and sensors, in short motions."""

import math
from typing import Any

import numpy as np
import pytest

from handover_robots.model.poses import Pose
from handover_robots.model.trajectory import Course, Setpoint
from handover_robots.physics.parts import Parts
from handover_robots.physics.robot_bodies import STEP_S
from handover_robots.physics.simulation import Simulation
from handover_robots.physics.world_model import GRAVITY_MPS2, build
from handover_robots.robots.ur10 import ROBOT
from handover_robots.scene.scene import Scene, Thing

NAME = "ur10-1"
NEST = (-0.60, 0.40)
ON_FIXTURE_M = 0.048
UPRIGHT = (0.0, 0.0, 0.0, 1.0)


def grip(simulation: Simulation, part: int = 0) -> None:
    simulation.put(part, Pose((*NEST, ON_FIXTURE_M), UPRIGHT))
    simulation.arm.move_fingers(0.0, 0.1)
    simulation.step()
    for _ in range(500):
        if simulation.arm.are_fingers_at_rest:
            return
        simulation.step()
    raise AssertionError("the fingers did not stop")


def lift(simulation: Simulation) -> None:
    target = ROBOT.reach(ROBOT.tool_pose(simulation.arm.positions).raised(0.1), simulation.arm.positions)
    follow(simulation, target)


def follow(simulation: Simulation, target: tuple[float, ...]) -> float:
    """Move to joints at full speed; return the largest distance of the tool from where it should be."""
    course = Course(simulation.arm.positions, target, ROBOT.limits, ROBOT.limits, simulation.time_s)
    worst_m = 0.0
    while not course.is_over(simulation.time_s):
        setpoint = course.at(simulation.time_s)
        wanted = ROBOT.tool_pose(setpoint.positions)
        worst_m = max(worst_m, wanted.distance_m(ROBOT.tool_pose(simulation.arm.positions)))
        simulation.arm.command(setpoint)
        simulation.step()
    simulation.arm.command(Setpoint.at_rest(target))
    return worst_m


def test_the_tip_is_where_the_kinematics_of_the_model_say(simulation: Simulation) -> None:
    expected = ROBOT.tool_pose(simulation.arm.positions)
    assert Pose.of(simulation.arm.tool).distance_m(expected) < 1e-9


def test_the_arm_follows_a_motion_at_full_speed_within_a_millimetre(simulation: Simulation) -> None:
    lift(simulation)
    target = (
        simulation.arm.positions[0] + 0.4,
        *simulation.arm.positions[1:5],
        simulation.arm.positions[5] - 0.4,
    )
    assert follow(simulation, target) < 0.001


def test_a_part_between_the_fingers_is_gripped_and_lifted(simulation: Simulation) -> None:
    grip(simulation)
    assert simulation.gripped_part(NAME) == 0
    lift(simulation)
    simulation.step_for(0.1)
    assert simulation.gripped_part(NAME) == 0
    assert simulation.part_pose(0).position[2] > ON_FIXTURE_M + 0.08


def test_the_wrist_measures_the_weight_of_a_lifted_part(simulation: Simulation) -> None:
    simulation.step_for(0.1)
    empty = np.linalg.norm(simulation.arm.wrench.force)
    grip(simulation)
    lift(simulation)
    simulation.step_for(0.3)
    assert simulation.gripped_part(NAME) == 0
    volume_m3 = math.prod(simulation.world.part_size_m)
    assert np.linalg.norm(simulation.arm.wrench.force) - empty == pytest.approx(
        1200 * volume_m3 * GRAVITY_MPS2, rel=0.1
    )


def test_a_part_without_friction_slips_out_of_the_gripper(simulation: Simulation) -> None:
    simulation.set_friction(0, 0.001)
    grip(simulation)
    lift(simulation)
    simulation.step_for(0.4)
    assert simulation.gripped_part(NAME) is None
    assert simulation.part_pose(0).position[2] < ON_FIXTURE_M + 0.02


def test_a_gripper_that_closes_on_nothing_holds_nothing(simulation: Simulation) -> None:
    simulation.arm.move_fingers(0.0, 0.1)
    simulation.step_for(0.6)
    assert simulation.arm.are_fingers_at_rest
    assert simulation.gripped_part(NAME) is None
    assert simulation.arm.finger_position == pytest.approx(0.0, abs=5e-4)


def test_an_arm_that_meets_something_is_blocked_and_names_the_joint(simulation: Simulation) -> None:
    through_the_table = (
        simulation.arm.positions[0],
        simulation.arm.positions[1] + 0.5,
        *simulation.arm.positions[2:],
    )
    follow(simulation, through_the_table)
    assert simulation.arm.blocked is not None
    assert simulation.arm.blocked.joint in ROBOT.joint_names
    assert ROBOT.tool_pose(simulation.arm.positions).position[2] > -0.05


def test_an_arm_without_new_commands_stops(simulation: Simulation) -> None:
    lift(simulation)
    positions = simulation.arm.positions
    velocity = (0.5, 0.0, 0.0, 0.0, 0.0, 0.0)
    simulation.arm.command(Setpoint(positions, velocity, (0.0,) * 6))
    simulation.step_for(0.4)
    assert simulation.arm.blocked is None
    assert simulation.arm.positions[0] - positions[0] < 0.05
    assert max(map(abs, simulation.arm.velocities)) < 0.02


def test_parts_that_are_dropped_lie_still_in_the_bin_and_the_same_with_the_same_seed(scene: Scene) -> None:
    poses = []
    for seed in (7, 7, 8):
        simulation = Simulation(build({NAME: ROBOT}, scene, Parts.needed(scene)), {NAME: ROBOT.home})
        parts = Parts(simulation, scene, seed)
        simulation.run(parts.fill("bin-1"))
        lying = parts.in_bin("bin-1")
        assert len(lying) == len(scene.bins["bin-1"].parts)
        assert max(map(simulation.part_speed_mps, lying)) < 0.005
        poses.append([simulation.part_pose(part) for part in lying])
    assert poses[0] == poses[1]
    assert poses[0] != poses[2]


def test_a_stirred_bin_keeps_its_parts_in_other_places(scene: Scene) -> None:
    simulation = Simulation(build({NAME: ROBOT}, scene, Parts.needed(scene)), {NAME: ROBOT.home})
    parts = Parts(simulation, scene, 3)
    simulation.run(parts.fill("bin-1"))
    before = {part: simulation.part_pose(part) for part in parts.in_bin("bin-1")}
    simulation.run(parts.stir("bin-1"))
    assert set(parts.in_bin("bin-1")) == set(before)
    assert any(simulation.part_pose(part).distance_m(pose) > 0.005 for part, pose in before.items())


def test_a_saved_state_is_restored_with_the_part_in_the_gripper(simulation: Simulation, scene: Scene) -> None:
    grip(simulation)
    saved = simulation.saved()
    other = Simulation(build({NAME: ROBOT}, scene, 2), {NAME: ROBOT.home})
    assert other.restore(saved)
    assert other.arm.positions == simulation.arm.positions
    other.step_for(0.1)
    assert other.gripped_part(NAME) == 0
    assert other.is_parked(1)
    fewer = Simulation(build({NAME: ROBOT}, scene, 1), {NAME: ROBOT.home})
    assert not fewer.restore(saved)


def test_the_same_commands_give_the_same_result_bit_by_bit(scene: Scene) -> None:
    ends = []
    for _ in range(2):
        joints = ROBOT.reach(scene.fixtures["fixture-1"].nests[0].pose.raised(-0.006), ROBOT.home)
        simulation = Simulation(build({NAME: ROBOT}, scene, 2), {NAME: joints})
        grip(simulation)
        simulation.step(round(0.1 / STEP_S))
        ends.append(simulation.saved()["state"].tobytes())
    assert ends[0] == ends[1]


def test_a_changed_scene_continues_with_the_same_result_each_time(scene: Scene) -> None:
    board = Thing(box=(0.2, 0.2, 0.02), position=(0.4, 0.4, 0.3))
    board = Thing(box=(0.2, 0.2, 0.02), position=(0.4, 0.4, 0.3))
    shelf = scene.model_copy(update={"obstacles": {**scene.obstacles, "shelf": board}})
    without, among = build({NAME: ROBOT}, scene, 2), build({NAME: ROBOT}, shelf, 3)

    def run() -> tuple[dict[str, Any], Pose]:
        simulation = Simulation(without, {NAME: ROBOT.home})
        simulation.put(0, Pose((0.4, 0.4, 0.5), (0.0, 0.0, 0.0, 1.0)))
        simulation.set_friction(0, 0.2)
        simulation.step_for(0.1)
        falling = simulation.part_speed_mps(0)
        simulation.change_world(among)
        assert simulation.part_speed_mps(0) == pytest.approx(falling)
        assert simulation.time_s == pytest.approx(0.1)
        assert simulation.is_parked(1)
        assert simulation.is_parked(2)
        simulation.run(simulation.settling())
        return simulation.saved(), simulation.part_pose(0)

    (first, lies), (second, _) = run(), run()
    assert (first["state"] == second["state"]).all()
    assert lies.position[2] == pytest.approx(0.322, abs=0.002), "it fell onto the shelf"
