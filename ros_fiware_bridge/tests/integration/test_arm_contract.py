"""The driver `ros` does what every driver does, with a genuine arm of a ROS graph behind the bridge."""

import asyncio
import re
import threading
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from websockets.asyncio.client import connect

from handover.broker import BrokerClient
from handover_datamodels.arm_stream import ARM_REPORTS, ArmJoints, ArmSetup, ArmVelocity, VelocityOutput
from handover_datamodels.robot_messages import StreamRefusal
from handover_robots.driver_base.context import Clock
from handover_robots.driver_contract import RobotContract, context_of
from handover_robots.drivers.ros_goals import twist
from handover_robots.drivers.ros_robot import RosRobot
from handover_robots.model.faults import RobotFault
from handover_robots.model.joints import Joints
from handover_robots.model.trajectory import Setpoint
from handover_robots.robots.ur10 import ROBOT
from handover_robots.settings import TrajectorySettings
from ros_fiware_bridge.tests.integration.conftest import Shop
from tests.kit.cell import new_cell
from tests.kit.ros_arm import TWISTS, VELOCITIES, RosArm
from tests.kit.ros_domains import ros_domain
from tests.kit.waiting import scaled, until

pytestmark = pytest.mark.slow

HOME = (0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0)
NewRobot = Callable[..., AbstractAsyncContextManager[RosRobot]]


@pytest.fixture(scope="module")
def at_work(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shop]:
    """A broker, and a bridge with the shipped mapping."""
    with new_cell(tmp_path_factory.mktemp("cell")) as cell:
        made = Shop(cell, ros_domain())
        made.begin("", HANDOVER_ROS_MAPPING="arm")
        yield made


@pytest.fixture
async def arm(shop: Shop) -> AsyncIterator[RosArm]:
    made = RosArm(list(ROBOT.joint_names), list(HOME))
    await made.join(shop.robot)
    yield made
    await made.leave()


@pytest.fixture
def new_robot(shop: Shop, tmp_path: Path) -> NewRobot:
    """Return a function that makes a robot with options of the driver."""

    @asynccontextmanager
    async def make(*, wait: bool = True, **options: Any) -> AsyncIterator[RosRobot]:
        settings = TrajectorySettings.load(
            data_dir=tmp_path,
            broker_url=shop.cell.url("context_broker"),
            bridge_url=shop.cell.url("ros_fiware_bridge"),
            notify_key="of-the-contract",
        )
        async with BrokerClient(settings) as broker:
            context = context_of(
                ROBOT,
                tmp_path,
                settings=settings,
                robot_id="ur10-1",
                options={"max_delay_s": 10, **options},
                joints=HOME,
                broker=broker,
            )
            async with RosRobot.from_context(context) as robot:
                if wait:
                    await until(lambda: robot.link.joints is not None, why="no joints")
                yield robot

    return make


@pytest.fixture
async def robot(new_robot: NewRobot, arm: RosArm) -> AsyncIterator[RosRobot]:
    """A robot with a velocity controller."""
    async with new_robot(velocity_topic=VELOCITIES, watchdog_s=2.0) as made:
        yield made


class TestRosRobot(RobotContract):
    home = HOME
    limits = ROBOT.limits

    @pytest.fixture
    def move_by_hand(self, arm: RosArm) -> Callable[[Joints], None]:
        def move(displacements: Joints) -> None:
            arm.position += displacements

        return move


class StandingStill:
    """Waits in a process that stands still once: the first cycle is far ahead of the last report."""

    def __init__(self, arm: RosArm) -> None:
        self._arm = arm
        self._loop = asyncio.get_running_loop()
        self._waits = 0
        self._stands, self._goes_on = threading.Event(), threading.Event()

    def _stand_still(self) -> None:
        self._stands.set()
        self._goes_on.wait(10.0)

    def __call__(self, seconds: float) -> None:
        self._waits += bool(self._arm.goals)
        if self._waits == 1:
            self._loop.call_soon_threadsafe(self._stand_still)
            self._stands.wait()
            seconds = 0.3
        elif self._waits > 1:
            self._goes_on.set()
        time.sleep(seconds)


