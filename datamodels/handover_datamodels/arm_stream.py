"""The stream from the trajectory tool to an arm of a ROS graph, through the ROS bridge.

Each message is one JSON text of a WebSocket of the bridge (`/arm`). The tool sends `ArmSetup` first. The
bridge stops the arm when the stream ends: it cancels the goal, and commands a velocity of 0.
"""

from typing import Annotated, Final, Literal

from pydantic import Field, FiniteFloat, TypeAdapter

from handover_datamodels.robot_messages import Name, StreamRefusal
from handover_datamodels.streams import StreamMessage

MAX_JOINTS: Final = 32
MAX_POINTS: Final = 500
TRAJECTORY_ACTION: Final = "control_msgs/action/FollowJointTrajectory"
JOINT_VELOCITIES: Final = "std_msgs/msg/Float64MultiArray"

Values = Annotated[tuple[FiniteFloat, ...], Field(min_length=1, max_length=MAX_JOINTS)]


class VelocityOutput(StreamMessage):
    """A topic for velocities: of the joints, or of the tool in the frame `frame` (a twist)."""

    topic: Name
    type: Literal["std_msgs/msg/Float64MultiArray", "geometry_msgs/msg/TwistStamped"] = JOINT_VELOCITIES
    frame: str = Field("base_link", max_length=200)
    watchdog_s: float = Field(0.2, gt=0, le=2)
    """After so long without a command the bridge commands a velocity of 0."""


class ArmSetup(StreamMessage):
    """The first message: the names of the joints, and the interfaces of the arm."""

    type: Literal["setup"] = "setup"
    joint_names: Annotated[tuple[Name, ...], Field(min_length=1, max_length=MAX_JOINTS)]
    joint_states: Name = "/joint_states"
    trajectory_action: Name = "/joint_trajectory_controller/follow_joint_trajectory"
    velocity: VelocityOutput | None = None


class TrajectoryPoint(StreamMessage):
    """A point of a trajectory, `time_s` after the receipt of the goal."""

    time_s: FiniteFloat = Field(ge=0)
    positions: Values
    velocities: Values
    accelerations: Values


class ArmGoal(StreamMessage):
    """A trajectory to follow; it takes the place of the one before. The last point is at rest."""

    type: Literal["goal"] = "goal"
    id: int
    points: Annotated[tuple[TrajectoryPoint, ...], Field(min_length=1, max_length=MAX_POINTS)]


class ArmCancel(StreamMessage):
    """Stop: the goal is cancelled."""

    type: Literal["cancel"] = "cancel"


class ArmVelocity(StreamMessage):
    """Velocities of the joints in rad/s, or the twist of the tool (m/s, rad/s)."""

    type: Literal["velocity"] = "velocity"
    values: Values


class ArmJoints(StreamMessage):
    """The joints as the arm reports them, in its order; `stamp` in s since 1970."""

    type: Literal["joints"] = "joints"
    stamp: FiniteFloat
    names: tuple[str, ...]
    positions: tuple[float, ...]
    velocities: tuple[float, ...] = ()
    efforts: tuple[float, ...] = ()


class GoalAccepted(StreamMessage):
    """The controller follows a goal from now on."""

    type: Literal["accepted"] = "accepted"
    id: int


class GoalEnd(StreamMessage):
    """The end of a goal, with the reason of one that did not succeed."""

    type: Literal["ended"] = "ended"
    id: int
    succeeded: bool
    reason: str = ""
    unknown: bool = False
    """Whether the goal was sent and nobody knows whether it is, or was, carried out."""


ArmCommand = Annotated[ArmGoal | ArmCancel | ArmVelocity, Field(discriminator="type")]
ArmReport = Annotated[ArmJoints | GoalAccepted | GoalEnd | StreamRefusal, Field(discriminator="type")]

ARM_COMMANDS: TypeAdapter[ArmGoal | ArmCancel | ArmVelocity] = TypeAdapter(ArmCommand)
ARM_REPORTS: TypeAdapter[ArmJoints | GoalAccepted | GoalEnd | StreamRefusal] = TypeAdapter(ArmReport)
