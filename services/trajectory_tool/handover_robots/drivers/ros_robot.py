"""A robot behind ROS 2: its controllers follow what the tool plans and limits, through the ROS bridge.

A motion is sent as a goal of `FollowJointTrajectory`, since a trajectory controller interpolates without the
jitter of a network. It is computed on a grid of control cycles: each setpoint of a goal has passed the
limiter before the goal is sent. A change of the pace, or a stop, computes the rest of the motion at the new
pace and sends it as the next goal, which takes the place of the one before. So the arm slows down and stops
within its limits, on its path.

    grid      0   1   2   3   4   5   6 ...   setpoints of the first goal, all limited
    pace          1   1   0.5                 the motion has been advanced to 3; goal 2 begins there
    goal 2                3'  4'  5' ...      times of the points count from its sending

Commanded velocities (`servo`) go to a velocity topic in each cycle. The bridge commands 0 when they cease,
and stops the arm when the tool ends. The gripper is operated by Tasks of the bridge (the mapping `arm`).
"""

import asyncio
import copy
import math
import time
from collections.abc import Callable, Collection
from contextlib import suppress
from typing import Any, Self

from fastapi import FastAPI

from handover.broker import BrokerClient
from handover.errors import UsageError
from handover.messages import message
from handover.runtime.control_cycle import runs_in_cycle
from handover.subscriptions.record import SubscriptionRecord
from handover.telemetry import get_logger
from handover_datamodels.arm_stream import JOINT_VELOCITIES
from handover_robots.driver_base.context import RobotContext
from handover_robots.driver_base.control_thread import Cycles
from handover_robots.driver_base.cyclic_robot import CyclicRobot, Motion
from handover_robots.driver_base.robot import StopCategory
from handover_robots.drivers.ros_goals import (
    FOLLOWING_RAD,
    GoalPlan,
    GridPlace,
    Way,
    distance_rad,
    points,
    twist,
)
from handover_robots.drivers.ros_gripper import RosGripper
from handover_robots.drivers.ros_link import RosLink
from handover_robots.drivers.ros_options import RosOptions
from handover_robots.limits.jog import Jog
from handover_robots.model.faults import RobotFault, UnknownOutcome
from handover_robots.model.joint_trajectory import JointTrajectory
from handover_robots.model.joints import Joints, JointState, Pace, Velocity
from handover_robots.model.robot_model import RobotModel
from handover_robots.model.trajectory import Setpoint, rounded_pace

log = get_logger(__name__)

JOINTS_TIMEOUT_S = 10.0
RESEND_S = 0.1
"""A changed pace is sent no sooner after the goal before; a stop is sent at once."""
MAX_DURATION_S = 3600.0
END_TIMEOUT_S = 10.0
"""A goal ends no later after its last point."""
STILL_S, STILL_RAD, STILL_RAD_S = 0.3, 0.003, 0.02
"""An arm is at rest when its joints turn slower, or have turned no further for 0.3 s."""
REST_TIMEOUT_S = 10.0
POLL_S = 0.02


class _FellBehind(RobotFault):
    """The arm has left its goal; it was stopped, and the rest can be planned again."""


