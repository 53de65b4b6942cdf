"""Plans motions of a robot in a world, and says why there is none.

    target -> joint positions (inverse kinematics, several)
           -> path (a line, or RRT-Connect and shortcuts)
           -> trajectory (rounded corners, limits of velocity, acceleration and jerk)
           -> check of the trajectory, and of the torques

The trajectory is checked as it is executed, not its path: the corners are rounded less, or not at all,
until the check succeeds. A start or target that is nearer to something than the margin, such as a gripper
above a part, gets a smaller margin; one in contact is refused.
"""

import math
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pinocchio as pin

from handover.messages import Message
from handover_robots.model.faults import NoPath, Unreachable
from handover_robots.model.joint_trajectory import JointTrajectory
from handover_robots.model.joints import Joints
from handover_robots.model.obstacles import World
from handover_robots.model.poses import Pose
from handover_robots.model.robot_model import RobotModel
from handover_robots.model.trajectory import Limits
from handover_robots.planning import retiming, timing
from handover_robots.planning.arm import Arm, Array, se3_of
from handover_robots.planning.collision import Clearance, Collisions
from handover_robots.planning.explanations import Explanations
from handover_robots.planning.inverse import Inverse
from handover_robots.planning.motions import Motions
from handover_robots.planning.search import search, shorten
from handover_robots.planning.straight import Obstructed, ToolLine, tool_line
from handover_robots.planning.tilt import Tilt
from handover_robots.planning.torques import Overload, Torques
from handover_robots.planning.tracked_distances import TrackedDistances

CHECK_STEP_S = 0.004
BLEND_SHARES = (0.45, 0.2, 0.08)
STRAIGHT_TOLERANCE_M = 0.001
MAX_TURNED_GOALS = 12
SHARE_OF_MARGIN = 0.6
"""Of the time that is left for the search, with each margin but the last one."""


@dataclass(frozen=True, slots=True)
class Options:
    """How to plan.

    `margins_m` are tried from the largest; all certify that nothing touches. `timeout_s` bounds the search
    with all of them (time of the processor), `optimise_s` the search for a shorter path after the first one.
    """

    margins_m: tuple[float, ...] = (0.01, 0.005, 0.002)
    contact_margin_m: float = 0.001
    """The margin of a straight motion, which may lead to or from a part."""
    timeout_s: float = 2.0
    optimise_s: float = 0.02
    max_goals: int = 4
    seed: int = 1


@dataclass(frozen=True)
class Plan:
    """A motion: its trajectory at full speed, the path it came from, and the margin that was kept."""

    trajectory: JointTrajectory
    path: tuple[Array, ...]
    margin_m: float

    @property
    def target(self) -> Joints:
        """Return the joints at the end."""
        return self.trajectory.target

    def passed(self, waypoints: Sequence[Joints], here: Joints) -> int:
        """Return how many of the waypoints lie before `here`, a position on the way; never the last one."""
        samples = self.trajectory.positions(CHECK_STEP_S)

        def place(joints: Joints, since: int) -> int:
            return since + int(np.abs(samples[since:] - np.array(joints)).sum(axis=1).argmin())

        now, count, at = place(here, 0), 0, 0
        for waypoint in waypoints[:-1]:
            at = place(waypoint, at)
            if at > now:
                break
            count += 1
        return count


