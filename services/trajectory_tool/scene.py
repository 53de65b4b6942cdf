"""The scene: the layout of the cell with bins, fixtures and gripper, read from a YAML file.

The present positions of parts are in `contents.py`.
"""

import hashlib
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

import yaml
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from handover.errors import UsageError
from services.trajectory_tool.motion import Arm
from services.trajectory_tool.poses import Pose, pointing_down
from services.trajectory_tool.ur10_kinematics import Unreachable

BUILT_IN = Path(__file__).parent / "scenes" / "bin_picking.yaml"

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]+$")]
Length = Annotated[FiniteFloat, Field(gt=0, le=1)]


class _Written(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Spot(_Written):
    """A position of the gripper's tips, with the gripper pointing straight down."""

    position: tuple[FiniteFloat, FiniteFloat, FiniteFloat]
    yaw_deg: FiniteFloat = 0.0

    @property
    def pose(self) -> Pose:
        """Return the spot as a pose of the tool."""
        return pointing_down(self.position, math.radians(self.yaw_deg))


class Gripper(_Written):
    """The gripper at the flange, and its approach to a part."""

    length_m: Length
    opening_m: Length
    acts_in_s: Annotated[FiniteFloat, Field(ge=0, le=10)] = 0.3
    approach_m: Length


class Bin(_Written):
    """A bin, its camera position, and its initial parts, the topmost first."""

    view: Spot
    looks_for_s: Annotated[FiniteFloat, Field(ge=0, le=60)] = 0.5
    refilled: bool = False
    parts: tuple[Spot, ...] = ()


class Fixture(_Written):
    """A fixture with nests, each for one part."""

    nests: Annotated[tuple[Spot, ...], Field(min_length=1)]
    emptied: bool = False


class Scene(_Written):
    """The whole cell."""

    name: str
    home_rad: Annotated[tuple[FiniteFloat, ...], Field(min_length=6, max_length=6)]
    gripper: Gripper
    bins: dict[Name, Bin]
    fixtures: dict[Name, Fixture]

    @property
    def arm(self) -> Arm:
        """Return the arm with this gripper."""
        return Arm(self.gripper.length_m)

    def digest(self) -> str:
        """Return a hash that identifies this scene."""
        return hashlib.sha256(self.model_dump_json().encode()).hexdigest()[:16]


def load(file: Path | None) -> Scene:
    """Return the scene of `file`, or the built-in one. Raises `UsageError` with one line for each fault."""
    path = file or BUILT_IN
    try:
        written = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"the scene file {path} cannot be read: {error.strerror}") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise UsageError(f"the scene file {path} is not YAML: {' '.join(str(error).split())}") from None
    if not isinstance(written, Mapping):
        raise UsageError(f"the scene file {path} must name home_rad, gripper, bins and fixtures")
    try:
        scene = Scene.model_validate(written)
    except ValidationError as error:
        shown = (f"scene file {path}: {_place(fault['loc'])}: {fault['msg']}" for fault in error.errors())
        raise UsageError("\n".join(shown)) from None
    faults = [f"scene file {path}: {fault}" for fault in _faults(scene)]
    if faults:
        raise UsageError("\n".join(faults))
    return scene


def _faults(scene: Scene) -> Iterator[str]:
    for name in scene.bins.keys() & scene.fixtures.keys():
        yield f'"{name}" is a bin and a fixture; give one of them another name'
    try:
        home = scene.arm.allow(scene.home_rad)
    except Unreachable as why:
        yield f"home_rad: {why}"
        return
    for where, pose in _poses(scene):
        try:
            scene.arm.reach(pose, home)
        except Unreachable as why:
            yield f"{where}: {why}"


def _poses(scene: Scene) -> Iterator[tuple[str, Pose]]:
    approach_m = scene.gripper.approach_m
    for name, bin_ in scene.bins.items():
        yield f"bins.{name}.view", bin_.view.pose
        for number, spot in enumerate(bin_.parts):
            yield f"bins.{name}.parts.{number}", spot.pose
            yield f"bins.{name}.parts.{number}, approached from above", spot.pose.raised(approach_m)
    for name, fixture in scene.fixtures.items():
        for number, spot in enumerate(fixture.nests):
            yield f"fixtures.{name}.nests.{number}", spot.pose
            yield f"fixtures.{name}.nests.{number}, approached from above", spot.pose.raised(approach_m)


def _place(location: tuple[Any, ...]) -> str:
    return ".".join(str(part) for part in location) or "file"
