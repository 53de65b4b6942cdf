"""What a controller commands of a real machine, by ROS topic."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class VelocityCommand:
    """A `geometry_msgs/msg/Twist`: forwards in m/s, to the left in rad/s."""

    topic: str
    linear_mps: float
    angular_radps: float = 0.0


@dataclass(frozen=True, slots=True)
class NumberCommand:
    """A `std_msgs/msg/Float64`."""

    topic: str
    value: float


Command = VelocityCommand | NumberCommand
