"""Walking: pattern generator, stabiliser, stack of tasks and feed-forward torques in one controller.

Every `PERIOD_S` of the pattern generator the motion of the next period is planned; a foot in the air lands
farther by the error of the capture point. Every control period

1. the state is estimated from the sensors,
2. the stabiliser moves the wanted ZMP by the error of the capture point, within the soles that stand,
3. the stack of tasks computes the joints for the planned centre of mass and feet,
4. the torques of the wanted forces are fed forward to the joint impedance.

The plan lives on the ground of the footsteps. The estimate drifts against it with every step, in place and
yaw, and is moved onto it by where the standing feet are off their footprints.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin

from handover.runtime.control_cycle import runs_in_cycle
from handover_humanoid.balance.contact_forces import FeedForward, shares
from handover_humanoid.balance.estimation import StateEstimator
from handover_humanoid.components.robot import NOT_FINITE, JointCommand, RobotSensors
from handover_humanoid.engines.choice import DEFAULT_ENGINE, EngineName, MotionEngine, engine_maker
from handover_humanoid.engines.stack_engine import Step
from handover_humanoid.model.humanoid import Humanoid
from handover_humanoid.model.kinematics import Array, Kinematics
from handover_humanoid.patterns.footsteps import (
    Footsteps,
    Stance,
    StepLimits,
    Wish,
    swing_position,
)
from handover_humanoid.patterns.minimum_jerk import moved
from handover_humanoid.patterns.pendulum import Pendulum, PendulumState
from handover_humanoid.patterns.regions import SIDES, Footprint, Side, turn
from handover_humanoid.patterns.walking import Pattern, WalkingPattern
from handover_humanoid.patterns.zmp_control import PERIOD_S, ZmpControl
from handover_humanoid.solvers.problem import Solver
from handover_humanoid.tasks.base import Constraint, Level
from handover_humanoid.tasks.constraints import Contact, JointLimits
from handover_humanoid.tasks.tasks import CentreOfMassTask, OrientationTask, PoseTask, posture

ACCELERATION_SHARE, MAX_ACCELERATION = 0.6, 60.0
"""Of the newest difference of velocities in their moving mean; in rad/s² or m/s²."""
REST_MPS = 0.005
ZMP_MARGIN_M = 0.01
"""How far inside of the soles the ZMP is planned."""
FOOT_GAIN, MAX_OFFSET_M = 10.0, 0.02
"""How fast the target of a foot in the air makes up for what it missed, in 1/s, and by how much at most."""


@dataclass(frozen=True, slots=True)
class WalkingSettings:
    """The parameters of walking."""

    pose: str = "stand"
    control_s: float = 0.01
    capture_gain: float = 2.5
    """How far the ZMP moves for an error of the capture point; above 1 the error shrinks."""
    sole_margin_m: float = 0.02
    lift_m: float = 0.03
    contacts: dict[str, str] = field(default_factory=lambda: {"left": "left_sole", "right": "right_sole"})


@dataclass(frozen=True, slots=True)
class WalkingState:
    """What one control period found and wanted, on the ground of the footsteps."""

    stance: Stance
    reference: PendulumState
    com: Array
    com_velocity: Array
    wanted_zmp: Array
    measured_zmp: Array
    fault: str = ""


def footsteps_of(humanoid: Humanoid) -> Footsteps:
    """Return how a humanoid steps with the settings of `WalkingController`."""
    kinematics, settings = Kinematics(humanoid), WalkingSettings()
    kinematics.update(kinematics.standing(settings.pose))
    links = {side: humanoid.contacts[settings.contacts[side]].link for side in SIDES}
    left, right = (Footprint.below(side, kinematics.pose(links[side])) for side in SIDES)
    return Footsteps(_step_limits(left, right), PERIOD_S)


def _step_limits(left: Footprint, right: Footprint) -> StepLimits:
    width = float(np.linalg.norm(left.place - right.place))
    return StepLimits(width, 0.85 * width, 1.5 * width, 0.1)


class _Ground:
    """Where the ground of the plan is on that of the estimate: the same feet stand on both."""

    def __init__(self) -> None:
        self._planned, self._estimated, self.turned = np.zeros(2), np.zeros(2), np.eye(2)

    def set(self, planned: Array, estimated: Array, yaw: float) -> None:
        """Let a place (2,) of the estimate be one of the plan, which is turned by `yaw` in rad against it."""
        self._planned, self._estimated, self.turned = planned, estimated, turn(yaw)

    def of_estimate(self, place: Array) -> Array:
        """Return a place (2,) of the estimate on the ground of the plan."""
        return np.asarray(self.turned @ (place - self._estimated) + self._planned)

    def of_plan(self, place: Array) -> Array:
        """Return a place (2,) of the plan on the ground of the estimate."""
        return np.asarray(self.turned.T @ (place - self._planned) + self._estimated)


class WalkingController:
    """Walks with a commanded velocity. Not thread-safe; `step` performs no I/O."""

    def __init__(
        self,
        humanoid: Humanoid,
        solver: Solver | None = None,
        settings: WalkingSettings | None = None,
        limits: StepLimits | None = None,
        *,
        engine: EngineName = DEFAULT_ENGINE,
    ) -> None:
        self.humanoid = humanoid
        self.settings = settings or WalkingSettings()
        self._kinematics = Kinematics(humanoid)
        self.start = self._kinematics.standing(self.settings.pose)
        self._q = self.start.copy()
        self._kinematics.update(self._q)
        self.estimator = StateEstimator(Kinematics(humanoid), self.start)
        contacts = self.settings.contacts
        self._links: dict[Side, str] = {side: humanoid.contacts[contacts[side]].link for side in SIDES}
        self._sole = np.array(humanoid.contacts[contacts["left"]].corners)[:, :2]
        self._start_feet = {side: self._kinematics.pose(self._links[side]).copy() for side in SIDES}
        self._com_height = float(self._kinematics.centre_of_mass()[2])
        self._pendulum = Pendulum(self._com_height)
        stance = Stance(self._footprint("left"), self._footprint("right"))
        limits = limits or _step_limits(stance.left, stance.right)
        self._control = ZmpControl(self._pendulum, margin_m=ZMP_MARGIN_M)
        self._pattern = WalkingPattern(self._control, limits, self._sole, stance)
        self._limits = limits
        self._next = self._pattern.step(Wish(np.zeros(2)))
        first = self._next.plan.states[0]
        com = np.array([*first.com, self._com_height])
        self.state = WalkingState(stance, first, com, np.zeros(3), first.zmp, first.zmp)
        self._phase_s = 0.0
        self._feed_forward = FeedForward(self._kinematics)
        self._engine_of = engine_maker(engine, solver)
        self._tasks(humanoid)
        self.wish = Wish(np.zeros(2))
        self._ground = _Ground()
        self._capture_error = np.zeros(2)
        self._foot_offset, self._foot_wanted = np.zeros(3), np.zeros(3)

    @property
    def reference(self) -> Array:
        """Return the configuration that is commanded."""
        return self._q

    @property
    def reference_kinematics(self) -> Kinematics:
        """Return the kinematics of `reference`, updated by each `step` that had valid sensors; to be read."""
        return self._kinematics

    @property
    def is_at_rest(self) -> bool:
        """Return whether the robot stands on both feet, and its centre of mass hardly moves."""
        is_standing = self.state.stance.phase == "standing"
        return is_standing and float(np.linalg.norm(self.state.reference.velocity)) < REST_MPS

    @property
    def heading(self) -> float:
        """Return the mean yaw of the footprints in rad."""
        stance = self.state.stance
        return (stance.left.yaw + stance.right.yaw) / 2

    def next_landing(self, side: Side) -> Array:
        """Return place (2,) in m and yaw in rad of the next landing of a foot, on the ground of the estimate.

        A step begins at the foot that stands, so the landing turns with it where the estimate differs from
        the plan. NaN for a foot that stays, and while no foot stands.
        """
        pattern, estimator = self._next, self.estimator
        landing = pattern.landings.get(side)
        feet = {side_of_foot: estimator.feet[self.settings.contacts[side_of_foot]] for side_of_foot in SIDES}
        if landing is None or not any(foot.share for foot in feet.values()):
            return np.full(3, np.nan)
        mean = np.zeros(3)
        for side_of_foot, foot in feet.items():
            stands = self._planned_footprint(pattern.stance, side_of_foot)
            pose = estimator.kinematics.pose(foot.link)
            turned = Footprint.below(side_of_foot, pose).yaw - stands.yaw
            turned = float(np.arctan2(np.sin(turned), np.cos(turned)))
            place = pose.translation[:2] + turn(turned) @ (landing.place - stands.place)
            mean += foot.share * np.array([*place, landing.yaw + turned])
        return mean

    @property
    def fastest(self) -> Wish:
        """Return the highest speed ahead and turn that the steps allow; a higher wish is walked like it."""
        return Footsteps(self._limits, PERIOD_S).walked(Wish(np.array([math.inf, 0.0]), math.inf))

    @property
    def step_limits(self) -> StepLimits:
        """Return what the robot can step."""
        return self._limits

    def soles_frame(self, q: Array) -> tuple[Array, float]:
        """Return place (2,) and yaw of the frame between the soles in a configuration `q`."""
        self._kinematics.update(q)
        middle = self._sole.mean(axis=0)
        feet = [self._footprint_at(side) for side in SIDES]
        places = [foot.place + turn(foot.yaw) @ middle for foot in feet]
        return np.mean(places, axis=0), (feet[0].yaw + feet[1].yaw) / 2

    @property
    def level_names(self) -> tuple[tuple[str, ...], ...]:
        """Return the names of the levels of each stack, from the first level on."""
        stacks = (engine.stack for engine in self._engines.values())
        return tuple(tuple(level.name for level in stack.levels) for stack in stacks)

    @property
    def constraint_names(self) -> frozenset[str]:
        """Return the names of the constraints of all stacks."""
        return frozenset(
            constraint.name for engine in self._engines.values() for constraint in engine.stack.constraints
        )

    def draw_joints(self, joints: Array, target: Array) -> None:
        """Draw the joints (n,) of these numbers to `target` (n,) in the posture."""
        self._posture.target[joints] = target

    @runs_in_cycle
    def observe(self, sensors: RobotSensors) -> None:
        """Estimate the state while something else controls the standing robot."""
        if sensors.is_finite:
            self.estimator.update(sensors, self.settings.control_s)

    @runs_in_cycle
    def step(self, sensors: RobotSensors, command: JointCommand) -> WalkingState:
        """Compute the command of the next `control_s`.

        Sensors with values that are not finite change nothing: the last command holds, and `fault` says why.
        """
        if not sensors.is_finite:
            return replace(self.state, fault=NOT_FINITE)
        dt_s = self.settings.control_s
        self.estimator.update(sensors, dt_s)
        if self._phase_s >= PERIOD_S - dt_s / 2:
            self._next, self._phase_s = self._pattern.step(self.wish, self._capture_error), 0.0
        pattern = self._next
        self._phase_s += dt_s
        plan = pattern.plan
        reference = self._pendulum.advance(plan.states[0], plan.zmp_velocities[0], self._phase_s)
        com, velocity, measured_zmp = self._on_plan(pattern.stance)
        omega = self._pendulum.omega
        error = com[:2] + velocity[:2] / omega - self._pendulum.capture_point(reference)
        self._capture_error = error
        wanted = reference.zmp + self.settings.capture_gain * error
        feet = self._standing(pattern.stance)
        forces = shares(feet, self._sole, wanted, self.settings.sole_margin_m)
        wanted = sum((share * point for share, point in forces.values()), np.zeros(2))
        fault = self._move(pattern, reference, dt_s)
        self._send(command, omega**2 * (reference.zmp - wanted), feet)
        self.state = WalkingState(pattern.stance, reference, com, velocity, wanted, measured_zmp, fault)
        return self.state

    def _tasks(self, humanoid: Humanoid) -> None:
        self._com = CentreOfMassTask("com", self._kinematics.centre_of_mass(), gain=20.0)
        self._waist = OrientationTask("waist", humanoid.root)
        self._posture = posture(self._kinematics, self.settings.pose)
        limits = JointLimits(self._kinematics)
        self._swing = {
            side: PoseTask(f"{side} foot", self._links[side], self._start_feet[side], gain=20.0)
            for side in SIDES
        }
        self._contacts = {side: Contact(self._links[side], self._start_feet[side]) for side in SIDES}
        self._stands_on: dict[Side, Footprint] = {}
        self._engines: dict[tuple[Side, ...], MotionEngine] = {}
        supports: tuple[tuple[Side, ...], ...] = (SIDES, ("left",), ("right",))
        for standing in supports:
            top: Level = self._com
            for side in SIDES:
                if side not in standing:
                    top = top & self._swing[side]
            constraints: list[Constraint] = [self._contacts[side] for side in standing]
            stack = top / self._waist / self._posture << [*constraints, limits]
            self._engines[standing] = self._engine_of(self._kinematics, stack)
        self._velocity = np.zeros(self._kinematics.n_velocities)
        self._acceleration = np.zeros(self._kinematics.n_velocities)
        self.last_step = Step(self._q, self._velocity, {})

    @runs_in_cycle
    def _move(self, pattern: Pattern, reference: PendulumState, dt_s: float) -> str:
        """Advance the joint references; return what is wrong."""
        stance = pattern.stance
        self._com.target = np.array([*reference.com, self._com_height])
        self._com.velocity = np.array([*reference.velocity, 0.0])
        standing: list[Side] = []
        for side in SIDES:
            if stance.phase == "single" and side == stance.swing:
                self._swing_foot(stance, dt_s)
            else:
                standing.append(side)
                self._stand_on(stance.foot(side))
        step = self._engines[tuple(standing)].step(self._q, dt_s)
        change = (step.velocity - self._velocity) / dt_s
        np.minimum(change, MAX_ACCELERATION, out=change)
        np.maximum(change, -MAX_ACCELERATION, out=change)
        change -= self._acceleration
        change *= ACCELERATION_SHARE
        self._acceleration += change
        self._q, self._velocity, self.last_step = step.q, step.velocity, step
        return step.fault

    def _stand_on(self, foot: Footprint) -> None:
        """Let a foot stand on a footprint, which is the same for the many periods of a stance."""
        if self._stands_on.get(foot.side) is not foot:
            self._stands_on[foot.side] = foot
            self._contacts[foot.side].target = self._on_ground(foot, 0.0)

    def _swing_foot(self, stance: Stance, dt_s: float) -> None:
        start, landing = stance.foot(stance.swing), stance.landing or stance.foot(stance.swing)
        whole = self._limits.single * PERIOD_S
        now = whole - stance.remaining * PERIOD_S + self._phase_s
        places = [
            swing_position(start, landing, time_s / whole, self.settings.lift_m)
            for time_s in (now, now + dt_s)
        ]
        yaw = start.yaw + moved(min(max(now / whole, 0.0), 1.0)) * (landing.yaw - start.yaw)
        task = self._swing[stance.swing]
        foot = self.estimator.sole(self.settings.contacts[stance.swing])
        foot[:2] = self._ground.of_estimate(foot[:2])
        missed = self._foot_wanted - foot if now > 1.5 * dt_s else np.zeros(3)
        self._foot_wanted = places[0]
        kept = self._foot_offset if now > 1.5 * dt_s else np.zeros(3)
        offset = kept + FOOT_GAIN * dt_s * missed
        self._foot_offset = np.minimum(np.maximum(offset, -MAX_OFFSET_M, out=offset), MAX_OFFSET_M)
        place = places[0] + self._foot_offset
        task.target = self._on_ground(
            Footprint(stance.swing, float(place[0]), float(place[1]), yaw), float(place[2])
        )
        task.velocity = np.concatenate([(places[1] - places[0]) / dt_s, np.zeros(3)])

    @runs_in_cycle
    def _send(self, command: JointCommand, shift: Array, feet: dict[Side, Footprint]) -> None:
        self._kinematics.update(self._q)
        needed = self._feed_forward.needed(self._velocity, self._acceleration, np.array([*shift, 0.0]))
        forces = shares(feet, self._sole, needed.zmp, self.settings.sole_margin_m)
        links = {self._links[side]: force for side, force in forces.items()}
        self._feed_forward.write(command, self._q, self._velocity, needed, links)

    def _standing(self, stance: Stance) -> dict[Side, Footprint]:
        """Return the feet that stand by the plan."""
        return {
            side: stance.foot(side)
            for side in SIDES
            if not (stance.phase == "single" and side == stance.swing)
        }

    def _on_plan(self, stance: Stance) -> tuple[Array, Array, Array]:
        """Return the centre of mass, its velocity and the ZMP as measured, moved onto the footprints."""
        estimator, ground = self.estimator, self._ground
        planned_x = planned_y = x = y = yaw = stands = 0.0
        for side in SIDES:
            foot = estimator.feet[self.settings.contacts[side]]
            share = foot.share
            if share:
                footprint, pose = self._planned_footprint(stance, side), estimator.kinematics.pose(foot.link)
                at_x, at_y, _ = pose.translation.tolist()
                planned_x, planned_y = planned_x + share * footprint.x, planned_y + share * footprint.y
                x, y, stands = x + share * at_x, y + share * at_y, stands + share
                ahead = pose.rotation[:2, 0].tolist()
                turned = footprint.yaw - math.atan2(ahead[1], ahead[0])
                yaw += share * math.remainder(turned, 2 * math.pi)
        if stands:
            ground.set(np.array([planned_x, planned_y]), np.array([x, y]), yaw)
        com, velocity = estimator.com.copy(), estimator.com_velocity.copy()
        com[:2] = ground.of_estimate(com[:2])
        velocity[:2] = ground.turned @ velocity[:2]
        return com, velocity, ground.of_estimate(estimator.centre_of_pressure)

    def on_estimate(self, place: Array) -> Array:
        """Return a place (2,) of the plan, as `WalkingState` has them, on the ground of the estimate."""
        return self._ground.of_plan(place)

    def turned_to_estimate(self, vector: Array) -> Array:
        """Return a direction (2,) of the plan on the ground of the estimate."""
        return np.asarray(self._ground.turned.T @ vector)

    def _planned_footprint(self, stance: Stance, side: Side) -> Footprint:
        """Return where a foot stands by the plan; one in the air may touch the ground early."""
        is_swinging = stance.phase == "single" and side == stance.swing
        return stance.landing if is_swinging and stance.landing is not None else stance.foot(side)

    def _footprint(self, side: Side) -> Footprint:
        return Footprint.below(side, self._start_feet[side])

    def _footprint_at(self, side: Side) -> Footprint:
        return Footprint.below(side, self._kinematics.pose(self._links[side]))

    def _on_ground(self, foot: Footprint, height_m: float) -> pin.SE3:
        start = self._start_feet[foot.side]
        cosine, sine = math.cos(foot.yaw), math.sin(foot.yaw)
        turned = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        level = start.translation[2]
        return pin.SE3(turned, np.array([foot.x, foot.y, level + height_m]))
