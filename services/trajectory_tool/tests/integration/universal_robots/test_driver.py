"""The driver `ur` with a simulated controller: states, faults and their remedies, gripper, reconnection."""

import asyncio
import os
import signal
import socket
import struct
import threading
from dataclasses import replace
from typing import Any

import httpx
import pytest

from handover.errors import UsageError
from handover.security.guard import Guard
from handover.serving.service import create_app
from handover.settings import Settings
from handover_robots.driver_base.context import RobotContext
from handover_robots.model.faults import RobotFault
from handover_robots.robots.panda import ROBOT as PANDA
from handover_robots.robots.ur10 import ROBOT
from handover_ur import rtde
from handover_ur.arm_model import expected_model, other_series
from handover_ur.driver import UniversalRobot
from handover_ur.exchange import INPUTS
from handover_ur.options import UrOptions, with_environment
from handover_ur.routes import view_of
from handover_ur.simulator.controller import SimulatedController
from handover_ur.states import RobotMode, RuntimeState, UrSafetyStatus
from services.trajectory_tool.tests.integration.universal_robots.conftest import HOME, NewRobot
from tests.kit.ur_controllers import RunningController
from tests.kit.waiting import until, wait_for

pytestmark = pytest.mark.slow

AWAY = (1.5, *HOME[1:])
FAR = (3.0, *HOME[1:])


async def in_motion(robot: UniversalRobot) -> None:
    await until(lambda: abs(robot.state().velocities[0]) > 0.3, why="the arm does not move")


async def at_rest(controller: RunningController) -> None:
    await until(lambda: controller.do(lambda simulated: simulated.is_at_rest), why="the arm does not stop")


async def interrupted(robot: UniversalRobot, controller: RunningController, by: Any) -> str:
    """Return the fault of a motion that `by` interrupts."""
    moving = asyncio.create_task(robot.move(FAR, 1.0, lambda: 1.0))
    await in_motion(robot)
    controller.do(by)
    with pytest.raises(RobotFault) as fault:
        await moving
    await at_rest(controller)
    return str(fault.value)


async def test_a_protective_stop_is_named_and_only_a_person_ends_it(
    robot: UniversalRobot, controller: RunningController
) -> None:
    why = await interrupted(robot, controller, lambda simulated: simulated.protective_stop("collision"))
    assert "protective stop; remove the cause, then unlock the arm at the teach pendant" in why
    with pytest.raises(RobotFault, match="protective stop"):
        await robot.move(AWAY, 1.0, lambda: 1.0)
    assert controller.do(lambda simulated: simulated.safety) is UrSafetyStatus.PROTECTIVE_STOP
    controller.do(SimulatedController.clear_stop)
    await until(lambda: robot.exchange.report().safety_status == UrSafetyStatus.NORMAL)
    assert await robot.move(AWAY, 1.0, lambda: 1.0)
    assert robot.state().positions == pytest.approx(AWAY, abs=0.005)


async def test_an_arm_of_another_model_does_not_move_until_it_is_named(
    new_robot: NewRobot, controller: RunningController
) -> None:
    controller.do(lambda simulated: setattr(simulated, "model", "UR5"))
    async with new_robot() as robot:
        with pytest.raises(
            RobotFault, match="its arm is a UR5, and motions of ur10-1 are planned for a UR10"
        ):
            await robot.move(AWAY, 1.0, lambda: 1.0)
        assert controller.do(lambda simulated: simulated.programs_started) == 0
        controller.do(lambda simulated: setattr(simulated, "model", "UR10"))
        assert await robot.move(AWAY, 1.0, lambda: 1.0)
    controller.do(lambda simulated: setattr(simulated, "model", "UR10e, calibrated"))
    async with new_robot(controller_model="any") as robot:
        assert await robot.move(HOME, 1.0, lambda: 1.0)


