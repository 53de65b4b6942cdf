"""A driver notices by itself that commands stopped: the joints hold, and are damped while the robot falls."""

import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from handover.errors import UsageError
from handover_humanoid.components.robot import JointCommand, RobotSensors
from handover_humanoid.cycle.ports import PortReader
from handover_humanoid.cycle.robot_link import SENSORS, Driver, PortRobot
from handover_humanoid.cycle.watchdog import Safety
from handover_humanoid.model.kinematics import Kinematics
from handover_humanoid.robots import humanoid
from handover_humanoid.simulation.simulated_robot import SimulatedRobot
from tests.kit.waiting import Bound, wait_for

COMAN = humanoid("coman")
BOUND_S, FALL_CYCLES, TAKEN_OVER_CYCLES = 120.0, 5000, 500
DEPLOYMENT = """
folder: {folder}
fifo: false
components:
  robot: {{kind: driver, realtime: true}}
  walking: {{kind: walking, solver: daqp, realtime: true}}
"""


def repeat_until(condition: Callable[[], bool]) -> None:
    """Ask again and again without a pause: here the condition itself moves the robot."""
    bound = Bound(BOUND_S)
    while not condition():
        bound.check("the condition never came true")


def test_a_driver_without_commands_holds_the_robot_and_damps_its_fall(tmp_path: Path) -> None:
    start = Kinematics(COMAN).standing("stand")
    robot = SimulatedRobot(COMAN, start)
    driver = Driver(robot, tmp_path)
    assert driver.cycle() is Safety.HOLDING, "without any command yet"
    link, sensors, command = (
        PortRobot(COMAN, tmp_path, robot.period_s),
        RobotSensors(COMAN),
        JointCommand(COMAN),
    )
    command.positions[:] = start[7:]

    def commanded() -> Safety:
        link.write(command)
        return driver.cycle()

    repeat_until(lambda: commanded() is Safety.FOLLOWING)
    link.read(sensors)
    assert sensors.positions == pytest.approx(start[7:], abs=0.01)
    assert sensors.wrenches[:, 2].sum() > 100, "the feet carry the robot"
    repeat_until(lambda: driver.cycle() is Safety.HOLDING)
    for _ in range(500):
        assert driver.cycle() is Safety.HOLDING
    assert robot.true_configuration()[2] == pytest.approx(start[2], abs=0.01)
    repeat_until(lambda: commanded() is Safety.FOLLOWING)
    command.positions[3] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        link.write(command)
    command.positions[3] = start[10]
    repeat_until(lambda: driver.cycle() is Safety.HOLDING)
    robot.push(np.array([60.0, 0.0, 0.0]))
    assert any(driver.cycle() is Safety.DAMPED for _ in range(FALL_CYCLES))
    assert commanded() is Safety.DAMPED, "until the driver is started again"
    assert driver.watchdog.stalls >= 2
    with pytest.raises(UsageError, match="already has a writer"):
        Driver(robot, tmp_path)


@pytest.mark.nightly
def test_a_control_process_that_stalls_is_noticed_by_the_process_of_the_robot(tmp_path: Path) -> None:
    file, folder = tmp_path / "deployment.yaml", tmp_path / "ports"
    file.write_text(DEPLOYMENT.format(folder=folder), encoding="utf-8")
    with ExitStack() as stack:

        def started(module: str) -> subprocess.Popen[bytes]:
            package = "handover_humanoid"
            process = subprocess.Popen([sys.executable, "-m", f"{package}.{module}", str(file)])
            stack.callback(process.wait)
            stack.callback(process.kill)
            return process

        started("robot_process")
        wait_for((folder / "command").exists, BOUND_S)
        cycle = started("control_process")
        port = PortReader(folder / SENSORS)

        def safety() -> float:
            return port.value("safety") if port.read() else float("nan")

        wait_for(lambda: safety() == Safety.FOLLOWING, BOUND_S)
        state = PortReader(folder / "state")
        # Until then it takes over from the drives, whose robot hangs in them; a stall there may make it fall.
        wait_for(lambda: state.read() and state.value("cycles") > TAKEN_OVER_CYCLES, BOUND_S)
        wait_for(lambda: safety() == Safety.FOLLOWING, BOUND_S)
        cycle.send_signal(signal.SIGSTOP)
        wait_for(lambda: safety() == Safety.HOLDING, BOUND_S)
        before_s = port.value("time_s")
        wait_for(lambda: safety() == Safety.HOLDING and port.value("time_s") > before_s + 0.5, BOUND_S)
        forces = [port.value(name) for name in port.names if name.endswith(".fz")]
        assert sum(forces) > 200, "the feet still carry the robot"
        cycle.send_signal(signal.SIGCONT)
        wait_for(lambda: safety() == Safety.FOLLOWING, BOUND_S)
