"""Mapping files: short forms, and errors with line and key."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover.errors import UsageError
from handover_ros.mapping import InvalidMapping, load, parse
from handover_ros.mapping.document import Fault

BATTERY = """\
ros_to_ngsild:
  battery:
    topic: battery_state
    type: sensor_msgs/BatteryState
    entity: Device:amr-1
    qos: sensor_data
    attributes:
      batteryLevel: percentage
      voltage: {field: voltage, unit_code: VLT, dead_band: 0.1}
"""


def test_short_forms_are_expanded() -> None:
    rule = parse(BATTERY).mapping.ros_to_ngsild["battery"]
    assert rule.topic == "/battery_state"
    assert rule.type == "sensor_msgs/msg/BatteryState"
    assert rule.entity is not None
    assert str(rule.entity.id) == "urn:ngsi-ld:Device:{factory}:amr-1"
    assert rule.qos.preset == "sensor_data"
    assert str(rule.attributes["batteryLevel"].field) == "percentage"
    assert rule.attributes["voltage"].dead_band is not None
    assert rule.attributes["voltage"].dead_band.absolute == 0.1


MISTAKES = [
    ("topic: battery_state", "topik: battery_state", 3, "battery.topik", 'did you mean "topic"?'),
    ("topic: battery_state", "every_ms: 1", 2, "battery.topic", "missing"),
    ("topic: battery_state", "topic: 9bad", 3, "battery.topic", "not a name of a topic"),
    (
        "sensor_msgs/BatteryState",
        "BatteryState",
        4,
        "battery.type",
        "write it like sensor_msgs/msg/JointState",
    ),
    ("sensor_msgs/BatteryState", "std_srvs/srv/Trigger", 4, "battery.type", "not a msg type"),
    ("Device:amr-1", "amr-1", 5, "battery.entity", "write Type:id"),
    ("Device:amr-1", "Device:{header.frame_id", 5, "battery.entity.id", "has a { without a }"),
    ("qos: sensor_data", "qos: best", 6, "battery.qos.preset", "'sensor_data'"),
    ("batteryLevel: percentage", "batteryLevel: per cent", 8, "batteryLevel.field", "cannot be parsed"),
    ("batteryLevel: percentage", "battery level: percentage", 8, "attributes.battery level", "no blanks"),
    (
        "batteryLevel: percentage",
        "batteryLevel: true",
        8,
        "attributes.batteryLevel",
        "a mapping with these keys",
    ),
    ("unit_code: VLT", "unitCode: VLT", 9, "voltage.unitCode", 'did you mean "unit_code"?'),
    ("dead_band: 0.1", "dead_band: -1", 9, "voltage.dead_band.absolute", "greater than 0"),
    ("unit_code: VLT", "convert: rad to deg", 9, "attributes.voltage", 'write it like "rad -> deg"'),
    ("unit_code: VLT", "kind: Relationship", 9, "attributes.voltage", "is made of object"),
    ("unit_code: VLT", "text: x", 9, "attributes.voltage", "field and text"),
]


@pytest.mark.parametrize(("right", "wrong", "line", "key", "why"), MISTAKES)
def test_an_error_has_its_line_key_and_way_out(right: str, wrong: str, line: int, key: str, why: str) -> None:
    with pytest.raises(InvalidMapping) as caught:
        parse(BATTERY.replace(right, wrong), "cell.yaml")
    (fault,) = (fault for fault in caught.value.faults if why in fault.why)
    assert fault.line == line
    assert fault.key.endswith(key)
    assert f"cell.yaml:{line}: ros_to_ngsild.{fault.key.split('.', 1)[1]}: " in str(caught.value)


def test_all_errors_are_reported_together() -> None:
    wrong = BATTERY.replace("topic:", "topik:").replace("percentage", "per cent").replace("Device:", "")
    with pytest.raises(InvalidMapping) as caught:
        parse(wrong)
    assert [fault.line for fault in caught.value.faults] == [2, 3, 5, 8]


def test_a_duplicate_key_is_refused() -> None:
    with pytest.raises(
        InvalidMapping, match=r'mapping.yaml:10: .*"battery" is a duplicate key, first in line 2'
    ):
        parse(BATTERY + "  battery: {}\n")


def test_a_duplicate_rule_name_is_refused() -> None:
    more = "ngsild_to_ros:\n  battery: {entity: A:b, topic: /x, type: std_msgs/String, fields: {data: a}}\n"
    with pytest.raises(InvalidMapping, match='"battery" is in ros_to_ngsild and in ngsild_to_ros'):
        parse(BATTERY + more)


def test_yaml_words_stay_strings() -> None:
    text = BATTERY.replace("unit_code: VLT", "values: {on: off, 010: 0x10, 1: yes, 2: 1e3}")
    values = parse(text).mapping.ros_to_ngsild["battery"].attributes["voltage"].values
    assert values == {"on": "off", "010": "0x10", 1: "yes", 2: 1000.0}


@given(st.text(max_size=200))
def test_any_text_is_parsed_or_refused_with_its_line(text: str) -> None:
    _assert_read_or_refused(text)


@given(st.data())
def test_a_corrupted_file_is_parsed_or_refused_with_its_line(data: st.DataObject) -> None:
    at = data.draw(st.integers(0, len(BATTERY)))
    length = data.draw(st.integers(0, 12))
    put = data.draw(st.text("{}[]:,.- \n\"'&*!|>ab01~", max_size=6))
    _assert_read_or_refused(BATTERY[:at] + put + BATTERY[at + length :])


def _assert_read_or_refused(text: str) -> None:
    faults: tuple[Fault, ...] = ()
    try:
        assert parse(text).mapping is not None
    except InvalidMapping as wrong:
        faults = wrong.faults
    assert all(fault.line >= 1 and fault.why for fault in faults)


def test_an_alias_bomb_is_refused() -> None:
    bomb = "a0: &a0 [x,x,x,x,x,x,x,x,x,x]\n" + "".join(
        f"a{n}: &a{n} [{','.join([f'*a{n - 1}'] * 10)}]\n" for n in range(1, 9)
    )
    with pytest.raises(InvalidMapping, match="more than 50000 values"):
        parse(bomb)


def test_a_missing_file_lists_the_shipped_mappings() -> None:
    with pytest.raises(UsageError, match=r"there is no mapping file nowhere\.yaml; the shipped mappings are"):
        load(Path("nowhere.yaml"))
