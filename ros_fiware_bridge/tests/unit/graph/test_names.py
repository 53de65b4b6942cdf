import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_ros.errors import BadName
from handover_ros.graph import names
from handover_ros.graph.cyclone import dds_names

part = st.from_regex(r"[a-zA-Z][a-zA-Z0-9]{0,8}", fullmatch=True)
full = st.lists(part, min_size=1, max_size=4).map(lambda parts: "/" + "/".join(parts))


@pytest.mark.parametrize(
    ("name", "is_called"),
    [
        ("/joint_states", "/joint_states"),
        ("joint_states", "/cell/joint_states"),
        ("~/state", "/cell/bridge/state"),
        ("arm/joint_states", "/cell/arm/joint_states"),
    ],
)
def test_a_relative_name_is_resolved(name: str, is_called: str) -> None:
    assert names.full_name(name, "/cell", "bridge") == is_called


def test_the_root_namespace_adds_no_prefix() -> None:
    assert names.full_name("joint_states", "/", "bridge") == "/joint_states"
    assert names.full_name("~/state", "/", "bridge") == "/bridge/state"


@pytest.mark.parametrize(
    "name", ["", "/", "a b", "/1a", "a//b", "a/", "a__b", "ä", "~a", "/a/~/b", "a" * 300]
)
def test_an_invalid_name_is_refused(name: str) -> None:
    with pytest.raises(BadName, match=name[:20] if name.isalnum() else None):
        names.full_name(name, "/", "bridge")


@pytest.mark.parametrize("name", ["", "a b", "1a", "a/b", "/a"])
def test_an_invalid_node_name_is_refused(name: str) -> None:
    with pytest.raises(BadName):
        names.node_name(name)


@pytest.mark.parametrize("name", ["", "cell", "/cell/", "//", "/1"])
def test_an_invalid_namespace_is_refused(name: str) -> None:
    with pytest.raises(BadName):
        names.namespace(name)


@given(full)
def test_dds_names_round_trip(name: str) -> None:
    assert dds_names.to_topic(dds_names.of_topic(name)) == name
    assert dds_names.to_service(dds_names.of_request(name)) == (name, True)
    assert dds_names.to_service(dds_names.of_reply(name)) == (name, False)
    assert dds_names.to_service(dds_names.of_topic(name)) is None
    assert dds_names.to_topic(dds_names.of_request(name)) is None


def test_types_have_their_dds_names() -> None:
    assert dds_names.of_type("std_srvs/srv/SetBool_Request") == "std_srvs::srv::dds_::SetBool_Request_"
    assert dds_names.to_type("std_srvs::srv::dds_::SetBool_Request_") == "std_srvs/srv/SetBool_Request"
    assert dds_names.to_type("Factory::Temperature") == "Factory::Temperature"


@given(st.binary())
def test_any_user_data_is_parsed(data: bytes) -> None:
    assert isinstance(dds_names.parse_user_data(data), dict)


def test_user_data_round_trips() -> None:
    data = {"enclave": "/", "typehash": "RIHS01_0"}
    assert dds_names.user_data(data) == b"enclave=/;typehash=RIHS01_0;"
    assert dds_names.parse_user_data(dds_names.user_data(data)) == data


def test_the_vendor_id_gives_the_middleware() -> None:
    assert dds_names.vendor(bytes.fromhex("010f") + bytes(14)) == "fastdds"
    assert dds_names.vendor(bytes.fromhex("0110") + bytes(14)) == "cyclonedds"
    assert dds_names.vendor(bytes.fromhex("01ff") + bytes(14)) == "vendor 01ff"
