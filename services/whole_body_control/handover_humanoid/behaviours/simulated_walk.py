"""A walk in simulation with what was measured on the way; for tests, benchmarks and pictures."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from handover_humanoid.behaviours.walking import WalkingController, WalkingState
from handover_humanoid.components.robot import Interpolation, JointCommand, RobotSensors
from handover_humanoid.model.kinematics import Array
from handover_humanoid.patterns.footsteps import Wish
from handover_humanoid.patterns.regions import SIDES
from handover_humanoid.simulation.simulated_robot import SimulatedRobot

FALLEN_SHARE = 0.75
"""A robot has fallen when its base is below this share of its height at the start."""

Guide = Callable[[float], Wish]
"""Returns the wish at a time in s."""


@dataclass(frozen=True, slots=True)
class WalkRecord:
    """One row a control period: `time_s` (n,), and (n, 2) each of the rest, in m and m/s.

    `room_m` and `planned_room_m` are how far the measured centre of pressure and the planned ZMP are inside
    of the soles that stand; `is_single` is whether one foot stood.
    """

    time_s: Array
    com: Array
    reference: Array
    zmp: Array
    planned_zmp: Array
    room_m: Array
    planned_room_m: Array
    is_single: NDArray[np.bool_]
    has_fallen: bool
    states: tuple[WalkingState, ...]

    def tracking_rms_m(self) -> float:
        """Return the root mean square of the distance of the centre of mass from its reference."""
        return float(np.sqrt(((self.com - self.reference) ** 2).sum(axis=1).mean()))

    def share_inside(self, margin_m: float = 0.01) -> float:
        """Return the share of samples in single support with the pressure `margin_m` inside of the sole."""
        rooms = self.room_m[self.is_single]
        return float((rooms >= margin_m).mean()) if len(rooms) else 1.0


class SimulatedWalk:
    """A controller with its simulated robot."""

    def __init__(self, controller: WalkingController, robot: SimulatedRobot) -> None:
        self.controller, self.robot = controller, robot
        self.sensors, self.command = RobotSensors(robot.humanoid), JointCommand(robot.humanoid)
        self.command.positions[:] = controller.start[7:]
        self._between = Interpolation(
            robot.humanoid, controller.start[7:], controller.settings.control_s, robot.period_s
        )
        self._height_m = float(controller.start[2])
        self._foot = np.array(robot.humanoid.contacts[controller.settings.contacts["left"]].corners)[:, :2]
        self._low, self._high = self._foot.min(axis=0).tolist(), self._foot.max(axis=0).tolist()

    def cycle(self) -> WalkingState:
        """Run one control period."""
        self.robot.read(self.sensors)
        state = self.controller.step(self.sensors, self.command)
        self._between.start(self.command)
        for _ in range(self._between.steps):
            self.robot.write(self._between.next())
            self.robot.wait()
        return state

    @property
    def has_fallen(self) -> bool:
        """Return whether the base is on its way to the ground."""
        return self.robot.height_m < FALLEN_SHARE * self._height_m

    def run(self, seconds: float, guide: Guide) -> WalkRecord:
        """Walk as the guide wishes, or until the robot falls."""
        rows: list[Array] = []
        states: list[WalkingState] = []
        until_s, has_fallen = self.robot.time_s + seconds, False
        while self.robot.time_s < until_s - 1e-9 and not has_fallen:
            self.controller.wish = guide(self.robot.time_s)
            time_s = self.robot.time_s
            state = self.cycle()
            states.append(state)
            rows.append(np.array([time_s, *self._rooms(state), state.stance.phase == "single"]))
            has_fallen = self.has_fallen
        table = np.array(rows)
        return WalkRecord(
            table[:, 0],
            np.array([state.com[:2] for state in states]),
            np.array([state.reference.com for state in states]),
            np.array([state.measured_zmp for state in states]),
            np.array([state.reference.zmp for state in states]),
            table[:, 1],
            table[:, 2],
            table[:, 3] > 0,
            has_fallen,
            tuple(states),
        )

    def _rooms(self, state: WalkingState) -> tuple[float, float]:
        """Return how far the measured pressure is inside of the sole that stands, and the ZMP by the plan."""
        stance, controller = state.stance, self.controller
        planned = stance.region(self._foot).room_m(state.reference.zmp)
        if stance.phase != "single":
            return np.inf, planned
        side = next(stance_side for stance_side in SIDES if stance_side != stance.swing)
        x, y = controller.estimator.feet[controller.settings.contacts[side]].pressure.tolist()
        (low_x, low_y), (high_x, high_y) = self._low, self._high
        return min(x - low_x, y - low_y, high_x - x, high_y - y), planned
