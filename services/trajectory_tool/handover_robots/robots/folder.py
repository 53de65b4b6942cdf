"""A robot as a folder without a package: `robot.yaml`, a URDF and an SRDF.

    name: UR5e                      # robot.yaml
    urdf: ur5e.urdf
    srdf: ur5e.srdf
    tip: tool0
    max_acceleration: {shoulder_pan_joint: 8.0, …}
    max_jerk: {shoulder_pan_joint: 80.0, …}
    max_payload_kg: 5.0             # at the flange, the tool included; without it no part is carried

`handover robot add` makes one. Robots are looked for by name: those of packages, then in the folder
`robots` of the data directory; a path names a folder directly.
"""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import yaml
from pydantic import Field, FiniteFloat, ValidationError

from handover.errors import UsageError
from handover.extensions import UnknownExtension
from handover.formats.validation import ClosedModel, fault_lines
from handover.telemetry import get_logger
from handover_robots.model.robot_model import Finger, RobotModel
from handover_robots.robots import ROBOTS
from handover_robots.robots.urdf import read_model

log = get_logger(__name__)

FILE = "robot.yaml"

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")
Positive = Annotated[FiniteFloat, Field(gt=0)]


class FingerEntry(ClosedModel):
    """A joint of the gripper, for display."""

    joint: str
    opened: FiniteFloat
    closed: FiniteFloat
    holding: FiniteFloat


class RobotFolder(ClosedModel):
    """The content of `robot.yaml`; file names are relative to it."""

    name: Annotated[str, Field(min_length=1)]
    urdf: Path
    srdf: Path | None = None
    tip: str
    flange: str | None = None
    max_acceleration: Positive | dict[str, Positive]
    max_jerk: Positive | dict[str, Positive]
    labels: dict[str, dict[str, str]] = Field(default_factory=dict)
    fingers: tuple[FingerEntry, ...] = ()
    scene: Path | None = None
    max_payload_kg: Positive | None = None
    """What the robot may carry at its flange, the tool included."""


def read_folder(folder: Path) -> RobotModel:
    """Return the robot of a folder. Raises `UsageError`."""
    path = folder / FILE
    try:
        written: Any = yaml.safe_load(path.read_text(encoding="utf-8"))
        if not isinstance(written, Mapping):
            raise UsageError(f"{path} must name the robot, its urdf and its tip")
        entry = RobotFolder.model_validate(written)
    except OSError as error:
        raise UsageError(f"the robot {path} cannot be read: {error.strerror}") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise UsageError(f"the robot {path} is not YAML: {' '.join(str(error).split())}") from None
    except ValidationError as error:
        raise UsageError("\n".join(f"{path}: {line}" for line in fault_lines(error, "robot"))) from None
    return read_model(
        folder / entry.urdf,
        name=entry.name,
        tip=entry.tip,
        flange=entry.flange,
        srdf=folder / entry.srdf if entry.srdf is not None else None,
        max_acceleration=entry.max_acceleration,
        max_jerk=entry.max_jerk,
        labels=entry.labels,
        fingers=tuple(Finger(**finger.model_dump()) for finger in entry.fingers),
        scene=folder / entry.scene if entry.scene is not None else None,
        max_payload_kg=entry.max_payload_kg,
    )


def robots_folder(data_dir: Path) -> Path:
    """Return where added robots are kept."""
    return data_dir / "robots"


def require_free_name(name: str) -> None:
    """Raise `UsageError` for a name that an added robot cannot have.

    One of a robot that is installed would be ambiguous, and "..", a folder of something else.
    """
    if not NAME.fullmatch(name):
        raise UsageError(
            f'the name "{name}" must begin with a letter or digit, and may have letters, digits, "_", "." '
            'and "-" only'
        )
    if name in ROBOTS.names():
        owner = "Handover" if name in ROBOTS.own else "an installed package"
        raise UsageError(
            f'"{name}" is a robot of {owner}, which that name means everywhere; choose another one: '
            f"--name my-{name}"
        )


def load_robot(name: str, data_dir: Path, folder: Path) -> RobotModel:
    """Return the robot `name`: of a package, an added one, or a path from `folder`. Raises `UsageError`."""
    if name in ROBOTS.own:
        if (added := robots_folder(data_dir) / name / FILE).is_file():
            log.warning(
                "robot of Handover is used, not the added one of its name", robot=name, added=str(added)
            )
        own: RobotModel = ROBOTS.load(name)
        return own
    places = [robots_folder(data_dir) / name, folder / name]
    for place in places:
        if (place / FILE).is_file():
            return read_folder(place)
    try:
        model: RobotModel = ROBOTS.load(name)
    except UnknownExtension as unknown:
        if name in ROBOTS.names():
            raise
        raise UnknownExtension(
            f"{unknown}, or add a URDF: handover robot add FILE.urdf --name {name}"
        ) from None
    return model
