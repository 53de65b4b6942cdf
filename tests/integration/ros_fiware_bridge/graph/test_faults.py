"""What goes wrong on a graph: named, counted and survived by every adapter of the port."""

import asyncio
import os
import signal
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ros_fiware_bridge.errors import (
    BadMessage,
    BadName,
    GraphClosed,
    MessageTooBig,
    PublishBlocked,
    TypeHashDiffers,
    UnknownType,
)
from ros_fiware_bridge.graph.port import RosGraph
from ros_fiware_bridge.graph.qos import SENSOR_DATA, History, Qos
from ros_fiware_bridge.types.type_store import TypeStore
from tests.integration.ros_fiware_bridge.graph.conftest import (
    Joined,
    part,
    repeated,
    running_peer,
    true,
)

JOINTS = "sensor_msgs/msg/JointState"
pytestmark = pytest.mark.usefixtures("peer")


async def test_what_is_not_there_or_not_allowed_is_said_before_anything_starts(graph: RosGraph) -> None:
    with pytest.raises(UnknownType, match="did you mean sensor_msgs/msg/JointState"):
        await graph.subscribe("/joints", "sensor_msgs/JointStates", print)
    with pytest.raises(UnknownType, match="there is no type cell_msgs/srv/Fit"):
        await graph.call("/fit", "cell_msgs/Fit", {})
    for name in ("/joint states", "1st", "/a//b", "/a/", ""):
        with pytest.raises(BadName):
            await graph.publisher(name, JOINTS)


async def test_a_message_that_does_not_fit_or_is_too_big_is_not_published(joined: Joined) -> None:
    async with joined(most_bytes=1000) as graph:
        publisher = await graph.publisher("/say", JOINTS)
        with pytest.raises(BadMessage, match=r"JointState, position\[1\]: None is not a number"):
            publisher.publish({"position": [1.0, None]})
        with pytest.raises(MessageTooBig, match=r"/say: a message of .* bytes is too big, 1000 are allowed"):
            publisher.publish({"position": [0.0] * 200})
        assert publisher.published == 0
        publisher.publish({"position": [0.0]})
        assert publisher.published == 1


async def test_a_message_that_is_too_big_is_refused_and_the_next_one_taken(joined: Joined) -> None:
    async with joined(most_bytes=100_000) as graph:
        images: list[Any] = []
        heard = await graph.subscribe("/image", "sensor_msgs/msg/Image", images.append)
        await true(lambda: heard.refused)
        assert heard.last_error is not None
        assert "bytes came, 100000 are allowed" in heard.last_error
        assert not images
        assert await repeated(graph, "a", 1) == ["a"]


async def test_a_callback_that_fails_does_not_end_the_subscription(graph: RosGraph) -> None:
    seen: list[Any] = []

    def fails(received: Any) -> None:
        seen.append(received)
        raise RuntimeError("the rule has a fault")

    heard = await graph.subscribe("/noise", "std_msgs/msg/Float32", fails, SENSOR_DATA)
    await true(lambda: len(seen) > 2)
    assert heard.last_error == "RuntimeError: the rule has a fault"


async def test_what_is_closed_is_quiet_and_says_so(graph: RosGraph) -> None:
    seen: list[Any] = []
    heard = await graph.subscribe("/noise", "std_msgs/msg/Float32", seen.append, SENSOR_DATA)
    await true(lambda: seen)
    await heard.close()
    await heard.close()
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


async def test_who_waits_for_an_answer_is_told_when_the_graph_closes(graph: RosGraph) -> None:
    await repeated(graph, "a", 1)
    action = await graph.action_client("/fibonacci", "test_msgs/action/Fibonacci")
    goal = await action.send_goal({"order": 900}, timeout_s=120)
    waiting = [asyncio.ensure_future(repeated(graph, "a", 99)), asyncio.ensure_future(goal.result())]
    await asyncio.sleep(0.1)
    await graph.close()
    for one in waiting:
        with pytest.raises(GraphClosed):
            await one


@pytest.mark.usefixtures("only_cyclone")
async def test_a_peer_with_another_definition_is_named_and_not_believed(
    joined: Joined, adapter: Any, domain_id: int, tmp_path: Path
) -> None:
    # Both are four bytes long: what the peer sends could be read, and would be wrong.
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


@pytest.mark.usefixtures("only_cyclone")
async def test_a_peer_that_goes_is_gone_and_one_that_comes_back_is_heard(
    joined: Joined, adapter: Any, domain_id: int, tmp_path: Path
) -> None:
    folder = part(tmp_path, "uint32 count\n")
    async with joined(store=TypeStore([folder])) as graph:
        seen: list[Any] = []
        heard = await graph.subscribe("/part", "cell_msgs/msg/Part", seen.append)
        for _ in range(2):
            seen.clear()
            with running_peer(adapter, domain_id, folder):
                await true(lambda: seen)
                assert heard.publishers() == 1
            await true(lambda: not heard.publishers())
            await true(lambda: not {one.name: one for one in graph.topics()}["/part"].publishers)


@pytest.mark.usefixtures("only_cyclone")
async def test_subscribers_that_take_nothing_hold_us_up_for_a_moment_only(
    graph: RosGraph, peer: subprocess.Popen[str]
) -> None:
    said = await graph.publisher("/say", JOINTS, Qos(history=History.KEEP_ALL))
    assert await said.matched(10)
    message = {"position": np.zeros(50_000)}

    def say_much() -> None:
        for _ in range(500):
            said.publish(message)

    os.kill(peer.pid, signal.SIGSTOP)
    try:
        with pytest.raises(PublishBlocked, match="/say: its reliable subscribers take too slowly"):
            say_much()
    finally:
        os.kill(peer.pid, signal.SIGCONT)
    async with asyncio.timeout(120):
        while True:
            try:
                said.publish(message)
            except PublishBlocked:
                await asyncio.sleep(0.1)
            else:
                break
    assert await repeated(graph, "a", 1) == ["a"]
