"""The driver `ros2` of humanoids: a robot of a ROS graph behind the bridge, commanded in each mode."""

from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handover.errors import UsageError
from handover_humanoid.components.modes import ModeConversion
from handover_humanoid.components.robot import JointCommand, RobotSensors
from handover_humanoid.cycle.robot_link import Driver, PortRobot
from handover_humanoid.cycle.watchdog import Safety
from handover_humanoid.drivers import DriverContext, make_robot
from handover_humanoid.drivers.ros2 import LinkDelay, Ros2Options, Ros2Robot
from handover_humanoid.model.humanoid import JointMode
from handover_humanoid.model.kinematics import Kinematics
from handover_humanoid.robots import humanoid
from handover_humanoid.settings import WholeBodySettings
from handover_ros.graph.joining import Adapter, installed
from ros_fiware_bridge.tests.integration.conftest import Shop
from ros_fiware_bridge.tests.integration.graph.conftest import running_script
from tests.kit.cell import new_cell
from tests.kit.ros_domains import ros_domain
from tests.kit.ros_humanoid import FIRST_STAMP_S, GAINS, RosHumanoid
from tests.kit.skipping import NO_ROS
from tests.kit.waiting import until

pytestmark = pytest.mark.slow

COMAN = humanoid("coman")
HOME = Kinematics(COMAN).standing("stand")[7:]
WRENCHES = {name: f"/wrench/{name}" for name in COMAN.sensors.force_torque}
MODES = tuple(JointMode)


@pytest.fixture(scope="module")
def at_work(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shop]:
    """A broker, and a bridge with a shipped mapping."""
    with new_cell(tmp_path_factory.mktemp("cell")) as cell:
        made = Shop(cell, ros_domain())
        made.begin("", HANDOVER_ROS_MAPPING="joint-states")
        yield made


@pytest.fixture
async def node(shop: Shop) -> AsyncIterator[RosHumanoid]:
    made = RosHumanoid(COMAN.joint_names, HOME, tuple(WRENCHES.values()))
    await made.join(shop.robot)
    yield made
    await made.leave()


@contextmanager
def connected(shop: Shop, **options: Any) -> Iterator[Ros2Robot]:
    settings = WholeBodySettings.load(bridge_url=shop.cell.url("ros_fiware_bridge"))
    chosen = Ros2Options(**{"wrenches": WRENCHES, "modes": MODES, **options})
    robot = Ros2Robot(COMAN, chosen, settings)
    try:
        yield robot
    finally:
        robot.close()


def measured(robot: Ros2Robot) -> RobotSensors | None:
    """Return the measurements; None while there are none."""
    sensors = RobotSensors(COMAN)
    robot.read(sensors)
    return sensors if sensors.is_finite else None


def standing() -> JointCommand:
    command = JointCommand(COMAN)
    command.positions[:] = HOME + 0.1
    command.velocities[:], command.torques[:] = 0.2, 3.0
    return command


@pytest.mark.nightly
async def test_the_robot_is_measured_in_the_order_of_the_model_and_by_its_own_clock(
    shop: Shop, node: RosHumanoid
) -> None:
    with connected(shop) as robot:
        sensors = await until(lambda: measured(robot), why=robot.fault)
        assert sensors.positions == pytest.approx(HOME)
        assert sensors.torques == pytest.approx(np.arange(len(HOME), 0, -1))  # reported the other way round
        assert sensors.gyroscope == pytest.approx([0.1, 0.2, 0.3])
        assert sensors.accelerometer == pytest.approx([0.0, 0.0, 9.81])
        assert sensors.wrenches[:, 2] == pytest.approx(100.0 + np.arange(len(WRENCHES)))
        assert sensors.wrenches[:, 4] == pytest.approx(1.0)
        assert FIRST_STAMP_S < sensors.time_s <= node.time_s
        robot.write(standing())
        await until(lambda: robot._delay.round_trip_s > 0, why="no echo of a command")
        assert 0 < robot.delay_s < np.inf


@pytest.mark.parametrize("mode", MODES)
async def test_each_mode_is_commanded_by_what_its_controllers_accept(
    shop: Shop, node: RosHumanoid, mode: JointMode
) -> None:
    conversion = ModeConversion(COMAN, mode)
    with connected(shop, modes=(mode,), gains=GAINS) as robot:
        sensors = await until(lambda: measured(robot), why=robot.fault)
        command = conversion.convert(standing(), sensors)
        robot.write(command)
        received = await until(lambda: node.commands and node.commands[-1], why="no command")
        assert list(received["name"]) == list(COMAN.joint_names)
        sent = {key: len(received[key]) > 0 for key in ("position", "velocity", "effort")}
        assert sent == {
            "position": mode is not JointMode.TORQUE,
            "velocity": mode is JointMode.IMPEDANCE,
            "effort": mode is not JointMode.POSITION,
        }
        if mode is JointMode.TORQUE:
            assert received["effort"] == pytest.approx(command.torques)
        else:
            assert received["position"] == pytest.approx(command.positions)
        if mode is JointMode.IMPEDANCE:
            gains = await until(lambda: node.gains and node.gains[-1], why="no gains")
            assert gains == pytest.approx([*command.stiffness, *command.damping])
        other = next(each for each in MODES if each is not mode)
        with pytest.raises(ValueError, match=f'no mode "{other}"'):
            robot.write(ModeConversion(COMAN, other).convert(standing(), sensors))