async def test_an_emergency_stop_is_named_and_the_arm_stays_off(
    robot: UniversalRobot, controller: RunningController
) -> None:
    why = await interrupted(robot, controller, SimulatedController.emergency_stop)
    assert "emergency stop is active (ROBOT_EMERGENCY_STOP)" in why
    controller.do(SimulatedController.clear_stop)
    await until(lambda: robot.exchange.report().safety_status == UrSafetyStatus.NORMAL)
    with pytest.raises(RobotFault, match="powered off; power it on at the teach pendant"):
        await robot.move(AWAY, 1.0, lambda: 1.0)
    assert controller.do(lambda simulated: simulated.robot_mode) is RobotMode.POWER_OFF


async def test_safety_functions_inputs_and_force_of_the_controller_are_shown_and_nothing_resets_them(
    robot: UniversalRobot, controller: RunningController
) -> None:
    def set_inputs(simulated: SimulatedController) -> None:
        simulated.digital_inputs, simulated.tcp_force_n, simulated.speed_slider = (
            0b101,
            (0.0, 30.0, 40.0),
            0.5,
        )

    controller.do(set_inputs)
    await until(lambda: robot.digital_inputs() == 0b101)
    assert robot.wrist_force_n() == pytest.approx(50.0)
    status = robot.safety_status()
    assert (status.emergency_stop, status.protective_stop, status.safeguard_stop) == (False, False, False)
    assert (status.mode, status.speed, status.detail) == ("RUNNING, NORMAL", 0.5, "")
    controller.do(lambda simulated: simulated.protective_stop("collision"))
    await until(lambda: robot.safety_status().protective_stop)
    assert "unlock the arm at the teach pendant" in robot.safety_status().detail
    controller.do(SimulatedController.clear_stop)
    controller.do(SimulatedController.safeguard_stop)
    await until(lambda: robot.safety_status().safeguard_stop)
    controller.do(SimulatedController.release_safeguard)
    controller.do(SimulatedController.emergency_stop)
    await until(lambda: robot.safety_status().emergency_stop)
    assert controller.do(lambda simulated: simulated.safety) is UrSafetyStatus.ROBOT_EMERGENCY_STOP


async def test_without_reports_the_inputs_and_the_force_are_unknown(new_robot: NewRobot) -> None:
    async with new_robot(wait=False, rtde_port=1) as robot:
        assert robot.digital_inputs() is None
        assert robot.wrist_force_n() is None
        status = robot.safety_status()
        assert "is not connected" in status.detail
        assert "s old" not in status.detail, "a controller that never reported has no last report"
        assert (status.mode, status.speed) == ("", None)


async def test_the_arm_does_not_continue_by_itself_after_a_safeguard_stop(
    robot: UniversalRobot, controller: RunningController
) -> None:
    why = await interrupted(robot, controller, SimulatedController.safeguard_stop)
    assert "leave the safeguarded space and reset the safeguard" in why
    rest = controller.do(lambda simulated: tuple(simulated.positions))
    cycles = controller.do(lambda simulated: simulated.time_s)
    controller.do(SimulatedController.release_safeguard)
    await until(lambda: controller.do(lambda simulated: simulated.time_s) > cycles + 0.3)
    assert controller.do(lambda simulated: tuple(simulated.positions)) == pytest.approx(rest)
    assert await robot.move(AWAY, 1.0, lambda: 1.0)


@pytest.mark.parametrize(
    ("mode", "why"),
    [
        (RobotMode.POWER_OFF, "powered off"),
        (RobotMode.IDLE, "brakes of the arm are closed"),
        (RobotMode.BOOTING, "in the mode BOOTING"),
    ],
)
async def test_a_motion_needs_a_running_arm(
    robot: UniversalRobot, controller: RunningController, mode: RobotMode, why: str
) -> None:
    controller.do(lambda simulated: setattr(simulated, "robot_mode", mode))
    await until(lambda: robot.exchange.report().robot_mode == mode)
    with pytest.raises(RobotFault, match=why):
        await robot.move(AWAY, 1.0, lambda: 1.0)


@pytest.mark.nightly
async def test_local_control_is_named(robot: UniversalRobot, controller: RunningController) -> None:
    controller.do(lambda simulated: setattr(simulated, "in_remote_control", False))
    with pytest.raises(RobotFault, match="local control; select remote control"):
        await robot.move(AWAY, 1.0, lambda: 1.0)


