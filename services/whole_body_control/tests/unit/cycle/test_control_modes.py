"""Joints are commanded in positions, joint impedance or torques, and a mode that is not there is refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover.errors import UsageError
from handover_humanoid.components.modes import ModeConversion
from handover_humanoid.components.robot import JointCommand, RobotSensors
from handover_humanoid.control_process import control_loop
from handover_humanoid.cycle.deployment import read_deployment
from handover_humanoid.cycle.loop import Mode
from handover_humanoid.cycle.ports import PortWriter
from handover_humanoid.cycle.robot_link import Driver, PortRobot
from handover_humanoid.cycle.watchdog import Safety, Watchdog
from handover_humanoid.cycle.wish import WISH
from handover_humanoid.model.humanoid import JointMode
from handover_humanoid.model.kinematics import Array, Kinematics
from handover_humanoid.robots import humanoid
from handover_humanoid.simulation.simulated_robot import SimulatedRobot

COMAN = humanoid("coman")
JOINTS = len(COMAN.joints)
START = Kinematics(COMAN).standing("stand")
DEPLOYMENT = """
folder: {folder}
paced: false
fifo: false
components:
  robot: {{kind: {kind}, realtime: true}}
  walking: {{kind: walking, mode: {mode}, realtime: true}}
"""
vectors = st.lists(st.floats(-2.0, 2.0), min_size=JOINTS, max_size=JOINTS).map(np.array)


def written(folder: Path, mode: str, kind: str = "mujoco") -> Path:
    file = folder / "deployment.yaml"
    file.write_text(DEPLOYMENT.format(folder=folder / "ports", mode=mode, kind=kind), encoding="utf-8")
    return file


class Physical(SimulatedRobot):
    """A robot that says that it is none of a simulation, with fewer modes than its model."""

    is_simulated = False

    def __init__(self, *modes: JointMode) -> None:
        super().__init__(COMAN, START)
        self.modes = modes


@pytest.mark.parametrize("mode", list(JointMode))
def test_the_robot_walks_in_each_mode(mode: JointMode, tmp_path: Path) -> None:
    deployment = read_deployment(written(tmp_path, mode))
    loop, state = control_loop(deployment)
    modes, write = set[JointMode](), loop.robot.write

    def recorded(command: JointCommand) -> None:
        modes.add(command.mode)
        write(command)

    loop.robot.write = recorded
    wish = PortWriter(deployment.folder / "wish", WISH)
    wanted = {"ahead_mps": 0.08, "speed_share": 1.0}
    for _ in range(2000):
        wish.write(np.array([wanted.get(name, 0.0) for name in WISH]))
        loop.cycle()
    assert modes == {mode}
    assert loop.mode is Mode.FOLLOWING
    assert state.read()
    assert state.value("com.x") > 0.1
    assert abs(state.value("com.x") - state.value("reference.x")) < 0.02


@settings(max_examples=30, deadline=None)
@given(vectors, vectors, vectors)
def test_each_mode_makes_the_same_torque_on_the_reference(
    positions: Array, velocities: Array, torques: Array
) -> None:
    command, sensors = JointCommand(COMAN), RobotSensors(COMAN)
    command.positions[:], command.velocities[:], command.torques[:] = positions, velocities, torques
    sensors.positions[:], sensors.velocities[:] = positions, velocities
    servo = ModeConversion(COMAN, JointMode.POSITION).convert(command, sensors)
    drives = [joint.servo for joint in COMAN.joints]
    made = [
        drive.stiffness * deflection - drive.damping * velocity
        for drive, deflection, velocity in zip(drives, servo.positions - positions, velocities, strict=True)
        if drive is not None
    ]
    assert made == pytest.approx(torques, abs=1e-9)
    assert ModeConversion(COMAN, JointMode.TORQUE).convert(command, sensors).torques == pytest.approx(torques)
    assert ModeConversion(COMAN, JointMode.IMPEDANCE).convert(command, sensors) is command


@settings(max_examples=30, deadline=None)
@given(vectors, vectors, vectors)
def test_torques_are_those_of_the_impedance_within_the_limits_of_the_drives(
    wanted: Array, measured: Array, velocities: Array
) -> None:
    command, sensors = JointCommand(COMAN), RobotSensors(COMAN)
    command.positions[:], sensors.positions[:], sensors.velocities[:] = wanted, measured, velocities
    torques = ModeConversion(COMAN, JointMode.TORQUE).convert(command, sensors).torques
    for joint, torque, error, velocity in zip(
        COMAN.joints, torques, wanted - measured, velocities, strict=True
    ):
        free = joint.gains.stiffness * error - joint.gains.damping * velocity
        assert torque == pytest.approx(min(max(free, -joint.max_effort), joint.max_effort))


def test_a_mode_that_model_or_driver_lacks_is_refused_by_name(tmp_path: Path) -> None:
    soft = replace(COMAN, modes=(JointMode.IMPEDANCE,))
    with pytest.raises(UsageError, match=r'model coman does not have the mode "torque" .* has: impedance'):
        ModeConversion(soft, JointMode.TORQUE)
    deployment = read_deployment(written(tmp_path, "torque", kind="driver"))
    deployment.folder.mkdir()
    driver = Driver(Physical(JointMode.POSITION, JointMode.IMPEDANCE), deployment.folder)
    driver.cycle()
    with pytest.raises(UsageError, match=r'driver of coman .* "torque" .* has: position, impedance'):
        control_loop(deployment)
    with pytest.raises(ValueError, match='no mode "torque"'):
        driver.robot.write(ModeConversion(COMAN, JointMode.TORQUE).convert(JointCommand(COMAN), sensors()))
    with pytest.raises(UsageError, match="mode"):
        read_deployment(written(tmp_path, "voltage"))


def sensors() -> RobotSensors:
    measured = RobotSensors(COMAN)
    SimulatedRobot(COMAN, START).read(measured)
    return measured


def commanded(driver: Driver, link: PortRobot, command: JointCommand) -> Safety:
    """Return the first state of the driver for a new command; a slow machine makes it old, so it repeats."""
    for _ in range(1000):
        link.write(command)
        if driver.cycle() is Safety.FOLLOWING or driver.refusal:
            break
    return driver.watchdog.state


def test_a_driver_follows_no_command_that_its_robot_may_not_follow(tmp_path: Path) -> None:
    robot = Physical(JointMode.IMPEDANCE)
    driver = Driver(robot, tmp_path)
    link, command = PortRobot(COMAN, tmp_path, robot.period_s), JointCommand(COMAN)
    command.positions[:] = START[7:]
    assert commanded(driver, link, command) is Safety.FOLLOWING
    command.is_led = True
    assert commanded(driver, link, command) is Safety.HOLDING
    assert "assisted walking is for simulated robots only" in driver.refusal
    command.is_led = False
    assert commanded(driver, link, command) is Safety.FOLLOWING
    assert not driver.refusal
    command.mode = JointMode.TORQUE
    assert commanded(driver, link, command) is Safety.HOLDING
    assert 'no mode "torque"' in driver.refusal
    assert robot.true_configuration()[2] == pytest.approx(START[2], abs=0.01)


@pytest.mark.parametrize("mode", list(JointMode))
def test_a_robot_with_one_mode_stands_when_commands_stop(mode: JointMode) -> None:
    robot, measured, command = Physical(mode), RobotSensors(COMAN), JointCommand(COMAN)
    watchdog, conversion = Watchdog(COMAN, robot.period_s, robot.modes), ModeConversion(COMAN, mode)
    command.positions[:] = START[7:]

    def cycle(age_s: float) -> Safety:
        robot.read(measured)
        robot.write(watchdog.choose(conversion.convert(command, measured), age_s, measured))
        robot.wait()
        return watchdog.state

    assert [cycle(0.0) for _ in range(10)] == [Safety.FOLLOWING] * 10
    assert [cycle(1.0) for _ in range(500)] == [Safety.HOLDING] * 500
    assert robot.true_configuration()[2] == pytest.approx(START[2], abs=0.01)
    robot.push(np.array([60.0, 0.0, 0.0]))
    assert any(cycle(1.0) is Safety.DAMPED for _ in range(5000))
