"""A robot that is commanded in cycles: the base of drivers whose joints follow a setpoint in each cycle.

The cycles run in a separate thread, so that HTTP requests do not delay them. In each cycle the setpoint of
the motion at this time passes the limiter and is given to `command`. A motion is one of three: a straight
line in joint space (`Course`), a planned trajectory (`PlannedCourse`), or commanded velocities (`Jog`).

Before each setpoint the lease of the robot is checked, a comparison of local values: a motion whose lease
ends soon comes to rest, and one whose lease has ended, as in a process that was paused, sends nothing more.

A motion is a generator (`Cycles`) that yields until when to wait. By default a thread of the robot runs it; a
`ControlThread` or a simulation runs those of all its robots in one thread.
"""

import asyncio
from abc import abstractmethod
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from threading import Event
from typing import Protocol, Self, TypeVar

from handover.runtime.control_cycle import runs_in_cycle
from handover.tasks.device_lease import Authority
from handover_robots.driver_base.context import Clock
from handover_robots.driver_base.control_thread import ControlThread, Cycles
from handover_robots.driver_base.robot import Robot, StopCategory
from handover_robots.limits.jog import Jog
from handover_robots.limits.limiter import START_TOLERANCE_RAD, JointLimiter, Limiter
from handover_robots.metrics import MOTION_SECONDS, OVERRUNS
from handover_robots.model.faults import LeaseEnded, RobotFault
from handover_robots.model.joint_trajectory import JointTrajectory
from handover_robots.model.joints import Joints, JointState, Pace, Velocity
from handover_robots.model.planned_course import PlannedCourse
from handover_robots.model.trajectory import Course, Limits, Setpoint, duration_s

T = TypeVar("T")


class Motion(Protocol):
    """A motion as a function of time."""

    @property
    def stopping(self) -> bool:
        """Return whether it ends before its target."""

    def at(self, now_s: float, *, pace: float = 1.0) -> Setpoint:
        """Return the setpoint at a time, and continue at `pace`; a pace of 0 stops."""

    def remaining_s(self, now_s: float) -> float:
        """Return the time until the joints are at rest."""

    def is_over(self, now_s: float) -> bool:
        """Return whether the joints are at rest."""