@pytest.mark.nightly
async def test_the_speed_slider_slows_the_motion(
    robot: UniversalRobot, controller: RunningController
) -> None:
    controller.do(lambda simulated: setattr(simulated, "speed_slider", 0.3))
    await until(lambda: robot.exchange.report().speed_slider == pytest.approx(0.3))
    assert await robot.move(AWAY, 1.0, lambda: 1.0)
    assert robot.state().positions == pytest.approx(AWAY, abs=0.005)
    assert (
        controller.do(lambda simulated: simulated.peak_speed_rad_s) <= 0.3 * ROBOT.limits.velocity[0] + 0.02
    )
    assert controller.do(lambda simulated: simulated.safety) is UrSafetyStatus.NORMAL


async def test_a_speed_slider_at_zero_is_a_fault(
    robot: UniversalRobot, controller: RunningController
) -> None:
    controller.do(lambda simulated: setattr(simulated, "speed_slider", 0.0))
    await until(lambda: robot.exchange.report().speed_slider == 0.0)
    with pytest.raises(RobotFault, match="speed slider of the controller is at 0 %"):
        await robot.move(AWAY, 1.0, lambda: 1.0)


async def test_the_torques_of_the_controller_are_the_efforts_of_the_joints(robot: UniversalRobot) -> None:
    moving = asyncio.create_task(robot.move(AWAY, 1.0, lambda: 1.0))
    await until(lambda: (robot.state().efforts or (0.0,))[0] > 0.1, why="no torque accelerates the joint")
    assert await moving
    await until(lambda: robot.state().efforts == pytest.approx((0.0,) * 6, abs=0.01), why="torques at rest")


async def test_a_lost_connection_is_a_fault_and_is_established_again(
    robot: UniversalRobot, controller: RunningController
) -> None:
    moving = asyncio.create_task(robot.move(FAR, 1.0, lambda: 1.0))
    await in_motion(robot)
    controller.do(lambda _: controller.simulator.rtde.drop_clients())
    with pytest.raises(RobotFault, match=r"is not connected|has ended during the motion"):
        await moving
    await until(lambda: robot.exchange.report().connections >= 2 and robot.exchange.report().is_connected)
    assert await robot.move(AWAY, 1.0, lambda: 1.0)
    assert robot.state().positions == pytest.approx(AWAY, abs=0.005)


async def test_a_process_that_hangs_is_a_fault_until_it_runs_again(new_robot: NewRobot) -> None:
    async with new_robot(silence_s=0.5) as robot:
        pid = robot.exchange.pid
        assert pid is not None
        os.kill(pid, signal.SIGSTOP)
        try:
            await until(lambda: "s old" in robot.safety_status().detail, why="the silence is not noticed")
            with pytest.raises(RobotFault, match=r"is not connected: its last report is \d+\.\d s old"):
                await robot.move(AWAY, 1.0, lambda: 1.0)
        finally:
            os.kill(pid, signal.SIGCONT)


async def test_a_controller_that_restarts_is_found_again(
    robot: UniversalRobot, controller: RunningController
) -> None:
    controller.run(controller.simulator.restart(0.5))
    await until(
        lambda: (
            robot.exchange.report().is_connected and robot.exchange.report().robot_mode == RobotMode.POWER_OFF
        )
    )
    with pytest.raises(RobotFault, match="powered off"):
        await robot.move(AWAY, 1.0, lambda: 1.0)


@pytest.mark.nightly
async def test_an_absent_controller_is_a_fault_with_its_address(new_robot: NewRobot) -> None:
    with socket.socket() as closed:
        closed.bind(("127.0.0.1", 0))
        port = closed.getsockname()[1]
        async with new_robot(wait=False, rtde_port=port) as robot:
            await until(lambda: robot.exchange.report().reason)
            assert robot.state().positions == HOME
            with pytest.raises(RobotFault, match=rf"127.0.0.1 is not connected: 127.0.0.1:{port}"):
                await robot.move(AWAY, 1.0, lambda: 1.0)