async def test_an_arm_that_is_behind_a_late_first_cycle_is_not_a_fault(robot: RosRobot, arm: RosArm) -> None:
    robot.clock = Clock(wait_s=StandingStill(arm))
    assert await robot.move((0.5, *HOME[1:]), 1.0, lambda: 1.0)
    assert arm.position.tolist() == pytest.approx([0.5, *HOME[1:]], abs=1e-4)


def require_limits(arm: RosArm) -> None:
    """Require that the points of each goal are within the limits, and lead to rest."""
    for goal in arm.goals:
        points = goal["trajectory"]["points"]
        times = [each["time_from_start"]["sec"] + each["time_from_start"]["nanosec"] / 1e9 for each in points]
        velocities, accelerations = (
            np.array([each[key] for each in points]) for key in ("velocities", "accelerations")
        )
        limits = ROBOT.limits
        assert (np.abs(velocities) <= np.array(limits.velocity) * 1.001).all()
        assert (np.abs(accelerations) <= np.array(limits.acceleration) * 1.001).all()
        changes = np.abs(np.diff(velocities, axis=0)) / np.diff(times)[:, None]
        assert (changes <= np.array(limits.acceleration) * 1.001).all()
        assert not velocities[-1].any()


@pytest.mark.nightly
async def test_each_change_of_the_pace_sends_the_rest_of_the_motion_within_the_limits(
    robot: RosRobot, arm: RosArm
) -> None:
    paces = {0.0: 1.0, 0.3: 0.5, 0.7: 0.9}

    def pace() -> float:
        return next(value for turn, value in reversed(paces.items()) if robot.state().positions[0] >= turn)

    assert await robot.move((1.5, *HOME[1:]), 0.6, lambda: pace() if arm.goals else 1.0)
    assert arm.position.tolist() == pytest.approx([1.5, *HOME[1:]], abs=1e-4)
    assert len(arm.goals) >= 3
    slowest = min(
        max(abs(each["velocities"][0]) for each in goal["trajectory"]["points"]) for goal in arm.goals
    )
    assert slowest <= 0.9 * 0.6 * ROBOT.limits.velocity[0] * 1.001
    require_limits(arm)


async def test_a_pause_is_a_planned_stop_and_no_cancelled_goal(robot: RosRobot, arm: RosArm) -> None:
    assert not await robot.move(
        (2.0, *HOME[1:]), 1.0, lambda: 1.0 if robot.state().positions[0] < 0.3 else 0.0
    )
    assert len(arm.goals) == 2
    stop = arm.goals[1]["trajectory"]["points"]
    assert list(stop[-1]["velocities"]) == [0.0] * 6
    assert arm.position[0] == pytest.approx(stop[-1]["positions"][0], abs=1e-4)
    require_limits(arm)


async def test_a_goal_that_the_limiter_refuses_is_not_sent(robot: RosRobot, arm: RosArm) -> None:
    with pytest.raises(RobotFault, match="stopped by the limiter: joint 1 would be at"):
        await robot.move((7.0, *HOME[1:]), 1.0, lambda: 1.0)
    assert not arm.goals
    assert arm.position.tolist() == list(HOME)


async def test_the_reason_of_the_controller_is_the_fault(robot: RosRobot, arm: RosArm) -> None:
    arm.fault = "path tolerance violated at elbow_joint"
    with pytest.raises(RobotFault, match="did not follow the trajectory: path tolerance violated"):
        await robot.move((1.0, *HOME[1:]), 1.0, lambda: 1.0)


async def test_an_arm_that_does_not_move_is_a_fault(new_robot: NewRobot, arm: RosArm) -> None:
    arm.stuck = True
    async with new_robot(max_delay_s=0.2) as robot:
        with pytest.raises(RobotFault, match=r"trajectory controller is active|are unknown"):
            await robot.move((1.5, *HOME[1:]), 1.0, lambda: 1.0)
    assert arm.is_at_rest


async def test_without_a_velocity_topic_servo_is_a_fault(new_robot: NewRobot, arm: RosArm) -> None:
    async with new_robot() as robot:
        with pytest.raises(RobotFault, match="set velocity_topic"):
            await robot.servo(lambda: HOME, lambda: True, lambda: 1.0)


