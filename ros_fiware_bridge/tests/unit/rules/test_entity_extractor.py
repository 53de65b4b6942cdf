"""The entity extractor: messages become states of entities; an error affects one attribute alone."""

import math
from datetime import datetime
from typing import Any

import numpy as np
import orjson
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_ros.mapping import parse
from handover_ros.rules import plan
from handover_ros.rules.entity_extractor import EntityExtractor, Extraction
from handover_ros.types.type_store import TypeStore

TYPES = TypeStore()
RECEIVED_S = 1_770_000_000.5


def ready(type_name: str, attributes: str, entity: str = "Device:d", **more: str) -> EntityExtractor:
    extra = "".join(f"    {key}: {value}\n" for key, value in more.items())
    text = (
        f"ros_to_ngsild:\n  rule:\n    topic: /t\n    type: {type_name}\n    entity: {entity}\n{extra}"
        f"    attributes: {attributes}\n"
    )
    made = plan.make(parse(text), TYPES, "demo").ros_to_ngsild[0].extractor
    assert made is not None
    return made


def message(type_name: str, **fields: Any) -> dict[str, Any]:
    package, name = type_name.split("/")
    return {**TYPES.default(f"{package}/msg/{name}"), **fields}


def attribute(extraction: Extraction, name: str = "a") -> Any:
    assert extraction.errors == []
    return extraction.entities[0].attributes[name]


STAMP = {"frame_id": "base", "stamp": {"sec": 1_770_000_000, "nanosec": 250_000_000}}
JOINTS = message(
    "sensor_msgs/JointState", header=STAMP, name=["elbow", "wrist"], position=np.array([math.pi, 0.5])
)


def test_fields_become_attributes_with_the_time_of_the_header() -> None:
    rule = ready(
        "sensor_msgs/JointState",
        "{a: 'position[name=wrist]', deg: {field: 'position[0]', convert: rad -> deg, unit_code: DD}}",
        "Device:{header.frame_id}",
    )
    update = rule.extract(JOINTS, RECEIVED_S).entities[0]
    assert (update.entity_id, update.entity_type) == ("urn:ngsi-ld:Device:demo:base", "Device")
    assert update.attributes == {
        "a": {"type": "Property", "value": 0.5, "observedAt": "2026-02-02T02:40:00.250000Z"},
        "deg": {
            "type": "Property",
            "value": pytest.approx(180.0),
            "observedAt": "2026-02-02T02:40:00.250000Z",
            "unitCode": "DD",
        },
    }


@given(
    stamp_s=st.floats(0.001, 2e9),
    is_simulated=st.booleans(),
)
def test_a_stamp_of_simulated_time_is_never_written(stamp_s: float, is_simulated: bool) -> None:
    """One of a graph on simulated time, or that lies before ROS: the time of reception is written."""
    stamp = {"sec": int(stamp_s), "nanosec": int(stamp_s % 1 * 1e9)}
    given_message = {**JOINTS, "header": {"frame_id": "base", "stamp": stamp}}
    rule = ready("sensor_msgs/JointState", "{a: name}")
    extraction = rule.extract(given_message, RECEIVED_S, is_simulated=is_simulated)
    written = datetime.fromisoformat(attribute(extraction)["observedAt"]).timestamp()
    expected_simulated = is_simulated or 0 < stamp["sec"] + stamp["nanosec"] * 1e-9 < 1e9
    assert extraction.is_simulated == expected_simulated
    if expected_simulated or stamp["sec"] == 0:
        assert written == RECEIVED_S
    else:
        assert written == pytest.approx(stamp_s, abs=1e-3)


@pytest.mark.parametrize(
    ("observed_at", "written"),
    [
        ("received", "2026-02-02T02:40:00.500000Z"),
        ("none", None),
        ("header.stamp", "2026-02-02T02:40:00.250000Z"),
    ],
)
def test_observed_at_follows_the_rule(observed_at: str, written: str | None) -> None:
    rule = ready("sensor_msgs/JointState", "{a: name}", observed_at=observed_at)
    assert attribute(rule.extract(JOINTS, RECEIVED_S)).get("observedAt") == written


def test_an_unset_stamp_is_ignored() -> None:
    rule = ready("sensor_msgs/JointState", "{a: name}")
    unset = message("sensor_msgs/JointState")
    assert attribute(rule.extract(unset, RECEIVED_S))["observedAt"] == "2026-02-02T02:40:00.500000Z"


