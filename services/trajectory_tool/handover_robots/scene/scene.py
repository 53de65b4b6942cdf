"""The scene: the layout of the cell with bins, fixtures and gripper, read from a YAML file.

Each robot comes with a scene of its own, or with an empty one; `HANDOVER_SCENE_FILE` names another. The
present positions of parts are in `contents.py`.
"""

import hashlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, FiniteFloat, model_validator

from handover.formats.validation import ClosedModel
from handover_robots.model.obstacles import Box, Capsule, Cylinder, Mesh, Obstacle, Shape, Sphere
from handover_robots.model.poses import Frame, Pose, Vector, pointing_down

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]+$")]
Length = Annotated[FiniteFloat, Field(gt=0, le=1)]
Size = Annotated[FiniteFloat, Field(gt=0, le=20)]
IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


class Spot(ClosedModel):
    """A position of the gripper's tips, with the gripper pointing straight down."""

    position: tuple[FiniteFloat, FiniteFloat, FiniteFloat]
    yaw_deg: FiniteFloat = 0.0

    @property
    def pose(self) -> Pose:
        """Return the spot as a pose of the tool."""
        return pointing_down(self.position, math.radians(self.yaw_deg))


class Gripper(ClosedModel):
    """The simulated gripper, and its approach to a part."""

    opening_m: Length = 0.02
    acts_in_s: Annotated[FiniteFloat, Field(ge=0, le=10)] = 0.3
    approach_m: Length = 0.15
    part_size_m: tuple[Length, Length, Length] | None = None
    """The size of a held part along the axes of the tool, for the check of collisions."""
    part_mass_kg: Annotated[FiniteFloat, Field(gt=0, le=1000)] | None = None
    """The mass of a part, for the check of torques and simulated physics."""


class Placed(ClosedModel):
    """Where a shape is, by its middle."""

    position: tuple[FiniteFloat, FiniteFloat, FiniteFloat]
    yaw_deg: FiniteFloat = 0.0

    @property
    def pose(self) -> Pose:
        """Return the pose of the shape, upright."""
        half = math.radians(self.yaw_deg) / 2
        return Pose(self.position, (0.0, 0.0, math.sin(half), math.cos(half)))


class RoundShape(ClosedModel):
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

    def shape(self, folder: Path) -> Shape:
        """Return the shape; a mesh file is looked for in `folder`."""
        if self.box is not None:
            return Box(self.box)
        if self.cylinder is not None:
            return Cylinder(self.cylinder.radius, self.cylinder.length)
        if self.sphere is not None:
            return Sphere(self.sphere)
        return Mesh(folder / (self.mesh or ""), (self.scale,) * 3)

    def obstacle(self, name: str, folder: Path) -> Obstacle:
        """Return the obstacle."""
        return Obstacle(name, self.shape(folder), self.pose)


ZoneKind = Literal["keepOut", "reducedSpeed", "people"]

REDUCED_SPEED_MPS = 0.25
"""The speed of the tool in reduced mode (ISO 10218-1), and in a zone of reduced speed that names none."""
NEAR_STEP_M = 0.05
_TOOL_SPEEDS_MPS: dict[ZoneKind, float] = {"keepOut": 0.0, "people": math.inf}