async def test_a_servo_node_gets_the_twist_of_the_tool(new_robot: NewRobot, arm: RosArm) -> None:
    twisting = "geometry_msgs/msg/TwistStamped"
    async with new_robot(velocity_topic=TWISTS, velocity_type=twisting, twist_frame="base") as robot:
        velocity = (0.2, *(0.0,) * 5)
        assert await robot.servo(lambda: velocity, lambda: len(arm.twists) > 20, lambda: 1.0)
    fastest = max(arm.twists, key=lambda each: each["twist"]["angular"]["z"])
    assert fastest["header"]["frame_id"] == "base"
    turning = fastest["twist"]["angular"]["z"]
    assert 0 < turning <= 0.2001
    reach_m = float(np.hypot(*ROBOT.tool_pose(HOME).position[:2]))
    linear = fastest["twist"]["linear"]
    assert np.hypot(linear["x"], linear["y"]) == pytest.approx(reach_m * turning, rel=0.02)
    assert not any(arm.twists[-1]["twist"]["angular"].values())


def bridge_url(shop: Shop) -> str:
    return shop.cell.url("ros_fiware_bridge").replace("http", "ws") + "/arm"


def setup(watchdog_s: float) -> str:
    velocity = VelocityOutput(topic=VELOCITIES, watchdog_s=watchdog_s)
    return ArmSetup(joint_names=ROBOT.joint_names, velocity=velocity).model_dump_json(by_alias=True)


async def test_the_bridge_stops_an_arm_whose_commands_cease(shop: Shop, arm: RosArm) -> None:
    moving = ArmVelocity(values=(0.1, *(0.0,) * 5)).model_dump_json()
    async with connect(bridge_url(shop)) as tool:
        await tool.send(setup(0.1))

        async def is_moving() -> bool:
            await tool.send(moving)
            return not arm.is_at_rest

        await until(is_moving, why="the arm does not move")
        await until(lambda: arm.is_at_rest, why="the watchdog does not stop the arm")
        assert arm.velocities[-1] == [0.0] * 6


async def test_the_bridge_stops_the_arm_of_a_tool_that_has_gone(shop: Shop, arm: RosArm) -> None:
    tool = await connect(bridge_url(shop))
    await tool.send(setup(2.0))

    async def is_moving() -> bool:
        await tool.send(ArmVelocity(values=(0.1, *(0.0,) * 5)).model_dump_json())
        return not arm.is_at_rest

    await until(is_moving, why="the arm does not move")
    tool.transport.abort()
    await until(lambda: arm.is_at_rest, why="the arm still moves")


async def reports(tool: Any, kind: type) -> Any:
    """Return the next report of a kind."""
    async with asyncio.timeout(scaled(10)):
        while True:
            report = ARM_REPORTS.validate_json(await tool.recv())
            if isinstance(report, kind):
                return report


async def test_a_second_client_of_an_arm_is_refused_and_the_first_continues(shop: Shop, arm: RosArm) -> None:
    async with connect(bridge_url(shop)) as first, connect(bridge_url(shop)) as second:
        await first.send(setup(0.5))
        await reports(first, ArmJoints)
        await second.send(setup(0.5))
        assert "another client commands" in (await reports(second, StreamRefusal)).reason
        await reports(first, ArmJoints)


@pytest.mark.parametrize(
    ("sent", "why"),
    [
        ('{"type": "velocity", "values": [0.1]}', "1 velocities, and .* takes 6"),
        ('{"type": "velocity", "values": [NaN, 0, 0, 0, 0, 0]}', "finite"),
        ('{"type": "goal", "id": 1, "points": []}', "goal.points"),
        ("{", "JSON"),
        (b"{}", "JSON text"),
    ],
)
async def test_bad_commands_are_refused_with_the_reason_and_the_arm_rests(
    shop: Shop, arm: RosArm, sent: str | bytes, why: str
) -> None:
    async with connect(bridge_url(shop)) as tool:
        await tool.send(setup(0.5))
        await tool.send(sent)
        refusal = await reports(tool, StreamRefusal)
    assert re.search(why, refusal.reason), refusal.reason
    assert arm.is_at_rest


def test_a_setpoint_at_rest_has_no_twist() -> None:
    assert twist(ROBOT, Setpoint.at_rest(HOME)) == (0.0,) * 6