def test_all_kinds_of_ngsild_attributes_are_written() -> None:
    fix = message("sensor_msgs/NavSatFix", header=STAMP, longitude=24.9, latitude=60.2)
    rule = ready(
        "sensor_msgs/NavSatFix",
        "{a: {field: ., kind: GeoProperty}, p: {point: [longitude, latitude]}, whole: {field: status, kind: "
        "JsonProperty}, words: {languages: {en: header.frame_id}}, "
        "link: {object: 'Asset:{header.frame_id}'}, text: {text: 'at {latitude}'}, one: {constant: [pose]}}",
    )
    made = rule.extract(fix, RECEIVED_S).entities[0].attributes
    place = {"type": "Point", "coordinates": [24.9, 60.2]}
    assert (made["a"]["type"], made["a"]["value"]) == ("GeoProperty", place)
    assert made["p"]["value"] == place
    assert made["whole"]["type"] == "JsonProperty"
    assert set(made["whole"]["json"]) == {"status", "service"}
    assert made["words"]["languageMap"] == {"en": "base"}
    assert made["link"]["object"] == "urn:ngsi-ld:Asset:demo:base"
    assert made["text"]["value"] == "at 60.2"
    assert made["one"]["value"] == ["pose"]


def test_positions_in_metres_become_degrees() -> None:
    rule = ready(
        "geometry_msgs/PointStamped",
        "{a: {field: point, kind: GeoProperty, origin: {longitude: 24.0, latitude: 60.0, turned_deg: 90}}}",
    )
    moved = message("geometry_msgs/PointStamped", point={"x": 111_195.0, "y": 0.0, "z": 0.0})
    assert attribute(rule.extract(moved, RECEIVED_S))["value"]["coordinates"] == pytest.approx([24.0, 61.0])


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_nan_is_left_out_and_reported_or_replaced(bad: float) -> None:
    battery = message("sensor_msgs/BatteryState", voltage=bad, percentage=0.5)
    extraction = ready("sensor_msgs/BatteryState", "{a: voltage, b: percentage}").extract(battery, RECEIVED_S)
    assert list(extraction.entities[0].attributes) == ["b"]
    assert "voltage is" in extraction.errors[0]
    assert "JSON cannot represent" in extraction.errors[0]
    wanted = ready("sensor_msgs/BatteryState", "{a: {field: voltage, nan: unknown}}")
    assert attribute(wanted.extract(battery, RECEIVED_S))["value"] == "unknown"
    scan = message("sensor_msgs/LaserScan", ranges=np.array([1.0, bad], np.float32))
    assert ready("sensor_msgs/LaserScan", "{a: ranges}").extract(scan, RECEIVED_S).entities == []
    filled = ready("sensor_msgs/LaserScan", "{a: {field: ranges, nan: -1}}").extract(scan, RECEIVED_S)
    assert attribute(filled)["value"] == [1.0, -1]


@pytest.mark.parametrize(
    "number", [2**31 - 1, -(2**31), 2**31, -(2**31) - 1, 2**53, 1_764_408_000_000_000_000]
)
def test_an_integer_that_brokers_keep_in_32_bits_is_written_as_a_float_if_it_is_larger(number: int) -> None:
    one = ready("std_msgs/Int64", "{a: data}").extract(message("std_msgs/Int64", data=number), RECEIVED_S)
    data = np.array([number, 1], np.int64)
    many = ready("std_msgs/Int64MultiArray", "{a: data}").extract(
        message("std_msgs/Int64MultiArray", data=data), RECEIVED_S
    )
    whole = ready("std_msgs/Int64MultiArray", "{a: {field: ., kind: JsonProperty}}").extract(
        message("std_msgs/Int64MultiArray", data=data), RECEIVED_S
    )
    is_small = -(2**31) <= number < 2**31
    for written in (
        attribute(one)["value"],
        attribute(many)["value"][0],
        attribute(whole)["json"]["data"][0],
    ):
        assert written == number
        assert isinstance(written, int if is_small else float)


def test_a_large_array_is_refused_unless_the_rule_allows_it() -> None:
    scan = message("sensor_msgs/LaserScan", ranges=np.zeros(257, np.float32))
    extraction = ready("sensor_msgs/LaserScan", "{a: ranges, b: angle_min}").extract(scan, RECEIVED_S)
    assert list(extraction.entities[0].attributes) == ["b"]
    assert "ranges holds 257 elements, more than 256 (max_elements)" in extraction.errors[0]
    more = ready("sensor_msgs/LaserScan", "{a: ranges}", max_elements="257")
    assert len(attribute(more.extract(scan, RECEIVED_S))["value"]) == 257
    wanted = ready("sensor_msgs/Image", "{a: data}", large_arrays="true")
    assert attribute(wanted.extract(message("sensor_msgs/Image", data=b"ab"), RECEIVED_S))["value"] == [
        97,
        98,
    ]


