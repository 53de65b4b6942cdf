"""What people send while they exercise or steer: poses of the patient, pulls, and wishes of the therapist.

Vectors are in m in the frame of the ground, in which the live document has the base of the robot: z is up.
"""

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Final, Literal

from pydantic import Field, FiniteFloat, TypeAdapter

from handover_datamodels.robot_messages import Vector
from handover_datamodels.streams import StreamMessage
from handover_humanoid.patterns.footsteps import OTHER
from handover_humanoid.patterns.regions import SIDES, Side
from handover_humanoid.running.live_pace import Poses
from handover_humanoid.sessions.plausible import HEAD, Plausibility, Problem

SILENT_S: Final = 0.5
"""After so long without a pose the session pauses."""
HELD_S: Final = 0.3
"""After so long without a message the hands of the person have let go."""
CLOSED_GRIP: Final = 0.5

Rotation = tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]


class Headset(StreamMessage):
    """Where the headset is; the rotation is a quaternion (x, y, z, w)."""

    position: Vector
    rotation: Rotation = (0.0, 0.0, 0.0, 1.0)


class HandPose(Headset):
    """A tracked hand, and how far it is closed, from 0 to 1."""

    grip: Annotated[FiniteFloat, Field(ge=0, le=1)] = 0.0


class HandPoses(StreamMessage):
    """The hands that are tracked."""

    left: HandPose | None = None
    right: HandPose | None = None


class PoseMessage(StreamMessage):
    """Poses of the patient at the time `t` of the sender, in s; the echo has the same `t`."""

    kind: Literal["pose"]
    t: FiniteFloat
    headset: Headset | None = None
    hands: HandPoses = HandPoses()
    tracking: Literal["ok", "lost"] = "ok"
    in_bounds: bool = True
    recentred: bool = False
    """Whether the person has recentred the view, which moves all places at once."""


class PullMessage(StreamMessage):
    """Forces of the hands of a person on those of the robot, by the robot's side, in N; null lets go."""

    kind: Literal["pull"]
    left: Vector | None = None
    right: Vector | None = None


class WishMessage(StreamMessage):
    """The dead-man control of the therapist: velocities in m/s and rad/s count while `held`."""

    kind: Literal["wish"]
    ahead: FiniteFloat = 0.0
    left: FiniteFloat = 0.0
    yaw: FiniteFloat = 0.0
    held: bool


InputMessage = Annotated[PoseMessage | PullMessage | WishMessage, Field(discriminator="kind")]
MESSAGES: Final[TypeAdapter[Any]] = TypeAdapter(InputMessage)


class Turns:
    """Who sends in a role: one sender at a time, another one once that is silent."""

    def __init__(self) -> None:
        self._holder: object | None = None
        self._received_s = float("-inf")

    def takes(self, who: object) -> bool:
        """Return whether the message of `who` counts."""
        now_s = time.monotonic()
        if self._holder is not who and now_s - self._received_s <= SILENT_S:
            return False
        self._holder, self._received_s = who, now_s
        return True

    def leave(self, who: object) -> None:
        """Let another one send at once."""
        if self._holder is who:
            self._holder, self._received_s = None, float("-inf")


