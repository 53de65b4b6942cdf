"""Depth images of the simulated bin, the parts and grasps in them."""

import math

import numpy as np
import pytest

from handover.messages import Message
from handover_robots.model.poses import Pose
from handover_robots.perception.grasps import Fingers, Grasp, GraspFinder
from handover_robots.perception.segmentation import SeenPart, find_parts
from handover_robots.physics.cameras import HAND_CAMERA, Cameras
from handover_robots.physics.simulation import Simulation
from handover_robots.physics.vision import inside_of
from handover_robots.physics.world_model import build, fingers_of
from handover_robots.robots import ROBOTS
from handover_robots.robots.ur10 import ROBOT
from handover_robots.scene.scene import Scene

X, Y, BOTTOM = -0.55, -0.535, 0.012
LYING_M = BOTTOM + 0.012
HALF_TURN = math.pi / 2


def turned(x: float, y: float, z: float, yaw: float = 0.0) -> Pose:
    return Pose((x, y, z), (0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)))


STANDING = (math.sin(math.pi / 4), 0.0, 0.0, math.cos(math.pi / 4))


@pytest.fixture(scope="module")
def fingers() -> Fingers:
    return fingers_of(ROBOT)


def look(scene: Scene, *poses: Pose) -> tuple[list[SeenPart], GraspFinder]:
    """Return what the camera in the hand sees of parts at poses in the bin."""
    view = ROBOT.reach(scene.bins["bin-1"].view.pose, ROBOT.home)
    simulation = Simulation(build({"ur10-1": ROBOT}, scene, len(poses)), {"ur10-1": view})
    for part, pose in enumerate(poses):
        simulation.put(part, pose)
    camera = Cameras(simulation, simulation.arm, scene, seed=1)[HAND_CAMERA]
    image = camera.image()
    walls = scene.bins["bin-1"].walls
    assert walls is not None
    inside = inside_of(walls)
    size = scene.gripper.part_size_m
    assert size is not None
    return find_parts(image, inside, size), GraspFinder(image, inside, fingers_of(ROBOT))


def first(grasps: tuple[Grasp, ...] | Message) -> Grasp:
    assert not isinstance(grasps, Message), grasps
    return grasps[0]


def test_the_fingers_are_read_from_the_urdf(fingers: Fingers) -> None:
    assert fingers.opening == pytest.approx(0.068)
    assert fingers.thickness == pytest.approx(0.012)
    assert fingers.length == pytest.approx(0.066)


def test_fingers_that_close_along_y_and_end_beyond_the_tip_have_a_frame_of_their_own() -> None:
    of_panda = fingers_of(ROBOTS.load("panda"))
    assert of_panda.opening == pytest.approx(0.08, abs=2e-4)
    assert of_panda.length == pytest.approx(0.0542, abs=3e-4)
    assert of_panda.thickness < 0.021, "of the end; it is thicker at the hand"
    assert of_panda.frame.position == pytest.approx((0.0, 0.0, 0.0095), abs=1e-4)
    assert [row[0] for row in of_panda.frame.rotation] == [0.0, 1.0, 0.0], "x of the fingers is y of the tip"


def test_every_robot_with_a_gripper_can_be_simulated(scene: Scene) -> None:
    for name in ("ur10", "ur5e", "panda"):
        model = ROBOTS.load(name)
        simulation = Simulation(build({"arm": model}, Scene(name="empty"), 1), {"arm": model.home})
        simulation.step(50)
        assert simulation.arm.positions == pytest.approx(model.home, abs=1e-3)


def test_an_empty_bin_has_no_parts(scene: Scene) -> None:
    parts, _ = look(scene)
    assert parts == []


@pytest.mark.parametrize("yaw", [0.0, 0.4, 1.2])
def test_a_lying_part_is_found_within_two_millimetres_and_three_degrees(scene: Scene, yaw: float) -> None:
    (part,), _ = look(scene, turned(X, Y, LYING_M, yaw))
    assert math.dist(part.pose.position, (X, Y, LYING_M)) < 0.002
    long_axis = np.array(part.pose.rotation)[:, part.size.index(0.06)]
    off = abs(float(long_axis @ [-math.sin(yaw), math.cos(yaw), 0.0]))
    assert off > math.cos(math.radians(3))


def test_a_standing_part_is_known_by_its_face(scene: Scene) -> None:
    (part,), _ = look(scene, Pose((X, Y, BOTTOM + 0.03), STANDING))
    assert part.size[2] == pytest.approx(0.06)
    assert math.dist(part.pose.position, (X, Y, BOTTOM + 0.03)) < 0.003


def test_two_parts_side_by_side_are_found_separately(scene: Scene) -> None:
    places = [(X - 0.012, Y), (X + 0.0122, Y)]
    parts, finder = look(scene, *(turned(x, y, LYING_M) for x, y in places))
    assert len(parts) == 2
    for x, y in places:
        assert min(math.dist(part.pose.position[:2], (x, y)) for part in parts) < 0.004
    for part in parts:  # the fingers do not fit between them: only the ends can be gripped
        closing = np.array(first(finder.grasps(part)).tool.rotation)[:, 0]
        assert abs(closing[1]) > 0.9


def test_the_highest_part_comes_first(scene: Scene) -> None:
    below, above = turned(X, Y, LYING_M), turned(X, Y, LYING_M + 0.024, HALF_TURN)
    parts, _ = look(scene, below, above)
    assert parts[0].top_m == pytest.approx(BOTTOM + 0.048, abs=0.002)


def test_a_free_part_is_gripped_across_its_short_side_from_above(scene: Scene) -> None:
    (part,), finder = look(scene, turned(X, Y, LYING_M))
    best = first(finder.grasps(part))
    rotation = np.array(best.tool.rotation)
    assert rotation[2, 2] < -0.99
    assert abs(rotation[0, 0]) > 0.99
    assert math.dist(best.tool.position[:2], (X, Y)) < 0.005
    assert best.tool.position[2] > BOTTOM + 0.003


def test_a_part_along_a_wall_is_gripped_at_its_ends(scene: Scene) -> None:
    (part,), finder = look(scene, turned(X - 0.188 + 0.013, Y, LYING_M))
    assert abs(np.array(first(finder.grasps(part)).tool.rotation)[1, 0]) > 0.9


def test_a_part_in_a_corner_has_no_grasp_and_the_reason_names_the_wall(scene: Scene) -> None:
    (part,), finder = look(scene, turned(X - 0.188 + 0.0135, Y - 0.188 + 0.0315, LYING_M))
    reason = finder.grasps(part)
    assert isinstance(reason, Message)
    assert "wall" in reason
