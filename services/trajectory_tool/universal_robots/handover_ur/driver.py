"""The driver `ur`: an arm of Universal Robots, moved by setpoints through its controller.

The setpoints of the control thread go through shared memory to the exchange process, and from there by RTDE
to our program on the controller, which calls `servoj`. The program is sent when a motion needs it. The safety
functions are those of the controller: nothing here ends a protective, safeguard or emergency stop.
"""

import asyncio
import random
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import replace
from typing import Self

from fastapi import FastAPI

from handover.errors import UsageError
from handover.messages import text_of
from handover.runtime.control_cycle import runs_in_cycle
from handover.telemetry import get_logger
from handover_robots.driver_base.context import Clock, RobotContext
from handover_robots.driver_base.cyclic_robot import CyclicRobot
from handover_robots.driver_base.robot import SafetyStatus, StopCategory
from handover_robots.model.faults import RobotFault
from handover_robots.model.joint_trajectory import JointTrajectory
from handover_robots.model.joints import Joints, JointState, Pace, Velocity
from handover_robots.model.trajectory import Setpoint
from handover_ur.arm_model import expected_model, other_model, other_series
from handover_ur.dashboard import Dashboard, DashboardError
from handover_ur.exchange_process import ExchangeProcess
from handover_ur.faults import (
    EMERGENCY_STOPS,
    MIN_SPEED_FRACTION,
    SAFEGUARD_STOPS,
    fault_of,
    is_connected,
)
from handover_ur.gripper import (
    NoGripper,
    RobotiqGripper,
    ToolOutputGripper,
    UrGripper,
)
from handover_ur.options import UrOptions, with_environment
from handover_ur.program import JOINTS, Payload, ProgramParameters, program
from handover_ur.routes import add_routes
from handover_ur.shared_memory import Interruption, Report
from handover_ur.states import (
    ProgramState,
    RuntimeState,
    UrSafetyStatus,
    robot_mode,
    safety_status,
)

log = get_logger(__name__)

CONTROL_HZ = 500.0
MAX_STEP_S = 0.010
"""A late cycle advances a motion by no more than this; the motion then takes longer."""
MAX_LAG_RAD, MIN_RATE = 0.03, 0.02
"""The time of a motion runs slower the further the joint targets are behind, down to a minimum."""
CHECK_EVERY_S = 0.005
CONNECT_TIMEOUT_S = 5.0
PROGRAM_TIMEOUT_S = 5.0
SETTLE_TIMEOUT_S = 3.0
SETTLED_RAD, SETTLED_RAD_S = 0.002, 0.01
MAX_PROGRAM_ID = 2**31 - 1


class _Stalled(RobotFault):
    """The motion was stopped because setpoints were late; it can be continued from the measured joints."""


