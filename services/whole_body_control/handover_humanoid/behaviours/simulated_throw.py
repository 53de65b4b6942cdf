"""Throws in simulation: controller and simulated robot together, for tests and measurements."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from handover_humanoid.behaviours.throwing import Phase, ThrowingController
from handover_humanoid.components.robot import Interpolation, JointCommand, RobotSensors
from handover_humanoid.engines.choice import DEFAULT_ENGINE, EngineName
from handover_humanoid.model.humanoid import Humanoid
from handover_humanoid.model.kinematics import Array
from handover_humanoid.patterns.regions import turn
from handover_humanoid.patterns.throwing import PlannedThrow
from handover_humanoid.simulation.ball import RobotWithBall
from handover_humanoid.simulation.simulated_robot import QUIET, SensorNoise
from handover_humanoid.solvers.problem import Solver


@dataclass(frozen=True, slots=True)
class ThrowRecord:
    """What a throw did: `landed` and `predicted` (3,) are in the frame in which the robot stood before it.

    `predicted` follows from the estimated state at the release; the phases are in their order. `solve_s` (n,)
    are the times of the solver, one a control period.
    """

    landed: Array
    predicted: Array
    phases: tuple[Phase, ...]
    solve_s: Array


class SimulatedThrow:
    """A standing robot that throws. Targets are in the frame of the robot as it stood before the throw.

    Each throw turns the feet on the ground by some milliradians, which the robot does not see. What sees
    the robot, such as the tracking of a headset, gives it targets in its own frame.
    """

    def __init__(
        self,
        humanoid: Humanoid,
        model: Any,
        solver: Solver | None = None,
        noise: SensorNoise = QUIET,
        seed: int = 0,
        *,
        engine: EngineName = DEFAULT_ENGINE,
    ) -> None:
        self.controller = ThrowingController(humanoid, solver, engine=engine)
        self.robot = RobotWithBall(humanoid, self.controller.start, noise, seed, model)
        self._sensors, self._command = RobotSensors(humanoid), JointCommand(humanoid)
        self._between = Interpolation(
            humanoid, self.controller.start[7:], self.controller.settings.control_s, self.robot.period_s
        )

    def throw(self, throw: PlannedThrow) -> ThrowRecord:
        """Put the ball into the hand and throw it."""
        robot, controller = self.robot, self.controller
        place, yaw = self._stance()
        robot.hold(throw.grip)
        controller.throw(throw)
        landed, predicted = np.full(3, np.nan), np.full(3, np.nan)
        phases, solve_s = [Phase.REACHING], list[float]()
        height_m, begun_s = float(throw.landing[2]), robot.time_s
        while controller.is_busy and robot.time_s - begun_s < throw.duration_s + 10.0:
            robot.read(self._sensors)
            state = controller.step(self._sensors, self._command)
            solve_s.append(controller.last_step.solve_s)
            if state.phase is not phases[-1]:
                phases.append(state.phase)
            self._between.start(self._command)
            if state.opens:
                predicted = state.predicted
                robot.release()
            for _ in range(self._between.steps):
                robot.write(self._between.next())
                before = robot.ball
                robot.wait()
                if not before.held_by and np.isnan(landed[0]):
                    landed = _crossing(before.position, robot.ball.position, height_m)
        landed[:2] = turn(-yaw) @ (landed[:2] - place) + controller.start[:2]
        return ThrowRecord(landed, predicted, tuple(phases), np.array(solve_s))

    def _stance(self) -> tuple[Array, float]:
        """Return place (2,) and yaw of the base."""
        q = self.robot.true_configuration()
        return q[:2], float(2 * np.arctan2(q[5], q[6]))


def _crossing(before: Array, after: Array, height_m: float) -> Array:
    """Return where a ball came down through a height between two positions; NaN if it did not."""
    if not before[2] > height_m >= after[2]:
        return np.full(3, np.nan)
    share = (before[2] - height_m) / (before[2] - after[2])
    return np.asarray(before + share * (after - before))
