import pytest

from handover_ros.mapping import names, parse
from handover_ros.mapping.document import InvalidMapping
from handover_ros.rules import plan
from handover_ros.types.type_store import TypeStore


def test_a_placeholder_matches_one_part_of_a_topic() -> None:
    assert names.topic_pattern("{robot}/odom") == "/{robot}/odom"
    assert names.placeholders("/{site}/{robot}/odom") == ("site", "robot")
    found = names.matcher("/{robot}/odom").fullmatch("/amr_1/odom")
    assert found is not None
    assert found.groupdict() == {"robot": "amr_1"}
    for other in ("/amr_1/x/odom", "//odom", "/odom", "/amr_1/odom2"):
        assert names.matcher("/{robot}/odom").fullmatch(other) is None


@pytest.mark.parametrize(
    "wrong", ["/{Robot}/odom", "/{robot/odom", "/{}/odom", "/{robot}//odom", "/{a}/{a}/x"]
)
def test_an_invalid_topic_pattern_is_refused(wrong: str) -> None:
    with pytest.raises(ValueError, match=r"topic|placeholder"):
        names.topic_pattern(wrong)


def test_a_topic_pattern_needs_a_type() -> None:
    text = "ros_to_ngsild: {odom: {topic: '/{robot}/odom', entity: 'Device:{robot}', attributes: {x: pose}}}"
    with pytest.raises(InvalidMapping, match="has placeholders; set its type as well"):
        plan.make(parse(text), TypeStore(), "demo")