class UniversalRobot(CyclicRobot):
    """An arm with the controller of `options`; the stored joints are used until the first report."""

    def __init__(self, context: RobotContext, options: UrOptions) -> None:
        self.exchange = ExchangeProcess(options, context.limits)
        super().__init__(
            context.joints,
            context.limits,
            control_hz=max(context.settings.control_hz, CONTROL_HZ),
            clock=context.clock or SteadyClock(lambda: self.exchange.report().lag_rad).clock,
            limiter=context.limiter,
        )
        self.options = options
        self.robot_id = context.robot_id
        self.dashboard = Dashboard(options.host, options.dashboard_port)
        self._stored = JointState(time.time(), context.joints, (0.0,) * len(context.joints))
        self._program_id = 0
        self._model_name = context.model.name
        self._checked_connection = 0
        self._in_motion = asyncio.Lock()
        self._gripper_closed = context.gripper_closed
        self._gripper = self._make_gripper(context)

    @classmethod
    def from_context(cls, context: RobotContext) -> Self:
        """Return the robot of a cell; raise `UsageError` for a model that does not have six joints."""
        if len(context.model.joints) != JOINTS:
            raise UsageError(
                f"the driver ur moves arms with {JOINTS} joints, and {context.model.name} has "
                f"{len(context.model.joints)}; choose another driver or model for {context.robot_id}"
            )
        complete = replace(context, options=with_environment(context.options))
        options, limit_kg = complete.read_options(UrOptions), context.model.max_payload_kg
        if options.payload_kg is not None and limit_kg is not None and options.payload_kg > limit_kg:
            raise UsageError(
                f"payload_kg of {context.robot_id} is {options.payload_kg:g}, and {context.model.name} may "
                f"carry {limit_kg:g} kg at its flange; correct the option"
            )
        return cls(context, options)

    def mount(self, app: FastAPI) -> None:
        """Add the routes of the controller."""
        add_routes(app, self.robot_id, self.dashboard, self.exchange.report, self.options)

    async def __aenter__(self) -> Self:
        await self.exchange.__aenter__()
        return await super().__aenter__()

    async def __aexit__(self, *_: object) -> None:
        try:
            await super().__aexit__(*_)
            await self._at_rest()
        finally:
            await self.exchange.__aexit__()

    def state(self) -> JointState:
        """Return the last reported joints."""
        report = self.exchange.report()
        if report.wall_s == 0.0:
            return self._stored
        return _joint_state(report)

    def measured(self) -> JointState:
        """Return the reported joints. Raises `RobotFault` when the last report is too old."""
        report = self.exchange.report()
        if not self._is_fresh(report):
            raise self._fault(report) or _ended(report)
        return _joint_state(report)

    @runs_in_cycle
    def command(self, setpoint: Setpoint) -> None:
        """Command a setpoint. Raises `RobotFault` once the controller has stopped the motion."""
        report = self.exchange.report()
        fault = self._fault(report)
        if fault is not None:
            raise fault
        if report.interruption == Interruption.STALLED:
            raise _Stalled("setpoints were late")
        if report.interruption == Interruption.STOPPED:
            raise _ended(report)
        self.exchange.servo(setpoint, self._program_id)

    async def move(self, target: Joints, speed: float, pace: Pace) -> bool:
        """Move to `target`; see `Robot.move`."""
        motion = super().move
        return await self._perform(lambda slowed: motion(target, speed, slowed), pace)

    async def follow(self, trajectory: JointTrajectory, pace: Pace) -> bool:
        """Follow a planned trajectory; see `Robot.follow`."""
        motion = super().follow
        return await self._perform(lambda slowed: motion(trajectory, slowed), pace)

    async def servo(self, velocity: Velocity, until: Callable[[], bool], pace: Pace) -> bool:
        """Move with the latest joint velocities; see `Robot.servo`."""
        motion = super().servo
        return await self._perform(lambda slowed: motion(velocity, until, slowed), pace)

    async def stop(self, category: StopCategory) -> None:
        """Bring the motion to rest; see `Robot.stop`."""
        await super().stop(2)
        await self._at_rest()
        if category == 1:
            await self.power_off()

    async def power_off(self) -> None:
        """Remove the power of the arm; its brakes close. Raises `RobotFault`."""
        try:
            await self.dashboard.power_off()
        except DashboardError as error:
            raise RobotFault(text_of(error)) from None

    async def close_gripper(self) -> bool:
        """Close the gripper; return True when an object is between its fingers."""
        self._require_connection()
        gripped = await self._gripper.close()
        self._gripper_closed = True
        return gripped

    async def open_gripper(self) -> None:
        """Open the gripper."""
        self._require_connection()
        await self._gripper.open()
        self._gripper_closed = False

    def safety_status(self) -> SafetyStatus:
        """Return what the controller reports of its safety functions."""
        report = self.exchange.report()
        status, fault = safety_status(report.safety_status), self._fault(report)
        is_fresh = self._is_fresh(report)
        return SafetyStatus(
            emergency_stop=is_fresh and status in EMERGENCY_STOPS,
            protective_stop=is_fresh and status is UrSafetyStatus.PROTECTIVE_STOP,
            safeguard_stop=is_fresh and status in SAFEGUARD_STOPS,
            mode=f"{robot_mode(report.robot_mode).name}, {status.name}" if is_fresh else "",
            speed=report.speed_fraction if is_fresh else None,
            detail="" if fault is None else text_of(fault),
        )

    def digital_inputs(self) -> int | None:
        """Return the digital inputs; None when the last report is too old."""
        report = self.exchange.report()
        return report.digital_inputs if self._is_fresh(report) else None

    def wrist_force_n(self) -> float | None:
        """Return the force at the tool as the controller measures it; None when the report is too old."""
        report = self.exchange.report()
        return report.wrist_force_n if self._is_fresh(report) else None

    @property
    def gripper_closed(self) -> bool:
        """Return whether the last command closed the gripper."""
        return self._gripper_closed

    def _make_gripper(self, context: RobotContext) -> UrGripper:
        match self.options.gripper:
            case "robotiq":
                return RobotiqGripper(self.options)
            case "tool_io":
                return ToolOutputGripper(
                    self.options,
                    self.exchange.report,
                    self.exchange.set_tool_outputs,
                    context.gripper_s,
                    lambda: context.is_between_fingers(self.state().positions),
                )
            case _:
                return NoGripper()

    # Motions

    async def _perform(self, motion: Callable[[Pace], Awaitable[bool]], pace: Pace) -> bool:
        """Run a motion with the program on the controller, until the measured joints are at rest."""
        if self._in_motion.locked():
            raise RobotFault.translated(
                "robot.in_motion", "the robot is in motion; wait for its end or stop it before another motion"
            )
        async with self._in_motion:
            try:
                await self._prepare()
                arrived = await motion(lambda: pace() * self._speed_fraction())
                await self._settle()
            except _Stalled:
                log.warning("motion stopped because setpoints were late", robot=self.robot_id)
                await self._await_report(_is_at_rest, SETTLE_TIMEOUT_S)
                arrived = False
            except asyncio.CancelledError:
                await asyncio.shield(self._settle())
                raise
            finally:
                self.exchange.hold()
        return arrived

    def _speed_fraction(self) -> float:
        """Return the fraction of the speed at which the controller runs programs; 0 stops the motion."""
        fraction = self.exchange.report().speed_fraction
        return 0.0 if fraction < MIN_SPEED_FRACTION else min(fraction, 1.0)

    async def _prepare(self) -> None:
        """Require that the arm can move, and start the program if it does not run."""
        if self.switched_off.is_set():
            return  # CyclicRobot rejects the motion
        await self._await_report(lambda report: report.is_connected, CONNECT_TIMEOUT_S)
        fault = self._fault(self.exchange.report())
        if fault is not None:
            raise fault
        await self._require_model()
        if self._speed_fraction() == 0.0:
            raise RobotFault.translated(
                "robot.ur_speed_slider",
                "the speed slider of the controller is at 0 %; raise it at the teach pendant",
            )
        self.exchange.hold()
        if not self._runs_program(self.exchange.report()):
            await self._start_program()

    async def _require_model(self) -> None:
        """Require, once a connection, that the arm is the expected one. Raises `RobotFault`."""
        connection = self.exchange.report().connections
        expected = expected_model(self._model_name, self.options.controller_model)
        if expected is None or connection == self._checked_connection:
            return
        try:
            identity = await self.dashboard.describe()
        except DashboardError as error:
            log.warning("model of the arm not checked", robot=self.robot_id, reason=text_of(error))
            return
        fault = other_model(self.robot_id, expected, identity["model"])
        if fault is not None:
            raise RobotFault(fault)
        warning = other_series(self._model_name, identity["software"])
        if warning is not None and self.options.controller_model is None:
            log.warning(warning, robot=self.robot_id)
        self._checked_connection = connection

    def _runs_program(self, report: Report) -> bool:
        return (
            report.runtime_state == RuntimeState.PLAYING
            and report.program_id == self._program_id != 0
            and report.program_state in {ProgramState.READY, ProgramState.SERVOING}
            and report.interruption == Interruption.NONE
        )

    async def _start_program(self) -> None:
        """Send the program to the script interface and wait until it runs. Raises `RobotFault`."""
        options = self.options
        self._program_id = random.randint(1, MAX_PROGRAM_ID)  # noqa: S311 - a name, not a secret
        payload = None
        if options.payload_kg is not None:
            payload = Payload(options.payload_kg, options.payload_centre_m)
        script = program(
            ProgramParameters(
                program_id=self._program_id,
                cycle_s=1.0 / self.exchange.report().frequency_hz,
                watchdog_s=options.watchdog_s,
                stop_rad_s2=options.stop_rad_s2,
                lookahead_s=options.lookahead_s,
                gain=options.gain,
                payload=payload,
            )
        )
        try:
            async with asyncio.timeout(PROGRAM_TIMEOUT_S):
                _, writer = await asyncio.open_connection(options.host, options.script_port)
        except (OSError, TimeoutError) as error:
            raise await self._not_started(str(error) or "no answer") from None
        try:
            writer.write(script.encode())
            await writer.drain()
            if not await self._await_report(self._runs_program, PROGRAM_TIMEOUT_S):
                raise await self._not_started("the program does not run")
        except OSError as error:
            raise await self._not_started(str(error)) from None
        finally:
            writer.close()

    async def _not_started(self, reason: str) -> RobotFault:
        fault = self._fault(self.exchange.report())
        if fault is not None:
            return fault
        try:
            is_remote = await self.dashboard.is_in_remote_control()
        except DashboardError as error:
            is_remote, reason = None, f"{reason}; {error}"
        if is_remote is False:
            return RobotFault.translated(
                "robot.ur_local_control",
                "the controller is in local control; select remote control at the teach pendant",
            )
        return RobotFault.translated(
            "robot.ur_program_not_started",
            "the controller did not start the motion program: {reason}; read the log at the teach pendant",
            reason=reason,
        )

    async def _await_report(self, condition: Callable[[Report], bool], within_s: float) -> bool:
        deadline_s = time.monotonic() + within_s
        while not condition(self.exchange.report()):
            if time.monotonic() > deadline_s:
                return False
            await asyncio.sleep(CHECK_EVERY_S)
        return True

    async def _settle(self) -> None:
        """Wait until the measured joints have reached the last setpoint. Raises `RobotFault`."""

        def is_settled(report: Report) -> bool:
            away = max(abs(a - b) for a, b in zip(report.positions, self.setpoint.positions, strict=True))
            return away < SETTLED_RAD and _is_at_rest(report)

        def is_done(report: Report) -> bool:
            return report.interruption != Interruption.NONE or is_settled(report)

        if self._program_id == 0:
            return
        await self._await_report(is_done, SETTLE_TIMEOUT_S)
        report = self.exchange.report()
        fault = self._fault(report)
        if fault is not None:
            raise fault
        if report.interruption == Interruption.STOPPED:
            raise _ended(report)

    async def _at_rest(self) -> None:
        """Wait until no motion is performed."""
        with suppress(TimeoutError):
            async with asyncio.timeout(SETTLE_TIMEOUT_S), self._in_motion:
                pass

    def _is_fresh(self, report: Report) -> bool:
        return is_connected(report, time.monotonic(), self.options.silence_s)

    def _require_connection(self) -> None:
        report = self.exchange.report()
        if not self._is_fresh(report):
            raise self._fault(report) or _ended(report)

    def _fault(self, report: Report) -> RobotFault | None:
        fault = fault_of(report, time.monotonic(), self.options.silence_s, self.options.host)
        return None if fault is None else RobotFault(fault)


