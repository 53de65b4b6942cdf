"""Robots by name: what `HANDOVER_ROBOT_MODEL` chooses, ours and those of other packages.

A robot is a folder with its URDF and a `RobotModel` called `ROBOT`; one in this folder is found by its name.
Another package registers its own:

    [project.entry-points."handover.robots"]
    my-arm = "my_arm:ROBOT"
"""

from collections.abc import Iterable, Mapping
from pkgutil import iter_modules

from handover.extensions import ExtensionPoint


def robots_in(folders: Iterable[str]) -> Mapping[str, str]:
    """Return each package in `folders` of this package as a robot, by its name, without an import of it."""
    return {
        module.name: f"{__name__}.{module.name}:ROBOT" for module in iter_modules(folders) if module.ispkg
    }


ROBOTS = ExtensionPoint("robot", "handover.robots", robots_in(__path__))
"""Each entry point is a `RobotModel`."""
