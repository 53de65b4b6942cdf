from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_ros.errors import BadMessage
from handover_ros.types.definition import Many
from handover_ros.types.excerpt import FieldNames, wanted
from handover_ros.types.type_store import TypeStore
from ros_fiware_bridge.tests.unit.types.random_messages import listed, message_of

pytest.importorskip("rosbags")

JOINT_STATE = "sensor_msgs/msg/JointState"
CELL = {
    "Bolt": "uint8 kind\nfloat64 length_mm\nint16 turns\n",
    "Hole": "int32 x\nint32 y\n",
    "Nothing": "",
    "Part": "uint8 grade\nBolt[3] bolts\nHole[] holes\nbool sound\nBolt[<=2] spare\nstring<=8 name\n",
    "Shelf": "string[2] labels\nNothing gap\nNothing[2] gaps\nuint16 rows\nfloat32[4] heights\n"
    "int64[] counts\nuint8[5] code\nbool[3] lit\nstring<=4[<=3] tags\nbyte level\nfloat64 last\n",
    "Box": "Part[] parts\nuint8 lid\nShelf shelf\nPart first\nuint64 number\n",
}
TYPES = [
    JOINT_STATE,
    "actionlib_msgs/msg/GoalStatusArray",
    "control_msgs/action/FollowJointTrajectory_SendGoal_Request",
    "diagnostic_msgs/msg/DiagnosticArray",
    "geometry_msgs/msg/PoseArray",
    "geometry_msgs/msg/TwistWithCovarianceStamped",
    "nav_msgs/msg/OccupancyGrid",
    "nav_msgs/msg/Odometry",
    "rcl_interfaces/msg/ParameterEvent",
    "rcl_interfaces/msg/ParameterValue",
    "rmw_dds_common/msg/ParticipantEntitiesInfo",
    "sensor_msgs/msg/BatteryState",
    "sensor_msgs/msg/CameraInfo",
    "sensor_msgs/msg/PointCloud2",
    "shape_msgs/msg/Mesh",
    "std_msgs/msg/Empty",
    "std_msgs/msg/Float32MultiArray",
    "tf2_msgs/msg/TFMessage",
    "trajectory_msgs/msg/JointTrajectory",
    "visualization_msgs/msg/MarkerArray",
    *(f"cell_msgs/msg/{name}" for name in CELL),
]


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> TypeStore:
    folder: Path = tmp_path_factory.mktemp("types") / "cell_msgs" / "msg"
    folder.mkdir(parents=True)
    for name, text in CELL.items():
        (folder / f"{name}.msg").write_text(text)
    return TypeStore([folder.parent.parent])


@pytest.fixture(scope="module")
def library(store: TypeStore) -> Any:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    known = get_typestore(Stores.ROS2_JAZZY)
    for name in ("Bolt", "Hole", "Nothing", "Part", "Shelf", "Box"):
        known.register(get_types_from_msg(CELL[name], f"cell_msgs/msg/{name}"))
    return known


def field_paths(store: TypeStore, type_name: str, above: FieldNames = ()) -> Iterator[FieldNames]:
    """Yield the paths to all fields, also to nested ones."""
    yield above
    for field in store.definition(type_name).fields:
        way = (*above, field.name)
        if field.type.is_message and field.type.many is Many.ONE:
            yield from field_paths(store, field.type.base, way)
        else:
            yield way


def selected(message: Any, asked: Any) -> Any:
    if not asked:
        return message
    return {name: selected(message[name], below) for name, below in asked.items()}


def big_endian(library: Any, data: bytes, type_name: str) -> bytes:
    """Return a message in big-endian byte order."""
    read = library.deserialize_cdr(data, type_name)
    return bytes(library.serialize_cdr(read, type_name, little_endian=False))


@pytest.mark.nightly
@given(st.data())
@settings(max_examples=400, deadline=None)
def test_an_excerpt_equals_the_selected_fields_of_the_message(
    store: TypeStore, library: Any, data: st.DataObject
) -> None:
    name = data.draw(st.sampled_from(TYPES))
    asked = data.draw(st.frozensets(st.sampled_from(list(field_paths(store, name))), min_size=1))
    for _ in range(2):
        message = store.encode(name, data.draw(message_of(store, name)))
        if data.draw(st.booleans()) and name in library.fielddefs:
            message = big_endian(library, message, name)
        found = store.excerpt(name, message, asked)
        assert listed(found) == listed(selected(store.decode(name, message), wanted(asked)))


@pytest.mark.nightly
@given(st.data())
@settings(max_examples=200, deadline=None)
def test_a_truncated_message_is_refused_for_any_selection(store: TypeStore, data: st.DataObject) -> None:
    name = data.draw(st.sampled_from(TYPES))
    asked = data.draw(st.frozensets(st.sampled_from(list(field_paths(store, name))), min_size=1))
    message = store.encode(name, data.draw(message_of(store, name)))
    cut = message[: data.draw(st.integers(0, len(message)))]
    try:
        store.decode(name, cut)
    except BadMessage:
        with pytest.raises(BadMessage, match=f"is not a message of {name}"):
            store.excerpt(name, cut, asked)
    else:
        store.excerpt(name, cut, asked)


@given(st.data(), st.binary(max_size=200), st.sampled_from([b"\0\0\0\0", b"\0\1\0\0"]))
@settings(max_examples=300, deadline=None)
def test_random_bytes_are_decoded_or_refused(
    store: TypeStore, data: st.DataObject, body: bytes, header: bytes
) -> None:
    name = data.draw(st.sampled_from(TYPES))
    asked = data.draw(st.frozensets(st.sampled_from(list(field_paths(store, name))), min_size=1))
    try:
        store.excerpt(name, header + body, asked)
    except BadMessage:
        with pytest.raises(BadMessage):
            store.decode(name, header + body)


def test_the_cache_of_the_last_message_applies_to_equal_bytes_only(store: TypeStore) -> None:
    names = frozenset({("name",), ("position",)})
    for joints in (["a", "b"], ["a", "b"], ["a", "c"], ["a"], [], ["a", "b"]):
        data = store.encode(JOINT_STATE, {"name": joints, "position": [0.5] * len(joints)})
        found = store.excerpt(JOINT_STATE, data, names)
        assert (found["name"], found["position"].tolist()) == (joints, [0.5] * len(joints))
        found["name"].append("changed by the caller")
        assert store.excerpt(JOINT_STATE, data, frozenset({("position",)}))["position"].size == len(joints)


def test_bytes_behind_a_message_are_ignored(store: TypeStore) -> None:
    data = store.encode(JOINT_STATE, {"effort": [1.5]}) + b"\x6f\x73\x69" * 5
    assert store.excerpt(JOINT_STATE, data, frozenset({("effort",)}))["effort"].tolist() == [1.5]


def test_arrays_of_an_excerpt_are_read_only(store: TypeStore, library: Any) -> None:
    data = store.encode(JOINT_STATE, {"position": [1, 2.5]})
    for message in (data, big_endian(library, data, JOINT_STATE)):
        with pytest.raises(ValueError, match="read-only"):
            store.excerpt(JOINT_STATE, message, frozenset({("position",)}))["position"][0] = 7


def test_a_selected_field_includes_its_fields() -> None:
    assert wanted([("a", "b", "c"), ("a", "b"), ("a", "d"), ("e",), ("e", "f")]) == {
        "a": {"b": {}, "d": {}},
        "e": {},
    }
    assert wanted([("a",), ()]) == {}
