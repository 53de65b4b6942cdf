"""The adapter `auto` between genuine nodes on Fast DDS and nodes on Cyclone DDS."""

import asyncio
from collections.abc import AsyncIterator, Iterator
from contextlib import ExitStack
from typing import Any

import pytest

from handover_ros.graph.joining import Adapter, JoinSettings, installed, join
from handover_ros.graph.mixed import MixedGraph
from handover_ros.graph.port import GoalStatus, RosGraph
from handover_ros.types.type_store import TypeStore
from ros_fiware_bridge.tests.integration.graph.conftest import repeated, running_peer, true
from ros_fiware_bridge.tests.integration.graph.test_genuine_cyclone import TRIGGER, genuine
from tests.kit.skipping import NO_ROS
from tests.kit.waiting import scaled

pytestmark = [
    pytest.mark.skipif(Adapter.RCLPY not in installed(), reason=NO_ROS),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
]


@pytest.fixture(scope="module", autouse=True)
def robots(domain_id: int) -> Iterator[None]:
    with ExitStack() as running:
        running.enter_context(running_peer(Adapter.RCLPY, domain_id))
        running.enter_context(genuine(domain_id + 1))
        yield


@pytest.fixture
async def graph(store: TypeStore, domain_id: int) -> AsyncIterator[RosGraph]:
    opened = await join(store, JoinSettings(node="bridge", domain_id=domain_id, interfaces=("127.0.0.1",)))
    assert isinstance(opened, MixedGraph)
    yield opened
    await opened.close()


async def test_services_and_actions_on_fast_dds_are_called(graph: RosGraph) -> None:
    await true(lambda: "/repeat" in {one.name for one in graph.services()})
    (service,) = (one for one in graph.services() if one.name == "/repeat")
    assert service.vendors == ("fastdds",)
    assert await repeated(graph, "ab", 2, 30) == ["ab", "ab"]
    action = await graph.action_client("/fibonacci", "test_msgs/action/Fibonacci")
    feedback: list[Any] = []
    goal = await action.send_goal({"order": 6}, on_feedback=feedback.append, timeout_s=120)
    ended = await goal.result(30)
    assert ended.status is GoalStatus.SUCCEEDED
    assert ended.result["sequence"].tolist() == [0, 1, 1, 2, 3, 5]
    await true(lambda: feedback)
    await action.close()


async def test_a_service_of_ours_answers_a_client_on_fast_dds(graph: RosGraph) -> None:
    async def answer(_: dict[str, Any]) -> dict[str, Any]:
        return {"success": True, "message": "here"}

    served = await graph.serve("/ours", TRIGGER, answer)
    got: asyncio.Queue[Any] = asyncio.Queue()
    subscription = await graph.subscribe("/asked", "std_msgs/msg/String", got.put_nowait)
    ask = await graph.publisher("/ask", "std_msgs/msg/String")
    assert await subscription.matched(scaled(60))
    assert await ask.matched(scaled(60))
    # The first call may end before the service has moved to the middleware of the client.
    for _ in range(10):
        ask.publish({"data": "/ours"})
        if (await asyncio.wait_for(got.get(), scaled(60))).message == {"data": "here"}:
            break
    else:
        pytest.fail(f"the client on Fast DDS got no answer: {served.last_error}")
    assert served.failed == 0
    await served.close()


async def test_a_service_on_cyclone_dds_is_called_without_rclpy(store: TypeStore, domain_id: int) -> None:
    settings = JoinSettings(node="bridge", domain_id=domain_id + 1, interfaces=("127.0.0.1",))
    graph = await join(store, settings)
    try:
        assert (await graph.call("/trigger", TRIGGER, {}, scaled(20)))["message"] == "done"
        assert not any("rclpy" in node.name for node in graph.nodes())
    finally:
        await graph.close()


async def test_one_side_serves_at_a_time(graph: RosGraph, store: TypeStore, domain_id: int) -> None:
    asked = 0

    async def count(_: dict[str, Any]) -> dict[str, Any]:
        nonlocal asked
        asked += 1
        return {"success": True}

    served = await graph.serve("/counted", TRIGGER, count)
    settings = JoinSettings(node="client", domain_id=domain_id, interfaces=("127.0.0.1",))
    client = await join(store, settings, Adapter.CYCLONE)
    try:
        for _ in range(3):
            assert (await client.call("/counted", TRIGGER, {}, scaled(20)))["success"]
        assert asked == 3
    finally:
        await client.close()
        await served.close()
