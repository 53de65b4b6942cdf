"""Topics of every adapter of the port, between two processes."""

import asyncio
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handover_ros.errors import (
    IncompatibleQos,
)
from handover_ros.graph.port import Publisher, RosGraph
from handover_ros.graph.qos import LATCHED, SENSOR_DATA, History, Qos
from handover_ros.types.type_store import TypeStore
from ros_fiware_bridge.tests.integration.graph.conftest import (
    REPEAT,
    Joined,
    part,
    running_peer,
    true,
)
from tests.kit.waiting import scaled

JOINTS = "sensor_msgs/msg/JointState"
FIBONACCI = "test_msgs/action/Fibonacci"
pytestmark = pytest.mark.usefixtures("peer")


async def test_a_message_is_echoed_unchanged(graph: RosGraph) -> None:
    got: asyncio.Queue[Any] = asyncio.Queue()
    subscription = await graph.subscribe("/echo", JOINTS, got.put_nowait)
    publisher = await graph.publisher("/say", JOINTS)
    assert await subscription.matched(scaled(10))
    assert await publisher.matched(scaled(10))
    message = {
        "header": {"stamp": {"sec": 12, "nanosec": 34}, "frame_id": "Grüße"},
        "name": ["shoulder", "elbow"],
        "position": [0.5, -1.5],
    }
    publisher.publish(message)
    received = await asyncio.wait_for(got.get(), scaled(10))
    assert received.topic == "/echo"
    assert received.type_name == JOINTS
    assert received.message["header"] == message["header"]
    assert received.message["name"] == message["name"]
    assert isinstance(received.message["position"], np.ndarray)
    assert received.message["position"].tolist() == [0.5, -1.5]
    assert received.message["velocity"].tolist() == []
    assert received.message["header"]["stamp"] == {"sec": 12, "nanosec": 34}
    assert received.message["effort"].tolist() == []
    assert received.sent_at_s is not None
    assert 0 <= received.received_at_s - received.sent_at_s < 10
    assert received.ours in (False, None)
    assert (subscription.received, subscription.refused, publisher.published) == (1, 0, 1)


async def test_a_late_subscriber_receives_the_latched_message(graph: RosGraph) -> None:
    got: asyncio.Queue[Any] = asyncio.Queue()
    await graph.subscribe("/cell/greeting", "std_msgs/msg/String", got.put_nowait, LATCHED)
    received = await asyncio.wait_for(got.get(), scaled(10))
    assert received.message == {"data": "welcome"}
    await asyncio.sleep(0.1)
    assert got.empty()


async def both_know(numbers: list[int], count: Publisher) -> None:
    """Wait until the publisher of the peer has matched our subscription too."""
    assert await count.matched(scaled(10))
    async with asyncio.timeout(120):
        while not numbers:
            count.publish({"data": 1})
            await asyncio.sleep(0.1)
    await asyncio.sleep(0.2)
    numbers.clear()


async def test_messages_arrive_in_order_without_loss(graph: RosGraph) -> None:
    numbers: list[int] = []
    deep = Qos(history=History.KEEP_LAST, depth=1000)
    subscription = await graph.subscribe(
        "/numbered", "std_msgs/msg/UInt32", lambda got: numbers.append(got.message["data"]), deep
    )
    count = await graph.publisher("/count", "std_msgs/msg/UInt32")
    await both_know(numbers, count)
    count.publish({"data": 200})
    await true(lambda: numbers and numbers[-1] == 199)
    # Messages of `both_know` may still arrive before.
    assert numbers[-200:] == list(range(200))
    assert subscription.dropped == 0


async def test_a_slow_subscriber_keeps_the_last_messages_and_counts_the_dropped_ones(graph: RosGraph) -> None:
    numbers: list[int] = []
    subscription = await graph.subscribe(
        "/numbered", "std_msgs/msg/UInt32", lambda got: numbers.append(got.message["data"]), Qos(depth=5)
    )
    count = await graph.publisher("/count", "std_msgs/msg/UInt32")
    await both_know(numbers, count)
    before = subscription.received
    count.publish({"data": 100})
    # The loop is blocked while the messages arrive.
    for _ in range(200):
        if subscription.received - before >= 100:
            break
        time.sleep(0.02)
    numbers.clear()
    await true(lambda: numbers and numbers[-1] == 99)
    assert numbers == [95, 96, 97, 98, 99]
    assert subscription.dropped == 95


