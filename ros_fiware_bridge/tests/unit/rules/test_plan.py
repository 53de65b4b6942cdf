"""A mapping is checked against the message definitions before anything starts."""

import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_ros.mapping import InvalidMapping, parse
from handover_ros.rules import plan
from handover_ros.types.type_store import TypeStore

TYPES = TypeStore()


def planned(text: str, **types: tuple[str, ...]) -> plan.Plan:
    return plan.make(parse(text), TYPES, "demo", lambda topic: types.get(topic.strip("/"), ()))


def outward(topic_type: str, attribute: str, **more: str) -> str:
    extra = "".join(f"    {key}: {value}\n" for key, value in more.items())
    return (
        f"ros_to_ngsild:\n  rule:\n    topic: /t\n    type: {topic_type}\n    entity: Device:d\n{extra}"
        f"    attributes:\n      a: {attribute}\n"
    )


def inward(topic_type: str, field: str, source: str) -> str:
    return (
        f"ngsild_to_ros:\n  rule:\n    entity: Device:d\n    topic: /t\n    type: {topic_type}\n"
        f"    fields:\n      b: {{attribute: c}}\n      {field}: {source}\n"
    ).replace("      b: {attribute: c}\n", "")


OUTWARD_MISTAKES = [
    ("sensor_msgs/JointStat", "position", 4, "did you mean sensor_msgs/msg/JointState"),
    ("nowhere_msgs/Thing", "x", 4, "type_paths"),
    ("sensor_msgs/JointState", "positions", 7, 'has no field "positions"; did you mean "position"?'),
    ("sensor_msgs/JointState", "header.stamp.secs", 7, 'has no field "secs"; did you mean "sec"?'),
    ("sensor_msgs/JointState", "position.x", 7, r"choose an element, as position[0]"),
    ("sensor_msgs/JointState", "header[0]", 7, "not an array"),
    ("sensor_msgs/JointState", "header.frame_id[0]", 7, "header.frame_id is string, not an array"),
    ("sensor_msgs/JointState", "header.stamp.sec.x", 7, "header.stamp.sec is int32 and has no field x"),
    ("sensor_msgs/JointState", "position[-1]", 7, 'cannot be parsed from "[-1]"'),
    ("sensor_msgs/JointState", "position[joint=elbow]", 7, 'has no field "joint"'),
    ("geometry_msgs/PoseWithCovariance", "covariance[36]", 7, "holds 36 at most"),
    ("sensor_msgs/JointState", "position[].x", 7, "the rule has no `each: position`"),
    ("sensor_msgs/Image", "data", 7, "large_arrays: true"),
    ("sensor_msgs/Image", ".", 7, "bytes without a bound"),
    ("sensor_msgs/PointCloud2", "{field: ., kind: JsonProperty}", 7, "bytes without a bound"),
    ("sensor_msgs/BatteryState", "{field: voltage, convert: V -> m}", 7, "cannot be converted"),
    ("sensor_msgs/BatteryState", "{field: voltage, convert: V -> vlot}", 7, "pint does not know"),
    ("sensor_msgs/BatteryState", "{field: location, convert: V -> mV}", 7, "only numbers are converted"),
    ("nav_msgs/Odometry", "{field: pose.pose.position, kind: GeoProperty}", 7, "in metres of its frame"),
    ("nav_msgs/Odometry", "{field: header, kind: GeoProperty}", 7, "longitude and latitude"),
    ("std_msgs/Int32", "{languages: {en: data}}", 7, "made of text"),
    ("std_msgs/String", "{object: nothing}", 7, "write Type:id"),
]


@pytest.mark.parametrize(("topic_type", "attribute", "line", "why"), OUTWARD_MISTAKES)
def test_an_invalid_source_in_a_message_is_reported_with_its_line(
    topic_type: str, attribute: str, line: int, why: str
) -> None:
    with pytest.raises(InvalidMapping, match=re.escape(why)) as caught:
        planned(outward(topic_type, attribute))
    assert [fault.line for fault in caught.value.faults] == [line]


INWARD_MISTAKES = [
    ("std_msgs/String", "data", "{constant: 5}", "5 is not text"),
    ("std_msgs/Int8", "data", "{attribute: c, values: {on: 300}}", "300 does not fit int8"),
    ("std_msgs/Int8", "data", "{text: 'x {c}'}", "text goes into a string"),
    ("std_msgs/Int8", "date", "c", 'did you mean "data"?'),
    ("std_msgs/Header", "frame_id", "{now: true}", "not a time"),
    ("geometry_msgs/PoseWithCovariance", "covariance[36]", "c", "holds 36 at most"),
    ("sensor_msgs/JointState", "position[name=a]", "c", "use a number"),
    ("std_msgs/String", "data", "{constant: x}", "no attribute to subscribe to"),
]