class CyclicRobot(Robot):
    """Joints that follow the setpoint of each cycle; a driver has `command`, `measured` and the gripper.

    `joints` are the joints at rest before the first motion. Every setpoint passes `limiter` before `command`;
    by default it has the joint limits. `thread` runs the cycles, those of `name` one after the other.
    """

    def __init__(
        self,
        joints: Joints,
        limits: Limits,
        *,
        limiter: Limiter | None = None,
        control_hz: float = 125.0,
        clock: Clock | None = None,
        name: str = "robot",
        thread: ControlThread | None = None,
    ) -> None:
        self.limits = limits
        self.limiter = limiter or JointLimiter(limits)
        self.clock = clock or Clock()
        self.setpoint = Setpoint.at_rest(joints)
        """The last setpoint that was commanded."""
        self.switched_off = Event()
        self._cycle_s = 1.0 / control_hz
        self._motion: Motion | None = None
        self._stopping: Event | None = None
        self._authority: Authority | None = None
        """The lease under which the present motion began."""
        self._name = name
        self._thread = thread
        self._control = ThreadPoolExecutor(max_workers=1, thread_name_prefix="robot-control")

    @abstractmethod
    @runs_in_cycle
    def command(self, setpoint: Setpoint) -> None:
        """Command a setpoint; called in the control thread in each cycle of a motion. Raises `RobotFault`."""

    @abstractmethod
    def measured(self) -> JointState:
        """Return the measured joints; cheap and thread-safe. Raises `RobotFault` when they are unknown."""

    async def power_off(self) -> None:
        """Remove the power of the drives after a stop of category 1."""

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        self.switched_off.set()
        if self._thread is not None:
            await asyncio.to_thread(self._thread.drain, self._name)
        await asyncio.to_thread(self._control.shutdown)

    def state(self) -> JointState:
        """Return the present joints."""
        return self.measured()

    def commanded(self) -> Joints:
        """Return the joints of the last setpoint."""
        return self.setpoint.positions

    @property
    def is_moving(self) -> bool:
        """Return whether a motion has begun and not ended; thread-safe."""
        return self._motion is not None

    def remaining_s(self) -> float:
        """Return the remaining time of the motion."""
        motion = self._motion
        return 0.0 if motion is None else motion.remaining_s(self.clock.now_s())

    def estimate_s(self, start: Joints, target: Joints, speed: float) -> float:
        """Return the duration of a motion from rest to rest."""
        return duration_s(start, target, self.limits.slowed(speed))

    async def move(self, target: Joints, speed: float, pace: Pace) -> bool:
        """Move to `target`; return False if it stopped on the way."""
        cruise = self.limits.slowed(speed)

        def course(start: Joints, now_s: float) -> Course:
            line = Course(start, target, cruise, self.limits, now_s)
            self.limiter.require_line(start, target)
            return line

        return await self._run(course, pace)

    async def follow(self, trajectory: JointTrajectory, pace: Pace) -> bool:
        """Follow a trajectory; return False if it stopped on the way."""

        def course(start: Joints, now_s: float) -> PlannedCourse:
            away_rad = _distance_rad(start, trajectory.start)
            if away_rad > START_TOLERANCE_RAD:
                raise RobotFault.translated(
                    "robot.not_at_the_start",
                    "the joints are {angle} rad away from the start of the planned motion; plan again",
                    angle=f"{away_rad:.3f}",
                )
            return PlannedCourse(trajectory, self.limits, now_s)

        return await self._run(course, pace)

    async def servo(self, velocity: Velocity, until: Callable[[], bool], pace: Pace) -> bool:
        """Move with the latest joint velocities; return False if it was stopped."""

        def jog(start: Joints, _: float) -> Jog:
            return Jog(start, velocity, until, self.limiter)

        return await self._run(jog, pace)

    async def stop(self, category: StopCategory) -> None:
        """Bring the motion to rest; see `Robot.stop`."""
        running = self._stopping
        if running is not None:
            running.set()
        await self.in_control(lambda: None)
        if category == 1:
            await self.power_off()

    async def in_control(self, work: Callable[[], T]) -> T:
        """Run `work` in the control thread, after what runs there; see `in_cycles`."""
        return await self.in_cycles(_at_once(work))

    async def in_cycles(self, cycles: Cycles[T], give_up: Callable[[], None] | None = None) -> T:
        """Run `cycles` in the control thread, after what runs there.

        A cancelled caller calls `give_up` and waits for the end of the cycles. Raises `RobotFault` when the
        robot is switched off.
        """
        if self.switched_off.is_set():
            raise RobotFault.translated(
                "robot.switched_off", "the robot is switched off; start the trajectory tool again"
            )
        doing = asyncio.wrap_future(self.submit(cycles))
        try:
            return await asyncio.shield(doing)
        except asyncio.CancelledError:
            if give_up is not None:
                give_up()
            await asyncio.wait([doing])
            raise

    def submit(self, cycles: Cycles[T]) -> "Future[T]":
        """Run `cycles` in the control thread, after what runs there."""
        if self._thread is not None:
            return self._thread.submit(self._name, cycles)
        return self._control.submit(self._run_cycles, cycles)

    @runs_in_cycle
    def _run_cycles(self, cycles: Cycles[T]) -> T:
        while True:
            try:
                due_s = next(cycles)
            except StopIteration as end:
                return end.value  # type: ignore[no-any-return]
            self.clock.wait_s(max(due_s - self.clock.now_s(), 0.0))

    async def _run(self, make: Callable[[Joints, float], Motion], pace: Pace) -> bool:
        if self._stopping is not None:
            raise RobotFault.translated(
                "robot.in_motion", "the robot is in motion; wait for its end or stop it before another motion"
            )
        authority = self._authority = self.authority()
        stopping = self._stopping = Event()

        def allowed() -> float:
            if stopping.is_set() or self.switched_off.is_set():
                return 0.0
            return pace() if authority is None or authority.may_continue() else 0.0

        try:
            if self.limiter.needs_preparation():
                await asyncio.to_thread(self.limiter.prepare)
            return await self.in_cycles(self._drive(make, allowed), stopping.set)
        finally:
            self._stopping = None

    @runs_in_cycle
    def _drive(self, make: Callable[[Joints, float], Motion], pace: Pace) -> Cycles[bool]:
        start = self._start()
        self.setpoint = Setpoint.at_rest(start)
        self.limiter.start(start, self.clock.now_s())
        started_s = self.clock.now_s()
        self._motion = motion = make(start, started_s)
        self.limiter.start(start, started_s)
        try:
            yield from self._follow(motion, pace, started_s)
        except LeaseEnded:
            self.setpoint = Setpoint.at_rest(self.setpoint.positions)
            return False
        finally:
            self._motion = None
            MOTION_SECONDS.inc(self.clock.now_s() - started_s)
        return not motion.stopping

    @runs_in_cycle
    def require_lease(self) -> None:
        """Raise `LeaseEnded` unless the lease of the present motion is held; called before each command."""
        if self._authority is not None and not self._authority.is_valid():
            raise LeaseEnded("the lease of the robot has ended during the motion")

    @runs_in_cycle
    def _start(self) -> Joints:
        """Return where a motion starts: at the last setpoint, unless the arm has been moved since."""
        measured = self.measured().positions
        commanded = self.setpoint.positions
        return commanded if _distance_rad(measured, commanded) <= START_TOLERANCE_RAD else measured

    @runs_in_cycle
    def _follow(self, motion: Motion, pace: Pace, now_s: float) -> Cycles[None]:
        """Command the setpoints of a motion; after a fault of the limiter, come to rest, then raise it."""
        due_s = now_s
        if self._thread is not None:  # all robots of the thread are due at the same times
            due_s -= now_s % self._cycle_s
        fault: RobotFault | None = None
        while True:
            if fault is None:
                try:
                    setpoint = self.limiter.limit(motion.at(now_s, pace=pace()), now_s)
                except RobotFault as why:
                    fault = why
            if fault is not None:
                setpoint = self.limiter.brake(now_s)
            self.require_lease()
            self.setpoint = setpoint
            self.command(setpoint)
            if fault is not None and setpoint.is_at_rest:
                raise fault
            if fault is None and motion.is_over(now_s):
                return
            due_s = self._next_cycle(due_s)
            yield due_s
            now_s = self.clock.now_s()

    @runs_in_cycle
    def _next_cycle(self, due_s: float) -> float:
        """Return when the next cycle is due; late cycles are counted and skipped."""
        due_s += self._cycle_s
        missed = int((self.clock.now_s() - due_s) / self._cycle_s)
        if missed > 0:
            OVERRUNS.inc(missed)
            due_s += missed * self._cycle_s
        return due_s


@runs_in_cycle
def _at_once(work: Callable[[], T]) -> Cycles[T]:
    """Return work without waiting as cycles."""
    return work()
    yield


def _distance_rad(first: Joints, second: Joints) -> float:
    return max((abs(a - b) for a, b in zip(first, second, strict=True)), default=0.0)
