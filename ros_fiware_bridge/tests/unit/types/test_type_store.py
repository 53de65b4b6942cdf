import struct
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover_ros.errors import BadDefinition, BadMessage, UnknownType, UnsupportedType
from handover_ros.types.type_store import TypeStore
from ros_fiware_bridge.tests.unit.types.random_messages import listed, message_of

pytest.importorskip("rosbags")

JOINT_STATE = "sensor_msgs/msg/JointState"
store = TypeStore()


def written(root: Path, text: str, where: str = "cell_msgs/msg/Part.msg") -> Path:
    file = root / where
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text)
    return file


def test_every_known_type_encodes_its_defaults() -> None:
    for name in store.type_names():
        if "/msg/" in name:
            store.sound(name)
            message = store.default(name)
            assert store.decode(name, store.encode(name, message)).keys() == message.keys()


def test_defaults_come_from_the_definition() -> None:
    assert store.default("geometry_msgs/msg/Pose")["orientation"] == {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
    assert store.default("sensor_msgs/msg/NavSatFix")["status"]["status"] == -2


def test_a_default_in_a_custom_message_is_used(tmp_path: Path) -> None:
    text = 'string<=8 name "bolt"\nfloat64[] sizes_mm [1.5, 2.0]\nuint8 count 3\nbool loose true\n'
    own = TypeStore([written(tmp_path, text)])
    message = own.default("cell_msgs/msg/Part")
    assert message["name"] == "bolt"
    assert message["sizes_mm"].tolist() == [1.5, 2.0]
    assert message["count"] == 3
    assert message["loose"] is True


def test_quotes_in_a_default_are_unescaped(tmp_path: Path) -> None:
    lines = (
        'string a "it\'s"',
        "string b 'it\\'s'",
        'string c "\\"so\\""',
        "string[] d ['x', \"y\"]",
        "string e bare words",
    )
    text = "\n".join(lines)
    message = TypeStore([written(tmp_path, text)]).default("cell_msgs/msg/Part")
    assert message == {"a": "it's", "b": "it's", "c": '"so"', "d": ["x", "y"], "e": "bare words"}


def test_bytes_behind_a_message_on_the_wire_are_ignored() -> None:
    # The serializer of Fast DDS hands out the space that it reserved to align empty arrays.
    data = store.encode(JOINT_STATE, {"name": ["a"]})
    assert store.decode(JOINT_STATE, data + b"\x6f\x73\x69" * 5)["name"] == ["a"]


def test_octets_are_bytes_and_number_arrays_are_read_only() -> None:
    image = store.decode(
        "sensor_msgs/msg/Image", store.encode("sensor_msgs/msg/Image", {"data": [0, 255, 128]})
    )
    assert image["data"] == b"\x00\xff\x80"
    joints = store.decode(JOINT_STATE, store.encode(JOINT_STATE, {"position": [1, 2.5]}))
    assert joints["position"].tolist() == [1.0, 2.5]
    with pytest.raises(ValueError, match="read-only"):
        joints["position"][0] = 7


def test_a_byte_is_an_unsigned_octet() -> None:
    status = store.encode("diagnostic_msgs/msg/DiagnosticStatus", {"level": 200})
    assert store.decode("diagnostic_msgs/msg/DiagnosticStatus", status)["level"] == 200


def test_an_empty_message_is_an_empty_dict() -> None:
    assert store.decode("std_msgs/msg/Empty", store.encode("std_msgs/msg/Empty", {})) == {}


@pytest.mark.parametrize(
    ("type_name", "message", "says"),
    [
        (JOINT_STATE, {"positio": [1]}, 'no field "positio"; did you mean "position"?'),
        (JOINT_STATE, {"name": ["a", 1]}, "name[1]: 1 is not text"),
        (JOINT_STATE, {"position": [0.5, "x"]}, "position[1]: 'x' is not a number"),
        (JOINT_STATE, {"position": [[1.0], [2.0]]}, "position[0]: [1.0] is not a number"),
        (JOINT_STATE, {"position": {"a": 1}}, "is not a list; float64[] is expected"),
        (
            JOINT_STATE,
            {"header": {"stamp": {"sec": 2**31}}},
            "header.stamp.sec: 2147483648 does not fit int32",
        ),
        (JOINT_STATE, {"header": None}, "header: None is not a message of std_msgs/msg/Header"),
        ("std_msgs/msg/UInt8", {"data": -1}, "data: -1 does not fit uint8, whose range is 0 to 255"),
        ("std_msgs/msg/UInt8", {"data": 1.5}, "data: 1.5 is not a whole number; uint8 is expected"),
        ("std_msgs/msg/Bool", {"data": 1}, "data: 1 is not true or false"),
        ("std_msgs/msg/Float32", {"data": 1e300}, "data: 1e+300 is out of the range of float32"),
        (
            "std_msgs/msg/Float32MultiArray",
            {"data": [0.0, 1e300]},
            "data[1]: 1e+300 is out of the range of float32",
        ),
        ("std_msgs/msg/Int8MultiArray", {"data": [0, 128]}, "data[1]: 128 does not fit int8"),
        ("std_msgs/msg/String", {"data": "a\0b"}, "NUL character"),
        (
            "geometry_msgs/msg/PoseWithCovariance",
            {"covariance": [0.0] * 35},
            "35 elements do not fit float64[36]",
        ),
        ("std_msgs/msg/Float64", {"data": 10**400}, "out of the range of float64"),
        ("std_msgs/msg/Float64", "text", "'text' is not a message of std_msgs/msg/Float64"),
    ],
)
def test_an_invalid_value_is_named_by_its_path(type_name: str, message: Any, says: str) -> None:
    with pytest.raises(BadMessage) as error:
        store.encode(type_name, message)
    assert says in str(error.value)


def test_bounds_are_checked(tmp_path: Path) -> None:
    own = TypeStore([written(tmp_path, "string<=4 name\nint32[<=2] slots\nstring<=3[<=2] tags\n")])
    part = "cell_msgs/msg/Part"
    own.check(part, {"name": "ÄÖ", "slots": [1, 2], "tags": ["abc"]})
    for message, says in [
        ({"name": "ÄÖa"}, "name: 5 bytes of text do not fit string<=4"),
        ({"slots": [1, 2, 3]}, "slots: 3 elements do not fit int32[<=2]; at most 2 are allowed"),
        ({"tags": ["a", "abcd"]}, "tags[1]: 4 bytes of text do not fit string<=3"),
    ]:
        with pytest.raises(BadMessage) as error:
            own.check(part, message)
        assert says in str(error.value)


def test_a_field_may_have_the_name_of_a_python_keyword(tmp_path: Path) -> None:
    own = TypeStore([written(tmp_path, "string from\nuint8 class_\nstd_msgs/Header header\n")])
    data = own.encode("cell_msgs/msg/Part", {"from": "bin-1"})
    assert own.decode("cell_msgs/msg/Part", data)["from"] == "bin-1"


@pytest.mark.parametrize("data", [b"", b"\0\1\0\0", b"\0\1\0\0\xff\xff\xff\x7f", b"\0\7\0\0\0\0\0\0"])
def test_invalid_data_is_refused(data: bytes) -> None:
    with pytest.raises(BadMessage, match="is not a message of std_msgs/msg/String"):
        store.decode("std_msgs/msg/String", data)


@given(st.binary(max_size=200))
@settings(max_examples=300, deadline=None)
def test_random_bytes_of_the_network_are_decoded_or_refused(body: bytes) -> None:
    for name in (
        "sensor_msgs/msg/JointState",
        "diagnostic_msgs/msg/DiagnosticArray",
        "tf2_msgs/msg/TFMessage",
    ):
        try:
            store.decode(name, b"\0\1\0\0" + body)
        except BadMessage:
            continue


@given(st.data())
@settings(max_examples=120, deadline=None)
def test_a_message_round_trips(data: st.DataObject) -> None:
    name = data.draw(
        st.sampled_from(
            [
                "sensor_msgs/msg/JointState",
                "nav_msgs/msg/OccupancyGrid",
                "diagnostic_msgs/msg/DiagnosticArray",
                "rcl_interfaces/msg/ParameterValue",
                "trajectory_msgs/msg/JointTrajectory",
                "rmw_dds_common/msg/ParticipantEntitiesInfo",
                "control_msgs/action/FollowJointTrajectory_SendGoal_Request",
            ]
        )
    )
    message = data.draw(message_of(store, name))
    assert listed(store.decode(name, store.encode(name, message))) == message


@pytest.mark.parametrize(
    ("name", "kind", "says"),
    [
        ("sensor_msgs/msg/JointStates", "msg", "did you mean sensor_msgs/msg/JointState?"),
        ("cell_msgs/msg/Part", "msg", "name its .msg file or folder in type_paths"),
        ("JointState", "msg", "write PACKAGE/msg/NAME"),
        ("std_srvs/srv/Trigger", "msg", "is a service type, but a message type is expected"),
        ("std_msgs/msg/String", "action", "is a message type, but an action type is expected"),
    ],
)
def test_an_unknown_type_is_named_with_the_nearest_one(name: str, kind: str, says: str) -> None:
    with pytest.raises(UnknownType) as error:
        store.resolve(name, kind)
    assert says in str(error.value)


def test_a_short_type_name_is_resolved() -> None:
    assert store.resolve("sensor_msgs/JointState") == JOINT_STATE
    assert store.resolve("std_srvs/Trigger", "srv") == "std_srvs/srv/Trigger"


def test_a_folder_of_packages_is_read(tmp_path: Path) -> None:
    written(tmp_path, "Bolt[] bolts\n", "cell_msgs/msg/Part.msg")
    written(tmp_path, "float32 length_mm\n", "cell_msgs/msg/Bolt.msg")
    written(tmp_path, "Part part\n---\nbool taken\n", "cell_msgs/srv/Take.srv")
    written(tmp_path, "Part part\n---\nbool done\n---\nfloat32 progress\n", "cell_msgs/action/Fit.action")
    own = TypeStore([tmp_path])
    assert own.default("cell_msgs/srv/Take_Request") == {"part": {"bolts": []}}
    assert own.default("cell_msgs/action/Fit_FeedbackMessage")["feedback"] == {"progress": 0.0}
    assert own.resolve("cell_msgs/Fit", "action") == "cell_msgs/action/Fit"


def test_a_custom_definition_replaces_the_built_in_one(tmp_path: Path) -> None:
    file = written(tmp_path, "string name\nfloat64 effort\n", "control_msgs/msg/JointTolerance.msg")
    own = TypeStore([file])
    name = "control_msgs/msg/JointTolerance"
    assert own.default(name) == {"name": "", "effort": 0.0}
    assert own.hash(name) != store.hash(name)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("float64 length\nflot 64\n", "line 2"),
        ("float64 length\nfloat64 length\n", 'line 2: the field "length" is a duplicate'),
        ("float64[0] sizes\n", "line 1"),
        ("float64 length\n---\nbool done\n", "a .msg file has 1 parts"),
    ],
)
def test_an_invalid_definition_is_named_by_file_and_line(tmp_path: Path, text: str, says: str) -> None:
    file = written(tmp_path, text)
    with pytest.raises(BadDefinition) as error:
        TypeStore([file]).definition("cell_msgs/msg/Part")
    assert says in str(error.value)
    assert str(file) in str(error.value)


