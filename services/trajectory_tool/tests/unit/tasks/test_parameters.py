import math
from typing import Any

import pytest

from handover.performer import TaskFailed
from handover_robots.tasks import operations, parameters


def read(operation: str, /, **written: Any) -> Any:
    return parameters.read(operations.operation_named(operation).parameters, operation, written)


@pytest.mark.parametrize(
    ("operation", "written", "complaint"),
    [
        ("moveTo", {"joints": []}, r'parameter "joints" of moveTo: .*at least 1'),
        ("moveTo", {"joints": [0, 0, 0, 0, 0, math.nan]}, r'"joints\.5" of moveTo: .*finite'),
        ("moveTo", {"joints": [0, 0, 0, 0, 0, "1"]}, r'"joints\.5" of moveTo: must be a number'),
        ("moveTo", {"joints": [0, 0, 0, 0, 0, True]}, r'"joints\.5" of moveTo: must be a number'),
        ("moveTo", {}, r'moveTo needs either "joints" .* or "pose"'),
        ("moveTo", {"joints": [0] * 6, "pose": {"position": [0, 0, 1]}}, "and not both"),
        ("moveTo", {"pose": {"position": [0, 1]}}, r'"pose\.position'),
        ("moveTo", {"pose": {"position": [0, 0, math.nan]}}, r'"pose\.position\.2" of moveTo: .*finite'),
        ("moveTo", {"pose": {"position": [0, 0, 1], "orientation": [1, 1, 0, 0]}}, "of length 1; .* 1.414"),
        ("moveTo", {"joints": [0] * 6, "speed": 1.5}, r'"speed" of moveTo: .*less than or equal to 1'),
        ("home", {"speed": 0}, r'"speed" of home: .*greater than or equal to 0\.01'),
        ("home", {"tempo": 0.5}, r'home knows no parameter "tempo"; it knows speed'),
        ("scan", {}, r'"bin" of scan: field required'),
        ("scan", {"bin": 7}, r'"bin" of scan'),
        ("place", {}, r'place needs either "location"'),
    ],
)
def test_a_wrong_parameter_is_named_with_its_rule(
    operation: str, written: dict[str, Any], complaint: str
) -> None:
    with pytest.raises(TaskFailed, match=complaint):
        read(operation, **written)


def test_all_faults_are_reported_at_once() -> None:
    with pytest.raises(TaskFailed, match=r'"speed".*; .*"joints"') as refused:
        read("moveTo", joints=[], speed=7)
    assert "\n" not in str(refused.value)


def test_an_unknown_operation_is_refused_with_the_known_ones() -> None:
    with pytest.raises(
        TaskFailed, match=r'no operation "dance".*moveTo, moveLinear, scan, pick, place, home'
    ):
        operations.operation_named("dance")


def test_a_urn_names_a_bin_by_its_last_part() -> None:
    assert read("scan", bin="urn:ngsi-ld:Location:demo:bin-1").bin == "bin-1"


def test_a_description_is_ignored_by_the_operation() -> None:
    assert read("home", operation="home", description="Go home").speed == 1.0


def test_a_pose_without_orientation_points_down() -> None:
    assert read("moveTo", pose={"position": [0.5, 0.5, 0.5]}).pose.orientation == parameters.DOWN


def test_a_quaternion_that_was_rounded_is_made_a_unit_again() -> None:
    written = read("moveTo", pose={"position": [0.5, 0.5, 0.5], "orientation": [0.707, 0.707, 0, 0]})
    assert math.hypot(*written.pose.orientation) == pytest.approx(1.0, abs=1e-12)
