"""Work: the execution of one Task by the robot, with its progress and its pauses."""

import asyncio
from collections.abc import Awaitable, Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Protocol, TypeVar

from handover.errors import UsageError
from handover.messages import text_of
from handover.performer import TaskFailed
from handover_robots.cell.memory import Act
from handover_robots.cell.motion import BlockedByNeighbour
from handover_robots.cell.robot_unit import RobotUnit
from handover_robots.model.faults import NoPath, Unreachable
from handover_robots.model.joints import Joints
from handover_robots.model.poses import Pose
from handover_robots.model.trajectory import Course, Setpoint, rounded_pace
from handover_robots.planning import is_available

if TYPE_CHECKING:
    from handover_robots.planning.planner import Plan, Planner
    from handover_robots.planning.tilt import Tilt


T = TypeVar("T")

NEIGHBOUR_POLL_S = 0.2
CONFIRMATION_POLL_S = 0.05
LIMIT_POLL_S = 0.05


class Steering(Protocol):
    """Pauses or ends the work."""

    def may_go(self) -> bool:
        """Return whether the work may continue; cheap, called in each control cycle from its thread."""

    async def rest(self) -> None:
        """Return when the paused work may continue; raise if it was cancelled."""


class Work:
    """The motions and gripper actions of one Task, at `speed` (0 to 1 of the joint limits)."""

    def __init__(
        self,
        task: str,
        operation: str,
        unit: RobotUnit,
        steering: Steering,
        speed: float,
        *,
        involves: Sequence[str] = (),
    ) -> None:
        self.task = task
        self.involves = tuple(involves)
        """The resources of the Task: the robot, and the person with whom it works."""
        self.operation = operation
        self.unit = unit
        self._steering = steering
        self._speed = speed
        self._neighbour_wait_s = unit.neighbour_wait_s
        self._planned: list[float] = []
        self._current_s = 0.0
        self._moving = False
        self._total_s = 0.0
        self._progress = 0.0
        self._planned_in = 0
        self._confirmed = asyncio.Event()
        self.awaits_confirmation = False

    def intend(self, *steps: Joints | float) -> None:
        """Set the planned steps: joints to move to in rad, and actions with their duration in s.

        Raises `RobotFault` when there is no such motion.
        """
        self._planned = list(self._durations(steps))
        self._total_s = sum(self._planned)

    def remaining_s(self) -> float:
        """Return the remaining time without pauses."""
        return max(self.unit.robot.remaining_s(), self._current_s) + sum(self._planned)

    def progress(self) -> float:
        """Return the progress from 0 to 1; it never decreases.

        It is unchanged after a stop until it is known whether the robot is at its target.
        """
        just_at_rest = self._moving and self.unit.robot.remaining_s() == 0.0
        if self._total_s > 0 and not just_at_rest:
            self._progress = max(self._progress, min(1 - self.remaining_s() / self._total_s, 1.0))
        return self._progress

    async def go(self, target: Joints, tilt: "Tilt | None" = None) -> None:
        """Move to joints in rad, with pauses on the way if requested; at rest there when it returns.

        The way is planned around obstacles and around the robot itself; `tilt` is kept on a planned way.
        Raises `TaskFailed` where there is none.
        """
        self._begin_next()
        while tilt is None and await self._is_straight_way_free(target):
            self._planned_in = self.unit.planning.revision
            if await self._move(target):
                await self.unit.remember()
                return
            await self.unit.remember()
            while not self._steering.may_go():
                await self._steering.rest()
        await self._follow(lambda planner, here: planner.to_joints(here, target, tilt))

    async def _is_straight_way_free(self, target: Joints) -> bool:
        """Return whether the straight way in joint space needs no plan; without the extra none does."""
        unit = self.unit
        if unit.planning.avoids_obstacles or not is_available():
            return not unit.planning.avoids_obstacles
        with self._reporting_why_not():
            return await self.plan(lambda planner: planner.is_straight_free(unit.joints, target))

    async def go_through(self, targets: Sequence[Joints], tilt: "Tilt | None" = None) -> None:
        """Move through all but the last of the targets without a stop; after a pause, through the rest."""
        self._begin_next()
        rest = list(targets)

        def drop_passed(plan: "Plan", here: Joints) -> None:
            del rest[: plan.passed(rest, here)]

        await self._follow(lambda planner, here: planner.through(here, rest, tilt), drop_passed)

    async def go_straight(self, pose: Pose, max_tool_speed_mps: float | None = None) -> None:
        """Move the tool on a straight line to a pose, likewise."""
        self._begin_next()
        await self._follow(lambda planner, here: planner.straight(here, pose, max_tool_speed_mps))

    async def _follow(
        self,
        make: "Callable[[Planner, Joints], Plan]",
        on_stop: "Callable[[Plan, Joints], None]" = lambda _, __: None,
    ) -> None:
        """Plan from the present joints and follow, again after a pause or when the obstacles changed."""
        while True:
            while not self._may_move():
                await self._rest()
            self._planned_in = self.unit.planning.revision
            plan = await self._plan_from_here(make)
            trajectory = plan.trajectory.slowed(self._speed)
            try:
                self._begin_motion(trajectory.at, trajectory.duration_s)
                self._moving, self._current_s = True, 0.0  # from now on the robot has the remaining time
                if await self.unit.robot.follow(trajectory, self._pace_of_plan):
                    break
            finally:
                self._moving = False
                self.unit.speed.end_motion()
                self.unit.planning.end_motion()
            on_stop(plan, self.unit.joints)
            await self.unit.remember()
        await self.unit.remember()

    async def _plan_from_here(self, make: "Callable[[Planner, Joints], Plan]") -> "Plan":
        unit = self.unit
        with self._reporting_why_not():
            return await self._when_neighbours_permit(
                lambda: unit.planning.plan_motion(
                    lambda planner: make(planner, unit.model.measured_within(unit.joints))
                )
            )

    @contextmanager
    def _reporting_why_not(self) -> Iterator[None]:
        """Let the Task fail with the reason why there is no motion."""
        try:
            yield
        except (Unreachable, NoPath, UsageError) as why:
            raise TaskFailed.translated(
                "robot.motion_not_planned", "{operation}: {why}", operation=self.operation, why=text_of(why)
            ) from None

    async def plan(self, make: "Callable[[Planner], T]") -> T:
        """Return what `make` plans in the cell. Raises `Unreachable`, `NoPath`, and `UsageError`."""
        return await self._when_neighbours_permit(lambda: self.unit.planning.plan(make))

    async def _when_neighbours_permit(self, plan: Callable[[], Awaitable[T]]) -> T:
        """Plan; while only another robot is in the way, wait for it and plan again."""
        clock, space = asyncio.get_running_loop().time, self.unit.planning.space
        ends_s = clock() + self._neighbour_wait_s
        while True:
            try:
                return await plan()
            except BlockedByNeighbour:
                if clock() >= ends_s:
                    raise
            await space.wait_for_change(NEIGHBOUR_POLL_S)
            while not self._steering.may_go():
                await self._steering.rest()
                ends_s = clock() + self._neighbour_wait_s

    def _pace_of_plan(self) -> float:
        """Return the pace of a planned motion: 0 when the obstacles have changed since."""
        return self._pace() if self.unit.planning.revision == self._planned_in else 0.0

    async def _move(self, target: Joints) -> bool:
        cruise = self.unit.limits.slowed(self._speed)
        course = Course(self.unit.joints, target, cruise, self.unit.limits, 0.0)
        self._begin_motion(course.at, course.remaining_s(0.0))
        self._moving, self._current_s = True, 0.0
        try:
            arrived = await self.unit.robot.move(target, self._speed, self._pace_of_plan)
            if not arrived:
                self._current_s = self.unit.robot.estimate_s(self.unit.joints, target, self._speed)
            return arrived
        finally:
            self._moving = False
            self.unit.speed.end_motion()

    def _pace(self) -> float:
        """Return the allowed fraction of the speed; after a stop the rest of the motion is still planned."""
        pace = self.unit.speed.pace() if self._steering.may_go() else 0.0
        if pace == 0.0 and self._current_s == 0.0:
            self._current_s = self.unit.robot.remaining_s()
        return pace

    def _begin_motion(self, at: Callable[[float], Setpoint], duration_s: float) -> None:
        """Give a motion to the limits. Raises `TaskFailed` for one that exceeds the contact table."""
        self.unit.speed.begin_motion(at, duration_s)
        refusal = self.unit.speed.contact_refusal(self.operation)
        if refusal is not None:
            raise TaskFailed(refusal)

    def _may_move(self) -> bool:
        return self._steering.may_go() and rounded_pace(self.unit.speed.pace()) > 0

    async def _rest(self) -> None:
        """Rest while the work is paused, or while a limit stops the robot."""
        await self._steering.rest()
        while self._steering.may_go() and rounded_pace(self.unit.speed.pace()) == 0:  # noqa: ASYNC110
            await asyncio.sleep(LIMIT_POLL_S)

    async def grip(self) -> str | None:
        """Close the gripper; return the gripped part, None (and open again) without one."""
        await self._begin_act()
        return await self.unit.grip(self.task)

    async def release(self, place: str | None) -> None:
        """Open the gripper; the part stays at its pose, in the fixture `place` if given."""
        await self._begin_act()
        await self.unit.release(self.task, place)

    async def give(self) -> None:
        """Open the gripper; a person takes the part out of the cell."""
        await self._begin_act()
        await self.unit.give(self.task)

    async def take(self, part: str) -> bool:
        """Close the gripper on `part`, which a person holds there; return whether it is gripped."""
        await self._begin_act()
        return await self.unit.take(self.task, part)

    def confirm(self) -> bool:
        """Confirm what the work waits for; return False without a change if it waits for nothing."""
        if self.awaits_confirmation:
            self._confirmed.set()
        return self.awaits_confirmation

    async def wait_for_confirmation(self, timeout_s: float, contact_n: float | None) -> bool:
        """Wait for `confirm`, or for a change of the wrist force by `contact_n`; False when the time is over.

        A pause does not count as time. Raises when the work is cancelled; the gripper is unchanged then.
        """
        await self._begin_act()
        clock, robot = asyncio.get_running_loop().time, self.unit.robot
        self._confirmed.clear()
        self.awaits_confirmation = True
        at_rest_n, left_s, before_s = robot.wrist_force_n(), timeout_s, clock()
        try:
            while not self._confirmed.is_set():
                if not self._steering.may_go():
                    await self._steering.rest()
                    before_s, at_rest_n = clock(), robot.wrist_force_n()
                    continue
                force_n = robot.wrist_force_n()
                if contact_n is not None and abs((force_n or 0.0) - (at_rest_n or 0.0)) >= contact_n:
                    return True
                now_s = clock()
                left_s, before_s = left_s - (now_s - before_s), now_s
                if left_s <= 0:
                    return False
                with suppress(TimeoutError):
                    await asyncio.wait_for(self._confirmed.wait(), min(CONFIRMATION_POLL_S, left_s))
            return True
        finally:
            self.awaits_confirmation = False

    async def wait(self, seconds: float) -> None:
        """Wait for the camera."""
        await self._begin_act()
        await asyncio.sleep(seconds)

    def done_before(self) -> Act | None:
        """Return the gripper's action for this Task in an earlier, interrupted run."""
        return self.unit.done_for(self.task)

    async def _begin_act(self) -> None:
        while not self._steering.may_go():
            await self._steering.rest()
        self._begin_next()

    def _begin_next(self) -> None:
        self._current_s = self._planned.pop(0) if self._planned else 0.0

    def _durations(self, steps: tuple[Joints | float, ...]) -> Iterator[float]:
        here = self.unit.joints
        for step in steps:
            if isinstance(step, tuple):
                yield self.unit.robot.estimate_s(here, step, self._speed)
                here = step
            else:
                yield step