WIDE = 'uint8 kind\nwstring name\nfloat64 length\nwstring<=4 short "ab"\nstring note\n'
wide_texts = st.text(st.characters(exclude_categories=("Cs",), exclude_characters="\0"), max_size=12)


@given(name=wide_texts, note=wide_texts)
def test_a_wstring_is_carried_as_text(tmp_path_factory: pytest.TempPathFactory, name: str, note: str) -> None:
    """Four bytes for each unit of UTF-16, as Fast CDR and Cyclone DDS write it for ROS."""
    store = TypeStore([written(tmp_path_factory.mktemp("wide"), WIDE)])
    store.sound("cell_msgs/msg/Part")
    given_message = {"kind": 3, "name": name, "length": 1.5, "note": note}
    data = store.encode("cell_msgs/msg/Part", given_message)
    units = name.encode("utf-16-le")
    (count,) = struct.unpack_from("<I", data, 8)
    assert count == len(units) // 2
    wide = b"".join(units[at : at + 2] + b"\0\0" for at in range(0, len(units), 2))
    assert data[12 : 12 + 4 * count] == wide
    whole = {**given_message, "short": "ab"}
    assert store.decode("cell_msgs/msg/Part", data) == whole
    for fields in ({("name",)}, {("note",)}, {("length",), ("short",)}, {()}):
        excerpt = store.excerpt("cell_msgs/msg/Part", data, frozenset(fields))
        assert excerpt
        assert excerpt == {key: whole[key] for key in excerpt}
    with pytest.raises(BadMessage, match="wstring<=4"):
        store.encode("cell_msgs/msg/Part", {"short": "abcde"})


