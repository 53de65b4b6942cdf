"""The port over the rosbridge protocol, between two clients of one server."""

import asyncio
import json
import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from websockets.asyncio.client import connect

from handover_ros.errors import (
    AdapterUnavailable,
    BadMessage,
    CallTimeout,
    GoalRefused,
    GraphClosed,
    MessageTooBig,
    PublishBlocked,
    ServerLost,
    ServiceUnavailable,
)
from handover_ros.graph.joining import Adapter, JoinSettings, join
from handover_ros.graph.port import GoalEnded, GoalStatus, RosGraph, ServedGoal
from handover_ros.graph.qos import LATCHED
from handover_ros.types.type_store import TypeStore
from ros_fiware_bridge.tests.integration.graph.conftest import true
from ros_fiware_bridge.tests.integration.graph.rosbridge_server import RosbridgeServer, running
from tests.kit.waiting import scaled

JOINTS = "sensor_msgs/msg/JointState"
FIBONACCI = "test_msgs/action/Fibonacci"
TYPES = TypeStore([Path(__file__).parent / "types"])


@asynccontextmanager
async def client(server: RosbridgeServer, name: str, **settings: Any) -> AsyncIterator[RosGraph]:
    asked = JoinSettings(node=name, rosbridge_url=server.url, **settings)
    opened = await join(TYPES, asked, Adapter.ROSBRIDGE)
    try:
        yield opened
    finally:
        await opened.close()


@pytest.fixture
async def server() -> AsyncIterator[RosbridgeServer]:
    async with running() as made:
        yield made


@pytest.fixture
async def graph(server: RosbridgeServer) -> AsyncIterator[RosGraph]:
    async with client(server, "tested") as opened:
        yield opened


@pytest.fixture
async def robot(server: RosbridgeServer) -> AsyncIterator[RosGraph]:
    async with client(server, "robot") as opened:
        yield opened


async def test_a_message_is_received_unchanged(graph: RosGraph, robot: RosGraph) -> None:
    got: asyncio.Queue[Any] = asyncio.Queue()
    subscription = await graph.subscribe("/joints", JOINTS, got.put_nowait)
    publisher = await robot.publisher("/joints", JOINTS)
    assert await subscription.matched(scaled(10))
    assert await publisher.matched(scaled(10))
    stamp = {"sec": 12, "nanosec": 34}
    publisher.publish(
        {"header": {"stamp": stamp, "frame_id": "Grüße"}, "name": ["a", "b"], "position": [0.5, -1]}
    )
    received = await asyncio.wait_for(got.get(), scaled(10))
    assert received.message["header"]["stamp"] == stamp
    assert received.message["header"]["frame_id"] == "Grüße"
    assert received.message["name"] == ["a", "b"]
    assert isinstance(received.message["position"], np.ndarray)
    assert received.message["position"].tolist() == [0.5, -1.0]
    assert received.ours is None
    assert (subscription.received, subscription.refused, publisher.published) == (1, 0, 1)


async def test_octets_are_received_unchanged(graph: RosGraph, robot: RosGraph) -> None:
    got: asyncio.Queue[Any] = asyncio.Queue()
    subscription = await graph.subscribe("/image", "sensor_msgs/msg/Image", got.put_nowait)
    publisher = await robot.publisher("/image", "sensor_msgs/msg/Image")
    assert await subscription.matched(scaled(10))
    publisher.publish({"data": bytes(range(256))})
    assert (await asyncio.wait_for(got.get(), scaled(10))).message["data"] == bytes(range(256))


async def test_a_late_subscriber_receives_the_latched_message(graph: RosGraph, robot: RosGraph) -> None:
    publisher = await robot.publisher("/greeting", "std_msgs/msg/String", LATCHED)
    publisher.publish({"data": "welcome"})
    await asyncio.sleep(0)
    got: asyncio.Queue[Any] = asyncio.Queue()
    await graph.subscribe("/greeting", "std_msgs/msg/String", got.put_nowait, LATCHED)
    assert (await asyncio.wait_for(got.get(), scaled(10))).message == {"data": "welcome"}