@dataclass
class PersonInputs:
    """The newest input of the patient; times are those of the monotonic clock in s."""

    pose: PoseMessage | None = None
    pose_s: float = float("-inf")
    pull: PullMessage | None = None
    pull_s: float = float("-inf")
    values: Mapping[str, float] = field(default_factory=dict)
    """The newest state of the robot, which says where its feet are."""
    plausibility: Plausibility = field(default_factory=Plausibility)
    poses: Poses = field(default_factory=Poses)
    """Reports each pose that is received."""

    def receive(self, message: PoseMessage | PullMessage) -> None:
        """Take a message."""
        now_s = time.monotonic()
        if isinstance(message, PoseMessage):
            self.pose, self.pose_s = message, now_s
            robot = (self.values.get("base.x", 0.0), self.values.get("base.y", 0.0))
            self.plausibility.see(now_s, _places(message), robot, is_moved=message.recentred)
            self.poses.report()
        else:
            self.pull, self.pull_s = message, now_s
            self.plausibility.feel(
                now_s, [force for force in (message.left, message.right) if force is not None]
            )

    def feel(self) -> None:
        """Take the forces at the hands that the robot measures."""
        forces = [[self.values.get(f"{side}_hand.force.{axis}", 0.0) for axis in "xyz"] for side in SIDES]
        finite = [force for force in forces if all(map(math.isfinite, force))]
        self.plausibility.feel(time.monotonic(), finite)

    def problem(self, now_s: float) -> Problem | None:
        """Return what is wrong with what the person sends: then no hand counts."""
        return self.plausibility.problem(now_s)

    def shown(self, now_s: float) -> dict[str, Any] | None:
        """Return the person as the live document shows them, None while no poses arrive."""
        pose = self.pose
        if pose is None or now_s - self.pose_s > SILENT_S:
            return None
        keys = {"t", "headset", "hands", "tracking", "in_bounds"}
        return {**pose.model_dump(by_alias=True, include=keys), "problem": self.problem(now_s)}

    def is_silent(self, now_s: float) -> bool:
        """Return whether neither poses nor pulls arrive."""
        return now_s - max(self.pose_s, self.pull_s) > SILENT_S

    def hands(self, now_s: float) -> dict[Side, HandPose]:
        """Return the hands that are tracked now, by the side of the patient."""
        pose = self.pose
        is_old = pose is None or now_s - self.pose_s > HELD_S
        if pose is None or is_old or pose.tracking != "ok" or self.problem(now_s) is not None:
            return {}
        both: dict[Side, HandPose | None] = {"left": pose.hands.left, "right": pose.hands.right}
        return {side: hand for side, hand in both.items() if hand is not None}

    def port_values(self, names: Sequence[str]) -> list[float] | None:
        """Return the values of the port `person`, by the robot's side; None while nothing was received."""
        now_s = time.monotonic()
        if self.pose is None and self.pull is None:
            return None
        by_name: dict[str, float] = {}
        hands = self.hands(now_s)
        pulls = self.pull is not None and now_s - self.pull_s <= HELD_S and self.problem(now_s) is None
        for side in SIDES:
            hand = hands.get(OTHER[side])  # the patient faces the robot
            if self.pull is not None and pulls:
                force = self.pull.left if side == "left" else self.pull.right
                by_name.update(_pulled(side, force))
            elif hand is not None and hand.grip >= CLOSED_GRIP:
                place = self._at_feet(hand.position)
                by_name[f"{side}.held"] = 1.0
                by_name.update({f"{side}.{axis}_m": value for axis, value in zip("xyz", place, strict=True)})
        return [by_name.get(name, 0.0) for name in names]

    def _at_feet(self, place: Vector) -> Vector:
        """Return a place of the ground in the frame of the feet."""
        yaw = self.values.get("feet.yaw", 0.0)
        x, y = place[0] - self.values.get("feet.x", 0.0), place[1] - self.values.get("feet.y", 0.0)
        cosine, sine = math.cos(yaw), math.sin(yaw)
        return cosine * x + sine * y, cosine * y - sine * x, place[2]


def _pulled(side: Side, force: Vector | None) -> dict[str, float]:
    if force is None:
        return {f"{side}.held": 0.0}
    forces = {f"{side}.force_{axis}_n": value for axis, value in zip("xyz", force, strict=True)}
    return {f"{side}.held": 2.0, **forces}


def _places(pose: PoseMessage) -> dict[str, Vector]:
    parts = {HEAD: pose.headset, "left": pose.hands.left, "right": pose.hands.right}
    return {name: part.position for name, part in parts.items() if part is not None}