@dataclass(frozen=True, slots=True)
class Zone:
    """A part of the cell with a rule: no robot enters it, the tool is slow in it, or people may be in it.

    `shape` is at `pose` in the frame of the cell. `max_tool_speed_mps` is 0 in a keep-out zone, and infinite
    in one of people, where the contact table of each robot holds.
    """

    name: str
    shape: Box | Cylinder | Sphere
    pose: Pose
    kind: ZoneKind
    max_tool_speed_mps: float

    def distance_m(self, point: Vector) -> float:
        """Return the distance of a point from the zone; 0 inside."""
        x, y, z = map(abs, (self.pose.frame().inverse() @ Frame(IDENTITY, point)).position)
        match self.shape:
            case Box((width, depth, height)):
                return math.hypot(max(x - width / 2, 0.0), max(y - depth / 2, 0.0), max(z - height / 2, 0.0))
            case Cylinder(radius, length):
                return math.hypot(max(math.hypot(x, y) - radius, 0.0), max(z - length / 2, 0.0))
            case Sphere(radius):
                return max(math.hypot(x, y, z) - radius, 0.0)

    def is_near(self, chain: Sequence[Vector], margin_m: float) -> bool:
        """Return whether a line through points is within a margin of the zone; within 5 cm it may be."""
        return any(self._is_near(start, end, margin_m) for start, end in pairwise(chain))

    def _is_near(self, start: Vector, end: Vector, margin_m: float) -> bool:
        half_m = math.dist(start, end) / 2
        middle = ((start[0] + end[0]) / 2, (start[1] + end[1]) / 2, (start[2] + end[2]) / 2)
        if self.distance_m(middle) > margin_m + half_m:
            return False
        if half_m <= NEAR_STEP_M:
            return True
        return self._is_near(start, middle, margin_m) or self._is_near(middle, end, margin_m)

    def contains(self, point: Vector) -> bool:
        """Return whether a point of the cell is in the zone."""
        return self.distance_m(point) == 0.0


class WrittenZone(Thing):
    """A zone in a scene file: a box, a cylinder or a sphere with its rule."""

    kind: ZoneKind
    max_tool_speed_mps: Annotated[FiniteFloat, Field(gt=0, le=10)] = REDUCED_SPEED_MPS

    @model_validator(mode="after")
    def _no_mesh(self) -> Self:
        if self.mesh is not None:
            raise ValueError('a zone is a "box", a "cylinder" or a "sphere"')
        return self

    def zone(self, name: str) -> Zone:
        """Return the zone."""
        shape = self.shape(Path())
        assert not isinstance(shape, Mesh | Capsule)  # noqa: S101 - the validator refuses a mesh
        return Zone(
            name,
            shape,
            self.pose,
            self.kind,
            _TOOL_SPEEDS_MPS.get(self.kind, self.max_tool_speed_mps),
        )


class Fence(ClosedModel):
    """A fence along points of the ground in m."""

    points: Annotated[tuple[tuple[FiniteFloat, FiniteFloat], ...], Field(min_length=2, max_length=100)]
    height_m: Size = 1.4
    thickness_m: Length = 0.04
    foot_m: FiniteFloat = 0.0
    """The height of its lower edge."""

    def obstacles(self, name: str) -> Iterator[Obstacle]:
        """Yield a panel between each two points."""
        for (x, y), (to_x, to_y) in pairwise(self.points):
            length, half = math.hypot(to_x - x, to_y - y), math.atan2(to_y - y, to_x - x) / 2
            middle = ((x + to_x) / 2, (y + to_y) / 2, self.foot_m + self.height_m / 2)
            panel = Box((max(length, self.thickness_m), self.thickness_m, self.height_m))
            yield Obstacle(name, panel, Pose(middle, (0.0, 0.0, math.sin(half), math.cos(half))))


class MountedCamera(Placed):
    """A camera of the cell: it looks along -z of its pose turned by `tilt_deg`; `body` is its housing."""

    tilt_deg: FiniteFloat = 0.0
    field_of_view_deg: Annotated[FiniteFloat, Field(gt=0, lt=180)] = 60.0
    body: tuple[Size, Size, Size] = (0.1, 0.1, 0.06)

    @property
    def optical_frame(self) -> Frame:
        """Return the frame of its images: z into the image, x right."""
        return _looking_down(self.pose, self.tilt_deg)

    def obstacle(self, name: str) -> Obstacle:
        """Return the housing."""
        return Obstacle(name, Box(self.body), self.pose)


class PeopleSensor(Placed):
    """A sensor of people in the cell: a lidar in its horizontal plane, or a depth camera.

    A depth camera looks along -z of its pose turned by `tilt_deg`. People are looked for within `range_m`,
    and up to 2.2 m above `ground_m`, the height of the ground in the frame of the cell.
    """

    kind: Literal["lidar", "depthCamera"]
    range_m: Size = 6.0
    tilt_deg: FiniteFloat = 0.0
    field_of_view_deg: Annotated[FiniteFloat, Field(gt=0, lt=180)] = 60.0
    ground_m: FiniteFloat = 0.0

    @property
    def optical_frame(self) -> Frame:
        """Return the frame of the images of a depth camera: z into the image, x right."""
        return _looking_down(self.pose, self.tilt_deg)


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


