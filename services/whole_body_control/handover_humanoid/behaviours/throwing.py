"""Throwing a ball while standing: swing, release, follow-through and return, by the whole body.

The stack is that of CoSiMA for juggling: the soles first, then the centre of mass, the throwing hand, the
waist and the posture. The hand follows the place of the grip in the plan, the posture its joints. The hand
opens at the time of the plan. Where the ball lands by the measured state at this moment shows what the next
throw must change (`Practice`).
"""

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from handover.errors import UsageError
from handover.runtime.control_cycle import runs_in_cycle
from handover_humanoid.balance.contact_forces import FeedForward, shares
from handover_humanoid.balance.estimation import StateEstimator
from handover_humanoid.components.robot import NOT_FINITE, JointCommand, RobotSensors
from handover_humanoid.engines.choice import DEFAULT_ENGINE, EngineName, engine_maker
from handover_humanoid.engines.stack_engine import Step
from handover_humanoid.model.humanoid import Humanoid
from handover_humanoid.model.kinematics import BASE_POSITIONS, BASE_VELOCITIES, Array, Kinematics
from handover_humanoid.patterns.ballistics import landing_point
from handover_humanoid.patterns.minimum_jerk import moved, rate
from handover_humanoid.patterns.pendulum import Pendulum
from handover_humanoid.patterns.regions import SIDES, Footprint, Side, turn
from handover_humanoid.patterns.throwing import PlannedThrow, ThrowPlanner
from handover_humanoid.solvers.problem import Solver
from handover_humanoid.tasks.base import Level
from handover_humanoid.tasks.constraints import JointLimits
from handover_humanoid.tasks.tasks import (
    CentreOfMassTask,
    JointTask,
    PointTask,
    PoseTask,
    posture,
)

HAND, ARM = "hand", "arm"
SMOOTHED = 3
"""The landing place at the release is that of a line through the last so many predictions."""
TURNS = (False, False, False, True, True, True)


class Phase(StrEnum):
    """What the robot does with the ball."""

    STANDING = "standing"
    REACHING = "reaching back"
    SWINGING = "swinging"
    FOLLOWING = "following through"
    RETURNING = "returning"


@dataclass(frozen=True, slots=True)
class ThrowingState:
    """What one control period found: `opens` is true in the period in which the hand is to open.

    `predicted` (3,) is where a ball that is released now would land, NaN outside of the swing.
    """

    phase: Phase
    opens: bool
    predicted: Array
    fault: str = ""


@dataclass(frozen=True, slots=True)
class ThrowingSettings:
    """The parameters of throwing; `reach_s` is the time for reaching back and for returning."""

    pose: str = "stand"
    control_s: float = 0.01
    reach_s: float = 1.2
    capture_gain: float = 1.5
    sole_margin_m: float = 0.015
    stiffer: float = 3.0
    """The joints are as stiff as this many times the gains of the model."""


class Practice:
    """Learns from throws by how much each hand misses: too far or short, and to the side.

    Both are lines over the direction and distance of the throw, by least squares over the last `KEPT` throws
    with a small cost of the slopes. Throws to places nearby count most, since the misses of an arm are no
    straight line over its whole reach. It needs no camera: where a ball lands follows from the measured state
    at the release.
    """

    KEPT = 50
    PRIOR = np.array([0.2, 0.05, 0.05])
    """Costs of offset and slopes: one throw alone corrects five sixths of its offset."""
    NEARBY = np.array([1.0, 0.15, 0.12])
    """How far a throw is, in the units of its features, that counts by half as much as one to the same
    place."""

    def __init__(self) -> None:
        self._throws: dict[str, deque[tuple[Array, Array]]] = {}

    def throws(self, grip: str) -> tuple[tuple[Array, Array], ...]:
        """Return what is known of the throws of a hand, oldest first: features (3,) and miss (2,) in m."""
        return tuple(self._throws.get(grip, ()))

    def restore(self, grip: str, throws: Iterable[tuple[Array, Array]]) -> None:
        """Replace what is known of the throws of a hand."""
        self._throws[grip] = deque(throws, maxlen=self.KEPT)

    def aim(self, grip: str, base: Array, target: Array) -> Array:
        """Return where to throw so that the ball lands at `target` (3,), from above `base` (2,)."""
        throws = self.throws(grip)
        if not throws:
            return target
        features = np.array([feature for feature, _ in throws])
        missed = np.array([miss for _, miss in throws])
        away = (features - _features(base, target)) / self.NEARBY
        weighted = features.T / (1.0 + (away**2).sum(axis=1))
        lines = np.linalg.solve(weighted @ features + np.diag(self.PRIOR), weighted @ missed)
        aimed = target.copy()
        aimed[:2] -= _axes(base, target) @ (_features(base, target) @ lines)
        return aimed

    def learn(self, grip: str, base: Array, aimed: Array, landed: Array) -> None:
        """Remember where a throw aimed at `aimed` (3,) has `landed` (3,); NaN is left out."""
        missed = _axes(base, aimed).T @ (landed - aimed)[:2]
        if np.isfinite(missed).all():
            self._throws.setdefault(grip, deque(maxlen=self.KEPT)).append((_features(base, aimed), missed))


