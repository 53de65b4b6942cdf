"""COMAN in MuJoCo stands under the stack of tasks, measures what acts on it, and repeats itself."""

from dataclasses import replace

import numpy as np
import pytest

from handover.errors import UsageError
from handover_humanoid.components.robot import JointCommand, RobotSensors
from handover_humanoid.engines.stack_engine import StackEngine
from handover_humanoid.model.kinematics import GRAVITY_MPS2, Array, Kinematics
from handover_humanoid.robots import humanoid
from handover_humanoid.simulation.body_model import STEP_S, build
from handover_humanoid.simulation.simulated_robot import QUIET, TYPICAL_NOISE, SimulatedRobot
from handover_humanoid.solvers.cascade import Cascade
from handover_humanoid.tasks.constraints import JointLimits
from handover_humanoid.tasks.tasks import CentreOfMassTask, OrientationTask, PoseTask, posture

COMAN = humanoid("coman")
KINEMATICS = Kinematics(COMAN)
MODEL = build(COMAN)
START = KINEMATICS.standing("stand")
STACK_EVERY = 5


def standing(noise: float = 0.0, seed: int = 1) -> SimulatedRobot:
    return SimulatedRobot(COMAN, START, TYPICAL_NOISE if noise else QUIET, seed, MODEL)


def run(robot: SimulatedRobot, seconds: float, stiffer: float = 1.0) -> RobotSensors:
    """Hold the feet, the centre of mass and the waist by the stack of tasks."""
    KINEMATICS.update(START)
    feet = [PoseTask(link, link, KINEMATICS.pose(link).copy()) for link in ("l_sole", "r_sole")]
    com = CentreOfMassTask("com", KINEMATICS.centre_of_mass())
    waist, limits = OrientationTask("waist", "Waist"), JointLimits(KINEMATICS)
    stack = (feet[0] & feet[1]) / com / waist / posture(KINEMATICS, "stand") << limits
    engine, q = StackEngine(KINEMATICS, stack, Cascade()), START
    sensors, command = RobotSensors(COMAN), JointCommand(COMAN)
    command.stiffness *= stiffer
    command.damping *= stiffer**0.5
    for cycle in range(round(seconds / STEP_S)):
        if cycle % STACK_EVERY == 0:
            q = engine.step(q, STACK_EVERY * STEP_S).q
            command.positions[:] = q[7:]
            robot.write(command)
        robot.wait()
    robot.read(sensors)
    return sensors


def tilt(q: Array) -> float:
    """Return the angle of the base from upright, in rad."""
    return float(2 * np.arcsin(np.hypot(q[3], q[4])))


@pytest.mark.parametrize("stiffer", [1.0, 5.0], ids=["impedance", "position"])
def test_the_robot_stands_and_measures_its_weight(stiffer: float) -> None:
    robot = standing()
    sensors = run(robot, 2.0, stiffer)
    assert tilt(robot.true_configuration()) < 0.03
    legs = [list(COMAN.sensors.force_torque).index(f"{side}_leg_ft_joint") for side in "lr"]
    weight, feet = COMAN.mass_kg * GRAVITY_MPS2, 2 * 0.6664668 * GRAVITY_MPS2
    assert sensors.wrenches[legs, 2].sum() == pytest.approx(weight - feet, rel=0.02)
    assert np.linalg.norm(sensors.accelerometer) == pytest.approx(GRAVITY_MPS2, rel=0.02)
    assert np.linalg.norm(sensors.gyroscope) < 0.05


def test_a_small_push_is_survived_and_a_large_one_is_not() -> None:
    for impulse, falls in ((1.0, False), (60.0, True)):
        robot = standing()
        robot.push(np.array([impulse, 0.0, 0.0]))
        run(robot, 2.0)
        assert (tilt(robot.true_configuration()) > 0.5) is falls


def test_the_same_seed_repeats_bit_by_bit_and_another_does_not() -> None:
    first, again, other = (run(standing(noise=1.0, seed=seed), 0.1) for seed in (1, 1, 2))
    assert (first.gyroscope == again.gyroscope).all()
    assert (first.positions == again.positions).all()
    assert (first.gyroscope != other.gyroscope).any()


def test_a_command_that_is_not_finite_is_refused_and_the_last_one_holds() -> None:
    robot, command = standing(), JointCommand(COMAN)
    command.positions[:] = START[7:]
    command.torques[3] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        robot.write(command)
    for _ in range(100):
        robot.wait()
    assert tilt(robot.true_configuration()) < 0.05


def test_torques_stay_within_the_limits_of_effort() -> None:
    robot, command, sensors = standing(), JointCommand(COMAN), RobotSensors(COMAN)
    command.positions[:] = START[7:] + 1.0
    command.stiffness *= 10
    robot.write(command)
    robot.wait()
    robot.read(sensors)
    efforts = np.array([joint.max_effort for joint in COMAN.joints])
    assert (np.abs(sensors.torques) <= efforts + 1e-9).all()
    assert (np.abs(sensors.torques) > 0.9 * efforts).any()


def test_a_model_that_mujoco_cannot_use_is_refused_by_name() -> None:
    broken = replace(COMAN, name="broken", urdf=COMAN.urdf.replace('link="LFoot"', 'link="LFoot2"'))
    with pytest.raises(UsageError, match="broken"):
        build(broken)