@pytest.mark.nightly
async def test_services_answer_or_return_the_reason(graph: RosGraph, robot: RosGraph) -> None:
    async def set_to(request: dict[str, Any]) -> dict[str, Any]:
        if request["data"]:
            raise RuntimeError("it is stuck")
        return {"success": True, "message": "off"}

    async def ponder(_: dict[str, Any]) -> dict[str, Any]:
        await asyncio.sleep(30)
        return {}

    served = await robot.serve("/lamp", "std_srvs/srv/SetBool", set_to)
    await robot.serve("/slow", "std_srvs/srv/Trigger", ponder)
    await true(lambda: "/lamp" in {one.name for one in graph.services()})
    answers = await asyncio.gather(*(graph.call("/lamp", "std_srvs/SetBool", {}, 60) for _ in range(5)))
    assert answers == [{"success": True, "message": "off"}] * 5
    with pytest.raises(ServiceUnavailable, match="RuntimeError: it is stuck"):
        await graph.call("/lamp", "std_srvs/srv/SetBool", {"data": True}, 60)
    assert (served.calls, served.failed) == (6, 1)
    with pytest.raises(ServiceUnavailable, match="Service /subtract does not exist"):
        await graph.call("/subtract", "std_srvs/srv/Trigger", {})
    with pytest.raises(CallTimeout, match=r"/slow did not answer within 0\.2 s"):
        await graph.call("/slow", "std_srvs/srv/Trigger", {}, 0.2)
    with pytest.raises(BadMessage, match='no field "date"'):
        await graph.call("/lamp", "std_srvs/srv/SetBool", {"date": True})
    waiting = asyncio.ensure_future(graph.call("/slow", "std_srvs/srv/Trigger", {}, scaled(20)))
    await asyncio.sleep(0.05)
    await graph.close()
    with pytest.raises(GraphClosed):
        await waiting


async def fibonacci(goal: ServedGoal) -> dict[str, Any]:
    numbers = [0, 1]
    while len(numbers) < goal.request["order"]:
        numbers.append(numbers[-1] + numbers[-2])
        goal.feedback({"sequence": numbers})
        if goal.cancel_requested:
            raise GoalEnded(GoalStatus.CANCELED, {"sequence": numbers})
        if goal.request["order"] == 40 and len(numbers) == 5:
            raise GoalEnded(GoalStatus.ABORTED, {"sequence": numbers})
        await asyncio.sleep(0.01)
    return {"sequence": numbers}


async def test_goals_succeed_abort_and_are_cancelled(graph: RosGraph, robot: RosGraph) -> None:
    await robot.serve_action("/fibonacci", FIBONACCI, fibonacci)
    action = await graph.action_client("/fibonacci", FIBONACCI)
    assert await action.available(10)
    feedback: list[list[int]] = []
    goal = await action.send_goal(
        {"order": 6}, on_feedback=lambda one: feedback.append(one["sequence"].tolist())
    )
    ended = await goal.result(120)
    assert (ended.status, ended.result["sequence"].tolist()) == (GoalStatus.SUCCEEDED, [0, 1, 1, 2, 3, 5])
    assert goal.status is GoalStatus.SUCCEEDED
    assert feedback[-1] == [0, 1, 1, 2, 3, 5]
    aborted = await (await action.send_goal({"order": 40})).result(120)
    assert (aborted.status, aborted.result["sequence"].tolist()) == (GoalStatus.ABORTED, [0, 1, 1, 2, 3])
    long = await action.send_goal({"order": 80})
    assert long.status is GoalStatus.EXECUTING
    with pytest.raises(CallTimeout):
        await long.result(0.05)
    assert await long.cancel()
    assert (await long.result(120)).status is GoalStatus.CANCELED
    assert not await long.cancel()
    with pytest.raises(GoalRefused, match="rejected"):
        await action.send_goal({"order": 13})
    nowhere = await graph.action_client("/nowhere", FIBONACCI)
    with pytest.raises(ServiceUnavailable, match="no server of /nowhere"):
        await nowhere.send_goal({"order": 3})


async def test_a_goal_whose_result_cannot_be_sent_is_aborted(graph: RosGraph, robot: RosGraph) -> None:
    async def work(goal: ServedGoal) -> dict[str, Any]:
        if goal.request["order"] == 1:
            return {"sequence": "not numbers"}
        raise GoalEnded(GoalStatus.CANCELED)

    served = await robot.serve_action("/work", FIBONACCI, work)
    action = await graph.action_client("/work", FIBONACCI)
    assert await action.available(10)
    invalid = await action.send_goal({"order": 1})
    assert (await invalid.result(120)).status is GoalStatus.ABORTED
    assert (served.failed, "sequence" in str(served.last_error)) == (1, True)
    uncancelled = await action.send_goal({"order": 2})
    assert (await uncancelled.result(120)).status is GoalStatus.ABORTED


@pytest.mark.nightly
async def test_the_graph_is_read_through_rosapi(graph: RosGraph, robot: RosGraph) -> None:
    await robot.publisher("/joints", JOINTS)
    await robot.serve_action("/fibonacci", FIBONACCI, fibonacci)
    await graph.subscribe("/joints", JOINTS, print)
    await true(lambda: "/fibonacci" in {one.name for one in graph.actions()})
    (joints,) = (one for one in graph.topics() if one.name == "/joints")
    assert joints.type_names == (JOINTS,)
    assert len(joints.publishers) == len(joints.subscribers) == 1
    assert not any("_action" in one.name for one in graph.topics())
    (action,) = graph.actions()
    assert action.type_names == (FIBONACCI,)
    assert len(graph.nodes()) == 2
    assert not graph.problems()