@pytest.mark.nightly
async def test_what_is_shown_of_a_controller_agrees_with_its_fault(
    new_robot: NewRobot, controller: RunningController
) -> None:
    """Of one whose report never ends, and of one whose software is not supported."""

    def shown(robot: UniversalRobot) -> dict[str, Any]:
        return view_of(robot.exchange.report(), robot.options)

    async with new_robot(silence_s=2.0) as robot:
        await until(lambda: shown(robot)["connected"])
        connections = robot.exchange.report().connections
        controller.do(lambda _: controller.simulator.rtde.broadcast(struct.pack(">HB", 0xFFFF, ord("U"))))
        await until(lambda: robot.exchange.report().connections > connections)
        await until(lambda: shown(robot)["connected"])
        controller.do(lambda simulated: setattr(simulated, "version", (3, 9, 1, 1)))
        controller.do(lambda _: controller.simulator.rtde.drop_clients())
        await until(lambda: "3.9.1.1" in str(shown(robot)["reason"]))
        view = shown(robot)
        assert not view["connected"]
        assert "127.0.0.1 is not connected: the controller has the software 3.9.1.1" in view["fault"]
        with pytest.raises(RobotFault, match=r"the driver needs PolyScope 5\.4 or newer"):
            await robot.move(AWAY, 1.0, lambda: 1.0)


@pytest.mark.nightly
async def test_registers_of_another_client_are_named(
    new_robot: NewRobot, controller: RunningController
) -> None:
    with socket.create_connection(("127.0.0.1", controller.simulator.ports.rtde)) as other:
        other.sendall(rtde.setup_inputs(INPUTS[:1]))
        other.recv(100)
        async with new_robot(wait=False) as robot:
            await until(lambda: "IN_USE" in robot.exchange.report().reason)
            with pytest.raises(RobotFault, match=r"input_int_register_24 \(IN_USE\)"):
                await robot.move(AWAY, 1.0, lambda: 1.0)


async def test_late_packages_of_the_controller_do_not_disturb_a_motion(
    robot: UniversalRobot, controller: RunningController
) -> None:
    controller.do(lambda _: setattr(controller.simulator.rtde, "output_delay_s", 0.008))
    assert await robot.move(AWAY, 1.0, lambda: 1.0)
    assert robot.state().positions == pytest.approx(AWAY, abs=0.005)
    assert controller.do(lambda simulated: simulated.safety) is UrSafetyStatus.NORMAL


@pytest.mark.nightly
async def test_the_arm_stops_when_the_exchange_process_dies(
    new_robot: NewRobot, controller: RunningController
) -> None:
    async with new_robot(watchdog_s=2.0) as robot:
        moving = asyncio.create_task(robot.move(FAR, 0.3, lambda: 1.0))
        await in_motion(robot)
        pid = robot.exchange.pid
        assert pid is not None
        os.kill(pid, signal.SIGKILL)
        await at_rest(controller)
        assert controller.do(lambda simulated: simulated.positions[0]) < FAR[0]
        with pytest.raises(RobotFault):
            await moving
        await until(lambda: robot.exchange.pid != pid and robot.exchange.report().is_connected)
        assert await robot.move(AWAY, 1.0, lambda: 1.0)


async def test_the_arm_stops_when_no_setpoints_arrive_and_the_motion_can_be_continued(
    new_robot: NewRobot, controller: RunningController
) -> None:
    stalled = threading.Event()

    async with new_robot(watchdog_s=0.5) as robot:

        def stall_once() -> float:
            """Stand still in the control thread until the exchange process has ended the motion."""
            if robot.state().positions[0] > 0.3 and not stalled.is_set():
                stalled.set()
                wait_for(lambda: robot.exchange.report().interruption)
            return 1.0

        assert not await robot.move(FAR, 0.5, stall_once)
        assert stalled.is_set()
        await at_rest(controller)
        assert controller.do(lambda simulated: simulated.safety) is UrSafetyStatus.NORMAL
        assert 0.28 < robot.state().positions[0] < FAR[0]
        while not await robot.move(AWAY, 1.0, lambda: 1.0):
            pass  # a busy machine may delay the setpoints again
        assert robot.state().positions == pytest.approx(AWAY, abs=0.005)


