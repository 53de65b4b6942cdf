"""What the humanoid does in the control cycle: walk by wishes, walk with a person by the hands, throw balls.

How it works:

1. One controller is active: that of walking, which stands as well, or that of throwing. Both know where the
   robot is only from its sensors.
2. The behaviour changes only while the robot is at rest on both feet. Throwing begins with the configuration
   that walking commands, in a frame of its own between the soles; walking continues with its own plan, since
   the feet do not move meanwhile.
3. Each behaviour wants joints of another stiffness; it changes within `GAINS_S`, so that nothing jumps.
   People may change the gains by chain, which is slower still (`cycle.gains`).
4. Where a ball should go has been planned elsewhere: a plan comes with the wish, and is checked again here.
5. It takes over gently: a robot that its drives held hangs in them, and full torques at once would make it
   lurch.
6. A stop ends the motion by standing on both feet: a step is finished, a throw followed through, and its ball
   stays in the hand.
7. A model whose legs are stretched in its pose `stand` stands and may throw, but does not walk.
8. Without valid values of some sensors a robot that walks finishes its step and stands, then it holds:
   joints that stopped within a step may let it fall. An inertial sensor is replaced by the leg that stands,
   whose sole does not turn, and a joint is taken to be where it was commanded.
9. Constraints that contradict each other are relaxed by the solver, by the least squares of their violations;
   the state has the largest slack of each for `RELAXED_S`.
"""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import pinocchio as pin

from handover.runtime.control_cycle import runs_in_cycle
from handover_humanoid.behaviours.assistance import AssistedWalking, Hands
from handover_humanoid.behaviours.component_state import (
    PHASES,
    REFUSED,
    SOLVER_BOUNDS_US,
    THROW_PHASES,
    Ball,
    BallPhase,
    Behaviour,
    Fault,
    constraint_names,
    residual_names,
    state_fields,
)
from handover_humanoid.behaviours.throwing import Phase, ThrowingController
from handover_humanoid.behaviours.walking import WalkingController
from handover_humanoid.components.robot import NOT_FINITE, JointCommand, RobotSensors, World
from handover_humanoid.cycle.gains import GainTransition
from handover_humanoid.cycle.wish import PERSON, PLANNED_JOINTS, Wanted
from handover_humanoid.engines.choice import DEFAULT_ENGINE, EngineName
from handover_humanoid.model.humanoid import Humanoid
from handover_humanoid.model.kinematics import (
    BASE_VELOCITIES,
    DOWNWARDS,
    Array,
    Kinematics,
    quaternion,
)
from handover_humanoid.model.standing import HANDS, stretched_legs
from handover_humanoid.patterns.footsteps import Wish
from handover_humanoid.patterns.intention import DEFAULT_INTENTION, IntentionName
from handover_humanoid.patterns.minimum_jerk import moved
from handover_humanoid.patterns.regions import SIDES, Side, turn
from handover_humanoid.patterns.throwing import PlannedThrow
from handover_humanoid.solvers.problem import Solver

GAINS_S: Final = 0.5
TAKE_OVER_S: Final = 0.5
"""The first commands begin with the positions and torques of the drives as they are."""
FALLEN_TILT_RAD: Final = 1.0
"""A robot whose root leans by more has fallen."""
MAX_THROW_S: Final = 2.0
RELAXED_S: Final = 2.0
FINISH_S: Final = 3.0
"""How long a step may be finished without valid values of some sensors."""
MIN_SLACK: Final = 1e-4
"""Of a constraint, in m/s or rad/s; less is the tolerance of a solver."""
LIMIT_SLACK_RAD: Final = 0.01


def behaviours_of(humanoid: Humanoid) -> tuple[Behaviour, ...]:
    """Return what a humanoid can do in simulation."""
    offered = [Behaviour.WALKING]
    if all(hand in humanoid.grips for hand in HANDS) and not stretched_legs(Kinematics(humanoid)):
        offered.append(Behaviour.ASSISTED_WALKING)
    if humanoid.grips:
        offered.append(Behaviour.JUGGLING)
    return tuple(offered)


