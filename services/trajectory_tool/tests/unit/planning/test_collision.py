import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover.errors import UsageError
from handover_robots.model.obstacles import Attached, Box, Capsule, Cylinder, Mesh, Obstacle, Sphere, World
from handover_robots.model.poses import Pose
from handover_robots.planning.arm import Arm
from handover_robots.planning.collision import Collisions, geometry_of
from handover_robots.planning.motions import Motions
from handover_robots.planning.tracked_distances import HORIZON_M, SHARE, TrackedDistances
from handover_robots.robots import ROBOTS

MARGIN_M = 0.01
GJK_TOLERANCE_M = 1e-5
TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
STRAIGHT = (0.0, 0.0, 0.0, 1.0)


@pytest.fixture(scope="module", params=["ur10", "ur5e", "panda"])
def arm(request: pytest.FixtureRequest) -> Arm:
    return Arm(ROBOTS.load(request.param))


def samples(arm: Arm, count: int, seed: int = 3) -> Any:
    low, high = np.maximum(arm.lower, -np.pi), np.minimum(arm.upper, np.pi)
    return np.random.default_rng(seed).uniform(low, high, (count, arm.n))


def test_every_named_pose_is_free(arm: Arm, cell: World) -> None:
    collisions = Collisions(arm, cell)
    for name, joints in arm.model.poses.items():
        assert collisions.is_free(np.array(joints), 0.015), name


def test_a_check_with_a_margin_agrees_with_the_distances(arm: Arm, cell: World) -> None:
    collisions = Collisions(arm, cell)
    free = 0
    for joints in samples(arm, 300):
        closest_m = min(distance.distance_m for distance in collisions.distances(joints))
        for margin_m in (0.0, 0.01, 0.04):
            if abs(closest_m - margin_m) > 1e-4:
                assert collisions.is_free(joints, margin_m) == (closest_m > margin_m)
        free += closest_m > 0
    assert 30 < free < 290


places = st.tuples(*(st.floats(-0.9, 0.9) for _ in range(3)))
turns = (
    st.tuples(*(st.floats(-1.0, 1.0) for _ in range(4))).map(np.array).filter(lambda turn: turn @ turn > 0.1)
)
poses = st.builds(lambda place, turn: Pose(place, tuple(turn / np.linalg.norm(turn))), places, turns)
lengths = st.floats(0.01, 0.5)
shapes = st.one_of(
    st.builds(Box, st.tuples(lengths, lengths, lengths)),
    st.builds(Cylinder, lengths, lengths),
    st.builds(Capsule, lengths, lengths),
    st.builds(Sphere, lengths),
)
obstacles = st.builds(lambda shape, pose: Obstacle("thing", shape, pose), shapes, poses)
held = st.builds(
    lambda size: Attached("part", Box(size), Pose((0.0, 0.0, 0.1), STRAIGHT)), st.tuples(*[lengths] * 3)
)


@given(st.lists(obstacles, max_size=4), st.lists(held, max_size=1), st.integers(0, 10_000))
def test_the_closest_pair_is_that_of_all_distances(
    arm: Arm, world: list[Obstacle], carried: list[Attached], seed: int
) -> None:
    collisions = Collisions(arm, World(tuple(world), tuple(carried)))
    for joints in samples(arm, 5, seed):
        expected_m = min(distance.distance_m for distance in collisions.distances(joints))
        assert collisions.closest(joints).distance_m == pytest.approx(expected_m, abs=GJK_TOLERANCE_M)


@given(st.lists(obstacles, max_size=4), st.lists(held, max_size=1), st.floats(0.0, 0.5))
def test_the_distances_below_a_horizon_are_exact(
    arm: Arm, world: list[Obstacle], carried: list[Attached], horizon_m: float
) -> None:
    collisions = Collisions(arm, World(tuple(world), tuple(carried)))
    for joints in samples(arm, 5):
        expected = [distance for distance in collisions.distances(joints) if distance.distance_m < horizon_m]
        clearances = collisions.within(joints, horizon_m)
        assert sorted((clearance.first, clearance.second) for clearance in clearances) == sorted(
            (clearance.first, clearance.second) for clearance in expected
        )
        assert sorted(clearance.distance_m for clearance in clearances) == pytest.approx(
            sorted(clearance.distance_m for clearance in expected), abs=GJK_TOLERANCE_M
        )