@pytest.mark.nightly
async def test_two_motions_at_once_are_refused_without_disturbing_the_first(
    robot: UniversalRobot,
) -> None:
    first, second = (asyncio.create_task(robot.move(target, 1.0, lambda: 1.0)) for target in (AWAY, FAR))
    with pytest.raises(RobotFault, match="in motion"):
        await second
    assert await first
    assert robot.state().positions == pytest.approx(AWAY, abs=0.005)


async def test_the_payload_is_set_by_the_program(new_robot: NewRobot, controller: RunningController) -> None:
    async with new_robot(payload_kg=1.2, payload_centre_m=(0.0, 0.01, 0.06)) as robot:
        assert await robot.move((0.1, *HOME[1:]), 1.0, lambda: 1.0)
    assert controller.do(lambda simulated: (simulated.payload_kg, simulated.payload_centre_m)) == (
        1.2,
        (0.0, 0.01, 0.06),
    )


async def test_the_program_ends_with_the_tool(new_robot: NewRobot, controller: RunningController) -> None:
    async with new_robot() as robot:
        assert await robot.move((0.1, *HOME[1:]), 1.0, lambda: 1.0)
        assert controller.do(lambda simulated: simulated.runtime) is RuntimeState.PLAYING
    await until(lambda: controller.do(lambda simulated: simulated.runtime) is RuntimeState.STOPPED)


async def test_a_stop_of_category_1_removes_the_power(
    robot: UniversalRobot, controller: RunningController
) -> None:
    moving = asyncio.create_task(robot.move(FAR, 1.0, lambda: 1.0))
    await in_motion(robot)
    await robot.stop(1)
    assert not await moving
    assert controller.do(lambda simulated: simulated.robot_mode) is RobotMode.POWER_OFF


# Grippers


async def test_a_gripper_at_the_tool_outputs_reports_what_it_holds(
    new_robot: NewRobot, controller: RunningController
) -> None:
    async with new_robot(gripper="tool_io", tool_output=1, tool_input=0) as robot:
        assert not await robot.close_gripper()
        assert controller.do(lambda simulated: simulated.digital_outputs) == 1 << 17
        controller.do(lambda simulated: setattr(simulated, "digital_inputs", 1 << 16))
        await until(lambda: robot.exchange.report().digital_inputs == 1 << 16)
        assert await robot.close_gripper()
        assert robot.gripper_closed
        await robot.open_gripper()
        assert controller.do(lambda simulated: simulated.digital_outputs) == 0
        assert not robot.gripper_closed


async def test_a_robotiq_gripper_reports_an_object(
    new_robot: NewRobot, controller: RunningController
) -> None:
    fingers = controller.simulator.robotiq
    fingers.variables["ACT"] = 1
    async with new_robot(gripper="robotiq", robotiq_force=0.5) as robot:
        assert not await robot.close_gripper()
        await robot.open_gripper()
        fingers.object_at = 120
        assert await robot.close_gripper()
        assert fingers.variables["FOR"] == 128
        await robot.open_gripper()
        assert not robot.gripper_closed


async def test_faults_of_a_robotiq_gripper_are_named(
    new_robot: NewRobot, controller: RunningController
) -> None:
    async with new_robot(gripper="robotiq") as robot:
        with pytest.raises(RobotFault, match="not activated; activate it at the teach pendant"):
            await robot.close_gripper()
        controller.simulator.robotiq.variables.update(ACT=1, FLT=9)
        with pytest.raises(RobotFault, match="fault 9"):
            await robot.close_gripper()
    async with new_robot(gripper="robotiq", robotiq_port=1) as robot:
        with pytest.raises(RobotFault, match=r"gripper at 127\.0\.0\.1:1"):
            await robot.open_gripper()
    async with new_robot() as robot:
        with pytest.raises(RobotFault, match="no gripper is configured"):
            await robot.close_gripper()


# Routes and settings


