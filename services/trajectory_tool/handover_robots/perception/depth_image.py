"""Depth images: distances along the optical axis, with the intrinsics of the camera.

The frame of a camera is that of OpenCV and of ROS's optical frames: z into the image, x right, y down.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from handover_robots.model.poses import Frame

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def frame_of(x_axis: Array, y_axis: Array, z_axis: Array, at: Array) -> Frame:
    """Return the frame with these axes at a position."""
    a, b, c = ((row[0], row[1], row[2]) for row in np.stack([x_axis, y_axis, z_axis], axis=1).tolist())
    x, y, z = at.tolist()
    return Frame((a, b, c), (x, y, z))


@dataclass(frozen=True, slots=True)
class Intrinsics:
    """A camera without distortion: `focal` in pixels, the optical axis in the middle of the image."""

    width: int
    height: int
    focal: float

    @classmethod
    def of_view(cls, width: int, height: int, field_of_view_deg: float) -> "Intrinsics":
        """Return the intrinsics for a field of view, measured along the height of the image."""
        return cls(width, height, height / 2 / math.tan(math.radians(field_of_view_deg) / 2))

    def directions(self) -> Array:
        """Return the ray of each pixel with z = 1, rows first: height x width x 3."""
        x = (np.arange(self.width) + 0.5 - self.width / 2) / self.focal
        y = (np.arange(self.height) + 0.5 - self.height / 2) / self.focal
        return np.stack([*np.meshgrid(x, y), np.ones((self.height, self.width))], axis=-1)


@dataclass(frozen=True)
class DepthImage:
    """Distances along the optical axis in m (nan: none measured), seen from `camera` in the cell."""

    depth_m: Array
    intrinsics: Intrinsics
    camera: Frame

    @cached_property
    def camera_points(self) -> Array:
        """Return the points in the frame of the camera: height x width x 3."""
        return self.intrinsics.directions() * self.depth_m[..., None]

    @cached_property
    def points(self) -> Array:
        """Return the points in the frame of the cell: height x width x 3."""
        rotation, position = np.array(self.camera.rotation), np.array(self.camera.position)
        return np.asarray(self.camera_points @ rotation.T + position)
