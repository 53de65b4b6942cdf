"""The simulated cell: the servo, the gripper, parts and sensors, in short motions."""

import math

import numpy as np
import pytest

from services.trajectory_tool.physics.parts import Parts
from services.trajectory_tool.physics.simulation import Simulation
from services.trajectory_tool.physics.world_model import GRAVITY_MPS2, STEP_S, build
from services.trajectory_tool.poses import Pose
from services.trajectory_tool.robots.ur10 import ROBOT
from services.trajectory_tool.scene import Scene
from services.trajectory_tool.trajectory import Course, Setpoint

NEST = (-0.60, 0.40)
ON_FIXTURE_M = 0.048
UPRIGHT = (0.0, 0.0, 0.0, 1.0)


def grip(simulation: Simulation, part: int = 0) -> None:
    simulation.put(part, Pose((*NEST, ON_FIXTURE_M), UPRIGHT))
    simulation.move_fingers(0.0, 0.1)
    simulation.step()
    for _ in range(500):
        if simulation.are_fingers_at_rest:
            return
        simulation.step()
    raise AssertionError("the fingers did not stop")


def lift(simulation: Simulation) -> None:
    target = ROBOT.reach(ROBOT.tool_pose(simulation.positions).raised(0.1), simulation.positions)
    follow(simulation, target)


def follow(simulation: Simulation, target: tuple[float, ...]) -> float:
    """Move to joints at full speed; return the largest distance of the tool from where it should be."""
    course = Course(simulation.positions, target, ROBOT.limits, ROBOT.limits, simulation.time_s)
    worst_m = 0.0
    while not course.is_over(simulation.time_s):
        setpoint = course.at(simulation.time_s)
        wanted = ROBOT.tool_pose(setpoint.positions)
        worst_m = max(worst_m, wanted.distance_m(ROBOT.tool_pose(simulation.positions)))
        simulation.command(setpoint)
        simulation.step()
    simulation.command(Setpoint.at_rest(target))
    return worst_m


def test_the_tip_is_where_the_kinematics_of_the_model_say(simulation: Simulation) -> None:
    expected = ROBOT.tool_pose(simulation.positions)
    assert Pose.of(simulation.tool).distance_m(expected) < 1e-9


def test_the_arm_follows_a_motion_at_full_speed_within_a_millimetre(simulation: Simulation) -> None:
    lift(simulation)
    target = (simulation.positions[0] + 0.4, *simulation.positions[1:5], simulation.positions[5] - 0.4)
    assert follow(simulation, target) < 0.001


def test_a_part_between_the_fingers_is_gripped_and_lifted(simulation: Simulation) -> None:
    grip(simulation)
    assert simulation.gripped_part() == 0
    lift(simulation)
    simulation.step_for(0.1)
    assert simulation.gripped_part() == 0
    assert simulation.part_pose(0).position[2] > ON_FIXTURE_M + 0.08


def test_the_wrist_measures_the_weight_of_a_lifted_part(simulation: Simulation) -> None:
    simulation.step_for(0.1)
    empty = np.linalg.norm(simulation.wrench.force)
    grip(simulation)
    lift(simulation)
    simulation.step_for(0.3)
    assert simulation.gripped_part() == 0
    volume_m3 = math.prod(simulation.world.part_size_m)
    assert np.linalg.norm(simulation.wrench.force) - empty == pytest.approx(
        1200 * volume_m3 * GRAVITY_MPS2, rel=0.1
    )


def test_a_part_without_friction_slips_out_of_the_gripper(simulation: Simulation) -> None:
    simulation.set_friction(0, 0.001)
    grip(simulation)
    lift(simulation)
    simulation.step_for(0.4)
    assert simulation.gripped_part() is None
    assert simulation.part_pose(0).position[2] < ON_FIXTURE_M + 0.02


def test_a_gripper_that_closes_on_nothing_holds_nothing(simulation: Simulation) -> None:
    simulation.move_fingers(0.0, 0.1)
    simulation.step_for(0.6)
    assert simulation.are_fingers_at_rest
    assert simulation.gripped_part() is None
    assert simulation.finger_position == pytest.approx(0.0, abs=5e-4)


def test_an_arm_that_meets_something_is_blocked_and_names_the_joint(simulation: Simulation) -> None:
    through_the_table = (simulation.positions[0], simulation.positions[1] + 0.5, *simulation.positions[2:])
    follow(simulation, through_the_table)
    assert simulation.blocked is not None
    assert simulation.blocked.joint in ROBOT.joint_names
    assert ROBOT.tool_pose(simulation.positions).position[2] > -0.05


def test_an_arm_without_new_commands_stops(simulation: Simulation) -> None:
    lift(simulation)
    positions = simulation.positions
    velocity = (0.5, 0.0, 0.0, 0.0, 0.0, 0.0)
    simulation.command(Setpoint(positions, velocity, (0.0,) * 6))
    simulation.step_for(0.4)
    assert simulation.blocked is None
    assert simulation.positions[0] - positions[0] < 0.05
    assert max(map(abs, simulation.velocities)) < 0.02


def test_parts_that_are_dropped_lie_still_in_the_bin_and_the_same_with_the_same_seed(scene: Scene) -> None:
    found = []
    for seed in (7, 7, 8):
        simulation = Simulation(build(ROBOT, scene, Parts.needed(scene)), ROBOT.home)
        parts = Parts(simulation, scene, seed)
        parts.fill("bin-1")
        lying = parts.in_bin("bin-1")
        assert len(lying) == len(scene.bins["bin-1"].parts)
        assert max(map(simulation.part_speed_mps, lying)) < 0.005
        found.append([simulation.part_pose(part) for part in lying])
    assert found[0] == found[1]
    assert found[0] != found[2]


def test_a_stirred_bin_keeps_its_parts_in_other_places(scene: Scene) -> None:
    simulation = Simulation(build(ROBOT, scene, Parts.needed(scene)), ROBOT.home)
    parts = Parts(simulation, scene, 3)
    parts.fill("bin-1")
    before = {part: simulation.part_pose(part) for part in parts.in_bin("bin-1")}
    parts.stir("bin-1")
    assert set(parts.in_bin("bin-1")) == set(before)
    assert any(simulation.part_pose(part).distance_m(pose) > 0.005 for part, pose in before.items())


def test_a_saved_state_is_restored_with_the_part_in_the_gripper(simulation: Simulation, scene: Scene) -> None:
    grip(simulation)
    saved = simulation.saved()
    other = Simulation(build(ROBOT, scene, 2), ROBOT.home)
    assert other.restore(saved)
    assert other.positions == simulation.positions
    other.step_for(0.1)
    assert other.gripped_part() == 0
    assert other.is_parked(1)
    fewer = Simulation(build(ROBOT, scene, 1), ROBOT.home)
    assert not fewer.restore(saved)


def test_the_same_commands_give_the_same_result_bit_by_bit(scene: Scene) -> None:
    ends = []
    for _ in range(2):
        joints = ROBOT.reach(scene.fixtures["fixture-1"].nests[0].pose.raised(-0.006), ROBOT.home)
        simulation = Simulation(build(ROBOT, scene, 2), joints, ROBOT.fingers[0].opened)
        grip(simulation)
        simulation.step(round(0.1 / STEP_S))
        ends.append(simulation.saved()["state"].tobytes())
    assert ends[0] == ends[1]
