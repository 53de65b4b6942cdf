"""Poses: position and orientation of the tool, a part or a nest.

A pose is a position in metres and a unit quaternion (x, y, z, w), as ROS writes them. All poses of the cell
are given in the frame of the robot's base (the frame "base" of Universal Robots, not ROS's "base_link").
"""

import math
from dataclasses import dataclass
from typing import Any

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Rotation = tuple[Vector, Vector, Vector]

NO_TURN: Rotation = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True, slots=True)
class Frame:
    """A pose as a rotation matrix (rows) and a translation in m."""

    rotation: Rotation
    position: Vector

    def __matmul__(self, other: "Frame") -> "Frame":
        # Written out: a control cycle multiplies some 30 of them.
        (a, b, c), (d, e, f), (g, h, i) = self.rotation
        (j, k, u), (m, n, o), (p, q, r) = other.rotation
        x, y, z = other.position
        at_x, at_y, at_z = self.position
        return Frame(
            (
                (a * j + b * m + c * p, a * k + b * n + c * q, a * u + b * o + c * r),
                (d * j + e * m + f * p, d * k + e * n + f * q, d * u + e * o + f * r),
                (g * j + h * m + i * p, g * k + h * n + i * q, g * u + h * o + i * r),
            ),
            (
                at_x + (a * x + b * y + c * z),
                at_y + (d * x + e * y + f * z),
                at_z + (g * x + h * y + i * z),
            ),
        )

    def inverse(self) -> "Frame":
        """Return the inverse frame."""
        back = transposed(self.rotation)
        x, y, z = turn(back, self.position)
        return Frame(back, (-x, -y, -z))


@dataclass(frozen=True, slots=True)
class Pose:
    """A position in m and an orientation as a unit quaternion (x, y, z, w)."""

    position: Vector
    orientation: Quaternion

    def frame(self) -> Frame:
        """Return the pose as a rotation matrix and a translation."""
        x, y, z, w = self.orientation
        rows = (
            (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
            (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
            (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
        )
        return Frame(rows, self.position)

    @classmethod
    def of(cls, frame: Frame) -> "Pose":
        """Return the pose of `frame`; w of the quaternion is not negative."""
        return cls(frame.position, _quaternion(frame.rotation))

    def moved(self, offset_m: Vector) -> "Pose":
        """Return the pose moved along the axes of the cell."""
        x, y, z = (here + by for here, by in zip(self.position, offset_m, strict=True))
        return Pose((x, y, z), self.orientation)

    def raised(self, height_m: float) -> "Pose":
        """Return the pose `height_m` above this one, along the vertical of the base."""
        x, y, z = self.position
        return Pose((x, y, z + height_m), self.orientation)

    def distance_m(self, other: "Pose") -> float:
        """Return the distance of the two positions."""
        return math.dist(self.position, other.position)

    def written(self) -> dict[str, Any]:
        """Return the pose as JSON of parameters and results, rounded (and without -0)."""
        return {
            "position": [round(value, 5) + 0.0 for value in self.position],
            "orientation": [round(value, 6) + 0.0 for value in self.orientation],
        }


def pointing_down(position: Vector, yaw_rad: float = 0.0) -> Pose:
    """Return the pose of a tool at `position` that points straight down, turned by `yaw_rad`."""
    return Pose(position, (math.cos(yaw_rad / 2), math.sin(yaw_rad / 2), 0.0, 0.0))


def cross(first: Vector, second: Vector) -> Vector:
    """Return the cross product."""
    (a, b, c), (x, y, z) = first, second
    return (b * z - c * y, c * x - a * z, a * y - b * x)


def turn(rotation: Rotation, vector: Vector) -> Vector:
    """Return `vector` turned by `rotation`."""
    x, y, z = vector
    a, b, c = rotation
    return (
        a[0] * x + a[1] * y + a[2] * z,
        b[0] * x + b[1] * y + b[2] * z,
        c[0] * x + c[1] * y + c[2] * z,
    )


def transposed(rows: Rotation) -> Rotation:
    """Return the matrix with rows and columns exchanged (of a rotation: its inverse)."""
    a, b, c = rows
    return ((a[0], b[0], c[0]), (a[1], b[1], c[1]), (a[2], b[2], c[2]))


def _quaternion(rows: Rotation) -> Quaternion:
    (a, b, c), (d, e, f), (g, h, i) = rows
    # Of four formulas for the same quaternion, the one that divides by the largest element is exact enough.
    squares = (1 + a - e - i, 1 - a + e - i, 1 - a - e + i, 1 + a + e + i)
    ways = (
        (squares[0], b + d, c + g, h - f),
        (b + d, squares[1], f + h, c - g),
        (c + g, f + h, squares[2], d - b),
        (h - f, c - g, d - b, squares[3]),
    )
    chosen = ways[squares.index(max(squares))]
    length = math.copysign(math.hypot(*chosen), chosen[3] or 1.0)
    x, y, z, w = (value / length for value in chosen)
    return (x, y, z, w)
