"""Convex regions on the ground: footprints, and their hull while both feet stand."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, Literal, Self

import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull

from handover_humanoid.model.kinematics import Array

Side = Literal["left", "right"]
SIDES: Final[tuple[Side, Side]] = ("left", "right")


@dataclass(frozen=True, slots=True)
class Footprint:
    """Where a foot stands: the origin of its sole in m and its yaw in rad."""

    side: Side
    x: float
    y: float
    yaw: float = 0.0

    @classmethod
    def below(cls, side: Side, pose: pin.SE3) -> Self:
        """Return the footprint of a sole at a pose."""
        x, y, _ = pose.translation.tolist()
        return cls(side, x, y, float(np.arctan2(pose.rotation[1, 0], pose.rotation[0, 0])))

    @property
    def place(self) -> Array:
        """Return x and y."""
        return np.array([self.x, self.y])

    def to_ground(self, points: Array) -> Array:
        """Return points (n, 2) of the frame of the foot on the ground."""
        return np.asarray(points @ turn(self.yaw).T + self.place)


@dataclass(frozen=True, slots=True)
class Region:
    """A convex polygon as half planes `normals @ x <= offsets`; the normals have length 1."""

    normals: Array
    offsets: Array
    centre: Array

    @classmethod
    def of(cls, footprints: Sequence[Footprint], sole: Array) -> "Region":
        """Return the hull of soles, whose corners (n, 2) are given in the frame of the foot."""
        return _region(tuple(footprints), sole.tobytes())

    def room_m(self, point: Array) -> float:
        """Return how far a point is inside, negative outside (there: of the edge that is violated most)."""
        return float((self.offsets - self.normals @ point).min())


def turn(yaw: float) -> Array:
    """Return the rotation (2, 2) by a yaw."""
    cosine, sine = math.cos(yaw), math.sin(yaw)
    return np.array([[cosine, -sine], [sine, cosine]])


@lru_cache(maxsize=16)
def _region(footprints: tuple[Footprint, ...], sole: bytes) -> Region:
    """Return the hull of soles; feet stand for many periods, and their hull takes longer than the rest."""
    shape = np.frombuffer(sole, dtype=np.float64).reshape(-1, 2)
    corners = np.vstack([footprint.to_ground(shape) for footprint in footprints])
    equations = ConvexHull(corners).equations
    region = Region(equations[:, :2].copy(), -equations[:, 2], corners.mean(axis=0))
    for values in (region.normals, region.offsets, region.centre):
        values.flags.writeable = False
    return region
