import pytest
from hypothesis import given
from hypothesis import strategies as st

from ros_fiware_bridge.errors import BadName
from ros_fiware_bridge.graph import names
from ros_fiware_bridge.graph.cyclone import dds_names

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
def test_a_name_is_relative_to_the_namespace_or_the_node(name: str, is_called: str) -> None:
    assert names.full_name(name, "/cell", "bridge") == is_called


def test_the_root_namespace_adds_nothing() -> None:
    assert names.full_name("joint_states", "/", "bridge") == "/joint_states"
    assert names.full_name("~/state", "/", "bridge") == "/bridge/state"


@pytest.mark.parametrize(
    "name", ["", "/", "a b", "/1a", "a//b", "a/", "a__b", "ä", "~a", "/a/~/b", "a" * 300]
)
def test_a_name_that_ros_does_not_allow_is_refused(name: str) -> None:
    with pytest.raises(BadName, match=name[:20] if name.isalnum() else None):
        names.full_name(name, "/", "bridge")


@pytest.mark.parametrize("name", ["", "a b", "1a", "a/b", "/a"])
def test_a_node_that_ros_does_not_allow_is_refused(name: str) -> None:
    with pytest.raises(BadName):
        names.node_name(name)


@pytest.mark.parametrize("name", ["", "cell", "/cell/", "//", "/1"])
def test_a_namespace_that_ros_does_not_allow_is_refused(name: str) -> None:
    with pytest.raises(BadName):
        names.namespace(name)


@given(full)
def test_dds_names_lead_back_to_ros_names(name: str) -> None:
    assert dds_names.to_topic(dds_names.of_topic(name)) == name
    assert dds_names.to_service(dds_names.of_request(name)) == (name, True)
    assert dds_names.to_service(dds_names.of_reply(name)) == (name, False)
    assert dds_names.to_service(dds_names.of_topic(name)) is None
    assert dds_names.to_topic(dds_names.of_request(name)) is None


def test_types_are_named_as_on_the_wire() -> None:
    assert dds_names.of_type("std_srvs/srv/SetBool_Request") == "std_srvs::srv::dds_::SetBool_Request_"
    assert dds_names.to_type("std_srvs::srv::dds_::SetBool_Request_") == "std_srvs/srv/SetBool_Request"
    assert dds_names.to_type("Factory::Temperature") == "Factory::Temperature"


@given(st.binary())
def test_whatever_a_peer_tells_about_itself_is_read_or_left_out(data: bytes) -> None:
    assert isinstance(dds_names.told(data), dict)


def test_what_is_told_is_read() -> None:
    told = {"enclave": "/", "typehash": "RIHS01_0"}
    assert dds_names.user_data(told) == b"enclave=/;typehash=RIHS01_0;"
    assert dds_names.told(dds_names.user_data(told)) == told


def test_vendors_are_told_by_their_number() -> None:
    assert dds_names.vendor(bytes.fromhex("010f") + bytes(14)) == "fastdds"
    assert dds_names.vendor(bytes.fromhex("0110") + bytes(14)) == "cyclonedds"
    assert dds_names.vendor(bytes.fromhex("01ff") + bytes(14)) == "vendor 01ff"
