"""Walking led by the hands of a person: where they are pulled to is where the robot goes.

The arms are drawn to a pose from which they lose mobility when a hand is pulled away or pushed back, and are
compliant. The direction comes from their manipulability (`patterns.intention`, CoSiMA, equation 3), or from
the lead of the hands (`patterns.lead`), which also notices a soft pull and one to the side; `IntentionName`
chooses. Added to both: hands that are moved apart, one ahead and one back, turn the robot. A person who pulls
with more than `MAX_PULL_N` may be falling, and would topple the robot: its hand opens and the robot stands
still, until the person has let go of it as well.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from handover.runtime.control_cycle import runs_in_cycle
from handover_humanoid.balance.external_torques import SMOOTHING_S, ExternalTorques
from handover_humanoid.behaviours.walking import WalkingController
from handover_humanoid.components.robot import RobotSensors
from handover_humanoid.cycle.wish import PERSON
from handover_humanoid.model.humanoid import Grip
from handover_humanoid.model.kinematics import BASE_POSITIONS, BASE_VELOCITIES, Array, Kinematics
from handover_humanoid.patterns.intention import (
    DEFAULT_INTENTION,
    ArmState,
    IntentionLimits,
    IntentionName,
    IntentionReader,
    IntentionReference,
    arm_state,
    hand_place,
    manipulability,
)
from handover_humanoid.patterns.lead import HoldStiffness, LeadReference, hand_force
from handover_humanoid.patterns.minimum_jerk import moved
from handover_humanoid.patterns.regions import SIDES, Side, turn

POSE: Final = "hold_hands"
TAKE_S: Final = 1.5
"""How long the arms take to their pose, and back."""
SHOULDER_FIRMNESS, ARM_FIRMNESS, SHOULDER_JOINTS = 0.05, 0.017, 3
"""The stiffness of the arms as shares of the gains of the model; the first joints of an arm are its shoulder.

