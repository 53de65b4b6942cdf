"""The stream from the driver of a humanoid to its robot in a ROS graph, through the ROS bridge.

Each message is one JSON text of a WebSocket of the bridge (`/humanoid`). The driver sends `HumanoidSetup`
first. When commands cease, or the stream ends, the bridge commands the last positions at rest; joints that
were commanded in efforts alone get nothing more, and the robot's own controller has to stop them.
"""

from typing import Annotated, Final, Literal

from pydantic import Field, FiniteFloat, TypeAdapter

from handover_datamodels.robot_messages import Name, StreamRefusal, Vector
from handover_datamodels.streams import StreamMessage

MAX_HUMANOID_JOINTS: Final = 64
MAX_WRENCHES: Final = 8

Values = Annotated[tuple[FiniteFloat, ...], Field(max_length=MAX_HUMANOID_JOINTS)]
Wrench = tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]


class HumanoidSetup(StreamMessage):
    """The first message: the names of the joints, and the topics of the robot.

    `joint_states` and `joint_commands` are `sensor_msgs/msg/JointState`: a command has the positions, the
    efforts, or positions, velocities and efforts together (joint impedance). `gains`, where it is set, is a
    `std_msgs/msg/Float64MultiArray` with the stiffness of all joints, then their damping.
    """

    type: Literal["setup"] = "setup"
    joint_names: Annotated[tuple[Name, ...], Field(min_length=1, max_length=MAX_HUMANOID_JOINTS)]
    joint_states: Name = "/joint_states"
    imu: Name = "/imu"
    wrenches: Annotated[tuple[Name, ...], Field(max_length=MAX_WRENCHES)] = ()
    joint_commands: Name = "/joint_commands"
    gains: Name | None = None
    watchdog_s: float = Field(0.2, gt=0, le=2)
    """After so long without a command the bridge commands the last positions at rest."""


class HumanoidCommand(StreamMessage):
    """What the joints do, in the order of the setup. `sent_s` is a clock of the driver, which is echoed."""

    type: Literal["command"] = "command"
    sent_s: FiniteFloat
    positions: Values = ()
    velocities: Values = ()
    efforts: Values = ()


class HumanoidGains(StreamMessage):
    """The gains of joint impedance from now on, in N m/rad and N m s/rad."""

    type: Literal["gains"] = "gains"
    stiffness: Values
    damping: Values


class HumanoidState(StreamMessage):
    """What the robot measures; joints in the order of the setup.

    `stamp` is the time of the joints by the clock of the robot in s, `age_s` how long ago the oldest part was
    received. `echo_s` is `sent_s` of the last command, received `held_s` before this was sent.
    """

    type: Literal["state"] = "state"
    stamp: FiniteFloat
    positions: Values
    velocities: Values
    efforts: Values = ()
    gyroscope: Vector
    accelerometer: Vector
    wrenches: tuple[Wrench, ...] = ()
    age_s: FiniteFloat = 0.0
    echo_s: FiniteFloat | None = None
    held_s: FiniteFloat = 0.0


class HumanoidProblem(StreamMessage):
    """What is missing, such as a topic that nobody publishes, or joints that are not reported."""

    type: Literal["problem"] = "problem"
    reason: str


HumanoidReport = HumanoidState | HumanoidProblem | StreamRefusal
HUMANOID_COMMANDS: TypeAdapter[HumanoidCommand | HumanoidGains] = TypeAdapter(
    Annotated[HumanoidCommand | HumanoidGains, Field(discriminator="type")]
)
HUMANOID_REPORTS: TypeAdapter[HumanoidReport] = TypeAdapter(
    Annotated[HumanoidReport, Field(discriminator="type")]
)