async def test_everything_is_restored_after_a_restart_of_the_server(
    server: RosbridgeServer, graph: RosGraph, robot: RosGraph
) -> None:
    got: asyncio.Queue[Any] = asyncio.Queue()
    await graph.subscribe("/word", "std_msgs/msg/String", got.put_nowait)
    publisher = await robot.publisher("/word", "std_msgs/msg/String")
    assert await publisher.matched(scaled(10))
    waiting = asyncio.ensure_future(graph.call("/never", "std_srvs/srv/Trigger", {}, scaled(20)))
    await server.stop()
    with pytest.raises(ServerLost):
        await waiting
    await true(graph.problems)
    assert "is unavailable" in str(graph.problems()[0])
    await true(robot.problems)
    with pytest.raises(PublishBlocked, match=r"/word: the rosbridge server at .* is unavailable"):
        publisher.publish({"data": "lost"})
    await server.start()
    await true(lambda: not graph.problems() and not robot.problems())

    async def publish_until_received() -> None:
        while got.empty():
            publisher.publish({"data": "back"})
            await asyncio.sleep(0.05)

    await asyncio.wait_for(publish_until_received(), scaled(15))
    assert got.get_nowait().message == {"data": "back"}


async def test_nan_and_oversized_messages_are_refused(server: RosbridgeServer, robot: RosGraph) -> None:
    number = await robot.publisher("/number", "std_msgs/msg/Float64")
    with pytest.raises(
        BadMessage, match="nan cannot be sent over rosbridge, because JSON has no such number"
    ):
        number.publish({"data": math.nan})
    image = await robot.publisher("/image", "sensor_msgs/msg/Image")
    async with client(server, "narrow", max_message_bytes=500_000) as narrow:
        got: list[Any] = []
        subscription = await narrow.subscribe("/image", "sensor_msgs/msg/Image", got.append)
        assert await subscription.matched(scaled(10))
        assert await image.matched(scaled(10))
        image.publish({"data": bytes(6_000_000)})  # its fragments are discarded
        image.publish({"data": bytes(1_000_000)})  # refused once it is complete
        image.publish({"data": bytes(1_000)})
        await true(lambda: got)
        assert [one.size_bytes < 2_000 for one in got] == [True]
        assert subscription.refused == 1
        assert "500000 are allowed" in str(subscription.last_error)
        with pytest.raises(MessageTooBig, match="600044 bytes is too big"):
            (await narrow.publisher("/mine", "sensor_msgs/msg/Image")).publish({"data": bytes(600_000)})


async def test_invalid_messages_are_refused_and_the_connection_stays_open(
    server: RosbridgeServer, graph: RosGraph
) -> None:
    got: asyncio.Queue[Any] = asyncio.Queue()
    subscription = await graph.subscribe("/number", "std_msgs/msg/Float64", got.put_nowait)
    async with connect(server.url, proxy=None) as odd:
        for message in ({"data": "many"}, {"date": 1}, [1], None, {"data": None}, {"data": 7}):
            await odd.send(json.dumps({"op": "publish", "topic": "/number", "msg": message}))
        assert math.isnan((await asyncio.wait_for(got.get(), scaled(10))).message["data"])
        assert (await asyncio.wait_for(got.get(), scaled(10))).message == {"data": 7.0}
    assert subscription.refused == 4


async def test_ros_1_formats_are_converted() -> None:
    async with running(ros1=True) as server, client(server, "tested") as graph:
        got: asyncio.Queue[Any] = asyncio.Queue()
        await graph.subscribe("/joints", JOINTS, got.put_nowait)
        publisher = await graph.publisher("/joints", JOINTS)
        async with connect(server.url, proxy=None) as robot:
            await robot.send(
                json.dumps({"op": "subscribe", "topic": "/joints", "type": "sensor_msgs/JointState"})
            )
            stamp = {"secs": 5, "nsecs": 6}
            header = {"seq": 1, "stamp": stamp, "frame_id": "base"}
            joints = {"header": header, "name": ["a"], "position": [1.5], "velocity": [], "effort": []}
            await robot.send(json.dumps({"op": "publish", "topic": "/joints", "msg": joints}))
            received = await asyncio.wait_for(got.get(), scaled(10))
            assert received.message["header"]["stamp"] == {"sec": 5, "nanosec": 6}
            assert received.message["position"].tolist() == [1.5]
            assert json.loads(await asyncio.wait_for(robot.recv(), scaled(10)))["msg"] == joints
            publisher.publish(received.message)
            assert (
                json.loads(await asyncio.wait_for(robot.recv(), scaled(10)))["msg"]["header"]["stamp"]
                == stamp
            )
        await true(lambda: "/joints" in {one.name for one in graph.topics()})
        (topic,) = (one for one in graph.topics() if one.name == "/joints")
        assert topic.type_names == (JOINTS,)


async def test_without_a_server_the_error_explains_how_to_start_one(free_port: Any) -> None:
    asked = JoinSettings(rosbridge_url=f"ws://127.0.0.1:{free_port()}")
    with pytest.raises(AdapterUnavailable, match=r"no rosbridge server answers at ws://.*; start it"):
        await join(TYPES, asked, Adapter.ROSBRIDGE)
