"""Robot drivers by name: what `HANDOVER_ROBOT` chooses, ours and those of other packages.

A driver moves the joints of any robot model. A package registers a factory, which makes a `Robot` from a
`RobotContext`:

    [project.entry-points."handover.robot_drivers"]
    my-controller = "my_controller:make_robot"
"""

from handover.extensions import ExtensionPoint
from handover_robots.driver_base.context import Clock, Peer, RobotContext, RobotFactory

__all__ = ["DRIVERS", "Clock", "Peer", "RobotContext", "RobotFactory"]

DRIVERS = ExtensionPoint(
    "robot driver",
    "handover.robot_drivers",
    {
        "simulated": "handover_robots.drivers.simulated_robot:SimulatedRobot.from_context",
        "physics": "handover_robots.physics.robot:PhysicsRobot.from_context",
        "ros": "handover_robots.drivers.ros_robot:RosRobot.from_context",
    },
    parts={"ur": "handover-ur"},
)
