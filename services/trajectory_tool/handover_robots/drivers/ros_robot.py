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
from collections import deque
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Literal, Self

from fastapi import FastAPI, Request, Response
from pydantic import Field

from handover.broker import BrokerClient, BrokerError
from handover.broker.resync import Resync
from handover.errors import UsageError
from handover.formats.validation import ClosedModel
from handover.messages import message
from handover.subscriptions.notifications import REQUIRES_NOTIFICATION_KEY, NotificationReceiver
from handover.subscriptions.own_subscriptions import OwnSubscriptions
from handover.subscriptions.record import SubscriptionRecord
from handover.tasks.outcomes import is_outcome_unknown
from handover.telemetry import get_logger
from handover_datamodels.arm_stream import JOINT_VELOCITIES, ArmSetup, TrajectoryPoint, VelocityOutput
from handover_robots.driver_base.context import RobotContext
from handover_robots.driver_base.control_thread import Cycles
from handover_robots.driver_base.cyclic_robot import CyclicRobot, Motion
from handover_robots.driver_base.robot import StopCategory
from handover_robots.drivers.orders import Ended, Orders
from handover_robots.drivers.ros_link import RosLink
from handover_robots.limits.jog import Jog
from handover_robots.model.faults import RobotFault, UnknownOutcome
from handover_robots.model.joint_trajectory import JointTrajectory
from handover_robots.model.joints import Joints, JointState, Pace, Velocity
from handover_robots.model.poses import Frame, transposed, turn
from handover_robots.model.robot_model import RobotModel
from handover_robots.model.trajectory import Setpoint, rounded_pace

log = get_logger(__name__)

JOINTS_TIMEOUT_S = 10.0
STEP_S, MAX_POINTS = 0.05, 400
"""A goal has a point every 50 ms, and no more than 400."""
RESEND_S = 0.1
"""A changed pace is sent no sooner after the goal before; a stop is sent at once."""
MAX_DURATION_S = 3600.0
FOLLOWING_RAD = 0.05
"""An arm follows its goal within an angle, and the way of the goal in the delay of the options."""
END_TIMEOUT_S = 10.0
"""A goal ends no later after its last point."""
STILL_S, STILL_RAD, STILL_RAD_S = 0.3, 0.003, 0.02
"""An arm is at rest when its joints turn slower, or have turned no further for 0.3 s."""
REST_TIMEOUT_S = 10.0
POLL_S = 0.02
FORWARD_S = 1e-4


class RosOptions(ClosedModel):
    """The settings of the driver: the interfaces of the arm, and the Device with its gripper."""

    arm: str = Field("arm-1", pattern=r"^[A-Za-z0-9_.:-]+$")
    joint_states: str = "/joint_states"
    trajectory_action: str = "/joint_trajectory_controller/follow_joint_trajectory"
    velocity_topic: str | None = None
    velocity_type: Literal["std_msgs/msg/Float64MultiArray", "geometry_msgs/msg/TwistStamped"] = (
        JOINT_VELOCITIES
    )
    twist_frame: str = "base_link"
    watchdog_s: float = Field(0.2, gt=0, le=2)
    max_delay_s: float = Field(0.5, gt=0, le=10)
    """The age up to which joints count as known, and the delay with which an arm may follow."""

    def setup(self, joint_names: tuple[str, ...]) -> ArmSetup:
        """Return the first message to the bridge."""
        velocity = None
        if self.velocity_topic is not None:
            velocity = VelocityOutput(
                topic=self.velocity_topic,
                type=self.velocity_type,
                frame=self.twist_frame,
                watchdog_s=self.watchdog_s,
            )
        return ArmSetup(
            joint_names=joint_names,
            joint_states=self.joint_states,
            trajectory_action=self.trajectory_action,
            velocity=velocity,
        )


@dataclass(frozen=True, slots=True)
class _Plan:
    """The rest of a motion: setpoints on the grid from cycle `first` on, the last one at rest."""

    first: int
    setpoints: list[Setpoint]
    goal: int
    began_at: Joints
    """Where the whole motion began."""

    @property
    def last(self) -> int:
        return self.first + len(self.setpoints) - 1

    def at(self, cycle: int) -> Setpoint:
        return self.setpoints[min(max(cycle - self.first, 0), len(self.setpoints) - 1)]


