"""Simulated sensors of people, by ray casting into a scene: a lidar and a depth camera, with noise."""

import base64
import math
from collections.abc import Sequence

import numpy as np

from handover_datamodels.streams import DepthReport, ScanReport
from handover_robots.limits.separation import Point
from handover_robots.model.obstacles import Box, Cylinder, Obstacle
from handover_robots.model.poses import Pose
from handover_robots.people.surroundings import Array, Surroundings
from handover_robots.perception.depth_image import Intrinsics
from handover_robots.scene.scene import PeopleSensor, Scene

PERSON_RADIUS_M, PERSON_M = 0.22, 1.75
GROUND_M = 20.0
INCREMENT_RAD = math.radians(0.5)
VIEW_RAD = math.radians(270)
WIDTH, HEIGHT = 80, 60
UPRIGHT = (0.0, 0.0, 0.0, 1.0)


class SimulatedSensor:
    """The sensor `name` of a scene. Raises `KeyError` if the scene has none."""

    def __init__(self, scene: Scene, name: str, *, noise_m: float = 0.01, seed: int = 0) -> None:
        self.name = name
        self.sensor: PeopleSensor = scene.people_sensors[name]
        self._things = scene.things()
        self._noise_m = noise_m
        self._random = np.random.default_rng(seed)

    def measure(self, people: Sequence[Point], stamp_s: float) -> ScanReport | DepthReport:
        """Return what the sensor measures with people at these places."""
        lidar = self.sensor.kind == "lidar"
        return self._scan(people, stamp_s) if lidar else self._depth(people, stamp_s)

    def _scan(self, people: Sequence[Point], stamp_s: float) -> ScanReport:
        count = round(VIEW_RAD / INCREMENT_RAD) + 1
        angles = -VIEW_RAD / 2 + INCREMENT_RAD * np.arange(count)
        local = np.stack([np.cos(angles), np.sin(angles), np.zeros(count)], axis=1)
        directions = local @ np.array(self.sensor.pose.frame().rotation).T
        ranges = self._cast(people, directions, 2 * self.sensor.range_m)
        return ScanReport(
            source=self.name,
            stamp=stamp_s,
            angle_min=-VIEW_RAD / 2,
            angle_increment=INCREMENT_RAD,
            ranges=tuple(
                None if math.isnan(range_m) else max(round(range_m, 4), 0.0) for range_m in ranges.tolist()
            ),
        )

    def _depth(self, people: Sequence[Point], stamp_s: float) -> DepthReport:
        intrinsics = Intrinsics.of_view(WIDTH, HEIGHT, self.sensor.field_of_view_deg)
        rays = intrinsics.directions().reshape(-1, 3)
        lengths = np.linalg.norm(rays, axis=1)
        directions = (rays / lengths[:, None]) @ np.array(self.sensor.optical_frame.rotation).T
        depth_m = self._cast(people, directions, 2 * self.sensor.range_m) / lengths
        millimetres = np.clip(np.nan_to_num(depth_m * 1000.0), 0, 65535).round().astype("<u2")
        return DepthReport(
            source=self.name,
            stamp=stamp_s,
            width=WIDTH,
            height=HEIGHT,
            depth=base64.b64encode(millimetres.tobytes()).decode(),
        )

    def _cast(self, people: Sequence[Point], directions: Array, max_m: float) -> Array:
        ground_m = self.sensor.ground_m
        world = [
            *self._things,
            Obstacle("ground", Box((GROUND_M, GROUND_M, 0.1)), Pose((0.0, 0.0, ground_m - 0.05), UPRIGHT)),
        ]
        for x, y in people:
            middle = (x, y, ground_m + PERSON_M / 2)
            world.append(Obstacle("person", Cylinder(PERSON_RADIUS_M, PERSON_M), Pose(middle, UPRIGHT)))
        ranges_m = Surroundings(world).ranges_m(np.array(self.sensor.position), directions, max_m)
        return np.asarray(ranges_m + self._random.normal(0.0, self._noise_m, len(ranges_m)))
