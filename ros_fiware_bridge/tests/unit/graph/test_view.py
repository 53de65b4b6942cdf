from handover_ros.errors import IncompatibleQos, TypeHashDiffers, VendorNotShared
from handover_ros.graph.cyclone import view
from handover_ros.graph.cyclone.discovery import DiscoveredEndpoint, GraphSnapshot
from handover_ros.graph.qos import SENSOR_DATA, Qos

OURS = bytes.fromhex("0110") + bytes(14)
CYCLONE = bytes.fromhex("0110") + b"\1" + bytes(13)
FAST = bytes.fromhex("010f") + bytes(14)
STRING = "std_msgs::msg::dds_::String_"


def end(
    participant: bytes,
    topic: str,
    dds_type: str = STRING,
    *,
    writes: bool,
    qos: Qos = SENSOR_DATA,
    type_hash: str = "RIHS01_1",
) -> DiscoveredEndpoint:
    return DiscoveredEndpoint(
        0,
        participant[:4] + topic.encode(),
        participant,
        writes,
        topic,
        dds_type,
        qos,
        {"typehash": type_hash},
    )


def test_services_on_fast_dds_are_reported_as_problems() -> None:
    add = "example_interfaces::srv::dds_::AddTwoInts_Request_"
    snapshot = GraphSnapshot(
        OURS,
        (
            end(OURS, "rq/addRequest", add, writes=False),
            end(FAST, "rq/addRequest", add, writes=True),
            end(CYCLONE, "rq/addRequest", add, writes=True),
        ),
    )
    (problem,) = view.problems(snapshot)
    assert isinstance(problem, VendorNotShared)
    assert str(problem).startswith("/add: a node calls it with fastdds, whose services cannot be reached")
    (service,) = view.services(snapshot)
    assert service.type_names == ("example_interfaces/srv/AddTwoInts",)
    assert service.servers == (None,)
    assert service.clients == (None, None)


def test_topics_of_different_vendors_are_compatible() -> None:
    snapshot = GraphSnapshot(OURS, (end(OURS, "rt/a", writes=False), end(FAST, "rt/a", writes=True)))
    assert view.problems(snapshot) == []
    (topic,) = view.topics(snapshot)
    assert topic.publishers[0].vendor == "fastdds"
    assert topic.subscribers[0].ours


def test_mismatches_between_peers_are_ignored() -> None:
    snapshot = GraphSnapshot(
        OURS, (end(CYCLONE, "rt/a", writes=False, qos=Qos()), end(FAST, "rt/a", writes=True))
    )
    assert view.problems(snapshot) == []


def test_qos_hash_and_type_are_compared() -> None:
    ours = end(OURS, "rt/a", writes=True)
    for theirs, kind, says in (
        (end(FAST, "rt/a", writes=False, qos=Qos()), IncompatibleQos, "subscribes to it with reliable"),
        (end(FAST, "rt/a", writes=False, type_hash="RIHS01_2"), TypeHashDiffers, "its hash is RIHS01_2"),
        (
            end(FAST, "rt/a", "std_msgs::msg::dds_::Bool_", writes=False),
            TypeHashDiffers,
            "subscribes to std_msgs/msg/Bool, we use std_msgs/msg/String",
        ),
    ):
        (problem,) = view.problems(GraphSnapshot(OURS, (ours, theirs)))
        assert isinstance(problem, kind)
        assert says in str(problem)


def test_a_topic_with_two_types_lists_both() -> None:
    snapshot = GraphSnapshot(
        OURS,
        (end(FAST, "rt/a", writes=True), end(CYCLONE, "rt/a", "std_msgs::msg::dds_::Bool_", writes=True)),
    )
    assert view.topics(snapshot)[0].type_names == ("std_msgs/msg/Bool", "std_msgs/msg/String")


def test_the_topics_and_services_of_an_action_are_hidden() -> None:
    goal = "example_interfaces::action::dds_::Fibonacci_SendGoal_Request_"
    snapshot = GraphSnapshot(
        OURS,
        (
            end(CYCLONE, "rq/arm/_action/send_goalRequest", goal, writes=False),
            end(CYCLONE, "rt/arm/_action/feedback", writes=True),
        ),
    )
    (action,) = view.actions(snapshot)
    assert (action.name, action.type_names) == ("/arm", ("example_interfaces/action/Fibonacci",))
    assert view.services(snapshot) == []
    assert view.topics(snapshot) == []
