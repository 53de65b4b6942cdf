"""Goals of `FollowJointTrajectory`: the rest of a motion as points, and how far an arm may be behind them."""

import math
from collections import deque
from dataclasses import dataclass

from handover_datamodels.arm_stream import TrajectoryPoint
from handover_robots.model.joints import Joints
from handover_robots.model.poses import Frame, transposed, turn
from handover_robots.model.robot_model import RobotModel
from handover_robots.model.trajectory import Setpoint

STEP_S, MAX_POINTS = 0.05, 400
"""A goal has a point every 50 ms, and no more than 400."""
FOLLOWING_RAD = 0.05
"""An arm follows its goal within an angle, and the way of the goal in the delay of the options."""
FORWARD_S = 1e-4


@dataclass(frozen=True, slots=True)
class GoalPlan:
    """The rest of a motion: setpoints on the grid from cycle `first` on, the last one at rest."""

    first: int
    setpoints: list[Setpoint]
    goal: int
    began_at: Joints
    """Where the whole motion began."""

    @property
    def last(self) -> int:
        """Return the cycle of the last setpoint."""
        return self.first + len(self.setpoints) - 1

    def at(self, cycle: int) -> Setpoint:
        """Return the setpoint of a cycle: the last one after the end."""
        return self.setpoints[min(max(cycle - self.first, 0), len(self.setpoints) - 1)]


@dataclass(frozen=True, slots=True)
class GridPlace:
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
            way_rad += distance_rad(before, positions)
        self._entries.append((now_s, positions, way_rad))
        while len(self._entries) > 1 and self._entries[1][0] <= now_s - self._delay_s:
            self._entries.popleft()

    def is_near(self, measured: Joints) -> bool:
        """Return whether an arm at `measured` follows the commanded joints, with the delay."""
        _, positions, way_rad = self._entries[-1]
        return distance_rad(measured, positions) <= FOLLOWING_RAD + way_rad - self._entries[0][2]


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


def distance_rad(some: Joints, others: Joints) -> float:
    """Return the largest difference of a joint."""
    return max(abs(first - second) for first, second in zip(some, others, strict=True))
