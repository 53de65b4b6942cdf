import pytest

from handover_ros.errors import UnknownQos
from handover_ros.graph.qos import LATCHED, SENSOR_DATA, Durability, Qos, Reliability


def test_profiles_have_the_names_of_ros() -> None:
    assert Qos.named("default") == Qos()
    assert Qos.named("sensor_data") == SENSOR_DATA
    assert str(SENSOR_DATA) == "best_effort, volatile, keep_last 5"
    assert str(LATCHED) == "reliable, transient_local, keep_last 1"
    with pytest.raises(UnknownQos, match='no quality of service "fast"; it is one of default, sensor_data'):
        Qos.named("fast")


def test_a_depth_of_zero_is_refused() -> None:
    with pytest.raises(UnknownQos, match="a depth of 0 keeps nothing"):
        Qos(depth=0)


@pytest.mark.parametrize("reliability", Reliability)
@pytest.mark.parametrize("durability", Durability)
def test_the_least_demanding_reader_matches_every_writer(
    reliability: Reliability, durability: Durability
) -> None:
    assert Qos(Reliability.BEST_EFFORT).unmet(Qos(reliability, durability)) is None
    assert Qos(reliability, durability).unmet(LATCHED) is None


def test_the_reasons_of_a_mismatch_are_listed() -> None:
    assert Qos().unmet(SENSOR_DATA) == "the reader wants reliable, the writer offers best_effort"
    assert LATCHED.unmet(SENSOR_DATA) == (
        "the reader wants reliable, the writer offers best_effort and "
        "the reader wants transient_local, the writer offers volatile"
    )