class RosRobot(CyclicRobot):
    """The arm with the interfaces of its options; the stored joints are used until the first report."""

    def __init__(self, context: RobotContext, broker: BrokerClient) -> None:
        settings = context.settings
        super().__init__(
            context.joints,
            context.limits,
            limiter=context.limiter,
            control_hz=settings.control_hz,
            clock=context.clock,
        )
        self.options = context.read_options(RosOptions)
        self.arm = settings.entity_id("Device", self.options.arm)
        setup = self.options.setup(context.model.joint_names)
        self.link = RosLink(settings.arm_url, setup, broker.credentials)
        self._model: RobotModel = context.model
        self._stored = JointState(time.time(), context.joints, (0.0,) * len(context.joints))
        self._gripper = RosGripper(context, broker, self.arm)
        self._in_motion = asyncio.Lock()
        self._way = Way(self.options.max_delay_s)

    @classmethod
    def from_context(cls, context: RobotContext) -> Self:
        """Return the robot of a cell; raise `UsageError` without a broker."""
        if context.broker is None:
            raise UsageError("a robot behind ROS is reached through the broker; start it with one")
        return cls(context, context.broker)

    def mount(self, app: FastAPI) -> None:
        """Add the route for notifications about orders."""
        self._gripper.mount(app)

    def record_subscriptions(self, record: SubscriptionRecord) -> Collection[str]:
        """Add the subscription to orders to `record` from now on; return its id."""
        return [self._gripper.record_subscription(record)]

    async def __aenter__(self) -> Self:
        await self._gripper.start()
        await self.link.open()
        return await super().__aenter__()

    async def __aexit__(self, *_: object) -> None:
        try:
            await super().__aexit__(*_)
            async with self._in_motion:
                pass
        finally:
            await self.link.close()
            await self._gripper.stop()

    def state(self) -> JointState:
        """Return the last reported joints."""
        return self.link.joints or self._stored

    def measured(self) -> JointState:
        """Return the reported joints. Raises `RobotFault` when the last report is too old."""
        joints, age_s = self.link.joints, time.monotonic() - self.link.reported_s
        if joints is None:
            raise self._unknown(self.link.fault)
        if age_s > self.options.max_delay_s:
            raise self._unknown(f"they have not been reported for {age_s:.1f} s")
        return joints

    @runs_in_cycle
    def command(self, setpoint: Setpoint) -> None:
        """Command the velocities of a setpoint; used by `servo`."""
        self._way.advance(self.clock.now_s(), setpoint.positions)
        if not self._way.is_near(self.measured().positions):
            raise RobotFault.translated(
                "robot.ros_does_not_follow",
                "{arm} does not follow the commanded velocities; check its velocity controller",
                arm=self.arm,
            )
        self.link.velocity(self._velocities(setpoint))

    async def move(self, target: Joints, speed: float, pace: Pace) -> bool:
        """Have the arm follow a trajectory to `target`; see `Robot.move`."""
        motion = super().move
        return await self._perform(lambda: motion(target, speed, pace))

    async def follow(self, trajectory: JointTrajectory, pace: Pace) -> bool:
        """Have the arm follow a planned trajectory; see `Robot.follow`."""
        motion = super().follow
        return await self._perform(lambda: motion(trajectory, pace))

    async def servo(self, velocity: Velocity, until: Callable[[], bool], pace: Pace) -> bool:
        """Move with the latest joint velocities; see `Robot.servo`."""
        if self.options.velocity_topic is None:
            raise RobotFault.translated(
                "robot.ros_has_no_velocity_topic",
                "{arm} has no velocity topic; set velocity_topic in the settings of the driver",
                arm=self.arm,
            )
        motion = super().servo
        return await self._perform(lambda: motion(velocity, until, pace))

    async def stop(self, category: StopCategory) -> None:
        """Bring the motion to rest, and return at rest; see `Robot.stop`. ROS cannot remove the power."""
        await super().stop(2)
        async with self._in_motion:
            pass
        if category == 1:
            raise RobotFault.translated(
                "robot.driver_has_no_power",
                "{arm} has been stopped, and its power cannot be removed through ROS; switch it off at "
                "its controller",
                arm=self.arm,
            )

    async def close_gripper(self) -> bool:
        """Close the gripper; return True when an object stopped it."""
        await self._current_joints()
        return await self._gripper.close()

    async def open_gripper(self) -> None:
        """Open the gripper."""
        await self._current_joints()
        await self._gripper.open()

    @property
    def gripper_closed(self) -> bool:
        """Return whether the last command closed the gripper."""
        return self._gripper.is_closed

    # Motions

    async def _perform(self, motion: Callable[[], Any]) -> bool:
        """Run a motion until the measured joints are at rest."""
        if self._in_motion.locked():
            raise RobotFault.translated(
                "robot.in_motion", "the robot is in motion; wait for its end or stop it before another motion"
            )
        async with self._in_motion:
            if not self.switched_off.is_set():
                await self._current_joints()
            try:
                arrived: bool = await motion()
            except _FellBehind:
                log.warning("motion stopped: the arm did not follow", arm=self.arm)
                arrived = False
            except asyncio.CancelledError:
                with suppress(RobotFault):
                    await asyncio.shield(self._rest())
                raise
            await self._rest()
        return arrived

    @runs_in_cycle
    def _follow(self, motion: Motion, pace: Pace, now_s: float) -> Cycles[None]:
        """Send a motion as goals; after a fault, bring the arm to rest, then raise it."""
        self._way = Way(self.options.max_delay_s)
        self._way.advance(now_s, self.setpoint.positions)  # a late first cycle is on the way too
        try:
            if isinstance(motion, Jog):
                yield from super()._follow(motion, pace, now_s)
            else:
                self._follow_goals(motion, pace, now_s)
        except RobotFault:
            with suppress(RobotFault):
                self.link.cancel()
                if isinstance(motion, Jog):
                    self.link.velocity(self._velocities(Setpoint.at_rest(self.setpoint.positions)))
            raise

    @runs_in_cycle
    def _follow_goals(self, motion: Motion, pace: Pace, began_s: float) -> None:
        plan: GoalPlan | None = None
        held, sent_s, cycle, due_s = 1.0, -math.inf, 0, began_s
        follows_s = began_s
        """When the controller began to follow the first goal."""
        while True:
            now_s = self.clock.now_s()
            until = int((now_s - follows_s) / self._cycle_s)
            while cycle < until and plan is not None:
                motion.at(began_s + cycle * self._cycle_s, pace=held)
                cycle += 1
            if plan is not None:
                self.setpoint = plan.at(cycle)
                if self._has_ended(plan, cycle):
                    return
                self._require_following(plan, cycle)
            wanted = rounded_pace(pace())
            is_due = wanted == 0.0 or now_s - sent_s >= RESEND_S
            if plan is None or (wanted != held and is_due and not motion.stopping and cycle < plan.last):
                held, sent_s = wanted, now_s
                passed_s = cycle * self._cycle_s
                place = GridPlace(cycle, began_s + passed_s, follows_s + passed_s)
                plan = self._send(motion, plan, held, place)
                if plan is None:
                    return
                if cycle == 0:
                    self._await_acceptance(plan)
                    follows_s = due_s = self.clock.now_s()
            due_s = self._next_cycle(due_s)
            self.clock.wait_s(max(due_s - self.clock.now_s(), 0.0))

    @runs_in_cycle
    def _send(
        self, motion: Motion, before: GoalPlan | None, pace: float, place: GridPlace
    ) -> GoalPlan | None:
        """Limit the rest of the motion at `pace`, and send it; None for one that is over at once."""
        if before is not None:
            self.limiter.resume(before.at(place.cycle), place.motion_s)
        setpoints: list[Setpoint] = []
        ahead = copy.copy(motion)
        time_s, is_over = place.motion_s, False
        while not is_over:
            setpoint = ahead.at(time_s, pace=pace)
            try:
                setpoints.append(self.limiter.limit(setpoint, time_s))
            except RobotFault as fault:
                if before is None:
                    raise
                self._brake(before, place)
                raise fault from None
            is_over = ahead.is_over(time_s)
            time_s += self._cycle_s
            if time_s - place.motion_s > MAX_DURATION_S:
                raise RobotFault(f"a motion at the pace {pace:g} would take longer than {MAX_DURATION_S} s")
        if before is None and len(setpoints) == 1:
            motion.at(place.motion_s, pace=pace)
            return None
        if before is None:
            self.require_lease()
            goal = self.link.follow(points(setpoints, self._cycle_s))
            return GoalPlan(place.cycle, setpoints, goal, setpoints[0].positions)
        return self._replace(before, setpoints, place)

    @runs_in_cycle
    def _replace(self, before: GoalPlan, setpoints: list[Setpoint], place: GridPlace) -> GoalPlan:
        """Send a goal that takes the place of the one before."""
        self.require_lease()
        late_s = max(self.clock.now_s() - place.due_s, 0.0)
        goal = self.link.follow(points(setpoints, self._cycle_s, late_s))
        return GoalPlan(place.cycle, setpoints, goal, before.began_at)

    @runs_in_cycle
    def _brake(self, before: GoalPlan, place: GridPlace) -> None:
        """Stop with the brake motion of the limiter, since the rest of the motion is not permitted."""
        self.limiter.resume(before.at(place.cycle), place.motion_s)
        setpoints = [self.limiter.brake(place.motion_s)]
        while not setpoints[-1].is_at_rest:
            setpoints.append(self.limiter.brake(place.motion_s + len(setpoints) * self._cycle_s))
        plan, cycle = self._replace(before, setpoints, place), place.cycle
        while not self._has_ended(plan, cycle):
            self.clock.wait_s(self._cycle_s)
            cycle = plan.first + int((self.clock.now_s() - place.due_s) / self._cycle_s)

    @runs_in_cycle
    def _await_acceptance(self, plan: GoalPlan) -> None:
        """Wait until the controller follows the first goal. Raises `RobotFault`."""
        while not self.link.is_accepted(plan.goal):
            self._has_ended(plan, plan.first)
            self.clock.wait_s(self._cycle_s)

    @runs_in_cycle
    def _has_ended(self, plan: GoalPlan, cycle: int) -> bool:
        """Return whether the controller has reached the end of a goal. Raises `RobotFault`."""
        self.measured()
        end = self.link.end_of(plan.goal)
        if end is not None and not end.succeeded:
            raise (UnknownOutcome if end.unknown else RobotFault)(
                message(
                    "robot.trajectory_not_followed",
                    "{arm} did not follow the trajectory: {reason}",
                    arm=self.arm,
                    reason=end.reason,
                )
            )
        if end is None and (cycle - plan.last) * self._cycle_s > END_TIMEOUT_S:
            raise RobotFault.translated(
                "robot.motion_overdue",
                "the motion of {resource} did not end within {within_s} s",
                resource=self.arm,
                within_s=f"{(plan.last - plan.first) * self._cycle_s + END_TIMEOUT_S:.0f}",
            )
        return end is not None and cycle >= plan.last

    @runs_in_cycle
    def _require_following(self, plan: GoalPlan, cycle: int) -> None:
        """Stop an arm that has left its goal, so that the next goal does not make it jump."""
        measured = self.measured().positions
        self._way.advance(self.clock.now_s(), plan.at(cycle).positions)
        if self._way.is_near(measured):
            return
        if distance_rad(measured, plan.began_at) > FOLLOWING_RAD:
            raise _FellBehind(f"{self.arm} did not follow its goal")
        raise RobotFault.translated(
            "robot.ros_does_not_move",
            "{arm} does not follow its goal; check that its trajectory controller is active",
            arm=self.arm,
        )

    @runs_in_cycle
    def _velocities(self, setpoint: Setpoint) -> Joints:
        if self.options.velocity_type == JOINT_VELOCITIES:
            return setpoint.velocities
        return twist(self._model, setpoint)

    async def _rest(self) -> None:
        """Wait until the reported joints are at rest. Raises `RobotFault`."""
        before, since_s = self.measured(), time.monotonic()
        deadline_s = since_s + REST_TIMEOUT_S
        while time.monotonic() < deadline_s:
            await asyncio.sleep(POLL_S)
            now = self.measured()
            if now is not before and max(map(abs, now.velocities)) < STILL_RAD_S:
                return
            if distance_rad(now.positions, before.positions) > STILL_RAD:
                before, since_s = now, time.monotonic()
            elif time.monotonic() - since_s >= STILL_S:
                return
        raise RobotFault.translated(
            "robot.not_at_rest", "{arm} was stopped and is not at rest; check it", arm=self.arm
        )

    async def _current_joints(self) -> Joints:
        """Return the current joints. Raises `RobotFault` when they are unknown."""
        deadline_s = time.monotonic() + JOINTS_TIMEOUT_S
        while True:
            try:
                return self.measured().positions
            except RobotFault:
                if time.monotonic() > deadline_s:
                    raise
            await asyncio.sleep(POLL_S)

    def _unknown(self, fault: str) -> RobotFault:
        return RobotFault.translated(
            "robot.joints_unknown",
            "the joints of {arm} are unknown: {fault}; start its driver, and the "
            "ROS bridge with a mapping that reports them (handover bridge check arm)",
            arm=self.arm,
            fault=fault,
        )