async def test_commands_that_end_leave_the_joints_at_rest(shop: Shop, node: RosHumanoid) -> None:
    with connected(shop, watchdog_s=0.1) as robot:
        await until(lambda: measured(robot), why=robot.fault)
        robot.write(standing())
        await until(lambda: node.commands and not np.any(node.commands[-1]["effort"]), why="not held")
        held = node.commands[-1]
        assert held["position"] == pytest.approx(HOME + 0.1)
        assert not np.any(held["velocity"])
        robot.write(standing())
        await until(lambda: np.any(node.commands[-1]["effort"]), why="not commanded again")
    await until(lambda: not np.any(node.commands[-1]["effort"]), why="not held after the end")


async def test_a_silent_robot_has_no_measurements_and_its_driver_holds(
    shop: Shop, node: RosHumanoid, tmp_path: Path
) -> None:
    with connected(shop, modes=(JointMode.IMPEDANCE,)) as robot:
        driver = Driver(robot, tmp_path)
        assert driver.cycle() is Safety.HOLDING  # nothing is measured yet, and nothing is commanded
        await until(lambda: measured(robot), why=robot.fault)
        link, sensors = PortRobot(COMAN, tmp_path, robot.period_s), RobotSensors(COMAN)

        def follows() -> bool:
            link.write(standing())
            return driver.cycle() is Safety.FOLLOWING

        await until(follows, why="the driver does not follow")
        node.is_silent = True

        def is_lost() -> bool:
            driver.cycle()
            link.read(sensors)
            return not sensors.is_finite

        await until(is_lost, why="old measurements are shown as new")
        await until(lambda: driver.cycle() is Safety.HOLDING, why="the driver does not hold")
        assert link.delay_s > 0.05
        node.is_silent = False
        await until(lambda: measured(robot), why="no measurements again")
        led = standing()
        led.is_led = True

        def is_refused() -> bool:
            link.write(led)
            driver.cycle()
            return "assisted walking" in driver.refusal

        await until(is_refused, why="a person may lead a physical robot")
        assert driver.watchdog.state is Safety.HOLDING


async def test_what_is_missing_is_named(shop: Shop, node: RosHumanoid) -> None:
    node.has_imu = False
    with connected(shop) as robot, connected(shop) as second:
        await until(
            lambda: "nothing has been received on /imu" in robot.fault + second.fault, why="no reason"
        )
        await until(lambda: "another client commands" in robot.fault + second.fault, why="both command")
    node.has_imu = True
    node.reported = node.reported[:-1]
    with connected(shop) as robot:
        await until(lambda: f"does not report the joints {node.names[0]};" in robot.fault, why=robot.fault)


def test_options_that_do_not_fit_the_model_are_refused() -> None:
    for options, says in (
        ({}, "needs a topic for"),
        ({"wrenches": {**WRENCHES, "tail": "/tail"}}, 'no force-torque sensor "tail"'),
        ({"wrenches": WRENCHES, "modes": ["voltage"]}, "modes.0"),
        ({"wrenches": WRENCHES, "speed": 3}, "speed"),
        ({"wrenches": WRENCHES, "modes": ["torque"], "command_hz": 100}, "the mode torque needs 250"),
    ):
        with pytest.raises(UsageError, match=says):
            make_robot("ros2", DriverContext(COMAN, options))
    with pytest.raises(UsageError, match="imu: Extra"):
        make_robot("simulated", DriverContext(COMAN, {"imu": "/imu"}))
    with pytest.raises(UsageError, match='no humanoid driver "ros3"; there are: simulated, ros2'):
        make_robot("ros3", DriverContext(COMAN, {}))


def test_the_delay_is_half_of_the_round_trip_or_how_late_a_stamp_is() -> None:
    delay, apart_s = LinkDelay(), 400.0
    assert delay.of(10.0, 10.0 + apart_s, 0.001) == pytest.approx((0.001, 0.001))
    delay.echo(0.006)
    assert delay.of(10.1, 10.1 + apart_s, 0.001) == pytest.approx((0.004, 0.004))
    assert delay.of(10.2, 10.23 + apart_s, 0.001) == pytest.approx((0.004, 0.03), abs=2e-3)
    assert delay.of(10.3, 10.28 + apart_s, 0.0) == pytest.approx((0.003, 0.003))  # faster than any before


@pytest.mark.parametrize("rate", [0.3, 0.9, 0.99, 1.0, 1.01])
def test_a_robot_whose_clock_has_another_rate_is_not_taken_for_a_late_one(rate: float) -> None:
    delay, random = LinkDelay(), np.random.default_rng(1)
    for number in range(800):
        sent_s = 0.01 * number
        way_s = 0.002 + random.exponential(0.002)
        _, late_s = delay.of(rate * sent_s, 50.0 + sent_s + way_s, 0.0)
        if number > 400:
            assert late_s == pytest.approx(way_s - 0.002, abs=0.01)
    _, late_s = delay.of(rate * 8.0, 58.0 + 0.1, 0.0)
    assert late_s == pytest.approx(0.1, abs=0.015)


@pytest.mark.skipif(Adapter.RCLPY not in installed(), reason=NO_ROS)
async def test_the_joints_of_a_genuine_ros_node_follow(at_work: Shop) -> None:
    arguments = (str(at_work.domain), ",".join(WRENCHES.values()), ",".join(COMAN.joint_names))
    with (
        running_script("genuine_humanoid.py", *arguments),
        connected(at_work, modes=(JointMode.POSITION,)) as robot,
    ):
        sensors = await until(lambda: measured(robot), 60.0, why="no measurements")
        command = ModeConversion(COMAN, JointMode.POSITION).convert(standing(), sensors)

        def follows() -> bool:
            robot.write(command)
            now = measured(robot)
            return now is not None and bool(np.allclose(now.positions, command.positions))

        await until(follows, why="the joints do not follow")
        assert 0 < robot.delay_s < np.inf
