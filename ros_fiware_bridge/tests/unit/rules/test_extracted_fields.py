"""The fields that a rule reads are sufficient: it extracts the same from an excerpt as from the message."""

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_ros.mapping import load, parse
from handover_ros.mapping.document import SHIPPED
from handover_ros.rules import plan
from handover_ros.rules.entity_extractor import EntityExtractor
from handover_ros.types.type_store import TypeStore
from ros_fiware_bridge.tests.unit.types.random_messages import message_of

TYPES = TypeStore()
RULES = """
ros_to_ngsild:
  beside:
    topic: /a
    type: sensor_msgs/JointState
    entity: Device:{header.frame_id}
    attributes: {elbow: "position[name=a]", second: "effort[1]"}
  each:
    topic: /b
    type: diagnostic_msgs/DiagnosticArray
    each: status
    when: {field: "status[].level", above: 3}
    entity: "Device:{status[].hardware_id}"
    attributes: {said: "status[].message", of: {text: "{header.frame_id} {status[].name}"}}
  json:
    topic: /c
    type: std_msgs/String
    json_text: [data]
    entity: Device:c
    attributes: {deep: data.a.b}
  inside:
    topic: /d
    type: nav_msgs/Odometry
    entity: Device:d
    observed_at: none
    attributes:
      at: pose.pose.position
      place: {field: pose.pose.position, kind: GeoProperty, origin: {longitude: 24.9, latitude: 60.2}}
      sure: "pose.covariance[35]"
      child: {object: "Device:{child_frame_id}"}
  whole:
    topic: /e
    type: sensor_msgs/BatteryState
    entity: Device:e
    attributes: {all: {field: ., kind: JsonProperty, nan: 0}}
  points:
    topic: /f
    type: trajectory_msgs/JointTrajectory
    entity: Device:f
    attributes:
      first: "points[0].positions[1]"
      lasts: {list: ["points[0].time_from_start.sec", "joint_names[0]"]}
  nothing:
    topic: /g
    type: std_msgs/Int32
    entity: Device:g
    attributes: {is: {constant: there}}
"""


def rules() -> dict[str, EntityExtractor]:
    documents = {"own": parse(RULES), **{file.stem: load(Path(file.stem)) for file in SHIPPED.glob("*.yaml")}}
    return {
        f"{name} {one.name}": one.extractor
        for name, document in documents.items()
        for one in plan.make(document, TYPES, "demo").ros_to_ngsild
        if one.extractor is not None
    }


READY = rules()


@pytest.mark.nightly
@given(st.data())
@settings(max_examples=300, deadline=None)
def test_an_excerpt_and_the_whole_message_extract_the_same(data: st.DataObject) -> None:
    rule = READY[data.draw(st.sampled_from(sorted(READY)))]
    given_message: Any = data.draw(message_of(TYPES, rule.type_name))
    encoded = TYPES.encode(rule.type_name, given_message)
    whole = rule.extract(TYPES.decode(rule.type_name, encoded), 1_770_000_000.0)
    excerpt = TYPES.excerpt(rule.type_name, encoded, rule.fields)
    assert rule.extract(excerpt, 1_770_000_000.0) == whole


@pytest.mark.parametrize(
    ("name", "fields"),
    [
        ("own beside", {("header", "stamp"), ("header", "frame_id"), ("position",), ("name",), ("effort",)}),
        ("own each", {("header", "stamp"), ("header", "frame_id"), ("status",)}),
        ("own whole", {(), ("header", "stamp")}),
        ("own inside", {("pose", "pose", "position"), ("pose", "covariance"), ("child_frame_id",)}),
    ],
)
def test_a_rule_reads_the_fields_of_its_paths_and_the_stamp(name: str, fields: set[tuple[str, ...]]) -> None:
    assert READY[name].fields == fields
