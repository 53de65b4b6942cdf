"""The stream between whole-body control and other nodes of a ROS graph, through the ROS bridge.

Each message is one JSON text of a WebSocket of the bridge (`/humanoid/link`). The service sends `LinkSetup`
first, then `LinkState` as often as it likes; the bridge sends a `LinkWish` for each wish of the graph.

All stamps are of the clock of the robot, in s. Who wishes stamps a wish with the stamp of the newest state
that it has received; so the service measures the whole way, from the state to the node and back, by the clock
of the robot alone.
"""

from typing import Annotated, Final, Literal

from pydantic import Field, FiniteFloat, TypeAdapter

from handover_datamodels.humanoid_stream import MAX_HUMANOID_JOINTS, Values
from handover_datamodels.robot_messages import Name, StreamRefusal, Vector
from handover_datamodels.streams import StreamMessage

MAX_STATUS: Final = 32

Quaternion = tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]
"""x, y, z, w."""


class LinkSetup(StreamMessage):
    """The first message: the names of the joints and the topics.

    `wish` is a `geometry_msgs/msg/TwistStamped`: velocities ahead and to the left in m/s, and about the
    vertical in rad/s. `joint_states` is a `sensor_msgs/msg/JointState`, `odometry` a `nav_msgs/msg/Odometry`
    of the base, `status` a `diagnostic_msgs/msg/DiagnosticArray`.
    """

    type: Literal["setup"] = "setup"
    humanoid: Name
    joint_names: Annotated[tuple[Name, ...], Field(min_length=1, max_length=MAX_HUMANOID_JOINTS)]
    wish: Name
    joint_states: Name
    odometry: Name
    status: Name


class LinkState(StreamMessage):
    """The state of the robot at `stamp`: joints in rad, the base in m on the ground of its odometry.

    `velocity` are those that it wants of its centre of mass, ahead, left and up in m/s. `level` is 0 while
    all is well, 1 for a warning, 2 for an error, as in `DiagnosticStatus`.
    """

    type: Literal["state"] = "state"
    stamp: FiniteFloat
    positions: Values
    place: Vector
    rotation: Quaternion
    velocity: Vector
    level: Annotated[int, Field(ge=0, le=2)] = 0
    message: Annotated[str, Field(max_length=500)] = ""
    status: Annotated[dict[str, str], Field(max_length=MAX_STATUS)] = Field(default_factory=dict)


class LinkWish(StreamMessage):
    """What a node of the graph wants; it waited `age_s` in the bridge."""

    type: Literal["wish"] = "wish"
    stamp: FiniteFloat
    ahead: FiniteFloat = 0.0
    left: FiniteFloat = 0.0
    yaw: FiniteFloat = 0.0
    age_s: FiniteFloat = 0.0


LINK_STATES: TypeAdapter[LinkState] = TypeAdapter(LinkState)
LINK_REPORTS: TypeAdapter[LinkWish | StreamRefusal] = TypeAdapter(
    Annotated[LinkWish | StreamRefusal, Field(discriminator="type")]
)