WIDES = "uint8 kind\nwstring[2] pair\nfloat64 length\nwstring[<=3] few\nwstring<=4[] short\nstring note\n"


@given(
    pair=st.lists(wide_texts, min_size=2, max_size=2), few=st.lists(wide_texts, max_size=3), note=wide_texts
)
def test_arrays_of_wstring_are_carried_as_lists_of_text(
    tmp_path_factory: pytest.TempPathFactory, pair: list[str], few: list[str], note: str
) -> None:
    store = TypeStore([written(tmp_path_factory.mktemp("wides"), WIDES)])
    store.sound("cell_msgs/msg/Part")
    whole = {"kind": 3, "pair": pair, "length": 1.5, "few": few, "short": ["ab", ""], "note": note}
    data = store.encode("cell_msgs/msg/Part", whole)
    for text in pair:
        assert text.encode("utf-32-le") in data or any(ord(letter) > 0xFFFF for letter in text)
    assert store.decode("cell_msgs/msg/Part", data) == whole
    for fields in ({("pair",)}, {("few",)}, {("note",)}, {("length",), ("short",)}, {()}):
        for _ in range(2):  # the second one finds the texts of the first
            excerpt = store.excerpt("cell_msgs/msg/Part", data, frozenset(fields))
            assert excerpt
            assert excerpt == {key: whole[key] for key in excerpt}
    defaults = store.decode("cell_msgs/msg/Part", store.encode("cell_msgs/msg/Part", {}))
    assert (defaults["pair"], defaults["few"]) == (["", ""], [])
    for wrong, rule in (
        ({"pair": ["a"]}, "exactly 2"),
        ({"few": [""] * 4}, "at most 3"),
        ({"short": ["abcde"]}, "<=4"),
    ):
        with pytest.raises(BadMessage, match=rule):
            store.encode("cell_msgs/msg/Part", wrong)
    for end in {4, 9, len(data) // 2, len(data) - 2}:
        for read in (store.decode, lambda name, cut: store.excerpt(name, cut, frozenset({("note",)}))):
            with pytest.raises(BadMessage):
                read("cell_msgs/msg/Part", data[:end])


def test_a_wstring_of_another_form_is_no_message(tmp_path: Path) -> None:
    """Two bytes for each unit would be read as other letters; the message is refused."""
    store = TypeStore([written(tmp_path, "wstring name\n")])
    units = "abcd".encode("utf-16-le")
    data = b"\0\1\0\0" + struct.pack("<I", 2) + units
    for read in (store.decode, lambda name, data: store.excerpt(name, data, frozenset({("name",)}))):
        with pytest.raises(BadMessage, match="another form of wstring"):
            read("cell_msgs/msg/Part", data)


def test_a_wstring_has_another_hash_than_a_string(tmp_path: Path) -> None:
    kinds = ("string", "string<=4", "wstring", "wstring<=4")
    stores = [TypeStore([written(tmp_path / str(at), f"{kind} name\n")]) for at, kind in enumerate(kinds)]
    assert len({store.hash("cell_msgs/msg/Part") for store in stores}) == len(kinds)


def test_unsupported_types_are_refused(tmp_path: Path) -> None:
    endless = TypeStore([written(tmp_path / "b", "Part[] parts\n")])
    with pytest.raises(UnsupportedType, match="contains itself"):
        endless.sound("cell_msgs/msg/Part")
    lost = TypeStore([written(tmp_path / "c", "other_msgs/Thing thing\n")])
    with pytest.raises(
        UnknownType, match=r"cell_msgs/msg/Part\.thing: there is no type other_msgs/msg/Thing"
    ):
        lost.sound("cell_msgs/msg/Part")


def test_a_type_path_without_definitions_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadDefinition, match="does not exist"):
        TypeStore([tmp_path / "nothing"])
    with pytest.raises(BadDefinition, match="contains no definition"):
        TypeStore([tmp_path])
    with pytest.raises(BadDefinition, match="is not in a package"):
        TypeStore([written(tmp_path, "bool a\n", "Part.msg")])


def test_contradicting_definitions_are_refused(tmp_path: Path) -> None:
    first = written(tmp_path / "a", "bool a\n")
    same = written(tmp_path / "b", "# the same\nbool a\n")
    other = written(tmp_path / "c", "bool b\n")
    TypeStore([first, same])
    with pytest.raises(BadDefinition, match="and, differently, by"):
        TypeStore([first, other])
