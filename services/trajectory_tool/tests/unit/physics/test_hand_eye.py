"""Where a camera is mounted, from images of a ball."""

import math

import numpy as np
import pytest

from handover_robots.model.poses import NO_TURN, Frame, Vector
from handover_robots.perception.depth_image import DepthImage, Intrinsics
from handover_robots.perception.hand_eye import NotCalibrated, find_ball, fixed, in_hand
from handover_robots.physics.cameras import HAND_MOUNT
from handover_robots.physics.depth_camera import CameraMount, misaligned
from handover_robots.scene.vision import SeenBall
from handover_robots.tasks.calibration import views

BALL: Vector = (0.35, -0.65, 0.15)


def seen_by(mount: CameraMount, noise_m: float, count: int = 12) -> list[SeenBall]:
    random = np.random.default_rng(5)
    seen = []
    for pose in list(views(BALL))[:count]:
        tool = pose.frame()
        exact = (mount.camera(tool).inverse() @ Frame(NO_TURN, BALL)).position
        x, y, z = (np.array(exact) + random.normal(0, noise_m, 3)).tolist()
        seen.append(SeenBall(tool, (x, y, z)))
    return seen


def difference(first: Frame, second: Frame) -> tuple[float, float]:
    """Return the distance in m and the angle in degrees between two frames."""
    change = first.inverse() @ second
    trace = sum(change.rotation[axis][axis] for axis in range(3))
    return math.hypot(*change.position), math.degrees(math.acos(max(-1.0, min((trace - 1) / 2, 1.0))))


def test_a_mount_that_is_off_by_a_centimetre_and_three_degrees_is_found() -> None:
    mount = misaligned(HAND_MOUNT, 3, 0.01, 3.0)
    calibration = in_hand(seen_by(mount, 0.0002), HAND_MOUNT.frame)
    distance_m, angle_deg = difference(calibration.mount, mount.frame)
    assert distance_m < 0.001
    assert angle_deg < 0.2
    assert calibration.residual_m < 0.001


def test_too_few_images_are_refused_with_their_number() -> None:
    with pytest.raises(NotCalibrated, match="in 4 images, and 5 are needed"):
        in_hand(seen_by(HAND_MOUNT, 0.0, 4), HAND_MOUNT.frame)


def test_images_from_one_direction_are_refused() -> None:
    sample = seen_by(HAND_MOUNT, 0.0, 1)
    with pytest.raises(NotCalibrated, match="tilt the camera"):
        in_hand(sample * 6, HAND_MOUNT.frame)


def test_a_ball_that_was_moved_between_the_images_is_noticed() -> None:
    seen = seen_by(HAND_MOUNT, 0.0)
    x, y, z = seen[3].ball
    moved = [*seen[:3], SeenBall(seen[3].tool, (x + 0.05, y, z)), *seen[4:]]
    with pytest.raises(NotCalibrated, match="disagree"):
        in_hand(moved, HAND_MOUNT.frame)


def test_a_fixed_camera_is_found_from_balls_at_known_places() -> None:
    camera = misaligned(CameraMount(Frame(NO_TURN, (0.1, 0.2, 1.0)), in_hand=False), 1, 0.1, 40.0).frame
    balls: list[Vector] = [(0.0, 0.0, 0.0), (0.3, 0.0, 0.1), (0.0, 0.4, 0.0), (0.2, 0.2, 0.3)]
    seen = [(camera.inverse() @ Frame(NO_TURN, ball)).position for ball in balls]
    assert difference(fixed(balls, seen).mount, camera) == pytest.approx((0.0, 0.0), abs=1e-5)
    with pytest.raises(NotCalibrated, match="one line"):
        fixed([(0, 0, 0), (1, 0, 0), (2, 0, 0)], [(0, 0, 1), (1, 0, 1), (2, 0, 1)])


def test_a_ball_is_found_in_a_noisy_depth_image() -> None:
    intrinsics, radius, middle = Intrinsics.of_view(160, 120, 50.0), 0.03, np.array([0.02, -0.03, 0.4])
    rays = intrinsics.directions()
    squared, along = (rays**2).sum(axis=-1), rays @ middle
    with np.errstate(invalid="ignore"):
        depth = (along - np.sqrt(along**2 - squared * (middle @ middle - radius**2))) / squared
    depth += np.random.default_rng(1).normal(0, 0.0005, depth.shape)
    image = DepthImage(depth, intrinsics, Frame(NO_TURN, (0.0, 0.0, 0.0)))
    ball = find_ball(image, (0.03, -0.02, 0.41), radius)
    assert ball is not None
    assert math.dist(ball, middle.tolist()) < 0.001
    assert find_ball(image, (0.3, 0.3, 0.8), radius) is None


@pytest.mark.parametrize("seed", range(20))
def test_a_ball_near_a_table_is_found(seed: int) -> None:
    random = np.random.default_rng(seed)
    intrinsics, radius, table_m = Intrinsics.of_view(320, 240, 50.0), 0.03, random.uniform(0.5, 1.4)
    middle = np.array([*random.uniform(-0.15, 0.15, 2), table_m - radius - random.uniform(0.0, 0.03)])
    rays = intrinsics.directions()
    squared, along = (rays**2).sum(axis=-1), rays @ middle
    with np.errstate(invalid="ignore"):
        ball = (along - np.sqrt(along**2 - squared * (middle @ middle - radius**2))) / squared
    depth = np.fmin(ball, table_m) + random.normal(0, 0.0005, ball.shape)
    x, y, z = (middle + random.normal(0, 0.006, 3)).tolist()
    place = find_ball(DepthImage(depth, intrinsics, Frame(NO_TURN, (0.0, 0.0, 0.0))), (x, y, z), radius)
    assert place is not None
    assert math.dist(place, middle.tolist()) < 0.001


def test_a_ball_behind_something_is_not_seen() -> None:
    intrinsics = Intrinsics.of_view(320, 240, 50.0)
    depth = np.full((240, 320), 0.8)
    image = DepthImage(depth, intrinsics, Frame(NO_TURN, (0.0, 0.0, 0.0)))
    assert find_ball(image, (0.0, 0.0, 0.83), 0.03) is None