def aimed_throw(
    planner: ThrowPlanner, practice: Practice, grip: str, base: Array, target: Array
) -> tuple[Array, PlannedThrow]:
    """Return where to aim so that the ball lands at `target`, and the throw that does.

    Where aiming off is beyond reach, the throw is to the target itself, so that `OutOfReach` names what was
    asked for.
    """
    aimed = practice.aim(grip, base, target)
    try:
        return aimed, planner.plan(aimed)
    except UsageError:
        return target, planner.plan(target)


def _features(base: Array, target: Array) -> Array:
    """Return 1, the distance from 0.8 m in m, and the direction in rad."""
    way = target[:2] - base[:2]
    return np.array([1.0, float(np.linalg.norm(way)) - 0.8, float(np.arctan2(way[1], way[0]))])


def _axes(base: Array, target: Array) -> Array:
    """Return the directions (2, 2) away from the base and to the left of it, as columns."""
    ahead = target[:2] - base[:2]
    ahead = ahead / max(float(np.linalg.norm(ahead)), 1e-9)
    return np.array([[ahead[0], -ahead[1]], [ahead[1], ahead[0]]])


class ThrowingController:
    """Stands, and throws when it is asked to. Not thread-safe; `step` performs no I/O."""

    def __init__(
        self,
        humanoid: Humanoid,
        solver: Solver | None = None,
        settings: ThrowingSettings | None = None,
        *,
        engine: EngineName = DEFAULT_ENGINE,
    ) -> None:
        self.settings = settings or ThrowingSettings()
        self._humanoid = humanoid
        self._kinematics, self._plan = Kinematics(humanoid), Kinematics(humanoid)
        self._estimated = Kinematics(humanoid)
        self._feed_forward = FeedForward(self._kinematics)
        self._engine_of = engine_maker(engine, solver)
        gains = JointCommand(humanoid)
        self._stiffness = gains.stiffness * self.settings.stiffer
        self._damping = gains.damping * self.settings.stiffer**0.5
        self.stand_at(self._kinematics.standing(self.settings.pose))

    def stand_at(self, q: Array) -> None:
        """Stand from now on as `q`, at rest, in a frame of its own with the origin between the soles."""
        self.start = q.copy()
        self._q = self.start.copy()
        self._velocity = np.zeros(self._kinematics.n_velocities)
        self._acceleration = np.zeros(self._kinematics.n_velocities)
        self._kinematics.update(self._q)
        self.estimator = StateEstimator(self._estimated, self.start)
        self._start_frame = self.estimator.feet_frame()
        self._centre = self._kinematics.centre_of_mass()
        self._pendulum = Pendulum(float(self._centre[2]))
        self._feet, self._sole = self._footprints()
        self._throw: PlannedThrow | None = None
        self._time_s, self._has_opened, self._is_cancelled = 0.0, False, False
        self.last_step = Step(self._q, self._velocity, {})
        self._stand()

    @property
    def is_busy(self) -> bool:
        """Return whether a throw is under way."""
        return self._throw is not None

    @property
    def reference(self) -> Array:
        """Return the configuration that is commanded."""
        return self._q

    @property
    def com_reference(self) -> Array:
        """Return where the centre of mass (2,) is to be, in the frame between the soles."""
        return self._com.target[:2]

    @property
    def level_names(self) -> tuple[tuple[str, ...], ...]:
        """Return the names of the levels of each stack, from the first level on: standing, and throwing."""
        standing = tuple(level.name for level in self._engine.stack.levels)
        return standing, (*standing[:2], HAND, standing[2], ARM, standing[3])

    @property
    def constraint_names(self) -> frozenset[str]:
        """Return the names of the constraints."""
        return frozenset(constraint.name for constraint in self._engine.stack.constraints)

    def cancel(self) -> None:
        """Open no hand in this throw: what has begun is followed through, and the arm returns."""
        self._is_cancelled = True

    def throw(self, throw: PlannedThrow) -> None:
        """Begin a throw; the hand has the ball. Raises `ValueError` while another one is under way."""
        if self._throw is not None:
            raise ValueError("a throw is under way; wait until the robot stands again")
        self._throw, self._time_s, self._has_opened, self._is_cancelled = throw, 0.0, False, False
        self._predictions: deque[Array] = deque(maxlen=SMOOTHED)
        self._frame_before = self.estimator.feet_frame()
        self._arm = np.array(self._humanoid.indices(throw.grip.arm))
        self._home = self._q[BASE_POSITIONS + self._arm].copy()
        place = self._plan.point(self.start, throw.grip.link, np.array(throw.grip.point))[0]
        self._hand = PointTask(HAND, throw.grip.link, np.array(throw.grip.point), place, gain=20.0)
        self._swing = JointTask(ARM, self._arm.tolist(), self._home, gain=10.0)
        stack = self._soles() / self._com / self._hand / self._waist
        stack = stack / self._swing / self._posture << self._limits
        self._engine = self._engine_of(self._kinematics, stack)

    @runs_in_cycle
    def step(self, sensors: RobotSensors, command: JointCommand) -> ThrowingState:
        """Compute the command of the next `control_s`; holds the last one for values that are not finite."""
        if not sensors.is_finite:
            return ThrowingState(Phase.STANDING, False, np.full(3, np.nan), NOT_FINITE)
        dt_s = self.settings.control_s
        self.estimator.update(sensors, dt_s)
        self._time_s += dt_s
        phase = self._follow()
        predicted, opens = self._release(phase)
        step = self._engine.step(self._q, dt_s)
        self._acceleration = (step.velocity - self._velocity) / dt_s
        self._q, self._velocity, self.last_step = step.q, step.velocity, step
        self._send(command)
        if phase is Phase.STANDING and self._throw is not None:
            self._throw = None
            self._stand()
        return ThrowingState(phase, opens, predicted, step.fault)

    def _soles(self) -> Level:
        self._kinematics.update(self.start)
        links = [contact.link for contact in self._humanoid.contacts.values()]
        first, *others = (PoseTask(link, link, self._kinematics.pose(link).copy()) for link in links)
        level: Level = first
        for other in others:
            level = level & other
        return level

    def _stand(self) -> None:
        self._com = CentreOfMassTask("com", self._centre)
        upright = self._kinematics.pose(self._humanoid.root).copy()
        self._waist = PoseTask("waist", self._humanoid.root, upright, axes=TURNS)
        self._posture = posture(self._kinematics, self.settings.pose)
        self._limits = JointLimits(self._kinematics)
        stack = self._soles() / self._com / self._waist / self._posture << self._limits
        self._engine = self._engine_of(self._kinematics, stack)

    @runs_in_cycle
    def _follow(self) -> Phase:
        """Set the targets of hand and arm for the end of this period, and return the phase."""
        throw = self._throw
        if throw is None:
            return Phase.STANDING
        (joints, velocity), phase = self._arm_at(throw, self._time_s)
        self._swing.target, self._swing.velocity = joints, velocity
        q = self.start.copy()
        q[BASE_POSITIONS + self._arm] = joints
        v = np.zeros(self._plan.n_velocities)
        v[BASE_VELOCITIES + self._arm] = velocity
        place, jacobian = self._plan.point(q, throw.grip.link, self._hand.point)
        self._hand.target, self._hand.velocity = place, jacobian @ v
        self._plan.update(q)
        self._com.target = self._plan.centre_of_mass()
        self._com.velocity = self._plan.centre_of_mass_jacobian() @ v
        return phase

    def _arm_at(self, throw: PlannedThrow, time_s: float) -> tuple[tuple[Array, Array], Phase]:
        reach_s = self.settings.reach_s
        if time_s < reach_s:
            return _between(self._home, throw.start, time_s / reach_s, reach_s), Phase.REACHING
        time_s -= reach_s
        if time_s < throw.duration_s:
            return throw.joints(time_s), Phase.FOLLOWING if self._has_opened else Phase.SWINGING
        time_s -= throw.duration_s
        if time_s < reach_s:
            return _between(throw.end, self._home, time_s / reach_s, reach_s), Phase.RETURNING
        return (self._home, np.zeros(len(self._arm))), Phase.STANDING

    def _release(self, phase: Phase) -> tuple[Array, bool]:
        """Return where the ball would land if it were released now, and whether it is."""
        throw = self._throw
        if throw is None or phase is not Phase.SWINGING:
            return np.full(3, np.nan), False
        late_s = self._time_s - self.settings.reach_s - throw.swing_s
        estimate = self.estimator.kinematics
        place, jacobian = estimate.point(self.estimator.q, throw.grip.link, self._hand.point)
        place, velocity = self._on_feet(place, jacobian @ self.estimator.v, self._frame_before)
        predicted = landing_point(place, velocity, float(throw.landing[2]))
        self._predictions.append(predicted)
        if late_s < -self.settings.control_s / 2:
            return predicted, False
        self._has_opened = True
        if self._is_cancelled:
            return predicted, False
        return _at_the_end(np.array(self._predictions)), True

    def _on_feet(self, place: Array, velocity: Array, frame: Array) -> tuple[Array, Array]:
        """Return a place and a velocity (3,) of the estimate in the frame in which the feet have not moved.

        `frame` (3,) is the frame between the soles in the estimate, which drifts in place and yaw, but not
        within a throw, whose swing may turn the feet. Its yaw is that of the soles, not of the line between
        them: a swing twists both feet where they stand.
        """
        turned = turn(self._start_frame[2] - frame[2])
        place, velocity = place.copy(), velocity.copy()
        place[:2] = turned @ (place[:2] - frame[:2]) + self._start_frame[:2]
        velocity[:2] = turned @ velocity[:2]
        return place, velocity

    @runs_in_cycle
    def _send(self, command: JointCommand) -> None:
        estimator, omega = self.estimator, self._pendulum.omega
        reference = self._com.target + self._com.velocity / omega
        com, velocity = self._on_feet(estimator.com, estimator.com_velocity, estimator.feet_frame())
        error = (com + velocity / omega - reference)[:2]
        self._kinematics.update(self._q)
        needed = self._feed_forward.needed(self._velocity, self._acceleration, np.zeros(3))
        wanted = needed.zmp + self.settings.capture_gain * error
        forces = shares(self._feet, self._sole, wanted, self.settings.sole_margin_m)
        wanted = sum((share * point for share, point in forces.values()), np.zeros(2))
        shift = np.array([*(omega**2 * (needed.zmp - wanted)), 0.0])
        needed = self._feed_forward.needed(self._velocity, self._acceleration, shift)
        forces = shares(self._feet, self._sole, needed.zmp, self.settings.sole_margin_m)
        links = {self._links[side]: force for side, force in forces.items()}
        command.stiffness[:] = self._stiffness
        command.damping[:] = self._damping
        self._feed_forward.write(command, self._q, self._velocity, needed, links)

    def _footprints(self) -> tuple[dict[Side, Footprint], Array]:
        contacts = {side: self._humanoid.contacts[f"{side}_sole"] for side in SIDES}
        self._links = {side: contact.link for side, contact in contacts.items()}
        feet = {
            side: Footprint.below(side, self._kinematics.pose(link)) for side, link in self._links.items()
        }
        return feet, np.array(contacts["left"].corners)[:, :2]


def _at_the_end(samples: Array) -> Array:
    """Return the last value of the lines through samples (n, 3)."""
    times = np.arange(len(samples)) - (len(samples) - 1) / 2
    slope = times @ samples / max(float(times @ times), 1.0)
    return np.asarray(samples.mean(axis=0) + slope * times[-1])


def _between(start: Array, end: Array, share: float, duration_s: float) -> tuple[Array, Array]:
    """Return place and velocity on the way of minimum jerk from rest to rest."""
    return start + moved(share) * (end - start), rate(share) / duration_s * (end - start)
