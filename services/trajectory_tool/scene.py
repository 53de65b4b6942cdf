"""The scene: the layout of the cell with bins, fixtures and gripper, read from a YAML file.

Each robot comes with a scene of its own, or with an empty one; `HANDOVER_SCENE_FILE` names another. The
present positions of parts are in `contents.py`.
"""

import hashlib
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import yaml
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from handover.errors import UsageError
from services.trajectory_tool.poses import Pose, pointing_down
from services.trajectory_tool.robot import Joints, Unreachable
from services.trajectory_tool.robot_model import RobotModel

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
    """The simulated gripper, and its approach to a part."""

    opening_m: Length = 0.02
    acts_in_s: Annotated[FiniteFloat, Field(ge=0, le=10)] = 0.3
    approach_m: Length = 0.15


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
    """The whole cell; `home` (rad or m for each joint) takes the place of the robot's own."""

    name: str
    home: tuple[FiniteFloat, ...] | None = None
    gripper: Gripper = Gripper()
    bins: dict[Name, Bin] = Field(default_factory=dict)
    fixtures: dict[Name, Fixture] = Field(default_factory=dict)

    def home_of(self, model: RobotModel) -> Joints:
        """Return the home position of a robot in this cell."""
        return model.home if self.home is None else self.home

    def digest(self, joint_names: Sequence[str]) -> str:
        """Return a hash that identifies this scene with a robot."""
        return hashlib.sha256(f"{self.model_dump_json()}{joint_names}".encode()).hexdigest()[:16]


def load(file: Path | None, model: RobotModel) -> Scene:
    """Return the scene of `file`, by default that of the robot, or an empty one without any.

    Raises `UsageError` with one line for each fault; everything in a scene must be reachable.
    """
    path = file or model.scene
    if path is None:
        return Scene(name="empty cell")
    try:
        written = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"the scene file {path} cannot be read: {error.strerror}") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise UsageError(f"the scene file {path} is not YAML: {' '.join(str(error).split())}") from None
    if not isinstance(written, Mapping):
        raise UsageError(f"the scene file {path} must name the cell, its bins and fixtures")
    try:
        scene = Scene.model_validate(written)
    except ValidationError as error:
        shown = (f"scene file {path}: {_place(fault['loc'])}: {fault['msg']}" for fault in error.errors())
        raise UsageError("\n".join(shown)) from None
    faults = [f"scene file {path}: {fault}" for fault in _faults(scene, model)]
    if faults:
        raise UsageError("\n".join(faults))
    return scene


def _faults(scene: Scene, model: RobotModel) -> Iterator[str]:
    for name in scene.bins.keys() & scene.fixtures.keys():
        yield f'"{name}" is a bin and a fixture; give one of them another name'
    try:
        home = model.allow(scene.home_of(model))
    except Unreachable as why:
        yield f"home: {why}"
        return
    for where, pose in _poses(scene):
        try:
            model.reach(pose, home)
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
