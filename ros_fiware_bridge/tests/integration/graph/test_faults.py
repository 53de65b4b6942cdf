"""Faults of a graph: reported, counted and survived by every adapter of the port."""

import asyncio
import os
import signal
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handover_ros.errors import (
    BadMessage,
    BadName,
    GraphClosed,
    MessageTooBig,
    PublishBlocked,
    TypeHashDiffers,
    UnknownType,
)
from handover_ros.graph.port import RosGraph
from handover_ros.graph.qos import SENSOR_DATA, History, Qos
from handover_ros.types.type_store import TypeStore
from ros_fiware_bridge.tests.integration.graph.conftest import (
    Joined,
    part,
    repeated,
    running_peer,
    true,
)
from tests.kit.waiting import scaled

JOINTS = "sensor_msgs/msg/JointState"
pytestmark = pytest.mark.usefixtures("peer")


@pytest.mark.nightly
async def test_unknown_types_and_invalid_names_are_refused_at_once(graph: RosGraph) -> None:
    with pytest.raises(UnknownType, match="did you mean sensor_msgs/msg/JointState"):
        await graph.subscribe("/joints", "sensor_msgs/JointStates", print)
    with pytest.raises(UnknownType, match="there is no type cell_msgs/srv/Fit"):
        await graph.call("/fit", "cell_msgs/Fit", {})
    for name in ("/joint states", "1st", "/a//b", "/a/", ""):
        with pytest.raises(BadName):
            await graph.publisher(name, JOINTS)


async def test_an_invalid_or_oversized_message_is_not_published(joined: Joined) -> None:
    async with joined(max_message_bytes=1000) as graph:
        publisher = await graph.publisher("/say", JOINTS)
        with pytest.raises(BadMessage, match=r"JointState, position\[1\]: None is not a number"):
            publisher.publish({"position": [1.0, None]})
        with pytest.raises(MessageTooBig, match=r"/say: a message of .* bytes is too big, 1000 are allowed"):
            publisher.publish({"position": [0.0] * 200})
        assert publisher.published == 0
        publisher.publish({"position": [0.0]})
        assert publisher.published == 1


async def test_an_oversized_message_is_refused_and_the_next_one_accepted(joined: Joined) -> None:
    async with joined(max_message_bytes=100_000) as graph:
        images: list[Any] = []
        subscription = await graph.subscribe("/image", "sensor_msgs/msg/Image", images.append)
        await true(lambda: subscription.refused)
        assert subscription.last_error is not None
        assert "bytes, 100000 are allowed" in subscription.last_error
        assert not images
        assert await repeated(graph, "a", 1) == ["a"]


@pytest.mark.nightly
async def test_a_failing_callback_does_not_end_the_subscription(graph: RosGraph) -> None:
    seen: list[Any] = []

    def fails(received: Any) -> None:
        seen.append(received)
        raise RuntimeError("the rule has a fault")

    subscription = await graph.subscribe("/noise", "std_msgs/msg/Float32", fails, SENSOR_DATA)
    await true(lambda: len(seen) > 2)
    assert subscription.last_error == "RuntimeError: the rule has a fault"


async def test_closed_endpoints_deliver_nothing_and_raise(graph: RosGraph) -> None:
    seen: list[Any] = []
    subscription = await graph.subscribe("/noise", "std_msgs/msg/Float32", seen.append, SENSOR_DATA)
    await true(lambda: seen)
    await subscription.close()
    await subscription.close()
    seen.clear()
    again: list[Any] = []
    await graph.subscribe("/noise", "std_msgs/msg/Float32", again.append, SENSOR_DATA)
    await true(lambda: again)
    assert not seen
    publisher = await graph.publisher("/say", JOINTS)
    await publisher.close()
    with pytest.raises(GraphClosed, match="/say was closed"):
        publisher.publish({})
    await graph.close()
    await graph.close()
    with pytest.raises(GraphClosed):
        await graph.subscribe("/noise", "std_msgs/msg/Float32", seen.append)


async def test_closing_the_graph_fails_pending_calls(graph: RosGraph) -> None:
    await repeated(graph, "a", 1)
    action = await graph.action_client("/fibonacci", "test_msgs/action/Fibonacci")
    goal = await action.send_goal({"order": 900}, timeout_s=120)
    waiting = [asyncio.ensure_future(repeated(graph, "a", 99)), asyncio.ensure_future(goal.result())]
    await asyncio.sleep(0.1)
    await graph.close()
    for one in waiting:
        with pytest.raises(GraphClosed):
            await one


@pytest.mark.nightly
@pytest.mark.usefixtures("only_cyclone")
async def test_messages_of_a_peer_with_another_definition_are_refused(
    joined: Joined, adapter: Any, domain_id: int, tmp_path: Path
) -> None:
    # Both are four bytes long: a message of the peer would be decoded wrongly.
    theirs = part(tmp_path / "theirs", "uint32 count\n")
    ours = TypeStore([part(tmp_path / "ours", "float32 count\n")])
    with running_peer(adapter, domain_id, theirs):
        async with joined(store=ours) as graph:
            seen: list[Any] = []
            await graph.subscribe("/part", "cell_msgs/msg/Part", seen.append)
            await true(lambda: [one for one in graph.problems() if isinstance(one, TypeHashDiffers)])
            (problem,) = (one for one in graph.problems() if isinstance(one, TypeHashDiffers))
            assert "/part: " in str(problem)
            assert ours.hash("cell_msgs/msg/Part") in str(problem)
            assert TypeStore([theirs]).hash("cell_msgs/msg/Part") in str(problem)
            await asyncio.sleep(0.2)
            assert not seen


@pytest.mark.nightly
@pytest.mark.usefixtures("only_cyclone")
async def test_a_peer_that_restarts_is_matched_again(
    joined: Joined, adapter: Any, domain_id: int, tmp_path: Path
) -> None:
    folder = part(tmp_path, "uint32 count\n")
    async with joined(store=TypeStore([folder])) as graph:
        seen: list[Any] = []
        subscription = await graph.subscribe("/part", "cell_msgs/msg/Part", seen.append)
        for _ in range(2):
            seen.clear()
            with running_peer(adapter, domain_id, folder):
                await true(lambda: seen and subscription.publishers() == 1)
            await true(lambda: not subscription.publishers())
            await true(lambda: not {one.name: one for one in graph.topics()}["/part"].publishers)


@pytest.mark.usefixtures("only_cyclone")
async def test_a_blocked_subscriber_delays_the_publisher_only_briefly(
    graph: RosGraph, peer: subprocess.Popen[str]
) -> None:
    publisher = await graph.publisher("/say", JOINTS, Qos(history=History.KEEP_ALL))
    assert await publisher.matched(scaled(10))
    message = {"position": np.zeros(50_000)}

    def say_much() -> None:
        for _ in range(500):
            publisher.publish(message)

    os.kill(peer.pid, signal.SIGSTOP)
    try:
        with pytest.raises(PublishBlocked, match="/say: its reliable subscribers read too slowly"):
            say_much()
    finally:
        os.kill(peer.pid, signal.SIGCONT)
    async with asyncio.timeout(120):
        while True:
            try:
                publisher.publish(message)
            except PublishBlocked:
                await asyncio.sleep(0.1)
            else:
                break
    assert await repeated(graph, "a", 1) == ["a"]
