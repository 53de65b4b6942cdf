"""The scene: the layout of the cell with bins, fixtures and gripper, read from a YAML file.

Each robot comes with a scene of its own, or with an empty one; `HANDOVER_SCENE_FILE` names another. The
present positions of parts are in `contents.py`.
"""

import hashlib
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Self

import yaml
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError, model_validator

from handover.errors import UsageError
from services.trajectory_tool.obstacles import Box, Cylinder, Mesh, Obstacle, Shape, Sphere
from services.trajectory_tool.poses import Pose, pointing_down
from services.trajectory_tool.robot import Joints, Unreachable
from services.trajectory_tool.robot_model import RobotModel

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]+$")]
Length = Annotated[FiniteFloat, Field(gt=0, le=1)]
Size = Annotated[FiniteFloat, Field(gt=0, le=20)]


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
    part_size_m: tuple[Length, Length, Length] | None = None
    """The size of a held part along the axes of the tool, for the check of collisions."""


class Placed(_Written):
    """Where a shape is, by its middle."""

    position: tuple[FiniteFloat, FiniteFloat, FiniteFloat]
    yaw_deg: FiniteFloat = 0.0

    @property
    def pose(self) -> Pose:
        """Return the pose of the shape, upright."""
        half = math.radians(self.yaw_deg) / 2
        return Pose(self.position, (0.0, 0.0, math.sin(half), math.cos(half)))


class RoundShape(_Written):
    """A cylinder along z, in m."""

    radius: Size
    length: Size


class Thing(Placed):
    """An obstacle: a box by its lengths, a cylinder, a sphere by its radius, or the hull of a mesh file."""

    box: tuple[Size, Size, Size] | None = None
    cylinder: RoundShape | None = None
    sphere: Size | None = None
    mesh: Path | None = None
    scale: Size = 1.0

    @model_validator(mode="after")
    def _one_shape(self) -> Self:
        if sum(shape is not None for shape in (self.box, self.cylinder, self.sphere, self.mesh)) != 1:
            raise ValueError('needs one of "box", "cylinder", "sphere" and "mesh"')
        return self

    def obstacle(self, name: str, folder: Path) -> Obstacle:
        """Return the obstacle; a mesh file is looked for in `folder`."""
        shape: Shape
        if self.box is not None:
            shape = Box(self.box)
        elif self.cylinder is not None:
            shape = Cylinder(self.cylinder.radius, self.cylinder.length)
        elif self.sphere is not None:
            shape = Sphere(self.sphere)
        else:
            shape = Mesh(folder / (self.mesh or ""), (self.scale,) * 3)
        return Obstacle(name, shape, self.pose)


class OpenBox(Placed):
    """A box without a lid, for a bin: `position` is the middle of its bottom, `size` is outside."""

    size: tuple[Size, Size, Size]
    wall_m: Length = 0.012

    def obstacles(self, name: str) -> Iterator[Obstacle]:
        """Yield the bottom and the four walls."""
        (width, depth, height), wall = self.size, self.wall_m
        frame = self.pose.frame()
        for size, at in (
            ((width, depth, wall), (0.0, 0.0, wall / 2)),
            ((width, wall, height), (0.0, (wall - depth) / 2, height / 2)),
            ((width, wall, height), (0.0, (depth - wall) / 2, height / 2)),
            ((wall, depth, height), ((wall - width) / 2, 0.0, height / 2)),
            ((wall, depth, height), ((width - wall) / 2, 0.0, height / 2)),
        ):
            placed = frame @ Pose(at, (0.0, 0.0, 0.0, 1.0)).frame()
            yield Obstacle(name, Box(size), Pose.of(placed))


class Bin(_Written):
    """A bin, its camera position, and its initial parts, the topmost first."""

    view: Spot
    looks_for_s: Annotated[FiniteFloat, Field(ge=0, le=60)] = 0.5
    refilled: bool = False
    walls: OpenBox | None = None
    parts: tuple[Spot, ...] = ()


class Fixture(_Written):
    """A fixture with nests, each for one part."""

    nests: Annotated[tuple[Spot, ...], Field(min_length=1)]
    emptied: bool = False
    body: Thing | None = None


class Scene(_Written):
    """The whole cell; `home` (rad or m for each joint) takes the place of the robot's own."""

    name: str
    home: tuple[FiniteFloat, ...] | None = None
    gripper: Gripper = Gripper()
    bins: dict[Name, Bin] = Field(default_factory=dict)
    fixtures: dict[Name, Fixture] = Field(default_factory=dict)
    obstacles: dict[Name, Thing] = Field(default_factory=dict)
    folder: Annotated[Path, Field(exclude=True)] = Path()
    """Where mesh files are looked for: the folder of the scene file."""

    def solids(self) -> tuple[Obstacle, ...]:
        """Return everything that the robot may not touch."""
        found = [thing.obstacle(name, self.folder) for name, thing in self.obstacles.items()]
        for name, bin_ in self.bins.items():
            if bin_.walls is not None:
                found += bin_.walls.obstacles(name)
        for name, fixture in self.fixtures.items():
            if fixture.body is not None:
                found.append(fixture.body.obstacle(name, self.folder))
        return tuple(found)

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
        scene = Scene.model_validate({**written, "folder": path.parent})
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
