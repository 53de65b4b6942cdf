"""A mapping is written for a topic that exists, and can work as it is."""

import pytest

from ros_fiware_bridge.graph.qos import LATCHED, SENSOR_DATA, Durability, Qos, Reliability
from ros_fiware_bridge.mapping import parse
from ros_fiware_bridge.rules import plan
from ros_fiware_bridge.scaffolding import mapping_for
from ros_fiware_bridge.types.type_store import TypeStore

TYPES = TypeStore()
MESSAGES = [name for name in TYPES.type_names() if "/msg/" in name]


@pytest.mark.parametrize("type_name", MESSAGES)
def test_a_mapping_for_any_message_of_ros_can_work(type_name: str) -> None:
    text = mapping_for("/robot/topic", type_name, None, TYPES)
    (rule,) = plan.make(parse(text), TYPES, "demo").outward
    assert rule.outward is not None
    made = rule.outward.harvest(TYPES.default(type_name), 1_770_000_000.0)
    assert made.updates
    assert made.faults == []


@pytest.mark.parametrize(
    ("qos", "line"),
    [
        (SENSOR_DATA, "qos: sensor_data"),
        (LATCHED, "qos: latched"),
        (Qos(reliability=Reliability.BEST_EFFORT, depth=1), "qos: sensor_data"),
        (
            Qos(Reliability.BEST_EFFORT, Durability.TRANSIENT_LOCAL),
            "qos: {reliability: best_effort, durability: transient_local}",
        ),
    ],
)
def test_the_publishers_quality_of_service_is_taken_over(qos: Qos, line: str) -> None:
    text = mapping_for("/joint_states", "sensor_msgs/msg/JointState", qos, TYPES)
    assert line in text
    (rule,) = plan.make(parse(text), TYPES, "demo").outward
    assert rule.qos.unmet(qos) is None


def test_the_scaffold_for_joint_states_reads_like_one_written_by_hand() -> None:
    assert mapping_for("/joint_states", "sensor_msgs/msg/JointState", None, TYPES).endswith(
        "    topic: /joint_states\n"
        "    type: sensor_msgs/msg/JointState\n"
        "    entity: Device:robot-1\n"
        "    every_ms: 1000\n"
        "    on_change: true\n"
        "    attributes:\n"
        "      name: name  # string[]\n"
        "      position: position  # float64[]\n"
        "      velocity: velocity  # float64[]\n"
        "      effort: effort  # float64[]\n"
    )