async def test_the_controller_is_shown_and_powered_at_the_request_of_a_person(
    robot: UniversalRobot, controller: RunningController
) -> None:
    app = create_app("Tool", description="", guard=Guard(Settings(_env_file=None), "trajectory-tool"))
    robot.mount(app)
    transport = httpx.ASGITransport(app)
    async with httpx.AsyncClient(transport=transport, base_url="http://localhost/robots/ur10-1") as client:
        controller.do(SimulatedController.power_off)
        await until(lambda: robot.exchange.report().robot_mode == RobotMode.POWER_OFF)
        shown = (await client.get("/controller")).json()
        assert (shown["robotMode"], shown["safetyStatus"]) == ("POWER_OFF", "NORMAL")
        assert "powered off" in shown["fault"]
        assert (await client.get("/controller/identity")).json()["model"] == "UR10"
        await client.post("/controller/power-on")
        await until(lambda: robot.exchange.report().robot_mode == RobotMode.IDLE)
        await client.post("/controller/brake-release")
        await until(lambda: robot.exchange.report().robot_mode == RobotMode.RUNNING)
        assert (await client.get("/controller")).json()["fault"] is None


def test_options_come_from_the_cell_file_and_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HANDOVER_UR_HOST", "10.0.0.5")
    monkeypatch.setenv("HANDOVER_UR_PAYLOAD_CENTRE_M", "[0, 0, 0.1]")
    monkeypatch.setenv("HANDOVER_UR_GRIPPER", "robotiq")
    options = UrOptions.model_validate(with_environment({"gripper": "tool_io"}))
    assert options.host == "10.0.0.5"
    assert options.payload_centre_m == (0, 0, 0.1)
    assert options.gripper == "tool_io"


@pytest.mark.parametrize(
    ("robot_model", "setting", "expected"),
    [
        ("UR10", None, "UR10"),
        ("UR5e", None, "UR5"),
        ("my arm", None, None),
        ("my arm", "UR3", "UR3"),
        ("UR10", "any", None),
    ],
)
def test_the_expected_model_is_that_of_the_arm_or_of_the_setting(
    robot_model: str, setting: str | None, expected: str | None
) -> None:
    assert expected_model(robot_model, setting) == expected


def test_another_series_is_noticed() -> None:
    warning = other_series("UR10", "URSoftware 5.15.0.1")
    assert (
        warning == "motions are planned for an arm of the CB3 series, and the controller is of the e-Series"
    )
    assert other_series("UR5e", "URSoftware 5.15.0.1") is None
    assert other_series("UR5e", "URSoftware 3.15.1") is not None
    assert other_series("my arm", "URSoftware 3.15.1") is None


def test_a_model_with_seven_joints_is_refused(context: RobotContext) -> None:
    with pytest.raises(UsageError, match="moves arms with 6 joints"):
        UniversalRobot.from_context(replace(context, model=PANDA))


@pytest.mark.parametrize("source", ["option", "environment"])
def test_a_payload_beyond_the_arm_is_refused(
    context: RobotContext, monkeypatch: pytest.MonkeyPatch, source: str
) -> None:
    limit_kg = context.model.max_payload_kg
    assert limit_kg is not None

    def made_with(payload_kg: float) -> UniversalRobot:
        options = {"host": "127.0.0.1"}
        if source == "environment":
            monkeypatch.setenv("HANDOVER_UR_PAYLOAD_KG", str(payload_kg))
        else:
            options |= {"payload_kg": str(payload_kg)}
        return UniversalRobot.from_context(replace(context, options=options))

    assert made_with(limit_kg).options.payload_kg == limit_kg
    with pytest.raises(
        UsageError, match=f"payload_kg of ur10-1 is .*may carry {limit_kg:g} kg at its flange"
    ):
        made_with(limit_kg + 0.1)


def test_an_unknown_option_is_refused(context: RobotContext) -> None:
    with pytest.raises(UsageError, match=r"robots\.ur10-1\.settings\.hostname"):
        UniversalRobot.from_context(replace(context, options={"hostname": "10.0.0.5"}))