@pytest.mark.parametrize(("topic_type", "field", "source", "why"), INWARD_MISTAKES)
def test_an_invalid_target_in_a_message_is_reported(
    topic_type: str, field: str, source: str, why: str
) -> None:
    with pytest.raises(InvalidMapping, match=re.escape(why)) as caught:
        planned(inward(topic_type, field, source))
    assert caught.value.faults[0].line >= 2


def test_the_errors_of_all_rules_are_reported_together() -> None:
    text = outward("std_msgs/String", "dat") + inward("std_msgs/String", "dot", "c").replace("rule", "other")
    with pytest.raises(InvalidMapping) as caught:
        planned(text)
    assert [fault.line for fault in caught.value.faults] == [7, 14]


def test_the_graph_may_supply_the_type() -> None:
    text = outward("X", "data").replace("    type: X\n", "")
    assert planned(text).ros_to_ngsild[0].extractor is None
    found = planned(text, t=("std_msgs/msg/String",)).ros_to_ngsild[0].extractor
    assert found is not None
    assert found.type_name == "std_msgs/msg/String"
    with pytest.raises(InvalidMapping, match="set one of them"):
        planned(text, t=("std_msgs/msg/String", "std_msgs/msg/Bool"))


def test_services_and_actions_are_checked_like_messages() -> None:
    text = """
services:
  reset:
    service: /reset
    type: std_srvs/SetBool
    task: reset
    resource: Device:d
    request: {dada: on}
    success: massage
actions:
  count:
    action: /count
    type: example_interfaces/Fibonacci
    task: reset
    resource: Device:d
    goal: {order: {constant: many}}
    feedback: {progress: percent}
tasks_from_ros:
  ask:
    service: /ask
    type: std_srvs/Trigger
    task: {definition: confirm, resources: [Person:anna]}
    response: {message: result}
"""
    with pytest.raises(InvalidMapping) as caught:
        planned(text)
    whys = {fault.line: fault.why for fault in caught.value.faults}
    assert 'did you mean "data"?' in whys[8]
    assert 'did you mean "message"?' in whys[9]
    assert "not a whole number" in whys[16]
    assert 'no field "percent"' in whys[17]
    assert 'a response has no "result"' in whys[23]
    assert any("is already mapped by the rule" in why for why in whys.values())


def test_type_paths_are_relative_to_the_mapping_file(tmp_path: Path) -> None:
    folder = tmp_path / "msgs" / "cell_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Grip.msg").write_text("float32 force\nbool[<=2] fingers\n")
    text = "type_paths: [./msgs]\n" + outward("cell_msgs/Grip", "{field: force, unit_code: NEW}")
    document = parse(text, "cell.yaml", tmp_path)
    made = plan.make(document, plan.type_store(document), "demo").ros_to_ngsild[0].extractor
    assert made is not None
    assert made.extract({"force": 2.5, "fingers": [True]}, 0.0).entities[0].values == {"a": 2.5}
    missing = parse("\ntype_paths: [./nowhere]\n", "cell.yaml", tmp_path)
    with pytest.raises(InvalidMapping, match=r"cell\.yaml:2: type_paths: .*nowhere"):
        plan.type_store(missing)


MESSAGES = [name for name in TYPES.type_names() if "/msg/" in name]
WORDS = sorted({field.name for name in MESSAGES for field in TYPES.definition(name).fields})
steps = st.builds(
    "{}{}".format, st.sampled_from(WORDS), st.sampled_from(["", "", "", "[0]", "[name=a]", "[7]", "[]"])
)
paths = st.one_of(st.just("."), st.lists(steps, min_size=1, max_size=4).map(".".join))
options = st.sampled_from(["", ", convert: m -> km", ", kind: GeoProperty", ", round: 1", ", nan: 0"])


@given(st.sampled_from(MESSAGES), paths, options)
def test_any_path_into_any_message_compiles_or_is_refused_with_its_line(
    type_name: str, path: str, option: str
) -> None:
    text = outward(type_name, f"{{field: '{path}'{option}}}")
    lines: list[int] = []
    try:
        made = planned(text).ros_to_ngsild[0].extractor
    except InvalidMapping as wrong:
        lines = [fault.line for fault in wrong.faults]
    else:
        assert made is not None
        extraction = made.extract(TYPES.default(type_name), 1_770_000_000.0)
        assert extraction.entities or extraction.errors
        excerpt = TYPES.excerpt(type_name, TYPES.encode(type_name, {}), made.fields)
        assert made.extract(excerpt, 1_770_000_000.0) == extraction
    assert all(line == 7 for line in lines)
