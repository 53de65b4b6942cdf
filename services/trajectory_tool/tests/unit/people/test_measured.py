"""Scans and depth images of simulated sensors become people, and a sensor that sees too little is refused."""

import base64
import math
from collections.abc import Iterator
from itertools import count
from typing import Any

import numpy as np
import pytest

from handover.control.speed_limits import RefusedReport
from handover_datamodels.streams import DepthReport, PeopleReport, ScanReport
from handover_robots.limits.separation import Separation, SeparationRule, distance_from
from handover_robots.model.obstacles import Box, Cylinder, Obstacle, Sphere
from handover_robots.model.poses import Pose
from handover_robots.people.measured import SceneSensors
from handover_robots.people.simulation import SimulatedSensor
from handover_robots.people.surroundings import Surroundings
from handover_robots.people.tracking import Cluster, Tracker, clusters
from handover_robots.scene.scene import Scene

UPRIGHT = (0.0, 0.0, 0.0, 1.0)
ARM = [(0.0, 0.0, 0.0), (0.0, 0.0, 0.8), (0.6, 0.0, 0.8)]
SCENE = Scene.model_validate(
    {
        "name": "cell",
        "obstacles": {
            "cabinet": {"box": [0.6, 0.6, 1.8], "position": [1.5, 2.0, 0.9], "yaw_deg": 30},
            "column": {"cylinder": {"radius": 0.2, "length": 3}, "position": [-1.5, 1.0, 1.0]},
        },
        "fences": {"fence": {"points": [[-2.5, -2.5], [-2.5, 3.0], [3.0, 3.0]]}},
        "people_sensors": {
            "lidar-1": {"kind": "lidar", "position": [2.0, -2.0, 0.3], "yaw_deg": 135, "range_m": 5},
            "ceiling-1": {
                "kind": "depthCamera",
                "position": [0.5, 0.0, 3.5],
                "field_of_view_deg": 75,
                "range_m": 5,
            },
        },
    }
)
SENSORS = pytest.mark.parametrize("name", ["lidar-1", "ceiling-1"])


class Seen:
    """What a sensor of the scene measures every 0.1 s becomes, for an arm at rest."""

    def __init__(self, name: str, scene: Scene = SCENE) -> None:
        self.simulated = SimulatedSensor(scene, name, seed=1)
        self.now_s = 100.0
        self.sensors = SceneSensors(lambda: scene, lambda: [ARM], lambda: self.now_s)

    def at(self, *people: tuple[float, float]) -> PeopleReport:
        self.now_s += 0.1
        return self.of(self.simulated.measure(people, self.now_s))

    def of(self, measured: ScanReport | DepthReport) -> PeopleReport:
        if isinstance(measured, ScanReport):
            return self.sensors.of_scan(measured)
        return self.sensors.of_depth(measured)


@SENSORS
def test_an_empty_cell_has_no_people(name: str) -> None:
    assert Seen(name).at().people == ()


@SENSORS
@pytest.mark.parametrize("place", [(1.2, 0.4), (0.9, -1.0), (-0.5, 1.2)])
def test_a_person_is_found_where_they_are(name: str, place: tuple[float, float]) -> None:
    (person,) = Seen(name).at(place).people
    assert math.dist(person.point, place) < 0.25
    assert math.dist(person.point, place) - person.radius < 0.1, "somewhere in the person"


@SENSORS
def test_a_person_who_walks_keeps_the_id(name: str) -> None:
    seen = Seen(name)
    ids = {seen.at((1.4 - 0.15 * step, -0.9)).people[0].id for step in range(10)}
    assert len(ids) == 1


def test_two_people_have_different_ids_while_they_pass_each_other() -> None:
    seen = Seen("ceiling-1")
    first = seen.at((-0.8, -1.0), (1.4, -1.0)).people
    assert len({person.id for person in first}) == 2
    for step in range(1, 22):
        report = seen.at((-0.8 + 0.1 * step, -1.0), (1.4 - 0.1 * step, -1.0))
        assert {person.id for person in first} <= {person.id for person in report.people}


def test_the_robot_is_no_person() -> None:
    arm = {"cylinder": {"radius": 0.08, "length": 0.8}, "position": [0, 0, 0.4]}
    written = {**SCENE.model_dump(mode="json"), "obstacles": {"arm": arm}}
    seen = Seen("lidar-1", SCENE.model_copy(update={"obstacles": {}}))
    seen.simulated = SimulatedSensor(Scene.model_validate(written), "lidar-1")
    assert seen.at().people == ()


def test_a_keep_out_zone_hides_nobody() -> None:
    zone = {"kind": "keepOut", "box": [2, 2, 2], "position": [1.2, 0.4, 1.0]}
    scene = SCENE.model_copy(
        update={"zones": Scene.model_validate({"name": "z", "zones": {"z": zone}}).zones}
    )
    seen = Seen("lidar-1", scene)
    (person,) = seen.at((1.2, 0.4)).people
    assert math.dist(person.point, (1.2, 0.4)) < 0.25


