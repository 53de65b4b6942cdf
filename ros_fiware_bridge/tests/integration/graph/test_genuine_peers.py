"""Our own DDS against nodes of a ROS that is installed, where there is one (`import rclpy`)."""

import asyncio
from collections.abc import AsyncIterator, Iterator
from typing import Any

import pytest

from handover_ros.errors import IncompatibleQos, VendorNotShared
from handover_ros.graph.joining import Adapter, JoinSettings, installed, join
from handover_ros.graph.port import RosGraph
from handover_ros.graph.qos import LATCHED, SENSOR_DATA
from handover_ros.inspection import description
from handover_ros.mapping import parse
from handover_ros.rules import plan
from handover_ros.types.type_store import TypeStore
from ros_fiware_bridge.tests.integration.graph.conftest import running_peer, true
from tests.kit.skipping import NO_ROS
from tests.kit.waiting import scaled

pytestmark = [
    pytest.mark.skipif(Adapter.RCLPY not in installed(), reason=NO_ROS),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
]
JOINTS = "sensor_msgs/msg/JointState"


@pytest.fixture(scope="module", autouse=True)
def robot(domain_id: int) -> Iterator[None]:
    with running_peer(Adapter.RCLPY, domain_id):
        yield


@pytest.fixture
async def graph(store: TypeStore, domain_id: int) -> AsyncIterator[RosGraph]:
    settings = JoinSettings(node="bridge", domain_id=domain_id, interfaces=("127.0.0.1",))
    opened = await join(store, settings, Adapter.CYCLONE)
    yield opened
    await opened.close()


async def test_messages_pass_to_and_from_a_genuine_node(graph: RosGraph) -> None:
    got: list[Any] = []
    await graph.subscribe("/echo", JOINTS, got.append)
    publisher = await graph.publisher("/say", JOINTS)
    assert await publisher.matched(scaled(20))
    message = {"header": {"frame_id": "Grüße"}, "name": ["a", "bc"], "position": [0.5, -1.5]}

    async def say() -> None:
        while not got:
            publisher.publish(message)
            await asyncio.sleep(0.2)

    await asyncio.wait_for(say(), scaled(20))
    assert got[0].message["name"] == ["a", "bc"]
    assert got[0].message["position"].tolist() == [0.5, -1.5]
    assert got[0].message["header"]["frame_id"] == "Grüße"


async def test_latched_and_best_effort_messages_of_a_genuine_node_are_received(graph: RosGraph) -> None:
    got: asyncio.Queue[Any] = asyncio.Queue()
    await graph.subscribe("/cell/greeting", "std_msgs/msg/String", got.put_nowait, LATCHED)
    assert (await asyncio.wait_for(got.get(), scaled(20))).message == {"data": "welcome"}
    await graph.subscribe("/noise", "std_msgs/msg/Float32", got.put_nowait, SENSOR_DATA)
    assert (await asyncio.wait_for(got.get(), scaled(20))).message == {"data": 0.5}


async def test_a_genuine_node_is_listed_with_its_hashes_and_qos(graph: RosGraph, store: TypeStore) -> None:
    await true(lambda: "/cell/peer" in {one.full_name for one in graph.nodes()})
    for name, type_name in (("/echo", JOINTS), ("/image", "sensor_msgs/msg/Image")):
        (topic,) = (one for one in graph.topics() if one.name == name)
        (publisher,) = topic.publishers
        assert topic.type_names == (type_name,)
        assert publisher.type_hash == store.hash(type_name)
        assert publisher.node == "/cell/peer"
    assert {one.name for one in graph.actions()} == {"/fibonacci"}
    await graph.subscribe("/noise", "std_msgs/msg/Float32", print)
    await true(graph.problems)
    assert [type(one) for one in graph.problems()] == [IncompatibleQos]


async def test_a_call_to_fast_dds_is_refused_before_anything_is_sent(graph: RosGraph) -> None:
    await true(lambda: "/repeat" in {one.name for one in graph.services()})
    (service,) = (one for one in graph.services() if one.name == "/repeat")
    if service.vendors != ("fastdds",):
        pytest.skip(f"the installed ROS speaks {service.vendors}, which carries services as we do")
    with pytest.raises(VendorNotShared, match="serves it with fastdds, whose services cannot be reached"):
        await graph.call("/repeat", "rcl_interfaces/srv/ListParameters", {})
    assert not any(one.clients for one in graph.services() if one.name == "/repeat")


async def test_a_genuine_node_lists_our_node_with_topics_and_hashes(
    graph: RosGraph, store: TypeStore, domain_id: int
) -> None:
    await graph.publisher("~/state", "std_msgs/msg/String", LATCHED)
    other = await join(store, JoinSettings(node="genuine", domain_id=domain_id), Adapter.RCLPY)
    try:
        await true(lambda: "/bridge" in {one.full_name for one in other.nodes()})

        def seen() -> list[Any]:
            topics = [one for one in other.topics() if one.name == "/bridge/state"]
            return [end for one in topics for end in one.publishers if end.node == "/bridge"]

        await true(seen)
        (publisher,) = seen()
        assert publisher.type_name == "std_msgs/msg/String"
        assert publisher.type_hash == store.hash("std_msgs/msg/String")
        assert str(publisher.qos).startswith("reliable, transient_local")
    finally:
        await other.close()


async def test_check_reports_services_and_actions_on_fast_dds(graph: RosGraph, store: TypeStore) -> None:
    mapping = """
services: {repeat: {service: /repeat, type: rcl_interfaces/ListParameters, task: a, resource: Device:r}}
actions: {count: {action: /fibonacci, type: test_msgs/Fibonacci, task: b, resource: Device:r}}
"""
    await true(lambda: "/repeat" in {one.name for one in graph.services()} and graph.actions())
    described = list(description.problems(plan.make(parse(mapping), store, "demo"), graph))
    assert [one.partition(":")[0] for one in described] == ["repeat", "count"]
    assert all("serves it with fastdds, whose services cannot be reached" in one for one in described)
