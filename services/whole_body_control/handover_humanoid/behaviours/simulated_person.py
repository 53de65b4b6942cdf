"""A simulated person who leads the humanoid by the hands, and what the robot made of it; for tests and
figures.

The person stands in front of the robot, follows it with the inertia of a body, and holds each hand by a
spring with damping between the hand of the robot and the own hand. The person walks on a curve while the
robot turns, and walks no further in the old direction when another one is wanted. The own hands are where
those of the robot rest, plus the lead of the script: ahead, to a side, one ahead and one back for a turn. So
a script is an intention with a direction, and what the robot reads of it can be compared. The person knows
the truth of the simulation, the robot knows its sensors.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from handover_humanoid.behaviours.component_state import Behaviour
from handover_humanoid.behaviours.humanoid_component import HumanoidComponent
from handover_humanoid.behaviours.simulated_walk import FALLEN_SHARE
from handover_humanoid.behaviours.walking import WalkingState
from handover_humanoid.components.robot import Interpolation, JointCommand, RobotSensors
from handover_humanoid.cycle.wish import PERSON, WISH
from handover_humanoid.model.humanoid import Humanoid
from handover_humanoid.model.kinematics import Array, Kinematics
from handover_humanoid.patterns.footsteps import StepLimits
from handover_humanoid.patterns.intention import DEFAULT_INTENTION, IntentionName
from handover_humanoid.patterns.regions import SIDES, Side, turn
from handover_humanoid.simulation.ball import RobotWithBall
from handover_humanoid.simulation.simulated_robot import TYPICAL_NOISE, SensorNoise
from handover_humanoid.solvers.problem import Solver

SETTLE_S: Final = 3.0
"""How long the robot draws its arms to their pose before the person takes its hands."""
FOLLOW_PS: Final = 0.8
"""How fast the body of the person follows the robot, in rad/s: place and speed of it, with critical
damping."""


@dataclass(frozen=True, slots=True)
class Lead:
    """What the person wants for some time: the hands `ahead_m` and `left_m` of where those of the robot rest.

    `apart_m` moves the right hand ahead and the left one back: a turn to the left. `holds` is False for a
    person who has let go, and `jerk_n` is a force of both hands ahead for the first tenth of a second.
    """

    seconds: float
    ahead_m: float = 0.0
    left_m: float = 0.0
    apart_m: float = 0.0
    jerk_n: float = 0.0
    holds: bool = True

    @property
    def direction(self) -> float | None:
        """The direction of the intention in rad from ahead to the left, None without one."""
        is_none = not self.holds or np.hypot(self.ahead_m, self.left_m) < MIN_LEAD_M
        return None if is_none else float(np.arctan2(self.left_m, self.ahead_m))

    @property
    def is_still(self) -> bool:
        """Whether the person stands."""
        return self.direction is None and not self.apart_m


MIN_LEAD_M: Final = 0.05
LET_GO_S: Final = 2.0
"""How long a person lets go when a hand of the robot has opened, before they take both again."""
STILL: Final = Lead(3.0)
TOUR: Final = (
    Lead(10.0, ahead_m=0.18),
    Lead(8.0, left_m=0.14),
    Lead(8.0, ahead_m=0.12, left_m=0.12),
    STILL,
    Lead(8.0, ahead_m=0.15, apart_m=0.12),
    Lead(8.0, left_m=-0.14),
    Lead(8.0, ahead_m=-0.15),
    Lead(7.0),
)
SCRIPTS: Final[Mapping[str, Sequence[Lead]]] = {
    "forward": (Lead(8.0, ahead_m=0.18), STILL, Lead(6.0, ahead_m=-0.15), STILL),
    "side": (Lead(8.0, left_m=0.14), STILL, Lead(8.0, left_m=-0.14), STILL),
    "turn": (Lead(8.0, apart_m=0.12), STILL, Lead(8.0, apart_m=-0.12), STILL),
    "stop": (Lead(5.0, ahead_m=0.18), STILL, Lead(5.0, ahead_m=0.18), Lead(4.0, holds=False)),
    "stumble": (Lead(5.0, ahead_m=0.18), Lead(2.0, ahead_m=0.3, jerk_n=40.0), Lead(3.0, holds=False), STILL),
    "tour": TOUR,
    "long": TOUR * 5,
}
"""Intentions by name; `tour` has all directions in 60 s, `long` five of them: five minutes."""


@dataclass(frozen=True, slots=True)
class PersonArm:
    """The arm of the person: a spring with damping."""

    stiffness_npm: float = 40.0
    damping_nspm: float = 8.0


@dataclass(frozen=True, slots=True)
class LedRecord:
    """One row a control period, (n,) or (n, k): places in m on the ground of the footsteps, angles in rad.

    `intention` (n,) is the direction of the person's intention in the frame of the heading, NaN without one;
    `velocity` (n, 2) in m/s what the robot made of it, in the same frame. `place` (n, 3) is where the robot
    is in truth: x, y, yaw. `manipulability` (n, 2) and `forces` (n, 6) are those of the left and right hand.
    """

    time_s: Array
    script: tuple[Lead, ...]
    intention: Array
    velocity: Array
    yaw_rate: Array
    place: Array
    manipulability: Array
    forces: Array
    faults: NDArray[np.int_]
    states: tuple[WalkingState, ...]
    has_fallen: bool


class LedWalk:
    """A robot that is led by a simulated person, in simulated physics."""

    def __init__(
        self,
        humanoid: Humanoid,
        solver: Solver | None = None,
        noise: SensorNoise = TYPICAL_NOISE,
        seed: int = 1,
        *,
        intention: IntentionName = DEFAULT_INTENTION,
        hold: PersonArm | None = None,
    ) -> None:
        start = HumanoidComponent(humanoid, solver).start
        self.robot = RobotWithBall(humanoid, start, noise, seed)
        self.component = HumanoidComponent(humanoid, solver, self.robot, intention=intention)
        if self.component.assistance is None:  # it has a world, so it has one
            raise ValueError(f"{humanoid.name} cannot be led")
        self.assistance = self.component.assistance
        self._hold = hold or PersonArm()
        self._sensors, self._command = RobotSensors(humanoid), JointCommand(humanoid)
        self._command.positions[:] = start[7:]
        self._between = Interpolation(humanoid, start[7:], self.component.control_s, self.robot.period_s)
        by_name = {"speed_share": 1.0, "behaviour": float(Behaviour.ASSISTED_WALKING)}
        self._wish = np.array([by_name.get(name, 0.0) for name in WISH])
        self._truth = Kinematics(humanoid)
        self._height_m = float(start[2])
        self._body, self._body_velocity, self._drift = np.zeros(3), np.zeros(3), np.zeros(3)
        self._takes_again_s = 0.0
        self._cycle(None)
        while self.robot.time_s < SETTLE_S:
            self._cycle(None)
        self._body = self.place

    @property
    def step_limits(self) -> StepLimits:
        """Return what the robot can step."""
        return self.component.walking.step_limits

    @property
    def place(self) -> Array:
        """Return where the robot is in truth: x and y in m, yaw in rad."""
        q = self.robot.true_configuration()
        return np.array([q[0], q[1], 2 * np.arctan2(q[5], q[6])])

    def run(self, script: Sequence[Lead]) -> LedRecord:
        """Let the person act, or until the robot falls."""
        rows: list[Array] = []
        states: list[WalkingState] = []
        has_fallen = False
        for lead in script:
            since_s = self.robot.time_s
            self._drift[:] = 0.0
            while self.robot.time_s < since_s + lead.seconds - 1e-9 and not has_fallen:
                is_jerk = self.robot.time_s - since_s < 0.1
                states.append(self._cycle(lead, lead.jerk_n if is_jerk else 0.0))
                rows.append(self._row(lead))
                has_fallen = bool(self.robot.true_configuration()[2] < FALLEN_SHARE * self._height_m)
        table = np.array(rows)
        return LedRecord(
            time_s=table[:, 0],
            script=tuple(script),
            intention=table[:, 1],
            velocity=table[:, 2:4],
            yaw_rate=table[:, 4],
            place=table[:, 5:8],
            manipulability=table[:, 8:10],
            forces=table[:, 10:16],
            faults=table[:, 16].astype(int),
            states=tuple(states),
            has_fallen=has_fallen,
        )

    def _row(self, lead: Lead) -> Array:
        component, assistance = self.component, self.assistance
        place, wanted = self.place, lead.direction
        heading = np.nan if wanted is None else self._body[2] + wanted - place[2]
        wish = component.walking.wish
        return np.array(
            [
                self.robot.time_s,
                heading,
                *(turn(-component.walking.heading) @ assistance.velocity),
                wish.yaw_rate,
                *place,
                *(assistance.manipulability(side) for side in SIDES),
                *(value for side in SIDES for value in component.hand_force(side)),
                component.fault,
            ],
            dtype=float,
        )

    def _cycle(self, lead: Lead | None, jerk_n: float = 0.0) -> WalkingState:
        """Run one control period."""
        if lead is not None and lead.is_still:
            self._drift[:], self._body_velocity[:] = 0.0, 0.0
        elif lead is not None:
            self._follow()
        self.robot.read(self._sensors)
        self.component.follow(self._wish, self._hands(lead, jerk_n))
        self.component.step(self._sensors, self._command)
        self._between.start(self._command)
        for _ in range(self._between.steps):
            self.robot.write(self._between.next())
            self.robot.wait()
        return self.component.walking.state

    def _follow(self) -> None:
        """Move the body of the person after the robot."""
        dt_s = self.component.control_s
        error = self.place - self._body
        error[2] = (error[2] + np.pi) % (2 * np.pi) - np.pi
        self._drift[:2] = turn(dt_s * self._body_velocity[2]) @ self._drift[:2]
        self._drift += dt_s * FOLLOW_PS**2 * error
        self._body_velocity = self._drift + 2 * FOLLOW_PS * error
        self._body = self._body + dt_s * self._body_velocity

    def _hands(self, lead: Lead | None, jerk_n: float) -> Array | None:
        """Return what the hands of the person do, as forces in the frame between the soles."""
        if self.assistance.is_pulled_hard and self.robot.time_s >= self._takes_again_s:
            self._takes_again_s = self.robot.time_s + LET_GO_S
        if lead is None or not lead.holds or self.robot.time_s < self._takes_again_s:
            return None
        self._truth.update(self.robot.true_configuration(), self.robot.true_velocity())
        values = np.zeros(len(PERSON))
        back = turn(-self.place[2])
        for index, side in enumerate(SIDES):
            force = self._force(side, lead) + np.array(
                [*(turn(self._body[2]) @ np.array([jerk_n, 0.0])), 0.0]
            )
            at = index * len(values) // len(SIDES)
            values[at], values[at + 4 : at + 7] = 2.0, [*(back @ force[:2]), force[2]]
        return values

    def _force(self, side: Side, lead: Lead) -> Array:
        """Return the force (3,) in N of a hand of the person on that of the robot, in the world."""
        link = self.assistance.link(side)
        rest = self.assistance.rest(side).copy()
        forwards = lead.apart_m if side == "right" else -lead.apart_m
        rest[:2] += [lead.ahead_m + forwards, lead.left_m]
        hand = np.array([*(self._body[:2] + turn(self._body[2]) @ rest[:2]), self._height_m + rest[2]])
        velocity = self._truth.velocity(link)[:3]
        body = np.array([*self._body_velocity[:2], 0.0])
        place = np.array(self._truth.pose(link).translation)
        return np.asarray(
            self._hold.stiffness_npm * (hand - place) - self._hold.damping_nspm * (velocity - body)
        )