def test_a_message_without_its_entity_is_reported() -> None:
    extraction = ready("sensor_msgs/JointState", "{a: name}", "Device:{header.frame_id}").extract(
        message("sensor_msgs/JointState"), RECEIVED_S
    )
    assert extraction.entities == []
    assert "header.frame_id is empty" in extraction.errors[0]


def test_values_are_mapped() -> None:
    rule = ready("std_msgs/Int8", "{a: {field: data, values: {0: idle, 1: busy}}}")
    assert attribute(rule.extract({"data": 1}, RECEIVED_S))["value"] == "busy"
    assert "2 is not among the `values`" in rule.extract({"data": 2}, RECEIVED_S).errors[0]
    else_known = ready("std_msgs/Int8", "{a: {field: data, values: {0: idle}, otherwise: error}}")
    assert attribute(else_known.extract({"data": 2}, RECEIVED_S))["value"] == "error"


def test_only_messages_that_meet_the_condition_are_written() -> None:
    rule = ready("std_msgs/Int8", "{a: data}", when="{field: data, above: 1, none_of: [5]}")
    said = [bool(rule.extract({"data": number}, RECEIVED_S).entities) for number in (1, 2, 5, 6)]
    assert said == [False, True, False, True]


def test_paths_lead_into_json_text() -> None:
    rule = ready("std_msgs/String", "{a: data.value}", "'Task:{data.id}'", json_text="[data]")
    text = orjson.dumps({"value": "completed", "id": "t-1"}).decode()
    update = rule.extract({"data": text}, RECEIVED_S).entities[0]
    assert (update.entity_id, update.values) == ("urn:ngsi-ld:Task:demo:t-1", {"a": "completed"})
    assert "data holds no JSON" in rule.extract({"data": "completed"}, RECEIVED_S).errors[0]
    assert "no data.id" in rule.extract({"data": "{}"}, RECEIVED_S).errors[0]


def test_each_element_is_written_to_its_own_entity() -> None:
    rule = ready(
        "tf2_msgs/TFMessage",
        "{a: 'transforms[].transform.translation.x'}",
        "'Asset:{transforms[].child_frame_id}'",
        each="transforms",
    )
    moved = [
        {**TYPES.default("geometry_msgs/msg/TransformStamped"), "child_frame_id": name} for name in ("p", "q")
    ]
    ids = [update.entity_id for update in rule.extract({"transforms": moved}, RECEIVED_S).entities]
    assert ids == ["urn:ngsi-ld:Asset:demo:p", "urn:ngsi-ld:Asset:demo:q"]


DIAGNOSTICS = """
ros_to_ngsild:
  diagnostics:
    topic: /diagnostics
    type: diagnostic_msgs/DiagnosticArray
    each: status
    alert:
      key: "{status[].hardware_id} {status[].name}"
      about: Device:{status[].hardware_id}
      active: {field: "status[].level", none_of: [0]}
      category: diagnostics
      severity: {field: "status[].level", values: {1: medium, 2: high}, otherwise: low}
      description: "{status[].name}: {status[].message}"
"""


def test_an_alert_is_active_while_its_condition_holds() -> None:
    rule = plan.make(parse(DIAGNOSTICS), TYPES, "demo").ros_to_ngsild[0].extractor
    assert rule is not None
    one = TYPES.default("diagnostic_msgs/msg/DiagnosticStatus")
    status = [
        {**one, "level": 2, "hardware_id": "arm", "name": "motor", "message": "hot"},
        {**one, "level": 0, "hardware_id": "arm", "name": "fan"},
    ]
    alerts = rule.extract({"header": STAMP, "status": status}, RECEIVED_S).alerts
    assert [(alert.key, alert.active, alert.severity) for alert in alerts] == [
        ("arm motor", True, "high"),
        ("arm fan", False, "medium"),
    ]
    assert alerts[0].description == "motor: hot"


numbers = st.floats(width=32) | st.integers(-(2**31), 2**31 - 1).map(float)


@given(st.lists(numbers, max_size=300), st.text(max_size=20), st.integers(-(2**31), 2**31 - 1))
def test_any_message_gives_json_or_errors_and_never_raises(
    positions: list[float], frame: str, seconds: int
) -> None:
    rule = ready(
        "sensor_msgs/JointState",
        "{a: position, b: 'position[3]', c: {field: 'velocity[0]', convert: rad -> deg, round: 2}, d: .}",
        "Device:{header.frame_id}",
    )
    said = message(
        "sensor_msgs/JointState",
        header={"frame_id": frame, "stamp": {"sec": seconds, "nanosec": 4_000_000_000}},
        position=np.array(positions, np.float64),
        velocity=np.array(positions[:1], np.float64),
    )
    extraction = rule.extract(said, RECEIVED_S)
    for update in extraction.entities:
        assert b"null" not in orjson.dumps(dict(update.attributes))
    assert extraction.errors or extraction.entities
