"""Scans of a lidar and images of a depth camera become reports of people.

A point is a person unless it lies on the scene, on a robot, on the ground, or beyond the range of the sensor.
A sensor that measures too little, because it is covered or blinded, is refused: it is silent then.
"""

import base64
import binascii
import math
import time
from collections.abc import Callable, Sequence

import numpy as np

from handover.control.speed_limits import RefusedReport, require_new
from handover_datamodels.streams import MAX_PEOPLE, DepthReport, PeopleReport, ScanReport
from handover_robots.model.poses import Vector
from handover_robots.people.surroundings import Array, Surroundings, distances_from_chains
from handover_robots.people.tracking import Tracker, clusters
from handover_robots.perception.depth_image import DepthImage, Intrinsics
from handover_robots.scene.scene import PeopleSensor, Scene

ON_THING_M = 0.08
"""What is this near to the scene belongs to it."""
ON_ROBOT_M = 0.25
"""What is this near to the middle line of a link belongs to the robot."""
ABOVE_GROUND_M, BELOW_HEAD_M = 0.15, 2.2
COVERED_M = 0.05
MAX_COVERED, MAX_UNMEASURED = 0.2, 0.5
MIN_SCAN_POINTS, MIN_DEPTH_POINTS = 2, 8
MAX_POINTS = 4000
"""Of more points of an image, every second or third is used."""

Chains = Callable[[], Sequence[Sequence[Vector]]]
"""Returns, for each robot of the cell, the points along it from its base to the tip."""


class SceneSensors:
    """The sensors of people of a scene; `scene` returns the present one."""

    def __init__(
        self, scene: Callable[[], Scene], robots: Chains, wall_s: Callable[[], float] = time.time
    ) -> None:
        self._wall_s = wall_s
        self._scene = scene
        self._robots = robots
        self._digest = ""
        self._surroundings = Surroundings(())
        self._trackers: dict[str, Tracker] = {}
        self._stamps: dict[str, float] = {}

    def of_scan(self, scan: ScanReport) -> PeopleReport:
        """Return the people of a scan. Raises `RefusedReport`."""
        sensor = self._sensor(scan.source, "lidar")
        ranges = np.array([np.nan if range_m is None else range_m for range_m in scan.ranges])
        covered = float(np.mean(ranges < COVERED_M))
        if covered > MAX_COVERED:
            raise RefusedReport(f"{covered:.0%} of the ranges are below {COVERED_M} m; uncover {scan.source}")
        angles = scan.angle_min + scan.angle_increment * np.arange(len(ranges))
        local = np.stack([np.cos(angles), np.sin(angles), np.zeros(len(angles))], axis=1) * ranges[:, None]
        near = (ranges >= COVERED_M) & (ranges <= sensor.range_m)
        points = local[near] @ np.array(sensor.pose.frame().rotation).T + np.array(sensor.position)
        return self._report(scan, self._of_people(points), MIN_SCAN_POINTS)

    def of_depth(self, image: DepthReport) -> PeopleReport:
        """Return the people of a depth image. Raises `RefusedReport`."""
        sensor = self._sensor(image.source, "depthCamera")
        depth_m = _depth_m(image)
        unmeasured = float(np.mean(np.isnan(depth_m)))
        if unmeasured > MAX_UNMEASURED:
            raise RefusedReport(f"{unmeasured:.0%} of the pixels have no depth; check {image.source}")
        intrinsics = Intrinsics.of_view(image.width, image.height, sensor.field_of_view_deg)
        seen = DepthImage(depth_m, intrinsics, sensor.optical_frame)
        points, away_m = seen.points.reshape(-1, 3), np.linalg.norm(seen.camera_points.reshape(-1, 3), axis=1)
        height = points[:, 2] - sensor.ground_m
        near = (away_m <= sensor.range_m) & (height > ABOVE_GROUND_M) & (height < BELOW_HEAD_M)
        points = points[near]
        points = points[:: math.ceil(len(points) / MAX_POINTS) or 1]
        return self._report(image, self._of_people(points), MIN_DEPTH_POINTS)

    def _sensor(self, name: str, kind: str) -> PeopleSensor:
        scene = self._scene()
        if scene.digest != self._digest:
            self._digest, self._surroundings = scene.digest, Surroundings(scene.things())
        sensor = scene.people_sensors.get(name)
        if sensor is None or sensor.kind != kind:
            sensors = [
                sensor_name for sensor_name, placed in scene.people_sensors.items() if placed.kind == kind
            ]
            raise RefusedReport(
                f'the scene has no {kind} "{name}"; it has {", ".join(sensors) or "none"}; add it to '
                "people_sensors of the scene"
            )
        return sensor

    def _of_people(self, points: Array) -> Array:
        is_person = self._surroundings.distances_m(points) > ON_THING_M
        is_person &= distances_from_chains(points, self._robots()) > ON_ROBOT_M
        return points[is_person]

    def _report(self, measured: ScanReport | DepthReport, points: Array, min_points: int) -> PeopleReport:
        require_new(measured.stamp, self._stamps.get(measured.source), self._wall_s())
        things = clusters(points, min_points)
        if len(things) > MAX_PEOPLE:
            raise RefusedReport(
                f"{len(things)} things are not in the scene; at most {MAX_PEOPLE} are followed"
            )
        tracker = self._trackers.setdefault(measured.source, Tracker(measured.source))
        self._stamps[measured.source] = measured.stamp
        return PeopleReport(
            source=measured.source,
            stamp=measured.stamp,
            period=measured.period,
            people=tracker.people(things, measured.stamp),
        )


def _depth_m(image: DepthReport) -> Array:
    try:
        raw = base64.b64decode(image.depth, validate=True)
    except binascii.Error as error:
        raise RefusedReport(f"depth is not base64: {error}") from None
    if len(raw) != 2 * image.width * image.height:
        raise RefusedReport(f"depth has {len(raw)} bytes, not 2 for each of {image.width} x {image.height}")
    millimetres = np.frombuffer(raw, dtype="<u2").reshape(image.height, image.width)
    return np.where(millimetres > 0, millimetres / 1000.0, np.nan)