async def test_best_effort_messages_are_received(graph: RosGraph) -> None:
    got: asyncio.Queue[Any] = asyncio.Queue()
    await graph.subscribe("/noise", "std_msgs/msg/Float32", got.put_nowait, SENSOR_DATA)
    assert (await asyncio.wait_for(got.get(), scaled(10))).message == {"data": 0.5}


async def test_incompatible_qos_is_reported_with_both_sides(graph: RosGraph) -> None:
    got: list[Any] = []
    await graph.subscribe("/noise", "std_msgs/msg/Float32", got.append)
    # The node of a publisher is discovered after the publisher.
    says = "/noise: /cell/peer publishes it with best_effort, volatile, we have reliable, volatile"
    await true(lambda: any(says in str(one) for one in graph.problems()))
    assert [type(one) for one in graph.problems()] == [IncompatibleQos]
    assert not got


async def test_the_graph_lists_types_qos_hashes_and_nodes(graph: RosGraph, store: TypeStore) -> None:
    await graph.publisher("~/mine", "std_msgs/msg/String")
    await true(lambda: {"/cell/peer", "/tested"} <= {one.full_name for one in graph.nodes()})
    await true(lambda: {"/echo", "/noise", "/tested/mine"} <= {one.name for one in graph.topics()})
    assert graph.node_name == "/tested"
    assert [one.full_name for one in graph.nodes() if one.ours] == ["/tested"]
    topics = {one.name: one for one in graph.topics()}
    assert topics["/echo"].type_names == (JOINTS,)
    await true(lambda: {t.name: t for t in graph.topics()}["/noise"].publishers[0].node == "/cell/peer")
    (noise,) = {one.name: one for one in graph.topics()}["/noise"].publishers
    assert noise.qos.reliability.value == "best_effort"
    assert noise.type_hash == store.hash("std_msgs/msg/Float32")
    assert not noise.ours
    assert not any("_action" in name or name == "ros_discovery_info" for name in topics)
    await true(lambda: "/repeat" in {one.name for one in graph.services()})
    (repeat,) = (one for one in graph.services() if one.name == "/repeat")
    assert repeat.type_names == (REPEAT,)
    assert repeat.servers == ("/cell/peer",)
    await true(lambda: "/fibonacci" in {one.name for one in graph.actions()})
    (action,) = (one for one in graph.actions() if one.name == "/fibonacci")
    assert action.type_names == (FIBONACCI,)


async def test_our_own_messages_are_received_and_marked_as_ours(graph: RosGraph) -> None:
    got: asyncio.Queue[Any] = asyncio.Queue()
    await graph.subscribe("mine", "std_msgs/msg/String", got.put_nowait, LATCHED)
    publisher = await graph.publisher("/mine", "std_msgs/msg/String", LATCHED)
    publisher.publish({"data": "echo"})
    received = await asyncio.wait_for(got.get(), scaled(10))
    assert received.message == {"data": "echo"}
    assert received.ours in (True, None)


@pytest.mark.nightly
@pytest.mark.usefixtures("only_cyclone")
async def test_a_custom_type_is_supported(
    joined: Joined, adapter: Any, domain_id: int, tmp_path: Path
) -> None:
    fields = 'string<=8 name\nuint32 count\nfloat64[3] size_m\nwstring label "Gruß 𝄞"\n'
    folder = part(tmp_path, fields + 'wstring[2] pair ["ä", "𝄞"]\nwstring[<=3] few ["abc", ""]\n')
    with running_peer(adapter, domain_id, folder):
        async with joined(store=TypeStore([folder])) as graph:
            got: asyncio.Queue[Any] = asyncio.Queue()
            await graph.subscribe("/part", "cell_msgs/msg/Part", got.put_nowait)
            message = (await asyncio.wait_for(got.get(), scaled(10))).message
            assert (message["name"], message["count"], message["size_m"].tolist()) == ("", 7, [0, 0, 0])
            assert message["label"] == "Gruß 𝄞"
            assert (message["pair"], message["few"]) == (["ä", "𝄞"], ["abc", ""])
