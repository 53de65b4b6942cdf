"""What a robot can collide with: shapes with a name and a pose. Plain values without a library."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias

from handover_robots.model.poses import Pose, Vector


@dataclass(frozen=True, slots=True)
class Box:
    """A box about its middle, by its lengths along x, y and z in m."""

    size: Vector


@dataclass(frozen=True, slots=True)
class Cylinder:
    """A cylinder along z about its middle, in m."""

    radius: float
    length: float


@dataclass(frozen=True, slots=True)
class Capsule:
    """A cylinder along z with a half sphere beyond each end; `length` is that of the cylinder."""

    radius: float
    length: float


@dataclass(frozen=True, slots=True)
class Sphere:
    """A sphere about its middle."""

    radius: float


@dataclass(frozen=True, slots=True)
class Mesh:
    """The convex hull of a mesh file (STL, OBJ or DAE) in m, times `scale`."""

    file: Path
    scale: Vector = (1.0, 1.0, 1.0)


Shape: TypeAlias = Box | Cylinder | Capsule | Sphere | Mesh


@dataclass(frozen=True, slots=True)
class Obstacle:
    """A shape at a pose in the frame of the robot's base.

    Several obstacles may have the name of the same thing, such as the walls of a bin.
    """

    name: str
    shape: Shape
    pose: Pose


@dataclass(frozen=True, slots=True)
class Attached:
    """A shape that the tool carries: its pose is seen from the tip of the tool."""

    name: str
    shape: Shape
    pose: Pose


@dataclass(frozen=True, slots=True)
class World:
    """The obstacles, what the tool carries, and the pairs that may touch.

    `allowed` has pairs of names of obstacles, attached shapes and links of the robot. `payload_kg` is the
    mass of what the tool carries.
    """

    obstacles: tuple[Obstacle, ...] = ()
    attached: tuple[Attached, ...] = ()
    allowed: frozenset[tuple[str, str]] = field(default_factory=frozenset)
    payload_kg: float = 0.0

    def may_touch(self, first: str, second: str) -> bool:
        """Return whether two things may touch."""
        return (first, second) in self.allowed or (second, first) in self.allowed
