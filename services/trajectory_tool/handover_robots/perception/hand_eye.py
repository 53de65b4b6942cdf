"""Where a camera is mounted, from images of a ball (hand-eye calibration).

A camera in the hand sees a ball that lies still at an unknown place, from several poses of the tool. With the
mount X of the camera in the frame of the tip, the pose T of the tip and the middle c of the ball in the
frame of the camera, T X c is the same place p for all images. X and p are found by Gauss-Newton from the
nominal mount; tilts about two axes are needed. A fixed camera sees balls at known places, at least three that
are not in one line; the rotation and translation between both sets of points are its mount.

    position of the ball = T_i X c_i        six unknowns of X and three of p, three equations an image
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from handover.errors import TranslatedError
from handover_robots.model.poses import Frame, Vector
from handover_robots.perception.depth_image import Array, DepthImage, frame_of
from handover_robots.scene.vision import SeenBall

MIN_IMAGES = 5
MIN_BALLS = 3
MIN_POINTS = 30
MAX_RESIDUAL_M = 0.004
MAX_CONDITION = 1e4
SEARCH_M = 0.04
"""The ball is looked for this far around its expected place."""

STARTS_M = (0.0, 0.02, -0.02, 0.04)
"""The fit begins at the expected place and so much nearer: else a surface behind may attract it."""

BANDS_M = (0.03, 0.02, 0.015, 0.01, 0.008, 0.006, 0.004, 0.003, 0.003, 0.003)
CAP = 0.9
"""The part of the radius within which a ray counts: at the rim, a pixel may see what is behind the ball."""
MIN_SHARE = 0.7
"""So many of the rays through the ball must end at its surface."""


class NotCalibrated(TranslatedError):
    """The images do not determine the mount; the message has the reason."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """The mount of a camera, and the root mean square of what is left of the differences."""

    mount: Frame
    residual_m: float


def find_ball(image: DepthImage, expected: Vector, radius_m: float) -> Vector | None:
    """Return the middle of a ball in the frame of the camera, None if it is not seen near `expected`.

    Only rays that pass through the ball count, so that a table or a stand beside it has no part in the fit.
    """
    points = image.camera_points.reshape(-1, 3)
    rays = image.intrinsics.directions().reshape(-1, 3)
    rays = rays / np.linalg.norm(rays, axis=1)[:, None]
    start = np.array(expected)
    toward = start / np.linalg.norm(start)
    with np.errstate(invalid="ignore"):
        is_near = np.linalg.norm(points - start, axis=1) < radius_m + SEARCH_M
    best, best_share = None, MIN_SHARE
    for nearer_m in STARTS_M:
        fit = _fitted(points[is_near], rays[is_near], start - nearer_m * toward, radius_m)
        if fit is None:
            continue
        middle, count = fit
        share = count / int((_distance_of_rays(rays, middle) < CAP * radius_m).sum())
        if share > best_share:
            best, best_share = middle, share
    if best is None:
        return None
    x, y, z = best.tolist()
    return (x, y, z)


def _fitted(points: Array, rays: Array, middle: Array, radius_m: float) -> tuple[Array, int] | None:
    """Return the middle of the ball that fits the points best, and how many of them are on its surface."""
    for band_m in BANDS_M:
        away = points - middle
        distances = np.linalg.norm(away, axis=1)
        at_surface = np.abs(distances - radius_m) < band_m
        at_surface &= _distance_of_rays(rays, middle) < CAP * radius_m + band_m - BANDS_M[-1]
        if int(at_surface.sum()) < MIN_POINTS:
            return None
        directions = away[at_surface] / distances[at_surface, None]
        step, *_ = np.linalg.lstsq(directions, distances[at_surface] - radius_m, rcond=None)
        middle = middle + step
    return middle, int(at_surface.sum())


def _distance_of_rays(rays: Array, middle: Array) -> Array:
    """Return how far rays of unit length from the camera pass by a place, in m."""
    along = rays @ middle
    return np.asarray(np.sqrt(np.maximum(middle @ middle - along**2, 0.0)))


def in_hand(samples: Sequence[SeenBall], nominal: Frame) -> Calibration:
    """Return the mount of a camera in the hand. Raises `NotCalibrated`."""
    if len(samples) < MIN_IMAGES:
        raise _too_few(len(samples), MIN_IMAGES)
    rotation, translation = np.array(nominal.rotation), np.array(nominal.position)
    tools = [(np.array(sample.tool.rotation), np.array(sample.tool.position)) for sample in samples]
    seen = [np.array(sample.ball) for sample in samples]
    place = np.mean(
        [r @ (rotation @ c + translation) + t for (r, t), c in zip(tools, seen, strict=True)], axis=0
    )
    for _ in range(20):
        rows, residuals = [], []
        for (turn, shift), ball in zip(tools, seen, strict=True):
            turned = rotation @ ball
            rows.append(np.hstack([-turn @ _cross(turned), turn, -np.eye(3)]))
            residuals.append(turn @ (turned + translation) + shift - place)
        jacobian, residual = np.vstack(rows), np.concatenate(residuals)
        if float(np.linalg.cond(jacobian)) > MAX_CONDITION:
            raise NotCalibrated.translated(
                "robot.camera_poses_alike",
                "the poses of the images are too much alike; tilt the camera about two axes",
            )
        step = -np.linalg.lstsq(jacobian, residual, rcond=None)[0]
        rotation = _turn(step[:3]) @ rotation
        translation, place = translation + step[3:6], place + step[6:]
        if float(np.abs(step).max()) < 1e-10:
            break
    return _checked(rotation, translation, residual.reshape(-1, 3))


def fixed(balls: Sequence[Vector], seen: Sequence[Vector]) -> Calibration:
    """Return the mount of a camera that sees balls at known places. Raises `NotCalibrated`."""
    if len(balls) < MIN_BALLS:
        raise NotCalibrated.translated(
            "robot.too_few_balls",
            "the camera sees {seen} balls, and {needed} are needed; put more of them into its view",
            seen=len(balls),
            needed=MIN_BALLS,
        )
    places, measured = np.array(balls), np.array(seen)
    from_known, from_found = places - places.mean(axis=0), measured - measured.mean(axis=0)
    u, sizes, v = np.linalg.svd(from_found.T @ from_known)
    if sizes[1] < 1e-6 * max(sizes[0], 1e-12):
        raise NotCalibrated.translated(
            "robot.balls_in_line", "the balls are in one line; move one of them aside"
        )
    mirror = np.diag([1.0, 1.0, np.sign(np.linalg.det(v.T @ u.T))])
    rotation = v.T @ mirror @ u.T
    translation = places.mean(axis=0) - rotation @ measured.mean(axis=0)
    return _checked(rotation, translation, measured @ rotation.T + translation - places)


def _checked(rotation: Array, translation: Array, residuals: Array) -> Calibration:
    left_m = float(np.sqrt((residuals**2).sum(axis=1).mean()))
    if left_m > MAX_RESIDUAL_M:
        raise NotCalibrated.translated(
            "robot.camera_residual",
            "the images disagree by {residual} mm; hold the ball still and check its radius",
            residual=f"{1000 * left_m:.1f}",
        )
    return Calibration(frame_of(rotation[:, 0], rotation[:, 1], rotation[:, 2], translation), left_m)


def _too_few(seen: int, needed: int) -> NotCalibrated:
    return NotCalibrated.translated(
        "robot.ball_rarely_seen",
        "the ball was found in {seen} images, and {needed} are needed; move it into the view",
        seen=seen,
        needed=needed,
    )


def _cross(vector: Array) -> Array:
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _turn(vector: Array) -> Array:
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return np.eye(3)
    k = _cross(vector / angle)
    return np.asarray(np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * (k @ k))
