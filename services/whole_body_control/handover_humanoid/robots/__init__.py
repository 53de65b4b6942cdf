"""Humanoids by name: one folder each, ours and those of other packages.

A package registers the path of a folder with `robot.yaml`, a URDF and an SRDF:

    [project.entry-points."handover.humanoids"]
    my-humanoid = "my_humanoid:FOLDER"
"""

from pathlib import Path
from typing import Final

from handover.extensions import ExtensionPoint
from handover_humanoid.model.humanoid import Humanoid
from handover_humanoid.model.reading import read_folder

HERE = Path(__file__).parent

HUMANOIDS: Final = ExtensionPoint(
    "humanoid",
    "handover.humanoids",
    {
        "coman": "handover_humanoid.robots:COMAN",
        "talos": "handover_humanoid.robots:TALOS",
    },
)
COMAN: Final = HERE / "coman"
TALOS: Final = HERE / "talos"


def folder(name: str) -> Path:
    """Return the folder of a humanoid. Raises `UsageError` for one that is unknown."""
    return Path(HUMANOIDS.load(name))


def humanoid(name: str) -> Humanoid:
    """Return the humanoid of this name. Raises `UsageError` for one that is unknown or faulty."""
    return read_folder(folder(name))
