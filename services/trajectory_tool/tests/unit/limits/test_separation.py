import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from handover.control.speed_limits import RefusedReport
from handover_datamodels.streams import PeopleReport
from handover_robots.limits.separation import (
    Separation,
    SeparationRule,
    SeparationState,
    distance_from,
)

RULE = SeparationRule()
PEAK_MPS = 1.0
FROM_ROBOT = distance_from([(0.0, 0.0), (0.5, 0.0)], 0.1)


class Sensor:
    """A sensor that reports every 0.1 s."""

    def __init__(self, monitor: Separation) -> None:
        self.monitor, self.now_s = monitor, 0.0

    def report(self, *people: tuple[str, float, float], **fields: bool) -> SeparationState:
        self.now_s += 0.1
        seen = [{"id": name, "x": x, "y": y} for name, x, y in people]
        values = {"source": "lidar", "stamp": self.now_s, "people": seen, **fields}
        message = PeopleReport.model_validate(values)
        self.monitor.receive(message, self.now_s, self.now_s, FROM_ROBOT, PEAK_MPS)
        return self.state()

    def state(self, after_s: float = 0.0) -> SeparationState:
        return self.monitor.state(self.now_s + after_s, FROM_ROBOT, PEAK_MPS)


@pytest.fixture
def sensor() -> Sensor:
    return Sensor(Separation([], RULE, 0.0))


def test_without_a_sensor_nothing_is_limited() -> None:
    state = Separation([], RULE, 0.0).state(100.0, FROM_ROBOT, PEAK_MPS)
    assert state.allowed.fraction == 1.0
    assert state.distance_m is None


def test_the_distance_is_the_sum_of_its_parts() -> None:
    parts = RULE.parts_m(1.0)
    assert parts["Sh"] == pytest.approx(1.6 * (0.1 + 0.1 + 1.0 / 1.5))
    assert parts["Sr"] == pytest.approx(0.1)
    assert parts["Ss"] == pytest.approx(0.1 + 1.0 / 3.0)
    assert RULE.distance_m(1.0) == pytest.approx(sum(parts.values()))


@given(st.floats(0, 10))
def test_the_allowed_speed_has_the_distance_as_its_protective_distance(distance_m: float) -> None:
    speed_mps = RULE.speed_mps(distance_m)
    if distance_m > RULE.distance_m(0.0) + 1e-6:
        assert RULE.distance_m(speed_mps) == pytest.approx(distance_m)
    else:
        assert speed_mps < 1e-5


def test_a_person_far_away_limits_nothing(sensor: Sensor) -> None:
    assert sensor.report(("anna", 6.0, 0.0)).allowed.fraction == 1.0


def test_the_speed_falls_continuously_as_a_person_comes_near(sensor: Sensor) -> None:
    paces = [sensor.report(("anna", 4.0 - 0.1 * step, 0.0)).allowed.fraction for step in range(36)]
    assert paces == sorted(paces, reverse=True)
    assert paces[0] == 1.0
    assert paces[-1] == 0.0
    assert any(0.2 < pace < 0.8 for pace in paces)


def test_after_a_stop_the_distance_is_reported_for_two_seconds_before_the_robot_continues(
    sensor: Sensor,
) -> None:
    assert sensor.report(("anna", 0.7, 0.0)).allowed.fraction == 0.0
    far = [sensor.report(("anna", 0.7 + 0.4 * step, 0.0)).allowed.fraction for step in range(1, 40)]
    stopped = far.count(0.0)
    assert 20 <= stopped <= 28
    assert far[-1] == 1.0


def test_a_silent_sensor_stops_the_robot(sensor: Sensor) -> None:
    assert sensor.report().allowed.fraction == 1.0
    assert sensor.state(0.4).allowed.fraction == 1.0
    silent = sensor.state(0.6)
    assert silent.allowed.fraction == 0.0
    assert silent.distance_m == 0.0
    assert "silent" in silent.allowed.reason
    assert sensor.state(100.0).allowed.fraction == 0.0