@dataclass(frozen=True, slots=True)
class _Place:
    """A cycle of the grid, when the motion is there by its own time, and by the clock."""

    cycle: int
    motion_s: float
    due_s: float


class Way:
    """How far the commanded joints turned in the last `delay_s`: so far may a delayed arm be behind them."""

    def __init__(self, delay_s: float) -> None:
        self._delay_s = delay_s
        self._entries: deque[tuple[float, Joints, float]] = deque()
        """Time in s, positions, and the way until then in rad; the first entry is the delay old, or older."""

    def advance(self, now_s: float, positions: Joints) -> None:
        """Add commanded joints."""
        way_rad = 0.0
        if self._entries:
            _, before, way_rad = self._entries[-1]
            way_rad += _distance_rad(before, positions)
        self._entries.append((now_s, positions, way_rad))
        while len(self._entries) > 1 and self._entries[1][0] <= now_s - self._delay_s:
            self._entries.popleft()

    def is_near(self, measured: Joints) -> bool:
        """Return whether an arm at `measured` follows the commanded joints, with the delay."""
        _, positions, way_rad = self._entries[-1]
        return _distance_rad(measured, positions) <= FOLLOWING_RAD + way_rad - self._entries[0][2]


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
        self._gripper = _GripperOrders(context, broker, self.arm)
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

    def command(self, setpoint: Setpoint) -> None:
        """Command the velocities of a setpoint; used by `servo`."""
        self._way.advance(self.clock.now_s(), setpoint.positions)
        if not self._way.is_near(self.measured().positions):
            raise RobotFault(
                message(
                    "robot.ros_does_not_follow",
                    "{arm} does not follow the commanded velocities; check its velocity controller",
                    arm=self.arm,
                )
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
            raise RobotFault(
                message(
                    "robot.ros_has_no_velocity_topic",
                    "{arm} has no velocity topic; set velocity_topic in the settings of the driver",
                    arm=self.arm,
                )
            )
        motion = super().servo
        return await self._perform(lambda: motion(velocity, until, pace))

    async def stop(self, category: StopCategory) -> None:
        """Bring the motion to rest, and return at rest; see `Robot.stop`. ROS cannot remove the power."""
        await super().stop(2)
        async with self._in_motion:
            pass
        if category == 1:
            raise RobotFault(
                message(
                    "robot.driver_has_no_power",
                    "{arm} has been stopped, and its power cannot be removed through ROS; switch it off at "
                    "its controller",
                    arm=self.arm,
                )
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
            raise RobotFault(
                message(
                    "robot.in_motion",
                    "the robot is in motion; wait for its end or stop it before another motion",
                )
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

    def _follow_goals(self, motion: Motion, pace: Pace, began_s: float) -> None:
        plan: _Plan | None = None
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
                place = _Place(cycle, began_s + passed_s, follows_s + passed_s)
                plan = self._send(motion, plan, held, place)
                if plan is None:
                    return
                if cycle == 0:
                    self._await_acceptance(plan)
                    follows_s = due_s = self.clock.now_s()
            due_s = self._next_cycle(due_s)
            self.clock.wait_s(max(due_s - self.clock.now_s(), 0.0))

    def _send(self, motion: Motion, before: _Plan | None, pace: float, place: _Place) -> _Plan | None:
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
            return _Plan(place.cycle, setpoints, goal, setpoints[0].positions)
        return self._replace(before, setpoints, place)

    def _replace(self, before: _Plan, setpoints: list[Setpoint], place: _Place) -> _Plan:
        """Send a goal that takes the place of the one before."""
        self.require_lease()
        late_s = max(self.clock.now_s() - place.due_s, 0.0)
        goal = self.link.follow(points(setpoints, self._cycle_s, late_s))
        return _Plan(place.cycle, setpoints, goal, before.began_at)

    def _brake(self, before: _Plan, place: _Place) -> None:
        """Stop with the brake motion of the limiter, since the rest of the motion is not permitted."""
        self.limiter.resume(before.at(place.cycle), place.motion_s)
        setpoints = [self.limiter.brake(place.motion_s)]
        while not setpoints[-1].is_at_rest:
            setpoints.append(self.limiter.brake(place.motion_s + len(setpoints) * self._cycle_s))
        plan, cycle = self._replace(before, setpoints, place), place.cycle
        while not self._has_ended(plan, cycle):
            self.clock.wait_s(self._cycle_s)
            cycle = plan.first + int((self.clock.now_s() - place.due_s) / self._cycle_s)

    def _await_acceptance(self, plan: _Plan) -> None:
        """Wait until the controller follows the first goal. Raises `RobotFault`."""
        while not self.link.is_accepted(plan.goal):
            self._has_ended(plan, plan.first)
            self.clock.wait_s(self._cycle_s)

    def _has_ended(self, plan: _Plan, cycle: int) -> bool:
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
            raise RobotFault(
                message(
                    "robot.motion_overdue",
                    "the motion of {resource} did not end within {within_s} s",
                    resource=self.arm,
                    within_s=f"{(plan.last - plan.first) * self._cycle_s + END_TIMEOUT_S:.0f}",
                )
            )
        return end is not None and cycle >= plan.last

    def _require_following(self, plan: _Plan, cycle: int) -> None:
        """Stop an arm that has left its goal, so that the next goal does not make it jump."""
        measured = self.measured().positions
        self._way.advance(self.clock.now_s(), plan.at(cycle).positions)
        if self._way.is_near(measured):
            return
        if _distance_rad(measured, plan.began_at) > FOLLOWING_RAD:
            raise _FellBehind(f"{self.arm} did not follow its goal")
        raise RobotFault(
            message(
                "robot.ros_does_not_move",
                "{arm} does not follow its goal; check that its trajectory controller is active",
                arm=self.arm,
            )
        )

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
            if _distance_rad(now.positions, before.positions) > STILL_RAD:
                before, since_s = now, time.monotonic()
            elif time.monotonic() - since_s >= STILL_S:
                return
        raise RobotFault(
            message("robot.not_at_rest", "{arm} was stopped and is not at rest; check it", arm=self.arm)
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
        return RobotFault(
            message(
                "robot.joints_unknown",
                "the joints of {arm} are unknown: {fault}; start its driver, and the "
                "ROS bridge with a mapping that reports them (handover bridge check arm)",
                arm=self.arm,
                fault=fault,
            )
        )


class _GripperOrders:
    """The gripper of `arm`, operated by Tasks of the bridge."""

    def __init__(self, context: RobotContext, broker: BrokerClient, arm: str) -> None:
        settings, robot = context.settings, context.robot_id
        self.is_closed = context.gripper_closed
        self._arm = arm
        self._broker = broker
        self._notify_path = f"/notifications/{robot}/arm"
        self._receiver = NotificationReceiver(f"trajectory-tool-{robot}-arm", settings, broker)
        self._subscriptions = OwnSubscriptions("trajectory-tool", settings, broker)
        self._settings = settings
        self._orders = Orders(robot, arm, settings, broker)
        endpoint = self._receiver.endpoint(f"{settings.trajectory_tool}{self._notify_path}")
        self._subscription: Mapping[str, Any] = self._orders.subscription(endpoint)
        self._within_s = context.gripper_s + 20
        self._resync = Resync(self._try_reconcile, settings.reconcile_s)
        self._task: asyncio.Task[None] | None = None
        self._is_clean = False

    def mount(self, app: FastAPI) -> None:
        """Add the route for notifications."""

        @app.post(
            self._notify_path,
            status_code=204,
            tags=["notifications"],
            dependencies=[REQUIRES_NOTIFICATION_KEY],
        )
        async def notify(request: Request) -> Response:
            """Check changed orders."""
            await self._receiver.receive(request)
            self._orders.wake()
            return Response(status_code=204)

    def record_subscription(self, record: SubscriptionRecord) -> str:
        """Add the subscription to `record` from now on; return its id."""
        self._subscriptions = OwnSubscriptions("trajectory-tool", self._settings, self._broker, record)
        return str(self._subscription["id"])

    async def start(self) -> None:
        """Subscribe to orders, and end old ones."""
        self._receiver.require_key()
        self._task = asyncio.create_task(self._resync.run())

    async def stop(self) -> None:
        """Stop."""
        if self._task is not None:
            self._task.cancel()
            with suppress(asyncio.CancelledError):
                await self._task

    async def close(self) -> bool:
        """Close the gripper; return True when an object stopped it."""
        ended = await self._perform("closeGripper")
        self.is_closed = True
        stalled = ended.outputs.get("stalled") is True
        if not ended.completed and not stalled:
            raise RobotFault(
                message(
                    "robot.gripper_did_not_close",
                    "the gripper of {arm} did not close: {reason}",
                    arm=self._arm,
                    reason=ended.reason,
                )
            )
        return stalled

    async def open(self) -> None:
        """Open the gripper."""
        ended = await self._perform("openGripper")
        if not ended.completed:
            raise RobotFault(
                message(
                    "robot.gripper_did_not_open",
                    "the gripper of {arm} did not open: {reason}",
                    arm=self._arm,
                    reason=ended.reason,
                )
            )
        self.is_closed = False

    async def _perform(self, operation: str) -> Ended:
        order = await self._orders.give(operation)
        ended = await self._orders.end_of(order, self._within_s)
        if is_outcome_unknown(ended.outputs):
            raise UnknownOutcome(
                message(
                    "robot.gripper_unknown",
                    "whether the gripper of {arm} has moved is unknown: {reason}; look what it holds, then "
                    "free it on the page System, Robots",
                    arm=self._arm,
                    reason=ended.reason,
                )
            )
        return ended

    async def _try_reconcile(self) -> bool:
        try:
            await self._subscriptions.keep(self._subscription)
            if not self._is_clean:
                await self._orders.end_old()
                self._is_clean = True
        except (BrokerError, RobotFault) as error:
            log.warning("orders of the gripper not reconciled", arm=self._arm, error=str(error))
            return False
        return True


def points(setpoints: list[Setpoint], cycle_s: float, late_s: float = 0.0) -> list[TrajectoryPoint]:
    """Return the points of a goal: every 50 ms, and the last setpoint.

    `setpoints` are `cycle_s` apart, the first one `late_s` ago. Times count from now.
    """
    count = len(setpoints) - 1
    step = max(math.ceil(STEP_S / cycle_s), math.ceil(count / (MAX_POINTS - 1)))
    first = math.ceil(late_s / cycle_s) + step
    chosen = [*range(first, count - step // 2, step), count]
    return [
        TrajectoryPoint(
            time_s=max(number * cycle_s - late_s, cycle_s),
            positions=_rounded(setpoints[number].positions),
            velocities=_rounded(setpoints[number].velocities),
            accelerations=_rounded(setpoints[number].accelerations),
        )
        for number in chosen
    ]


def twist(model: RobotModel, setpoint: Setpoint) -> Joints:
    """Return the twist of the tool (m/s, rad/s) in the frame of the robot's root link."""
    now = model.tool_pose(setpoint.positions).frame()
    ahead = tuple(
        position + FORWARD_S * velocity
        for position, velocity in zip(setpoint.positions, setpoint.velocities, strict=True)
    )
    soon = model.tool_pose(ahead).frame()
    (_, r01, r02), (r10, _, r12), (r20, r21, _) = (
        soon @ Frame(now.inverse().rotation, (0.0, 0.0, 0.0))
    ).rotation
    to_base = transposed(model.base.rotation)
    x, y, z = (after - before for before, after in zip(now.position, soon.position, strict=True))
    parts = turn(to_base, (x, y, z)) + turn(to_base, ((r21 - r12) / 2, (r02 - r20) / 2, (r10 - r01) / 2))
    return tuple(part / FORWARD_S for part in parts)


def _rounded(values: Joints) -> Joints:
    return tuple(round(value, 6) for value in values)


def _distance_rad(some: Joints, others: Joints) -> float:
    return max(abs(first - second) for first, second in zip(some, others, strict=True))