turned_by = st.one_of(st.floats(0.0, 0.01), st.floats(0.0, 3.0))


@given(
    st.lists(obstacles, max_size=4),
    st.lists(held, max_size=1),
    st.lists(turned_by, min_size=2, max_size=12),
    st.integers(0, 10_000),
)
def test_tracked_distances_are_exact_below_the_horizon_and_within_their_radius_elsewhere(
    arm: Arm, world: list[Obstacle], carried: list[Attached], turns_rad: list[float], seed: int
) -> None:
    collisions = Collisions(arm, World(tuple(world), tuple(carried)))
    tracked = TrackedDistances(collisions)
    random = np.random.default_rng(seed)
    (joints,) = samples(arm, 1, seed)
    for turn_rad in turns_rad:
        joints = np.clip(joints + turn_rad * random.uniform(-1, 1, arm.n), arm.lower, arm.upper)
        tracked.update(joints)
        exact_m = np.array([distance.distance_m for distance in collisions.distances(joints)])
        error_m = np.abs(exact_m - tracked.distances_m)
        assert np.all(error_m <= tracked.radii_m + GJK_TOLERANCE_M)
        assert np.all(error_m[exact_m < HORIZON_M] <= GJK_TOLERANCE_M)
        assert np.all(tracked.radii_m <= SHARE * np.maximum(tracked.distances_m - HORIZON_M, 0.0))
        closest = tracked.closest()
        assert closest is not None
        assert closest.distance_m == pytest.approx(exact_m.min(), abs=GJK_TOLERANCE_M)


def test_along_a_slow_motion_few_distances_are_computed(arm: Arm, cell: World) -> None:
    collisions = Collisions(arm, cell)
    tracked = TrackedDistances(collisions)
    home, cycles = np.array(arm.model.home), 200
    for turn_rad in np.linspace(0.0, 0.2, cycles):
        tracked.update(home + turn_rad)
    assert tracked.computed < 0.3 * cycles * collisions.pairs
    here = tracked.computed
    tracked.update(home + 0.2)
    assert tracked.computed == here, "at rest, everything is known"


@pytest.mark.parametrize("kept", ["", "forearm_tube|wrist_3", "foot"])
@pytest.mark.parametrize(
    "around", [World(), World((Obstacle("ball", Sphere(0.1), Pose((0.9, 0.0, 0.5), STRAIGHT)),))]
)
def test_the_closest_pair_of_a_robot_with_few_collision_shapes_is_that_of_all_distances(
    kept: str, around: World
) -> None:
    model = ROBOTS.load("ur10")
    shapes = re.findall(r'<collision name="[^"]*">.*?</collision>', model.urdf, re.DOTALL)
    urdf = re.sub(r"<!--.*?-->|<collision_checking>.*?</collision_checking>", "", model.urdf, flags=re.DOTALL)
    for shape in shapes:
        if not kept or not re.search(kept, shape):
            urdf = urdf.replace(shape, "")
    few = Arm(replace(model, urdf=urdf))
    collisions = Collisions(few, around)
    for joints in samples(few, 20):
        expected_m = min(distance.distance_m for distance in collisions.distances(joints))
        assert collisions.closest(joints).distance_m == pytest.approx(expected_m, abs=GJK_TOLERANCE_M)


def test_the_closest_pair_of_a_hull_is_that_of_all_distances(arm: Arm, tmp_path: Path) -> None:
    file = tmp_path / "wedge.obj"
    file.write_text(TETRAHEDRON)
    piece = Obstacle("piece", Mesh(file, (0.3, 0.2, 0.4)), Pose((0.5, 0.2, 0.3), STRAIGHT))
    collisions = Collisions(arm, World((piece,)))
    for joints in samples(arm, 200):
        expected_m = min(distance.distance_m for distance in collisions.distances(joints))
        assert collisions.closest(joints).distance_m == pytest.approx(expected_m, abs=GJK_TOLERANCE_M)