def test_a_sensor_that_was_never_received_stops_the_robot() -> None:
    monitor = Separation(["lidar"], RULE, 0.0)
    assert monitor.state(0.0, FROM_ROBOT, PEAK_MPS).allowed.fraction == 0.0
    assert monitor.remove("lidar")
    assert monitor.sources == ()


def test_a_person_who_vanished_near_the_robot_counts_as_at_the_robot_in_time(sensor: Sensor) -> None:
    sensor.report(("anna", 2.0, 0.0))
    states = [sensor.report() for _ in range(100)]
    assert states[-1].allowed.fraction == 0.0
    assert states[-1].distance_m == 0.0
    assert states[-1].lost == ("anna",)
    assert sensor.monitor.confirm_clear() == ["anna"]
    after = [sensor.report().allowed.fraction for _ in range(30)]
    assert after[0] == 0.0
    assert after[-1] == 1.0


def test_a_person_who_leaves_far_away_is_gone(sensor: Sensor) -> None:
    sensor.report(("anna", 9.0, 0.0))
    assert sensor.report().lost == ()
    assert sensor.state(0.3).allowed.fraction == 1.0


def test_a_person_who_is_seen_again_within_reach_counts_where_they_are(sensor: Sensor) -> None:
    sensor.report(("anna", 2.0, 0.0))
    for _ in range(5):
        sensor.report()
    assert sensor.report(("anna", 2.3, 0.0)).lost == ()


def test_a_person_who_jumps_counts_at_both_places(sensor: Sensor) -> None:
    sensor.report(("anna", 1.0, 0.0))
    state = sensor.report(("anna", 9.0, 0.0))
    assert state.lost == ("anna",)
    assert state.distance_m is not None
    assert state.distance_m < 1.0


def test_the_fields_of_a_scanner_slow_and_stop_the_robot(sensor: Sensor) -> None:
    warned = sensor.report(warning_field=True).allowed
    assert warned.fraction == 1.0
    assert warned.pace(1.0) == 0.25
    assert warned.reason == "the warning field is infringed"
    assert sensor.report(warning_field=True, protective_field=True).allowed.fraction == 0.0
    assert sensor.report().allowed.fraction == 0.0
    assert [sensor.report().allowed.fraction for _ in range(25)][-1] == 1.0


def test_reversed_time_and_the_same_id_twice_are_refused(sensor: Sensor) -> None:
    sensor.report(("anna", 2.0, 0.0))
    sensor.now_s -= 0.2
    with pytest.raises(RefusedReport, match="later"):
        sensor.report()
    sensor.now_s += 0.5
    with pytest.raises(RefusedReport, match="same id"):
        sensor.report(("anna", 2.0, 0.0), ("anna", 3.0, 0.0))


@pytest.mark.parametrize(
    "fault",
    [
        {"people": [{"id": "a", "x": math.nan, "y": 0.0}]},
        {"people": [{"id": "a", "x": 1e9, "y": 0.0}]},
        {"people": [{"id": "a", "x": 0.0, "y": 0.0}] * 65},
        {"people": None},
        {"period": 2.0},
        {"stamp": math.inf},
    ],
)
def test_a_malformed_report_is_refused(fault: dict[str, Any]) -> None:
    values = {"source": "lidar", "stamp": 1.0, "people": [], **fault}
    with pytest.raises(ValidationError):
        PeopleReport.model_validate(values)


@settings(deadline=None, max_examples=50)
@given(st.lists(st.tuples(st.floats(-5, 5), st.floats(-5, 5)), min_size=1, max_size=30))
def test_the_robot_is_never_faster_than_the_distance_allows(places: list[tuple[float, float]]) -> None:
    sensor = Sensor(Separation([], RULE, 0.0))
    for x, y in places:
        state = sensor.report(("anna", x, y))
        speed_mps = state.allowed.pace(PEAK_MPS) * PEAK_MPS
        assert speed_mps == 0.0 or RULE.distance_m(speed_mps) <= FROM_ROBOT((x, y)) + 1e-9
