"""Generated mappings compile."""

import pytest

from handover_ros.graph.qos import LATCHED, SENSOR_DATA, Durability, Qos, Reliability
from handover_ros.inspection.scaffolding import mapping_for
from handover_ros.mapping import parse
from handover_ros.rules import plan
from handover_ros.types.type_store import TypeStore

TYPES = TypeStore()
MESSAGES = [name for name in TYPES.type_names() if "/msg/" in name]


@pytest.mark.parametrize("type_name", MESSAGES)
def test_a_scaffold_for_any_ros_message_compiles_and_extracts(type_name: str) -> None:
    text = mapping_for("/robot/topic", type_name, None, TYPES)
    (rule,) = plan.make(parse(text), TYPES, "demo").ros_to_ngsild
    assert rule.extractor is not None
    made = rule.extractor.extract(TYPES.default(type_name), 1_770_000_000.0)
    assert made.entities
    assert made.errors == []


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
def test_a_scaffold_uses_the_quality_of_service_of_the_publisher(qos: Qos, line: str) -> None:
    text = mapping_for("/joint_states", "sensor_msgs/msg/JointState", qos, TYPES)
    assert line in text
    (rule,) = plan.make(parse(text), TYPES, "demo").ros_to_ngsild
    assert rule.qos.unmet(qos) is None


def test_the_scaffold_for_joint_states_is_readable() -> None:
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