def test_a_person_behind_the_column_vanishes_and_counts() -> None:
    seen = Seen("lidar-1")
    monitor, distance = Separation([], SeparationRule(), seen.now_s), distance_from([(0.0, 0.0)], 0.1)

    def report(*people: tuple[float, float]) -> float:
        seen_people = seen.at(*people)
        monitor.receive(seen_people, seen.now_s, seen.now_s, distance, 1.0)
        return monitor.state(seen.now_s, distance, 1.0).allowed.fraction

    assert report((0.2, 1.8)) > 0
    paces = [report() for _ in range(40)]
    assert paces[-1] == 0.0
    assert monitor.state(seen.now_s, distance, 1.0).lost
    assert monitor.confirm_clear()
    assert [report() for _ in range(30)][-1] == 1.0


def scan(**values: Any) -> ScanReport:
    fields = {"source": "lidar-1", "stamp": 100.0, "angleMin": 0.0, "angleIncrement": 0.01}
    return ScanReport.model_validate({**fields, "ranges": [None] * 100, **values})


def depth(pixels: Any, **values: Any) -> DepthReport:
    raw = base64.b64encode(np.asarray(pixels, dtype="<u2").tobytes()).decode()
    fields = {"source": "ceiling-1", "stamp": 100.0, "width": 10, "height": 8, "depth": raw}
    return DepthReport.model_validate({**fields, **values})


@pytest.mark.parametrize(
    ("measured", "reason"),
    [
        (scan(ranges=[0.01] * 30 + [None] * 70), "uncover lidar-1"),
        (scan(source="lidar-2"), 'no lidar "lidar-2"; it has lidar-1'),
        (scan(source="ceiling-1"), 'no lidar "ceiling-1"'),
        (scan(stamp=90.0), "synchronize"),
        (scan(stamp=1e12), "synchronize"),
        (depth(np.zeros((8, 10))), "100% of the pixels have no depth"),
        (depth(np.zeros((4, 10))), "80 bytes"),
        (depth(np.zeros((8, 10)), depth="?" * 216), "not base64"),
    ],
)
def test_a_sensor_that_sees_too_little_or_is_unknown_is_refused(
    measured: ScanReport | DepthReport, reason: str
) -> None:
    with pytest.raises(RefusedReport, match=reason):
        Seen("lidar-1").of(measured)


def test_a_refused_stamp_does_not_block_the_next_scan() -> None:
    seen = Seen("lidar-1")
    with pytest.raises(RefusedReport):
        seen.of(scan(stamp=1e12))
    assert seen.of(scan(stamp=100.0)).people == ()
    with pytest.raises(RefusedReport, match="later"):
        seen.of(scan(stamp=100.0))


def test_rays_end_at_the_nearest_shape() -> None:
    world = Surroundings(
        [
            Obstacle("box", Box((1.0, 1.0, 1.0)), Pose((3.0, 0.0, 0.0), UPRIGHT)),
            Obstacle("post", Cylinder(0.5, 2.0), Pose((0.0, 4.0, 0.0), UPRIGHT)),
            Obstacle("ball", Sphere(1.0), Pose((0.0, 0.0, 6.0), UPRIGHT)),
        ]
    )
    rays = np.vstack([np.eye(3), -np.eye(3)])
    ranges_m = world.ranges_m(np.zeros(3), rays, 10.0)
    assert ranges_m[:3] == pytest.approx([2.5, 3.5, 5.0], abs=0.005)
    assert np.isnan(ranges_m[3:]).all()


def test_points_that_are_near_each_other_are_one_cluster() -> None:
    points = np.array([[0.0, 0.0], [0.1, 0.0], [0.2, 0.05], [2.0, 2.0], [2.05, 2.0], [5.0, 5.0]])
    sorted_clusters = sorted(clusters(points, 2), key=lambda cluster: cluster.middle)
    assert [cluster.middle[0] for cluster in sorted_clusters] == pytest.approx([0.1, 2.025])
    assert sorted_clusters[0].radius_m == pytest.approx(math.hypot(0.1, 0.025))


@pytest.fixture
def stamps() -> Iterator[float]:
    return (0.1 * number for number in count(1))


def test_somebody_who_was_not_measured_for_long_gets_another_id(stamps: Iterator[float]) -> None:
    tracker, here = Tracker("lidar-1"), [Cluster((1.0, 0.0), 0.2)]
    (before,) = tracker.people(here, next(stamps))
    tracker.people([], next(stamps))
    (again,) = tracker.people(here, next(stamps))
    assert again.id == before.id
    for _ in range(6):
        tracker.people([], next(stamps))
    (later,) = tracker.people(here, next(stamps))
    assert later.id != before.id