class Planner:
    """Plans for one robot; not thread-safe. Every method that plans raises `Unreachable` or `NoPath`.

    A world whose payload is more than the robot may carry is refused with `NoPath`, unless `checks_payload`
    is false: for tests of torques, and where nothing is planned.
    """

    def __init__(
        self,
        model: RobotModel,
        limits: Limits | None = None,
        world: World | None = None,
        options: Options | None = None,
        *,
        checks_payload: bool = True,
    ) -> None:
        self.model = model
        self._checks_payload = checks_payload
        self.limits = limits or model.limits
        self.options = options or Options()
        self.arm = Arm(model)
        self.inverse = Inverse(self.arm, self.options.seed)
        self._worlds: dict[World, Collisions] = {}
        self._torques: Torques | None = None
        self._use(world or World())

    @property
    def world(self) -> World:
        """Return the present world."""
        return self.collisions.world

    @world.setter
    def world(self, world: World) -> None:
        self._use(world)

    def to_joints(self, start: Joints, target: Joints, tilt: Tilt | None = None) -> Plan:
        """Return a motion to joint positions, as they are given.

        The arm itself can divide the range of a joint, such as its base where the upper arm cannot pass. So
        where no way is found, one to the same position of all links is: with full turns of difference.
        """
        begin, goal = np.array(start), np.array(self.model.allow(target))
        try:
            return self._to_goals(begin, [goal], tilt)
        except NoPath as why:
            turned = [other for other in self.arm.equivalents(goal) if np.abs(other - goal).max() > math.pi]
            if not turned:
                raise
            turned.sort(key=lambda joints: (int((np.abs(joints - goal) > 1).sum()), _way(joints, begin)))
            with suppress(NoPath):
                return self._to_goals(begin, turned[:MAX_TURNED_GOALS], tilt)
            raise why from None

    def is_straight_free(self, start: Joints, target: Joints) -> bool:
        """Return whether the straight line in joint space is free. Raises `NoPath` where an end is not."""
        begin, goal = np.array(start), np.array(self.model.allow(target))
        return Motions(self.collisions, self._common_margin(begin, [goal])).is_free(begin, goal)

    def to_pose(self, start: Joints, pose: Pose, tilt: Tilt | None = None) -> Plan:
        """Return a motion to a pose of the tool, with the joint positions that are reached soonest."""
        begin = np.array(start)
        return self._to_goals(begin, self.goals(pose, begin), tilt)

    def through(self, start: Joints, targets: Sequence[Joints], tilt: Tilt | None = None) -> Plan:
        """Return one motion through waypoints, without a stop; each corner is rounded."""
        begin, path, margin_m = np.array(start), [np.array(start)], math.inf
        for target in targets:
            part = self._to_goals(begin, [np.array(self.model.allow(target))], tilt)
            path += part.path[1:]
            begin, margin_m = path[-1], min(margin_m, part.margin_m)
        return self._timed(path, Motions(self.collisions, margin_m), tilt)

    def straight(self, start: Joints, pose: Pose, max_tool_speed_mps: float | None = None) -> Plan:
        """Return a straight motion of the tool to a pose."""
        begin = np.array(start)
        line = tool_line(self.arm, self.inverse, begin, se3_of(pose))
        if isinstance(line, Obstructed):
            raise Unreachable(self._why.obstructed(line, pose, begin))
        return self._along_tool_line(line, se3_of(pose), max_tool_speed_mps)

    def approach(self, start: Joints, above: Pose, at: Pose) -> tuple[Plan, Plan]:
        """Return a motion to `above`, and the straight one from there to `at`.

        Joint positions above are chosen so that the straight motion exists.
        """
        begin, why = np.array(start), None
        for goal in self.goals(above, begin):
            try:
                down = self.straight(tuple(goal.tolist()), at)
                return self._to_goals(begin, [goal], None), down
            except (Unreachable, NoPath) as refusal:
                why = why or refusal
        assert why is not None  # noqa: S101 - there is at least one goal
        raise why

    def is_approachable(self, start: Joints, above: Pose, at: Pose) -> bool:
        """Return whether `approach` can choose joints, without the search for the way to them."""
        motions = Motions(self.collisions, self.options.margins_m[-1])
        begin = np.array(start)
        if not self.inverse.several(at, begin, 1, motions.is_state_free):
            return False
        for goal in self.inverse.several(above, begin, self.options.max_goals, motions.is_state_free):
            try:
                self.straight(tuple(goal.tolist()), at)
            except (Unreachable, NoPath):
                continue
            return True
        return False

    def reach(self, pose: Pose, near: Joints) -> Joints:
        """Return joint positions near `near` with the tool at a pose, without a look at obstacles."""
        begin = np.array(near)
        joints = self.inverse.solve(pose, begin)
        if joints is None:
            raise Unreachable(self._why.unreachable(pose, begin))
        return tuple(joints.tolist())

    def nearest_free(self, pose: Pose, near: Joints) -> Joints:
        """Return the free joint positions nearest to `near` with the tool at a pose."""
        return tuple(self.goals(pose, np.array(near))[0].tolist())

    def goals(self, pose: Pose, near: Array) -> list[Array]:
        """Return free joint positions with the tool at a pose, the nearest first; at least one."""
        for margin_m in self.options.margins_m:
            motions = Motions(self.collisions, margin_m)
            solutions = self.inverse.several(pose, near, self.options.max_goals, motions.is_state_free)
            if solutions:
                return solutions
        touching = self.inverse.several(pose, near, self.options.max_goals)
        if not touching:
            raise Unreachable(self._why.unreachable(pose, near))
        raise NoPath(self._why.touching_at(pose, near, touching))

    def check(self, trajectory: JointTrajectory, margin_m: float) -> None:
        """Check a trajectory as it will be executed. Raises `NoPath` that names what it would touch."""
        samples = trajectory.positions(CHECK_STEP_S)
        motions = Motions(self.collisions, margin_m)
        if motions.are_samples_free(samples):
            return
        touch = motions.first_contact(list(samples))
        if touch is not None:
            raise NoPath.translated(
                "robot.motion_blocked", "{pair} on the way", pair=self._why.contact(touch, margin_m)
            )

    def why_not_free(self, joints: Joints, margin_m: float = 0.0) -> Message | None:
        """Return what touches at joint positions, None if nothing does."""
        values = np.array(joints)
        return None if self.collisions.is_free(values, margin_m) else self._why.contact(values, margin_m)

    def least_clearance(self, path: Sequence[Joints]) -> Clearance | None:
        """Return the closest pair on a path whose joints follow each other closely; None without pairs."""
        distances, least = TrackedDistances(self.collisions), None
        for joints in path:
            distances.update(np.array(joints))
            closest = distances.closest()
            if closest is not None and (least is None or closest.distance_m < least.distance_m):
                least = closest
        return least

    def _use(self, world: World) -> None:
        if self._checks_payload and (too_heavy := self.model.payload_fault(world.payload_kg)) is not None:
            raise NoPath(too_heavy)
        if world not in self._worlds:
            if len(self._worlds) > 16:
                self._worlds.clear()
            self._worlds[world] = Collisions(self.arm, world)
        self.collisions = self._worlds[world]
        self._why = Explanations(self.inverse, self.collisions, self.options.margins_m[-1])
        if self._torques is None or self._torques.payload_kg != world.payload_kg:
            self._torques = Torques(self.arm, world.payload_kg)

    def _to_goals(self, start: Array, goals: list[Array], tilt: Tilt | None) -> Plan:
        largest_m = self._common_margin(start, goals)
        margins_m = [allowed_m for allowed_m in self.options.margins_m if allowed_m <= largest_m]
        left_s = self.options.timeout_s
        for margin_m in margins_m:
            timeout_s = left_s if margin_m == margins_m[-1] else SHARE_OF_MARGIN * left_s
            left_s -= timeout_s
            plan = self._with_margin(start, goals, tilt, margin_m, timeout_s)
            if plan is not None:
                return plan
        raise NoPath(
            self._why.blocked(Motions(self.collisions, largest_m), start, goals[0], self.options.timeout_s)
        )

    def _with_margin(
        self, start: Array, goals: list[Array], tilt: Tilt | None, margin_m: float, timeout_s: float
    ) -> Plan | None:
        motions = Motions(self.collisions, margin_m)
        goals = [goal for goal in goals if motions.is_state_free(goal)]
        if float(np.abs(start - goals[0]).max()) < timing.MIN_LENGTH:
            return self._plan(timing.line(start, start, self.limits), (start, start), margin_m)
        is_allowed = None if tilt is None else tilt.check(self.arm)

        def is_free(begin: Array, end: Array) -> bool:
            return motions.is_free(begin, end) and (is_allowed is None or is_allowed(begin, end))

        path = self._shortest(motions, start, goals, timeout_s, is_free=is_free, is_allowed=is_allowed)
        return None if path is None else self._timed(path, motions, tilt)

    def _shortest(
        self,
        motions: Motions,
        start: Array,
        goals: list[Array],
        timeout_s: float,
        *,
        is_free: Callable[[Array, Array], bool],
        is_allowed: Callable[[Array, Array], bool] | None,
    ) -> list[Array] | None:
        """Return the shortest of the paths that are found until the time for optimisation is over."""
        options, best, best_s = self.options, None, math.inf
        ends = time.monotonic() + options.optimise_s
        for attempt in range(8):
            path = search(motions, start, goals, timeout_s=timeout_s, is_edge_allowed=is_allowed)
            if path is None:
                break
            path = shorten(path, self._time_s, is_free, seed=options.seed + attempt)
            needs_s = sum(self._time_s(begin, end) for begin, end in pairwise(path))
            if needs_s < best_s:
                best, best_s = path, needs_s
            if len(path) == 2 or time.monotonic() > ends:
                break
        return best

    def _time_s(self, begin: Array, end: Array) -> float:
        """Return about how long a line takes at full speed."""
        return float((np.abs(end - begin) / np.array(self.limits.velocity)).max())

    def _plan(self, trajectory: JointTrajectory, path: Sequence[Array], margin_m: float) -> Plan:
        """Return the motion, slowed as far as torques demand. Raises `NoPath` when gravity is too much."""
        assert self._torques is not None  # noqa: S101 - set with the world
        speed = self._torques.allowed_speed(trajectory)
        if isinstance(speed, Overload):
            raise NoPath.translated(
                "robot.torque_exceeded",
                "{joint} needs {torque} to hold the arm and {payload} kg on the way, more than its limit "
                "of {limit}; choose a way nearer to the base, or a lighter part",
                joint=speed.joint,
                torque=speed.needed,
                payload=f"{self._torques.payload_kg:g}",
                limit=speed.limit,
            )
        return Plan(trajectory if speed == 1.0 else trajectory.slowed(speed), tuple(path), margin_m)

    def _timed(self, path: list[Array], motions: Motions, tilt: Tilt | None = None) -> Plan:
        """Return the motion on a path, with corners as round as the obstacles allow."""
        checks = Motions(self.collisions, motions.margin_m / 2)
        path = timing.distinct(path)
        if len(path) == 2:
            return self._plan(timing.line(path[0], path[1], self.limits), path, motions.margin_m)
        for share in BLEND_SHARES:
            curve = timing.BlendedLines(path, self.limits, share)
            try:
                trajectory = timing.along(curve, self.limits)
            except timing.NoTimingError:
                continue
            samples = trajectory.positions(CHECK_STEP_S)
            if checks.are_samples_free(samples) and (tilt is None or tilt.is_kept(self.arm, samples)):
                return self._plan(retiming.faster(trajectory, self.limits), path, motions.margin_m)
        return self._plan(timing.with_stops(path, self.limits), path, motions.margin_m)

    def _along_tool_line(self, line: ToolLine, target: pin.SE3, max_tool_speed_mps: float | None) -> Plan:
        motions = Motions(self.collisions, self.options.contact_margin_m)
        if len(line.at) < 2:
            only = line.joints[0]
            return self._plan(timing.line(only, only, self.limits), (only, only), motions.margin_m)
        if not motions.is_path_free(list(line.joints)):
            touch = motions.first_contact(list(line.joints))
            raise NoPath.translated(
                "robot.line_blocked",
                "the tool cannot move straight: {pair} on the way",
                pair=self._why.contact(line.joints[0] if touch is None else touch, motions.margin_m),
            )
        columns = np.column_stack([line.joints, line.at])
        curve = timing.Through(line.at, columns)
        limits, speed = self.limits, max_tool_speed_mps or timing.UNLIMITED
        for _ in range(6):
            trajectory = timing.along(curve, limits, extra_velocity=(speed,))
            if self._is_straight(trajectory, line.joints[0], target):
                break
            limits = replace(limits, velocity=tuple(0.7 * value for value in limits.velocity))
        self.check(trajectory, motions.margin_m / 2)
        return self._plan(trajectory, (line.joints[0], line.joints[-1]), motions.margin_m)

    def _is_straight(self, trajectory: JointTrajectory, start: Array, target: pin.SE3) -> bool:
        begin = self.arm.tool(start).translation
        way = target.translation - begin
        length = float(np.linalg.norm(way))
        positions = self.arm.tool_positions(trajectory.positions(5 * CHECK_STEP_S)) - begin
        if length < STRAIGHT_TOLERANCE_M:
            return float(np.linalg.norm(positions, axis=1).max()) < 2 * STRAIGHT_TOLERANCE_M
        off = positions - np.outer(positions @ way / length**2, way)
        return float(np.linalg.norm(off, axis=1).max()) < STRAIGHT_TOLERANCE_M

    def _common_margin(self, start: Array, goals: list[Array]) -> float:
        """Return the largest margin that start and a goal have. Raises `NoPath` where something touches."""
        for margin_m in self.options.margins_m:
            motions = Motions(self.collisions, margin_m)
            if motions.is_state_free(start) and any(motions.is_state_free(goal) for goal in goals):
                return margin_m
        least_m = self.options.margins_m[-1]
        if not self.collisions.is_free(start, least_m):
            raise NoPath.translated(
                "robot.start_blocked",
                "the robot cannot start here: {pair}; move it away by hand, or correct the scene",
                pair=self._why.contact(start, least_m),
            )
        raise NoPath.translated(
            "robot.target_blocked",
            "the robot cannot be at the target: {pair}; choose another target",
            pair=self._why.contact(goals[0], least_m),
        )


def _way(joints: Array, start: Array) -> float:
    return float(np.abs(joints - start).max())
