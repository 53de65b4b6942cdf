"""The simulated depth camera: ray casting into the simulation, with noise. It needs no graphics."""

import math
from dataclasses import dataclass

import numpy as np

from handover_robots.model.poses import Frame
from handover_robots.perception.depth_image import DepthImage, Intrinsics
from handover_robots.physics.arm import SimulatedArm
from handover_robots.physics.simulation import Simulation

MAX_RANGE_M = 3.0


@dataclass(frozen=True, slots=True)
class CameraMount:
    """Where a camera is: its frame in the cell or, `in_hand`, in the frame of the tool's tip."""

    frame: Frame
    in_hand: bool

    def camera(self, tool: Frame) -> Frame:
        """Return the frame of the camera in the cell."""
        return tool @ self.frame if self.in_hand else self.frame


class DepthCamera:
    """A depth camera at `mount`, of `arm` where it is in a hand; `noise_m` is the deviation of distances."""

    def __init__(
        self,
        simulation: Simulation,
        arm: SimulatedArm,
        mount: CameraMount,
        intrinsics: Intrinsics,
        *,
        noise_m: float = 0.0005,
        seed: int = 0,
    ) -> None:
        self.mount = mount
        self.intrinsics = intrinsics
        self._simulation = simulation
        self._arm = arm
        self._noise_m = noise_m
        self._random = np.random.default_rng(seed)
        directions = intrinsics.directions().reshape(-1, 3)
        self._lengths = np.linalg.norm(directions, axis=1)
        self._directions = directions / self._lengths[:, None]

    def image(self, believed: CameraMount | None = None) -> DepthImage:
        """Return an image, in the frame of the cell for a camera that is mounted as `believed`."""
        return self.image_with_tool(believed or self.mount)[1]

    def image_with_tool(self, believed: CameraMount) -> tuple[Frame, DepthImage]:
        """Return the frame of the tip at the time of an image, and the image."""
        with self._simulation.lock:
            tool = self._arm.tool
            camera = self.mount.camera(tool)
            rays = self._directions @ np.array(camera.rotation).T
            ranges_m = self._simulation.cast_rays(np.array(camera.position), rays, MAX_RANGE_M)
        depth = ranges_m / self._lengths + self._random.normal(0.0, self._noise_m, len(ranges_m))
        size = (self.intrinsics.height, self.intrinsics.width)
        return tool, DepthImage(depth.reshape(size), self.intrinsics, believed.camera(tool))


def misaligned(mount: CameraMount, seed: int, offset_m: float, angle_deg: float) -> CameraMount:
    """Return a mount that is off by a distance and an angle in random directions, as fitters leave it."""
    random = np.random.default_rng(seed)
    axis, way = (vector / np.linalg.norm(vector) for vector in random.normal(size=(2, 3)))
    x, y, z = axis.tolist()
    angle = math.radians(angle_deg)
    c, s, t = math.cos(angle), math.sin(angle), 1 - math.cos(angle)
    rotation = (
        (t * x * x + c, t * x * y - s * z, t * x * z + s * y),
        (t * x * y + s * z, t * y * y + c, t * y * z - s * x),
        (t * x * z - s * y, t * y * z + s * x, t * z * z + c),
    )
    off_x, off_y, off_z = (offset_m * way).tolist()
    return CameraMount(mount.frame @ Frame(rotation, (off_x, off_y, off_z)), mount.in_hand)