So the elbow gives way before the shoulder, and a pull ahead stretches the arm.
"""
UNDAMPED_SHARE: Final = 0.7
"""Of the damping of the joints of the arms, what is compensated."""
THRESHOLD_SHARE: Final = 0.93
"""The threshold of manipulability as a share of that of the pose."""
STIFFNESS_NPM, DAMPING_NSPM = 40.0, 8.0
"""Of the hold of a hand that has a place: the arm of the person."""
ARM_DAMPING_S: Final = DAMPING_NSPM / STIFFNESS_NPM
"""Of the arms of a person; their stiffness differs more than this time."""
BRAKE_S: Final = 0.3
"""The lead is less by the way that the robot goes in this time, so that it slows down before it is there."""
MAX_PULL_N: Final = 15.0
"""At one hand. 30 N of both move the zero moment point by 8 cm, to the toes."""
MAX_SIDEWAYS_N: Final = 14.0
"""Of both hands; 14 N move it by 4 cm, to the edge of the sole that stands."""
PULL_S: Final = 0.1
"""Forces are smoothed over this time before they are compared with the limits above: a short pull moves the
robot little, and a person who changes direction makes one."""
JERK_SHARE: Final = 1.5
"""Beyond this share of the limits a force counts at once."""
STAND_S: Final = 0.4
ROOT_S: Final = 3.0
"""Above the time of two steps, in which the root sways. That of COMAN is 1.5 cm farther back than at rest."""
YAW_DEADBAND_M, YAW_GAIN, MAX_YAW_RADPS = 0.04, 1.5, 0.2
EVERY_S: Final = 0.02


@dataclass(frozen=True, slots=True)
class Hands:
    """What the hands of a person do, by the hand of the robot: each (7,) as the port has it."""

    values: Mapping[Side, Array]

    @classmethod
    def of(cls, person: Array) -> "Hands":
        """Return them from the values of `PERSON`."""
        count = len(PERSON) // 2
        return cls({side: person[index * count : (index + 1) * count] for index, side in enumerate(SIDES)})


class AssistedWalking:
    """Reads the hands. Not thread-safe; uses the estimate of the walking controller."""

    def __init__(
        self, walking: WalkingController, control_s: float, intention: IntentionName = DEFAULT_INTENTION
    ) -> None:
        humanoid = walking.humanoid
        self._walking, self._control_s = walking, control_s
        self._grips: dict[Side, Grip] = {
            side: humanoid.grips[f"{side}_hand"] for side in SIDES if f"{side}_hand" in humanoid.grips
        }
        pose = np.array(humanoid.pose(POSE if POSE in humanoid.poses else walking.settings.pose))
        kinematics = Kinematics(humanoid)
        rest = kinematics.standing(walking.settings.pose)
        self._joints = {side: np.array(humanoid.indices(grip.arm)) for side, grip in self._grips.items()}
        self._arms = np.concatenate([*self._joints.values()])
        self._home, self._pose = rest[BASE_POSITIONS + self._arms].copy(), pose[self._arms]
        rest[BASE_POSITIONS + self._arms] = self._pose
        kinematics.update(rest)
        self._rest = {side: hand_place(kinematics, grip.link) for side, grip in self._grips.items()}
        self._root = (rest[:3] - kinematics.centre_of_mass())[:2]
        """Where the root is (2,) in the frame between the soles, apart from its swaying: measured at rest
        whenever nobody holds a hand, and followed slowly while it walks."""
        volumes = [
            manipulability(arm_state(kinematics, *_names(grip), self._rest[side]))
            for side, grip in self._grips.items()
        ]
        self.threshold = THRESHOLD_SHARE * min(volumes, default=1.0)
        """v_d in m³/rad³."""
        makers: Mapping[IntentionName, Callable[[], IntentionReader]] = {
            "lead": LeadReference,
            "manipulability": lambda: IntentionReference(IntentionLimits(self.threshold)),
        }
        self._reference = makers[intention]()
        self.firmness = np.ones(len(humanoid.joints))
        self.firmness[self._arms] = ARM_FIRMNESS
        for joints in self._joints.values():
            self.firmness[joints[:SHOULDER_JOINTS]] = SHOULDER_FIRMNESS
        self._joint_damping = kinematics.joint_damping()
        hands = [grip.link for grip in self._grips.values()]
        self._external = ExternalTorques(walking.estimator, control_s, hands)
        self._stand = np.zeros(3)
        self.velocity = np.zeros(2)
        """The reference (2,) of the centre of mass in m/s on the ground of the plan."""
        self._open: set[Side] = set()
        """The hands that have opened, until the person lets go."""
        self._yaw_rate, self._is_wanted, self._taken, self._since_s = 0.0, False, 0.0, 0.0
        self._held: tuple[Side, ...] = ()
        self._pull = {side: np.zeros(3) for side in SIDES}
        """The smoothed force (3,) of each hand of the person."""
        self._places: dict[Side, Array] = {}
        """Where the held hands are (3,) from their rest pose, smoothed."""
        self._hold_stiffness = HoldStiffness()
        self._volumes: Mapping[str, float] = {}

    def begin(self, *, is_wanted: bool) -> None:
        """Draw the arms to their pose, or back."""
        self._is_wanted = is_wanted
        self._open.clear()

    @property
    def is_pulled_hard(self) -> bool:
        """Return whether a hand has opened, since it was pulled too hard."""
        return bool(self._open)

    def link(self, side: Side) -> str:
        """Return the link that a person holds."""
        return self._grips[side].link

    def rest(self, side: Side) -> Array:
        """Return where a hand is that nobody pulls (3,) from the root, in the heading frame, in m."""
        return self._rest[side]

    def manipulability(self, side: Side) -> float:
        """Return that of an arm in m³/rad³, NaN while nobody holds it."""
        return self._volumes.get(side, np.nan)

    @runs_in_cycle
    def feel(self, hands: Hands) -> dict[Side, Array]:
        """Return the forces (3,) in N at the hands, in the frame between the soles."""
        forces: dict[Side, Array] = {side: np.zeros(3) for side in SIDES}
        feet = self._walking.estimator.feet_frame()
        for side in self._grips:
            values = hands.values[side]
            if values[0] == 0 or not np.isfinite(values).all():
                self._open.discard(side)
            elif side not in self._open:
                forces[side] = values[4:7].copy() if values[0] == 2 else self._hold(side, values[1:4], feet)
            self._pull[side] += self._control_s / PULL_S * (forces[side] - self._pull[side])
        sideways = max(_sideways(self._pull), _sideways(forces) / JERK_SHARE)
        for side, force in forces.items():
            if not force.any():
                continue
            pull = max(_length(self._pull[side]), _length(force) / JERK_SHARE)
            if pull > MAX_PULL_N or sideways > MAX_SIDEWAYS_N:
                self._open.add(side)
                forces[side] = np.zeros(3)
        self._held = tuple(side for side, force in forces.items() if force.any())
        return forces

    @runs_in_cycle
    def carry(self, torques: Array) -> None:
        """Let the arms follow a hand: add to the torques (joints,) of the last step of walking.

        The weight of the arms is carried where they are, not where the reference has them, and most of the
        damping of their joints is taken away; otherwise they would follow within seconds only.
        """
        estimator, arms, plan = self._walking.estimator, self._arms, self._walking.reference_kinematics
        for side, grip in self._grips.items():
            self._rest[side] = hand_place(plan, grip.link)
        weight = estimator.kinematics.gravity_torques()[arms] - plan.gravity_torques()[arms]
        moving = UNDAMPED_SHARE * self._joint_damping[arms] * estimator.v[BASE_VELOCITIES + arms]
        torques[arms] += self._taken * (weight + moving)

    @runs_in_cycle
    def observe(self, sensors: RobotSensors) -> None:
        """Follow the forces at the arms, and where the robot is apart from its swaying.

        Call it each period with the sensors that the estimator has used. The place between the soles moves
        with each step and rests between. Smoothed over `STAND_S`, and moved with the wanted velocity
        meanwhile, it is where a robot would be that rolls.
        """
        estimator = self._walking.estimator
        feet = estimator.feet_frame()
        for side in SIDES:
            if side not in self._held:
                self._places.pop(side, None)
        if not self._held:
            self._external.restart()
            self._hold_stiffness.restart()
            self._stand = feet
            if self._taken >= 1.0 and self._walking.is_at_rest:
                self._root = turn(-feet[2]) @ (estimator.q[:2] - feet[:2])
            return
        self._external.update(sensors)
        share = self._control_s / STAND_S
        velocity = self._walking.turned_to_estimate(self.velocity)
        self._stand[:2] += self._control_s * velocity + share * (feet[:2] - self._stand[:2])
        self._stand[2] = feet[2]
        root = turn(-feet[2]) @ (estimator.q[:2] - self._stand[:2])
        root_s = STAND_S if self._walking.state.stance.phase == "standing" else ROOT_S
        self._root += self._control_s / root_s * (root - self._root)

    @runs_in_cycle
    def wish(self, share: float) -> tuple[Array, float]:
        """Return the velocity (2,) in m/s on the ground and the yaw rate after one control period."""
        self._take()
        self._since_s += self._control_s
        if self._since_s >= EVERY_S - self._control_s / 2:
            self._update(share, self._since_s)
            self._since_s = 0.0
        return self.velocity, self._yaw_rate

    def _update(self, share: float, dt_s: float) -> None:
        may_walk = self._is_wanted and self._taken >= 1.0 and not self.is_pulled_hard
        arms = self._arms_led(dt_s) if may_walk else {}
        intention = self._reference.update(arms, dt_s, share * self._reference.max_mps)
        self._volumes = intention.manipulability
        self.velocity = turn(self._walking.heading) @ intention.velocity
        self._yaw_rate = 0.0
        if len(arms) == len(SIDES) and not intention.fault:
            apart = self._apart(arms["right"]) - self._apart(arms["left"])
            beyond = np.sign(apart) * max(abs(apart) - YAW_DEADBAND_M, 0.0)
            self._yaw_rate = share * float(np.clip(YAW_GAIN * beyond, -MAX_YAW_RADPS, MAX_YAW_RADPS))

    def _arms_led(self, dt_s: float) -> dict[str, ArmState]:
        """Return the state of each arm that is held, with its lead."""
        if not self._held:
            return {}
        back, velocity = turn(-self._stand[2]), self._walking.turned_to_estimate(self.velocity)
        felt = [self._arm(side, back, velocity) for side in self._held]
        places = [
            self._smoothed(side, place, dt_s) for side, (_, place, _) in zip(self._held, felt, strict=True)
        ]
        stiffness = self._hold_stiffness.update(
            np.mean(places, axis=0)[:2], np.mean([force[:2] for _, _, force in felt], axis=0), dt_s
        )
        return {
            side: replace(state, lead=place + force / stiffness)
            for side, place, (state, _, force) in zip(self._held, places, felt, strict=True)
        }

    def _smoothed(self, side: Side, place: Array, dt_s: float) -> Array:
        """Return the place (3,) of a hand as of when its force is, which is smoothed."""
        before = self._places.get(side, place)
        self._places[side] = before + (1.0 - math.exp(-dt_s / SMOOTHING_S)) * (place - before)
        return self._places[side]

    def _arm(self, side: Side, back: Array, velocity: Array) -> tuple[ArmState, Array, Array]:
        """Return the state of an arm, the place of its hand (3,) from its rest pose, and the force (3,) at
        it.

        The place is measured from where the robot is apart from its swaying, ahead by what the damping of the
        person's arm makes of its velocity against the wanted one (2,), and back by `BRAKE_S`. `back` (2, 2)
        turns the ground of the estimate to the heading of the robot.
        """
        estimator, grip = self._walking.estimator, self._grips[side]
        state = arm_state(estimator.kinematics, *_names(grip), self._rest[side])
        force = self._force(side)
        force[:2] = back @ force[:2]
        hand = np.array(estimator.kinematics.pose(grip.link).translation)
        hand[:2] = back @ (hand[:2] - self._stand[:2]) - self._root
        hand[2] -= estimator.q[2]
        hand[:2] += ARM_DAMPING_S * (back @ (estimator.velocity_of(grip.link)[:2] - velocity))
        hand[:2] -= BRAKE_S * (back @ velocity)
        return state, hand - self._rest[side], force

    def _force(self, side: Side) -> Array:
        """Return the force (3,) at a hand on the ground: by its sensor, or else by the torques of its arm."""
        sensed = self._external.forces.get(self._grips[side].link)
        if sensed is not None:
            return sensed.copy()
        joints = self._joints[side]
        jacobian = self._walking.estimator.kinematics.jacobian(self._grips[side].link)
        return hand_force(jacobian[:3, BASE_VELOCITIES + joints], self._external.torques[joints])

    def _apart(self, arm: ArmState) -> float:
        """Return how far a hand is ahead, by the lead if this is what is read."""
        return float((arm.lead if isinstance(self._reference, LeadReference) else arm.displacement)[0])

    def _take(self) -> None:
        """Draw the arms by a control period towards their pose, or back home."""
        way = self._control_s / TAKE_S
        self._taken = min(max(self._taken + (way if self._is_wanted else -way), 0.0), 1.0)
        share = moved(self._taken)
        self._walking.draw_joints(self._arms, self._home + share * (self._pose - self._home))

    def _hold(self, side: Side, place: Array, feet: Array) -> Array:
        """Return the force of a hand at `place` in the frame `feet` between the soles, which holds the hand
        of the robot softly."""
        estimator = self._walking.estimator
        back = turn(-feet[2])
        link = self._grips[side].link
        hand = np.array(estimator.kinematics.pose(link).translation)
        hand[:2] = back @ (hand[:2] - feet[:2])
        speed = estimator.kinematics.velocity(link)[:3]
        speed = np.array([*(back @ speed[:2]), speed[2]])
        return np.asarray(STIFFNESS_NPM * (place - hand) - DAMPING_NSPM * speed)


def _names(grip: Grip) -> tuple[str, str]:
    return grip.arm, grip.link


def _length(force: Array) -> float:
    return math.sqrt(force.dot(force))


def _sideways(forces: Mapping[Side, Array]) -> float:
    """Return how strong forces are to one side together."""
    return abs(sum(float(force[1]) for force in forces.values()))