class HumanoidComponent:
    """All behaviours of a humanoid as one component of the control cycle. Not thread-safe.

    Without a `world` it walks only: there is no ball, and nobody holds its hands.
    """

    def __init__(
        self,
        humanoid: Humanoid,
        solver: Solver | None = None,
        world: World | None = None,
        *,
        engine: EngineName = DEFAULT_ENGINE,
        intention: IntentionName = DEFAULT_INTENTION,
    ) -> None:
        self.humanoid = humanoid
        self.walking = WalkingController(humanoid, solver, engine=engine)
        self.control_s = self.walking.settings.control_s
        self.start = self.walking.start
        self.behaviour = Behaviour.WALKING
        self.is_down = False
        self._world = world
        self._is_stretched = bool(stretched_legs(Kinematics(humanoid)))
        can_throw = world is not None and bool(humanoid.grips)
        can_be_led = world is not None and all(hand in humanoid.grips for hand in HANDS)
        self._throwing = ThrowingController(humanoid, solver, engine=engine) if can_throw else None
        self.assistance = AssistedWalking(self.walking, self.control_s, intention) if can_be_led else None
        gains = JointCommand(humanoid)
        self._stiffness, self._damping = gains.stiffness, gains.damping
        self._firmness = np.ones(len(humanoid.joints))
        """Share of the gains of the model, by joint."""
        self._shares = GainTransition(humanoid)
        self._taken, self._at_first = 0.0, JointCommand(humanoid)
        self._wanted, self._is_commanded, self._person = Wanted(), False, np.zeros(len(PERSON))
        self._ball = Ball()
        self._throw_phase, self.fault = 0.0, Fault.NONE
        self._hands: Mapping[Side, Array] = {side: np.zeros(3) for side in SIDES}
        self._solver_counts = np.zeros(len(SOLVER_BOUNDS_US) + 1)
        self._residuals = residual_names(self.walking, self._throwing)
        self._blind_s = 0.0
        """Since when sensors are not valid."""
        self._of_legs = Kinematics(humanoid)
        self._slack = dict.fromkeys(constraint_names(self.walking, self._throwing), 0.0)
        self._relaxed_s = 0.0
        self.fields: Sequence[str] = state_fields(humanoid, self._residuals, tuple(self._slack))

    def hand_force(self, side: Side) -> Array:
        """Return the force (3,) in N of a person at a hand, in the frame between the soles."""
        return self._hands[side]

    @property
    def behaviours(self) -> tuple[Behaviour, ...]:
        """Return what this robot can do; walking without a velocity is standing, which each can."""
        offered = [Behaviour.WALKING]
        if self.assistance is not None and not self._is_stretched:
            offered.append(Behaviour.ASSISTED_WALKING)
        if self._throwing is not None:
            offered.append(Behaviour.JUGGLING)
        return tuple(offered)

    @runs_in_cycle
    def follow(self, wish: Array | None, person: Array | None) -> None:
        """Accept the newest wish, and what a person does; None is one that is too old, or none."""
        self._is_commanded = wish is not None
        if wish is not None:
            self._wanted = Wanted.of(wish)
        self._person = np.zeros(len(PERSON)) if person is None else person

    @runs_in_cycle
    def tune(self, gains: Array | None) -> None:
        """Accept the shares of the gains that people want; None changes nothing."""
        self._shares.want(gains)

    @runs_in_cycle
    def step(self, sensors: RobotSensors, command: JointCommand) -> str:
        """Compute the next command; return what is wrong, or nothing."""
        is_blind = self._bridge(sensors, command)
        self._switch()
        self._feel()
        if self.behaviour is Behaviour.JUGGLING:
            fault = self._throw(sensors, command)
        else:
            fault = self._walk(sensors, command, is_to_stand=is_blind)
        self._soften(command)
        if self._taken < 1.0:
            self._take_over(sensors, command)
        if self._world is not None:
            estimator = self.walking.estimator
            self._ball.follow(self._world.ball_from_root, estimator.rotation, estimator.q[:3])
        self._count()
        self._note_slack()
        self._judge(NOT_FINITE if is_blind else fault)
        return fault

    @runs_in_cycle
    def write_state(self, state: Array) -> None:
        """Write the values of `fields`. Places are in m, and velocities in m/s, on the ground of the
        estimate."""
        walking, ball, estimator = self.walking, self._ball, self.walking.estimator
        now = walking.state
        phase = 0 if self.behaviour is Behaviour.JUGGLING else PHASES.index(now.stance.phase)
        feet = estimator.feet_frame()
        of_feet = [estimator.feet[walking.settings.contacts[side]] for side in SIDES]
        intention = self.assistance.velocity if self.assistance else np.zeros(2)
        com, reference = estimator.com[:2], walking.on_estimate(now.reference.com)
        if self.behaviour is Behaviour.JUGGLING and self._throwing is not None:
            reference = feet[:2] + turn(feet[2]) @ self._throwing.com_reference
        values = [
            self.behaviour,
            phase,
            *(foot.share for foot in of_feet),
            *com,
            *reference,
            *walking.on_estimate(now.wanted_zmp),
            *estimator.centre_of_pressure,
            *walking.turned_to_estimate(intention),
            *feet,
        ]
        for foot in of_feet:
            values += [*estimator.force_of(foot), *estimator.pressure_of(foot)]
        for side in SIDES:
            values += [
                *self._hands[side],
                self.assistance.manipulability(side) if self.assistance else np.nan,
            ]
        target = self._on_ground(ball.target, feet) if ball.phase is not BallPhase.NONE else ball.target
        values += [*ball.place, ball.phase, *target, *ball.landed, *ball.predicted]
        values += [ball.number, self._throw_phase, self.fault]
        is_juggling = self.behaviour is Behaviour.JUGGLING
        for side in SIDES:
            values += [np.nan] * 3 if is_juggling else walking.next_landing(side).tolist()
        values += self._shares.values.tolist()
        values += self._solver_counts.tolist()
        residuals = self._active.last_step.residuals
        level_of = {name: index for index, name in enumerate(residuals)}
        values += [
            residuals[name] if level_of.get(name) == index else np.nan for index, name in self._residuals
        ]
        values += self._slack.values()
        state[: len(values)] = values
        state[len(values) :] = estimator.q

    @property
    def _active(self) -> WalkingController | ThrowingController:
        if self.behaviour is Behaviour.JUGGLING and self._throwing is not None:
            return self._throwing
        return self.walking

    @property
    def _is_offered(self) -> bool:
        """Whether this robot has the wanted behaviour; it stands while another one is wanted."""
        return self._wanted.behaviour in self.behaviours

    @runs_in_cycle
    def _switch(self) -> None:
        """Change the behaviour, when the robot is at rest on both feet."""
        wanted = self._wanted.behaviour
        if not self._is_commanded or wanted == self.behaviour or not self._is_offered:
            return
        if self.behaviour is Behaviour.JUGGLING:
            if self._throwing is not None and self._throwing.is_busy:
                return
        elif not self.walking.is_at_rest:
            return
        if wanted == Behaviour.JUGGLING and self._throwing is not None:
            self._throwing.stand_at(self._between_soles(self.walking.reference))
            self._throwing.estimator.take_tilt(self.walking.estimator)
            self._ball, self._throw_phase = Ball(number=self._wanted.throw_number), 0.0
        elif self.behaviour is Behaviour.JUGGLING:
            self._throw_phase = 0.0
        if self.assistance is not None:
            self.assistance.begin(is_wanted=wanted == Behaviour.ASSISTED_WALKING)
        self.behaviour = Behaviour(wanted)

    def _between_soles(self, q: Array) -> Array:
        """Return a configuration (base and joints) in the frame between its soles."""
        place, yaw = self.walking.soles_frame(q)
        moved = q.copy()
        moved[:2] = turn(-yaw) @ (q[:2] - place)
        turned = pin.Quaternion(quaternion(pin.exp3(np.array([0.0, 0.0, -yaw])))) * pin.Quaternion(q[3:7])
        moved[3:7] = turned.coeffs()
        return moved

    @runs_in_cycle
    def _feel(self) -> None:
        """Let the person pull at the hands of the simulated robot."""
        if self._world is None or self.assistance is None:
            return
        if self.behaviour is Behaviour.ASSISTED_WALKING:
            self._hands = self.assistance.feel(Hands.of(self._person))
        else:
            self._hands = {side: np.zeros(3) for side in SIDES}
        feet, rotation = self.walking.estimator.feet_frame(), self.walking.estimator.rotation
        to_ground = turn(feet[2])
        for side in SIDES:
            force = self._hands[side]
            ground = np.array([*(to_ground @ force[:2]), force[2]])
            self._world.pull(self.assistance.link(side), rotation.T @ ground)

    @runs_in_cycle
    def _bridge(self, sensors: RobotSensors, command: JointCommand) -> bool:
        """Replace values that are not valid while a step is to be finished; return whether it is."""
        if sensors.is_finite:
            self._blind_s = 0.0
            return False
        is_walking = self.behaviour is not Behaviour.JUGGLING and not self.walking.is_at_rest
        if not is_walking or self._blind_s >= FINISH_S or not np.isfinite(sensors.wrenches).all():
            return False
        self._blind_s += self.control_s
        is_lost = ~(np.isfinite(sensors.positions) & np.isfinite(sensors.velocities))
        sensors.positions[is_lost] = self.walking.reference[7:][is_lost]
        sensors.velocities[is_lost] = command.velocities[is_lost]
        if not (np.isfinite(sensors.gyroscope).all() and np.isfinite(sensors.accelerometer).all()):
            self._measure_turn_by_leg(sensors)
        return True

    def _measure_turn_by_leg(self, sensors: RobotSensors) -> None:
        """Write what an inertial sensor would measure while the sole that carries most does not turn."""
        kinematics, estimator, contacts = (
            self._of_legs,
            self.walking.estimator,
            self.walking.settings.contacts,
        )
        still = np.zeros(BASE_VELOCITIES)
        kinematics.update(kinematics.neutral(sensors.positions), np.concatenate([still, sensors.velocities]))
        foot = max(
            (estimator.feet[contacts[side]] for side in SIDES), key=lambda foot_estimate: foot_estimate.share
        )
        to_sensor = kinematics.pose(self.humanoid.sensors.inertial[0]).rotation.T
        sensors.gyroscope[:] = to_sensor @ -kinematics.velocity(foot.link)[3:]
        sensors.accelerometer[:] = to_sensor @ (estimator.rotation.T @ -DOWNWARDS)

    @runs_in_cycle
    def _walk(self, sensors: RobotSensors, command: JointCommand, *, is_to_stand: bool = False) -> str:
        wanted, walking = self._wanted, self.walking
        share = wanted.speed_share if self._is_commanded and not wanted.stop else 0.0
        if wanted.behaviour != self.behaviour:
            share = 0.0  # it changes at rest, also while a person still pulls; or it is not offered
        if self._is_stretched or is_to_stand:
            share = 0.0
        ground, yaw_rate = np.zeros(2), 0.0
        if self.behaviour is Behaviour.ASSISTED_WALKING and self.assistance is not None:
            ground, yaw_rate = self.assistance.wish(share)
        elif share > 0:
            heading = walking.heading
            ground = share * (turn(heading) @ np.array([wanted.ahead_mps, wanted.left_mps]))
            yaw_rate = share * wanted.yaw_radps
        walking.wish = Wish(ground, yaw_rate)
        state = walking.step(sensors, command)
        if self.behaviour is Behaviour.ASSISTED_WALKING and self.assistance is not None and not state.fault:
            self.assistance.observe(sensors)
            self.assistance.carry(command.torques)
        return state.fault

    @runs_in_cycle
    def _throw(self, sensors: RobotSensors, command: JointCommand) -> str:
        throwing, wanted, ball = self._throwing, self._wanted, self._ball
        if throwing is None or self._world is None:  # `_switch` has looked
            return ""
        self.walking.observe(sensors)
        if throwing.is_busy and (wanted.cancel or not self._is_commanded):
            throwing.cancel()
        is_new = self._is_commanded and wanted.throw_number > ball.number and not wanted.stop
        if is_new and not throwing.is_busy:
            self._begin_throw()
        state = throwing.step(sensors, command)
        if state.opens:
            self._world.release()
            ball.phase, ball.predicted = BallPhase.FLYING, state.predicted
        if self._throw_phase != REFUSED or state.phase is not Phase.STANDING:
            self._throw_phase = float(THROW_PHASES.index(state.phase))
        return state.fault

    @runs_in_cycle
    def _begin_throw(self) -> None:
        """Put the ball into the hand and begin, if the plan can be carried out."""
        wanted, throwing, world = self._wanted, self._throwing, self._world
        self._ball = Ball(number=wanted.throw_number, height_m=wanted.target[2])
        self._ball.target = wanted.target.copy()
        throw = self._planned()
        if throw is None or throwing is None or world is None:
            self._throw_phase, self.fault = REFUSED, Fault.THROW_REFUSED
            return
        world.hold(throw.grip)
        throwing.throw(throw)
        self._ball.phase = BallPhase.HELD

    def _planned(self) -> PlannedThrow | None:
        """Return the throw of the wish, None if it is none that the arm can do."""
        wanted = self._wanted
        grip = self.humanoid.grips.get(f"{wanted.side}_hand")
        if grip is None:
            return None
        arm = np.array(self.humanoid.indices(grip.arm))
        if len(arm) > PLANNED_JOINTS:
            return None
        nothing = np.full(3, np.nan)
        release, velocity = wanted.release[: len(arm)], wanted.velocity[: len(arm)]
        throw = PlannedThrow(
            grip,
            wanted.target,
            wanted.flight_s,
            release,
            velocity,
            nothing,
            nothing,
            0.0,
            wanted.swing_s,
            wanted.follow_s,
        )
        joints = [self.humanoid.joints[index] for index in arm]
        lower = np.array([joint.lower for joint in joints]) - LIMIT_SLACK_RAD
        upper = np.array([joint.upper for joint in joints]) + LIMIT_SLACK_RAD
        fastest = np.array([joint.max_velocity for joint in joints])
        is_timed = 0 < wanted.swing_s <= MAX_THROW_S and 0 < wanted.follow_s <= MAX_THROW_S
        is_within = all(
            bool((joints_at >= lower).all() and (joints_at <= upper).all())
            for joints_at in (throw.start, release, throw.end)
        )
        return throw if is_timed and is_within and bool((np.abs(velocity) <= fastest).all()) else None

    @runs_in_cycle
    def _soften(self, command: JointCommand) -> None:
        """Move the gains of the joints towards those of the behaviour."""
        wanted: float | Array = 1.0
        if self.behaviour is Behaviour.JUGGLING and self._throwing is not None:
            wanted = self._throwing.settings.stiffer
        elif self.behaviour is Behaviour.ASSISTED_WALKING and self.assistance is not None:
            wanted = self.assistance.firmness
        most = self.control_s / GAINS_S * 3.0
        self._firmness += np.clip(wanted - self._firmness, -most, most)
        self._shares.step(self.control_s)
        command.stiffness[:] = self._stiffness * self._firmness * self._shares.stiffness
        command.damping[:] = self._damping * np.sqrt(self._firmness) * self._shares.damping
        command.is_led = self.behaviour is Behaviour.ASSISTED_WALKING

    @runs_in_cycle
    def _take_over(self, sensors: RobotSensors, command: JointCommand) -> None:
        """Lead the drives from what they do to the command."""
        first = self._at_first
        if not sensors.is_finite:
            return
        if self._taken == 0.0:
            first.positions[:] = sensors.positions
            first.torques[:] = np.nan_to_num(sensors.torques)
        self._taken = min(self._taken + self.control_s / TAKE_OVER_S, 1.0)
        left = 1.0 - moved(self._taken)
        command.positions += left * (first.positions - command.positions)
        command.torques += left * (first.torques - command.torques)

    def _on_ground(self, place: Array, feet: Array) -> Array:
        """Return a place (3,) of the frame of the feet on the ground of the estimate."""
        return np.array([*(feet[:2] + turn(feet[2]) @ place[:2]), place[2]])

    def _count(self) -> None:
        microseconds = self._active.last_step.solve_s * 1e6
        self._solver_counts[int(np.searchsorted(SOLVER_BOUNDS_US, microseconds))] += 1

    @runs_in_cycle
    def _note_slack(self) -> None:
        """Note which constraints this period relaxed; forget it when none has been for `RELAXED_S`."""
        if self._relaxed_s > 0:
            self._relaxed_s -= self.control_s
            if self._relaxed_s <= 0:
                self._slack.update(dict.fromkeys(self._slack, 0.0))
        for name, _, text in (relaxed.rpartition(" by ") for relaxed in self._active.last_step.relaxed):
            slack = float(text)
            if slack >= MIN_SLACK:
                self._slack[name], self._relaxed_s = max(self._slack[name], slack), RELAXED_S

    @property
    def _is_to_walk(self) -> bool:
        wanted = self._wanted
        if not self._is_commanded or wanted.stop or wanted.speed_share <= 0:
            return False
        is_led = wanted.behaviour == Behaviour.ASSISTED_WALKING
        velocity = (wanted.ahead_mps, wanted.left_mps, wanted.yaw_radps)
        return is_led or (wanted.behaviour == Behaviour.WALKING and any(velocity))

    @runs_in_cycle
    def _judge(self, fault: str) -> None:
        """Say what is wrong, and notice a fall."""
        self.is_down = bool(self.walking.estimator.rotation[2, 2] < np.cos(FALLEN_TILT_RAD))
        if self.is_down:
            self.fault = Fault.FALLEN
        elif fault:
            self.fault = Fault.SENSORS if fault == NOT_FINITE else Fault.SOLVER
        elif self.assistance is not None and self.assistance.is_pulled_hard:
            self.fault = Fault.PULLED_HARD
        elif self._is_stretched and self._is_to_walk:
            self.fault = Fault.STRETCHED
        elif self._is_commanded and not self._is_offered:
            self.fault = Fault.NOT_OFFERED
        elif self._relaxed_s > 0:
            self.fault = Fault.RELAXED
        elif self._throw_phase != REFUSED:
            self.fault = Fault.NONE