def test_an_arm_folded_into_itself_is_in_contact_with_itself() -> None:
    arm = Arm(ROBOTS.load("ur10"))
    collisions = Collisions(arm, World())
    folded = np.array([0.0, -1.5, 3.0, 0.0, 0.0, 0.0])
    pairs = {frozenset((contact.first, contact.second)) for contact in collisions.contacts(folded)}
    assert frozenset(("upper_arm", "wrist_1")) in pairs


def test_the_colliding_pair_is_named(arm: Arm) -> None:
    tip = arm.tool_pose(arm.model.home)
    ball = World((Obstacle("ball", Sphere(0.05), Pose(tip.position, STRAIGHT)),))
    contacts = Collisions(arm, ball).contacts(np.array(arm.model.home))
    assert contacts[0].second == "ball"
    assert contacts[0].distance_m < 0


def test_an_allowed_pair_may_touch(arm: Arm) -> None:
    home = np.array(arm.model.home)
    tip = arm.tool_pose(home)
    ball = Obstacle("ball", Sphere(0.05), Pose(tip.position, STRAIGHT))
    touching = {contact.first for contact in Collisions(arm, World((ball,))).contacts(home)}
    allowed = World((ball,), allowed=frozenset((link, "ball") for link in touching))
    assert touching
    assert Collisions(arm, allowed).is_free(home)


def test_a_held_part_collides_where_the_gripper_alone_does_not(arm: Arm) -> None:
    home = np.array(arm.model.home)
    below = arm.tool(home).act(np.array([0.0, 0.0, 0.15]))
    plate = Obstacle("plate", Box((0.1, 0.1, 0.01)), Pose(tuple(below.tolist()), STRAIGHT))
    rod = Attached("rod", Box((0.02, 0.02, 0.3)), Pose((0.0, 0.0, 0.1), STRAIGHT))
    assert Collisions(arm, World((plate,))).is_free(home)
    held = Collisions(arm, World((plate,), (rod,)))
    assert {(contact.first, contact.second) for contact in held.contacts(home)} == {("rod", "plate")}


@pytest.mark.nightly
def test_nothing_touches_on_a_certified_line(arm: Arm, cell: World) -> None:
    collisions = Collisions(arm, cell)
    motions = Motions(collisions, MARGIN_M)
    states = [joints for joints in samples(arm, 400, seed=4) if motions.is_state_free(joints)]
    certified = refused = 0
    for start, target in pairwise(states):
        end = start + 0.4 * (target - start)
        dense = start + np.linspace(0, 1, 250)[:, None] * (end - start)
        touches = not all(collisions.is_free(joints) for joints in dense)
        if motions.is_free(start, end):
            assert not touches
            certified += 1
            assert motions.are_samples_free(dense)
            assert motions.are_samples_free(np.array([start, end]))
        elif touches:
            refused += 1
            for step in (1, 3, 83, 249):  # the divisors of 249, so that the end is a sample
                assert not motions.are_samples_free(dense[::step])
            contact = motions.first_contact([start, end])
            assert contact is not None
            assert not motions.is_state_free(contact)
    assert certified > 20
    assert refused > 5


def test_a_mesh_counts_as_its_convex_hull(tmp_path: Path) -> None:
    file = tmp_path / "tetrahedron.obj"
    file.write_text(TETRAHEDRON)
    hull = geometry_of(Mesh(file, (0.1, 0.1, 0.1)))
    assert hull.num_points == 4
    arm = Arm(ROBOTS.load("ur10"))
    tip = arm.tool_pose(arm.model.home)
    world = World((Obstacle("piece", Mesh(file, (0.2, 0.2, 0.2)), Pose(tip.position, STRAIGHT)),))
    assert not Collisions(arm, world).is_free(np.array(arm.model.home))


@pytest.mark.parametrize("content", [None, b"solid nothing", b"\x00" * 100])
def test_a_mesh_that_cannot_be_used_is_named(tmp_path: Path, content: bytes | None) -> None:
    file = tmp_path / "broken.stl"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(UsageError, match=r"broken\.stl"):
        geometry_of(Mesh(file))


def test_a_huge_mesh_is_refused_before_it_is_read(tmp_path: Path) -> None:
    file = tmp_path / "huge.stl"
    with file.open("wb") as opened:
        opened.truncate(400 * 1024 * 1024)
    with pytest.raises(UsageError, match=r"has 400 MB; reduce it to 20 MB"):
        geometry_of(Mesh(file))