class SteadyClock:
    """A clock for motions that runs slower while the tool is late or the joint targets are behind.

    Thus setpoints never run away from the arm; it stays near the planned path.
    """

    def __init__(self, lag_rad: Callable[[], float]) -> None:
        self._lag_rad = lag_rad
        self._rate = 1.0
        self._time_s = self._mark_s = time.monotonic()

    @property
    def clock(self) -> Clock:
        """Return it as the clock of a robot."""
        return Clock(self.now_s, self.wait_s)

    def now_s(self) -> float:
        """Return the time."""
        return self._time_s + self._rate * min(time.monotonic() - self._mark_s, MAX_STEP_S)

    def wait_s(self, seconds: float) -> None:
        """Wait, and begin the next cycle."""
        time.sleep(seconds)
        self._time_s, self._mark_s = self.now_s(), time.monotonic()
        self._rate = max(1.0 - self._lag_rad() / MAX_LAG_RAD, MIN_RATE)


def _joint_state(report: Report) -> JointState:
    return JointState(report.wall_s, report.positions, report.velocities, report.torques)


def _is_at_rest(report: Report) -> bool:
    return max(map(abs, report.velocities)) < SETTLED_RAD_S


def _ended(report: Report) -> RobotFault:
    reason = report.reason or RuntimeState(min(max(report.runtime_state, 0), 5)).name
    return RobotFault.translated(
        "robot.ur_program_ended",
        "the motion program on the controller has ended during the motion ({reason}); send the Task again",
        reason=reason,
    )
