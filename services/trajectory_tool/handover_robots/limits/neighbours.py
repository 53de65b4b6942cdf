"""Robots of a cell that people move at the same time do not touch each other.

Each robot has a volume that it does not leave before its rest: what its links sweep on the way to rest from
the last commanded setpoint. The volumes of two robots are never nearer than `CLEARANCE_M`: a next setpoint is
permitted only if its own volume keeps this distance from those of the others, and then becomes the volume of
the robot; otherwise the robot follows its way to rest, within the volume that it has. So each can come to
rest, whatever the others do. Volumes are compared and replaced under one lock.

A volume consists of capsules around the links. A capsule is that of the middle of the way to rest, larger by
how far a point of it moves at most to any configuration of the way. Robots whose reaches do not meet are not
compared. Robots that have come as near as they may, or nearer, may move apart: by short ways to rest, whose
samples are compared without the addition.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from threading import RLock
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from handover_robots.model.joints import Joints
from handover_robots.model.obstacles import Attached
from handover_robots.model.robot_model import RobotModel
from handover_robots.model.trajectory import Setpoint

if TYPE_CHECKING:
    from handover_robots.planning.capsules import LinkCapsules

Array = NDArray[np.float64]

CLEARANCE_M = 0.035
"""A little more than what the planner keeps from another robot, so that a Task can begin from there."""
SAME_DISTANCE_M = 1e-6
SHORT_M = 0.004


@dataclass(frozen=True, slots=True)
class Volume:
    """Capsules: the two ends of each, and its radius."""

    starts: Array
    ends: Array
    radii: Array

    def distance_m(self, other: "Volume") -> float:
        """Return the distance of two volumes, negative when they overlap."""
        apart = _between_segments(self.starts, self.ends, other.starts, other.ends)
        return float((apart - self.radii[:, None] - other.radii[None, :]).min())


@dataclass(slots=True)
class _Robot:
    model: RobotModel
    joints_at_rest: Callable[[], Joints | None]
    attached: Callable[[], tuple[Attached, ...]]
    capsules: "LinkCapsules | None" = None
    volume: Volume | None = None
    neighbours: tuple[str, ...] = ()
    last: Joints = ()
    """The last commanded positions."""


class MovingRobots:
    """The volumes of the robots of a cell; thread-safe. Needs the extra `motion`."""

    def __init__(self) -> None:
        self._robots: dict[str, _Robot] = {}
        self._lock = RLock()

    def add(
        self,
        name: str,
        model: RobotModel,
        joints_at_rest: Callable[[], Joints | None],
        attached: Callable[[], tuple[Attached, ...]],
    ) -> None:
        """Add a robot: its joints while it rests (None while it moves), and what its tool carries."""
        self._robots[name] = _Robot(model, joints_at_rest, attached)

    def is_prepared(self) -> bool:
        """Return whether the models of all robots are built."""
        return all(robot.capsules is not None for robot in self._robots.values())

    def prepare(self) -> None:
        """Build the models."""
        from handover_robots.planning.capsules import LinkCapsules  # noqa: PLC0415 - extra

        for robot in self._robots.values():
            with self._lock:
                robot.capsules = robot.capsules or LinkCapsules(robot.model)

    def start(self, name: str, joints: Joints) -> None:
        """Begin a motion of a robot at rest; take the others where they are."""
        if not self.is_prepared():
            self.prepare()
        with self._lock:
            robot = self._robots[name]
            _capsules(robot).attach(robot.attached())
            robot.volume = _at_rest(robot, joints)
            robot.neighbours = tuple(
                other for other in self._robots if other != name and self._meet(name, other)
            )
            for other in robot.neighbours:
                neighbour = self._robots[other]
                resting = neighbour.joints_at_rest()
                if resting is not None:
                    _capsules(neighbour).attach(neighbour.attached())
                    neighbour.volume = _at_rest(neighbour, resting)
            robot.last = joints

    def permits(self, name: str, stop: Sequence[Setpoint], box: tuple[Joints, Joints]) -> bool:
        """Return whether a robot may go on to `stop[0]`; then its volume is that of this way to rest."""
        robot = self._robots[name]
        if not robot.neighbours:
            return True
        with self._lock:
            volume = Volume(*_capsules(robot).within(*map(np.array, box)))
            if self._distance_m(robot, volume) < CLEARANCE_M and not self._leads_apart(robot, stop, volume):
                return False
            robot.volume = volume
            return True

    def note(self, name: str, setpoint: Setpoint) -> None:
        """Note what is commanded."""
        self._robots[name].last = setpoint.positions

    def _leads_apart(self, robot: _Robot, stop: Sequence[Setpoint], volume: Volume) -> bool:
        here = _at_rest(robot, robot.last)
        if float((volume.radii - here.radii).max()) > SHORT_M:
            return False
        here_m = self._distance_m(robot, here)
        distances_m = [self._distance_m(robot, _at_rest(robot, setpoint.positions)) for setpoint in stop]
        least_m = min(here_m, CLEARANCE_M) - SAME_DISTANCE_M
        return min(distances_m) >= least_m and distances_m[-1] > here_m

    def _distance_m(self, robot: _Robot, volume: Volume) -> float:
        others = (self._robots[name].volume for name in robot.neighbours)
        return min((volume.distance_m(other) for other in others if other is not None), default=math.inf)

    def _meet(self, name: str, other: str) -> bool:
        first, second = _capsules(self._robots[name]), _capsules(self._robots[other])
        apart_m = float(np.linalg.norm(first.centre - second.centre))
        return apart_m < first.reach_m + second.reach_m + CLEARANCE_M


class NeighbourGuard:
    """The robot keeps its distance from the others that people move. The last guard of a limiter.

    A planned motion has reserved its volume with the planner, and the others rest meanwhile.
    """

    def __init__(self, name: str, robots: MovingRobots) -> None:
        self._name = name
        self._robots = robots

    def needs_preparation(self) -> bool:
        """Return whether the models are missing."""
        return not self._robots.is_prepared()

    def prepare(self) -> None:
        """Build the models."""
        self._robots.prepare()

    def start(self, joints: Joints) -> None:
        """Begin a motion at rest."""
        self._robots.start(self._name, joints)

    def violation(self, setpoint: Setpoint) -> None:
        """Permit every setpoint of a planned motion."""

    def permits_stop(self, stop: Any) -> bool:
        """Return whether the robot keeps its distance on its way to rest."""
        return self._robots.permits(self._name, stop, stop.box)

    def note(self, setpoint: Setpoint) -> None:
        """Note what is commanded; the volume was replaced when the way to rest was permitted."""
        self._robots.note(self._name, setpoint)


def _capsules(robot: _Robot) -> "LinkCapsules":
    assert robot.capsules is not None  # noqa: S101 - `start` has prepared it
    return robot.capsules


def _at_rest(robot: _Robot, joints: Joints) -> Volume:
    here = np.array(joints)
    return Volume(*_capsules(robot).within(here, here))


def _between_segments(p1: Array, q1: Array, p2: Array, q2: Array) -> Array:
    """Return the distance of each segment of the first set to each of the second (Ericson, 2005, 5.1.9)."""
    d1, d2 = (q1 - p1)[:, None, :], (q2 - p2)[None, :, :]
    r = p1[:, None, :] - p2[None, :, :]
    a, e = (d1 * d1).sum(-1), (d2 * d2).sum(-1)
    b, c, f = (d1 * d2).sum(-1), (d1 * r).sum(-1), (d2 * r).sum(-1)
    tiny = 1e-12
    across = a * e - b * b
    s = np.where(across > tiny, np.clip((b * f - c * e) / np.maximum(across, tiny), 0.0, 1.0), 0.0)
    t = np.where(e > tiny, np.clip((b * s + f) / np.maximum(e, tiny), 0.0, 1.0), 0.0)
    s = np.where(a > tiny, np.clip((b * t - c) / np.maximum(a, tiny), 0.0, 1.0), 0.0)
    between = r + d1 * s[..., None] - d2 * t[..., None]
    return np.asarray(np.sqrt((between * between).sum(-1)))
