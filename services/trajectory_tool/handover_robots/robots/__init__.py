"""Robots by name: what `HANDOVER_ROBOT_MODEL` chooses, ours and those of other packages.

A robot is a folder with its URDF and a `RobotModel`. Another package registers its own:

    [project.entry-points."handover.robots"]
    my-arm = "my_arm:ROBOT"
"""

from handover.extensions import ExtensionPoint

ROBOTS = ExtensionPoint(
    "robot",
    "handover.robots",
    {
        "ur10": "handover_robots.robots.ur10:ROBOT",
        "ur5e": "handover_robots.robots.ur5e:ROBOT",
        "panda": "handover_robots.robots.panda:ROBOT",
    },
)
"""Each entry point is a `RobotModel`."""
