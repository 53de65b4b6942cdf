"""The message builder: attributes become messages, field by field."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover.errors import HandoverError
from handover_ros.mapping import parse
from handover_ros.rules import plan
from handover_ros.rules.change_tracker import scope_of
from handover_ros.rules.message_builder import Incomplete, MessageBuilder, Scope
from handover_ros.types.type_store import TypeStore

TYPES = TypeStore()


def ready(type_name: str, fields: str) -> MessageBuilder:
    text = f"ngsild_to_ros:\n  r: {{entity: Device:d, topic: /t, type: {type_name}, fields: {{{fields}}}}}\n"
    return plan.make(parse(text), TYPES, "demo").ngsild_to_ros[0].builder


ENTITY = {
    "id": "urn:ngsi-ld:Device:demo:lamp-1",
    "type": "Device",
    "speed": {"type": "Property", "value": 36, "observedAt": "2026-02-02T02:40:00.250000Z"},
    "mode": {"type": "Property", "value": "auto"},
    "value": {"type": "Property", "value": {"joints": [0.1, 0.2, 0.3]}},
    "site": {"type": "Relationship", "object": "urn:ngsi-ld:Location:demo:hall"},
    "issued": {"type": "Property", "value": {"@type": "DateTime", "@value": "2026-01-01T00:00:00Z"}},
}
SCOPE = scope_of(ENTITY, 5.5)


@pytest.mark.parametrize(
    ("type_name", "fields", "made"),
    [
        ("std_msgs/Float64", "data: {attribute: speed, convert: km/h -> m/s, round: 3}", {"data": 10.0}),
        ("std_msgs/Float64", "data: 'value.joints[1]'", {"data": 0.2}),
        ("std_msgs/Int8", "data: {attribute: mode, values: {auto: 1, manual: 2}}", {"data": 1}),
        ("std_msgs/String", "data: {text: 'lamp {id} at {speed}'}", {"data": "lamp lamp-1 at 36"}),
        ("std_msgs/String", "data: {json_of: value}", {"data": '{"joints":[0.1,0.2,0.3]}'}),
        ("std_msgs/String", "data: site", {"data": "urn:ngsi-ld:Location:demo:hall"}),
        ("std_msgs/String", "data: issued", {"data": "2026-01-01T00:00:00Z"}),
        ("std_msgs/String", "data: {attribute: nothing, default: none}", {"data": "none"}),
        ("std_msgs/String", "data: nothing", {}),
        (
            "std_msgs/Header",
            "stamp: {observed_at: speed}, frame_id: mode",
            {"stamp": {"sec": 1770000000, "nanosec": 250000000}, "frame_id": "auto"},
        ),
        (
            "std_msgs/Header",
            "stamp: {now: true}, frame_id: mode",
            {"stamp": {"sec": 5, "nanosec": 500000000}},
        ),
        ("std_msgs/Float32MultiArray", "data: value.joints", {"data": [0.1, 0.2, 0.3]}),
        ("sensor_msgs/JointState", "'position[2]': speed", {"position": [0.0, 0.0, 36]}),
        (
            "trajectory_msgs/JointTrajectory",
            "'points[1].positions': value.joints, 'joint_names[0]': mode",
            {"points": [{}, {"positions": [0.1, 0.2, 0.3]}], "joint_names": ["auto"]},
        ),
        (
            "geometry_msgs/PoseWithCovariance",
            "'covariance[1]': speed",
            {"covariance": [0, 36] + [0] * 34},
        ),
    ],
)
def test_a_message_is_filled_from_an_entity(type_name: str, fields: str, made: dict[str, Any]) -> None:
    inward = ready(type_name, fields)
    message = inward.message(SCOPE)
    assert {key: message.get(key) for key in made} == made
    TYPES.check(inward.type_name, message)


def test_a_whole_message_is_filled_from_an_object() -> None:
    inward = ready("geometry_msgs/Point", "'.': pose")
    assert inward.message(Scope({"pose": {"x": 1.0, "y": 2.0}})) == {"x": 1.0, "y": 2.0}
    with pytest.raises(HandoverError, match="filled from an object"):
        inward.message(Scope({"pose": 3}))


def test_a_missing_required_value_raises() -> None:
    inward = ready("std_msgs/String", "data: {attribute: nothing, required: true}")
    with pytest.raises(Incomplete, match="there is no nothing"):
        inward.message(SCOPE)


json_values = st.recursive(
    st.none() | st.booleans() | st.floats(allow_nan=False) | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=8,
)


@given(json_values)
def test_any_value_of_the_broker_gives_a_message_or_an_error(value: Any) -> None:
    inward = ready("std_msgs/Float64", "data: {attribute: v, convert: km/h -> m/s}")
    try:
        message = inward.message(scope_of({"id": "urn:x:y:z", "v": {"value": value}}, 0.0))
        TYPES.check(inward.type_name, message)
    except (HandoverError, ValueError) as error:
        reason = str(error)
    else:
        reason = "it fits"
    assert reason
