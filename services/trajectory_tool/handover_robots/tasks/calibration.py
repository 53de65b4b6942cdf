"""The operation `calibrateCamera`: where a camera is mounted, from balls that it sees.

The camera in the hand looks at one ball from several poses. The ball is an obstacle of the scene with the
shape of a sphere. Its place in the scene need not be exact: the calibration finds it together with the mount
of the camera. A fixed camera sees several balls at once, whose places in the scene must be exact.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Any

from handover.errors import HandoverError
from handover.messages import text_of
from handover.performer import TaskFailed
from handover_robots.cell.robot_unit import RobotUnit
from handover_robots.model.faults import NoPath, Unreachable
from handover_robots.model.poses import Frame, Pose, Vector, turn
from handover_robots.scene.vision import Vision
from handover_robots.tasks.parameters import CalibrateCamera
from handover_robots.tasks.work import Work

HAND = "hand"
"""The name of the camera in the hand."""

TILT_RAD = math.radians(18)
TURN_RAD = 0.9
NEAR_M, FAR_M = 0.25, 0.40
ASIDE_M = 0.07

VIEWS = (
    # turn about the vertical, tilts about x and y of the tool, distance of the tip, and how far it is aside
    (0.0, 0.0, 0.0, NEAR_M, 0.0, 0.0),
    (0.0, TILT_RAD, 0.0, FAR_M, ASIDE_M, 0.0),
    (0.0, -TILT_RAD, 0.0, NEAR_M, 0.0, -ASIDE_M),
    (0.0, 0.0, TILT_RAD, FAR_M, 0.0, ASIDE_M),
    (0.0, 0.0, -TILT_RAD, NEAR_M, -ASIDE_M, 0.0),
    (TURN_RAD, 0.0, 0.0, FAR_M, -ASIDE_M, -ASIDE_M),
    (TURN_RAD, TILT_RAD, TILT_RAD, NEAR_M, 0.0, 0.0),
    (TURN_RAD, -TILT_RAD, 0.0, FAR_M, 0.0, ASIDE_M),
    (-TURN_RAD, 0.0, TILT_RAD, NEAR_M, ASIDE_M, -ASIDE_M),
    (-TURN_RAD, TILT_RAD, -TILT_RAD, FAR_M, -ASIDE_M, 0.0),
    (-TURN_RAD, 0.0, -TILT_RAD, FAR_M, ASIDE_M, ASIDE_M),
    (-TURN_RAD, -TILT_RAD, TILT_RAD, NEAR_M, 0.0, 0.0),
)
"""Poses around a ball. The ball must be at different places of the image: otherwise a turn of the camera
about it looks like a shift."""


async def calibrate_camera(work: Work, request: CalibrateCamera) -> dict[str, Any]:
    """Find out where a camera is mounted from balls that it sees, and store it."""
    unit = work.unit
    vision = unit.robot.vision
    if vision is None:
        raise TaskFailed.translated(
            "robot.no_camera", "{robot} has no camera that can be calibrated", robot=unit.name
        )
    if request.camera is not None and request.camera != HAND:
        return await _calibrate_fixed(work, vision, request.camera, request.targets)
    place, radius_m = _ball(unit, request.target)
    samples = []
    for pose in views(place):
        try:
            joints = await work.plan(lambda planner, pose=pose: planner.nearest_free(pose, unit.joints))  # type: ignore[misc]
            work.intend(joints)
            await work.go(joints)
        except (Unreachable, NoPath, TaskFailed):
            continue  # other poses are enough
        sample = await vision.find_ball(place, radius_m)
        if sample is not None:
            samples.append(sample)
    try:
        result = await vision.calibrate(samples)
    except HandoverError as why:
        raise _not_calibrated(why) from None
    return {**result, "images": len(samples)}


async def _calibrate_fixed(work: Work, vision: Vision, camera: str, targets: Sequence[str]) -> dict[str, Any]:
    """Look at balls with a fixed camera; the robot stays where it is."""
    unit = work.unit
    if camera not in vision.fixed_cameras:
        raise TaskFailed.translated(
            "robot.unknown_camera",
            'parameter "camera" of calibrateCamera: there is no camera "{camera}"; the scene has {known}',
            camera=camera,
            known=", ".join(vision.fixed_cameras) or "none",
        )
    places: list[Vector] = []
    seen: list[Vector] = []
    missed: list[str] = []
    for name in targets or _spheres(unit):
        place, radius_m = _ball(unit, name)
        ball = await vision.find_ball(place, radius_m, camera)
        if ball is None:
            missed.append(name)
        else:
            places.append(place)
            seen.append(ball.ball)
    try:
        result = await vision.calibrate_fixed(camera, places, seen)
    except HandoverError as why:
        if not missed:
            raise _not_calibrated(why) from None
        raise TaskFailed.translated(
            "robot.camera_misses_balls",
            "the camera is not calibrated: {why}. It does not see {missed}: each ball must be where the "
            "scene has it, with nothing in front of it",
            why=text_of(why),
            missed=", ".join(missed),
        ) from None
    return {**result, "balls": len(seen)}


def _spheres(unit: RobotUnit) -> list[str]:
    return [name for name, thing in unit.scene.obstacles.items() if thing.sphere is not None]


def _ball(unit: RobotUnit, name: str) -> tuple[Vector, float]:
    """Return the place and the radius of a ball of the scene. Raises `TaskFailed`."""
    ball = unit.scene.obstacles.get(name)
    if ball is None or ball.sphere is None:
        raise TaskFailed.translated(
            "robot.no_ball",
            'the scene has no sphere "{target}"; its spheres: {known}. Name one of them, or put a ball '
            "into the cell and add it to the obstacles",
            target=name,
            known=", ".join(_spheres(unit)) or "none",
        )
    return ball.position, ball.sphere


def _not_calibrated(why: HandoverError) -> TaskFailed:
    return TaskFailed.translated(
        "robot.camera_not_calibrated", "the camera is not calibrated: {why}", why=text_of(why)
    )


def views(ball: Vector) -> Iterator[Pose]:
    """Yield poses of the tool around a ball."""
    for yaw, tilt_x, tilt_y, distance_m, aside_x, aside_y in VIEWS:
        down = _turned((1.0, 0.0, 0.0), math.pi)
        pointing = _turned((0.0, 0.0, 1.0), yaw) @ down @ _turned((1.0, 0.0, 0.0), tilt_x)
        pointing = pointing @ _turned((0.0, 1.0, 0.0), tilt_y)
        back = turn(pointing.rotation, (aside_x, aside_y, -distance_m))
        at = (ball[0] + back[0], ball[1] + back[1], ball[2] + back[2])
        yield Pose.of(Frame(pointing.rotation, at))


def _turned(axis: Vector, angle_rad: float) -> Frame:
    x, y, z = (math.sin(angle_rad / 2) * share for share in axis)
    return Pose((0.0, 0.0, 0.0), (x, y, z, math.cos(angle_rad / 2))).frame()