class Bin(ClosedModel):
    """A bin, its camera position, and its initial parts, the topmost first."""

    view: Spot
    more_views: Annotated[tuple[Spot, ...], Field(max_length=20)] = ()
    """Further camera positions, for scans that name them."""
    looks_for_s: Annotated[FiniteFloat, Field(ge=0, le=60)] = 0.5
    refilled: bool = False
    camera: Name | None = None
    """The camera of the scene that looks into the bin; by default one in the hand of the robot."""
    walls: OpenBox | None = None
    parts: tuple[Spot, ...] = ()
    objects: Annotated[tuple[Name, ...], Field(max_length=20)] = ()
    """Objects of simulated physics that are no boxes; the camera looks for things of any shape there."""


class Fixture(ClosedModel):
    """A fixture with nests, each for one part."""

    nests: Annotated[tuple[Spot, ...], Field(min_length=1)]
    emptied: bool = False
    body: Thing | None = None


class Scene(ClosedModel):
    """The whole cell; `home` (rad or m for each joint) takes the place of the robot's own."""

    name: str
    home: tuple[FiniteFloat, ...] | None = None
    gripper: Gripper = Gripper()
    bins: dict[Name, Bin] = Field(default_factory=dict)
    fixtures: dict[Name, Fixture] = Field(default_factory=dict)
    obstacles: dict[Name, Thing] = Field(default_factory=dict)
    fences: dict[Name, Fence] = Field(default_factory=dict)
    cameras: dict[Name, MountedCamera] = Field(default_factory=dict)
    zones: dict[Name, WrittenZone] = Field(default_factory=dict)
    people_sensors: dict[Name, PeopleSensor] = Field(default_factory=dict)
    folder: Annotated[Path, Field(exclude=True)] = Path()
    """Where mesh files are looked for: the folder of the scene file."""

    def solids(self) -> tuple[Obstacle, ...]:
        """Return everything that a robot may not touch, keep-out zones included."""
        zones = (
            Obstacle(name, zone.shape(self.folder), zone.pose)
            for name, zone in self.zones.items()
            if zone.kind == "keepOut"
        )
        return (*self.things(), *zones)

    def things(self) -> tuple[Obstacle, ...]:
        """Return everything that stands in the cell."""
        standing = [thing.obstacle(name, self.folder) for name, thing in self.obstacles.items()]
        for name, fence in self.fences.items():
            standing += fence.obstacles(name)
        standing += [camera.obstacle(name) for name, camera in self.cameras.items()]
        for name, bin_ in self.bins.items():
            if bin_.walls is not None:
                standing += bin_.walls.obstacles(name)
        for name, fixture in self.fixtures.items():
            if fixture.body is not None:
                standing.append(fixture.body.obstacle(name, self.folder))
        return tuple(standing)

    def all_zones(self) -> tuple[Zone, ...]:
        """Return the zones."""
        return tuple(zone.zone(name) for name, zone in self.zones.items())

    @property
    def digest(self) -> str:
        """Return a hash that identifies this scene."""
        # Without sensors it is that of earlier releases, whose stored state stays valid.
        unused = set() if self.people_sensors else {"people_sensors"}
        return hashlib.sha256(self.model_dump_json(exclude=unused).encode()).hexdigest()[:16]


def _looking_down(pose: Pose, tilt_deg: float) -> Frame:
    """Return the optical frame of a camera that looks down, tilted about its x axis."""
    tilt = math.radians(tilt_deg)
    c, s = math.cos(tilt), math.sin(tilt)
    down = Frame(((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)), (0.0, 0.0, 0.0))
    tilted = Frame(((1.0, 0.0, 0.0), (0.0, c, -s), (0.0, s, c)), (0.0, 0.0, 0.0))
    return pose.frame() @ tilted @ down
