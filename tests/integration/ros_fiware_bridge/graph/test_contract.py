"""What every adapter of the port keeps, between two processes."""

import asyncio
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ros_fiware_bridge.errors import (
    BadMessage,
    BadName,
    CallTimeout,
    GoalRefused,
    GraphClosed,
    IncompatibleQos,
    MessageTooBig,
    ServiceUnavailable,
    TypeHashDiffers,
    UnknownType,
)
from ros_fiware_bridge.graph.joining import Adapter
from ros_fiware_bridge.graph.port import GoalEnded, GoalStatus, Publisher, RosGraph, ServedGoal
from ros_fiware_bridge.graph.qos import LATCHED, SENSOR_DATA, History, Qos
from ros_fiware_bridge.types.type_store import TypeStore
from tests.integration.ros_fiware_bridge.graph.conftest import Joined, running_peer

JOINTS = "sensor_msgs/msg/JointState"
REPEAT = "rcl_interfaces/srv/ListParameters"
FIBONACCI = "test_msgs/action/Fibonacci"
pytestmark = pytest.mark.usefixtures("peer")


async def true(holds: Callable[[], Any], timeout_s: float = 10.0) -> None:
    async with asyncio.timeout(timeout_s):
        while not holds():
            await asyncio.sleep(0.01)


async def repeated(graph: RosGraph, text: str, times: int, timeout_s: float = 10) -> list[str]:
    answer = await graph.call("/repeat", REPEAT, {"prefixes": [text], "depth": times}, timeout_s)
    return list(answer["result"]["names"])


async def test_a_message_goes_out_and_comes_back_as_it_was(graph: RosGraph) -> None:
    got: asyncio.Queue[Any] = asyncio.Queue()
    heard = await graph.subscribe("/echo", JOINTS, got.put_nowait)
    said = await graph.publisher("/say", JOINTS)
    assert await heard.matched(10)
    assert await said.matched(10)
    message = {
        "header": {"stamp": {"sec": 12, "nanosec": 34}, "frame_id": "Grüße"},
        "name": ["shoulder", "elbow"],
        "position": [0.5, -1.5],
    }
    said.publish(message)
    received = await asyncio.wait_for(got.get(), 10)
    assert received.topic == "/echo"
    assert received.type_name == JOINTS
    assert received.message["header"] == message["header"]
    assert received.message["name"] == message["name"]
    assert isinstance(received.message["position"], np.ndarray)
    assert received.message["position"].tolist() == [0.5, -1.5]
    assert received.message["velocity"].tolist() == []
    assert received.value("position[1]") == -1.5
    assert received.value("header.stamp") == {"sec": 12, "nanosec": 34}
    assert received.value("effort[0]") is None
    assert received.sent_at_s is not None
    assert 0 <= received.received_at_s - received.sent_at_s < 10
    assert received.ours in (False, None)
    assert (heard.received, heard.refused, said.published) == (1, 0, 1)


async def test_what_a_publisher_latched_is_given_to_who_comes_late(graph: RosGraph) -> None:
    got: asyncio.Queue[Any] = asyncio.Queue()
    await graph.subscribe("/cell/greeting", "std_msgs/msg/String", got.put_nowait, LATCHED)
    received = await asyncio.wait_for(got.get(), 10)
    assert received.message == {"data": "welcome"}
    await asyncio.sleep(0.1)
    assert got.empty()


async def both_know(numbers: list[int], count: Publisher) -> None:
    """Wait until the peer's publisher has met our subscription too: what it says before is not for us."""
    assert await count.matched(10)
    async with asyncio.timeout(10):
        while not numbers:
            count.publish({"data": 1})
            await asyncio.sleep(0.1)
    await asyncio.sleep(0.2)
    numbers.clear()


async def test_messages_come_in_order_and_none_is_lost(graph: RosGraph) -> None:
    numbers: list[int] = []
    deep = Qos(history=History.KEEP_LAST, depth=1000)
    heard = await graph.subscribe(
        "/numbered", "std_msgs/msg/UInt32", lambda got: numbers.append(got.message["data"]), deep
    )
    count = await graph.publisher("/count", "std_msgs/msg/UInt32")
    await both_know(numbers, count)
    count.publish({"data": 200})
    await true(lambda: len(numbers) == 200)
    assert numbers == list(range(200))
    assert heard.dropped == 0


async def test_who_is_too_slow_keeps_the_last_and_is_told_how_many_were_dropped(graph: RosGraph) -> None:
    numbers: list[int] = []
    heard = await graph.subscribe(
        "/numbered", "std_msgs/msg/UInt32", lambda got: numbers.append(got.message["data"]), Qos(depth=5)
    )
    count = await graph.publisher("/count", "std_msgs/msg/UInt32")
    await both_know(numbers, count)
    before = heard.received
    count.publish({"data": 100})
    # The loop is busy while they come, as a bridge is that waits for a slow disk.
    for _ in range(200):
        if heard.received - before >= 100:
            break
        time.sleep(0.02)
    numbers.clear()
    await true(lambda: numbers and numbers[-1] == 99)
    assert numbers == [95, 96, 97, 98, 99]
    assert heard.dropped == 95


async def test_best_effort_is_heard_by_best_effort(graph: RosGraph) -> None:
    got: asyncio.Queue[Any] = asyncio.Queue()
    await graph.subscribe("/noise", "std_msgs/msg/Float32", got.put_nowait, SENSOR_DATA)
    assert (await asyncio.wait_for(got.get(), 10)).message == {"data": 0.5}


async def test_quality_of_service_that_does_not_meet_is_named_with_both_sides(graph: RosGraph) -> None:
    got: list[Any] = []
    await graph.subscribe("/noise", "std_msgs/msg/Float32", got.append)
    # Which node a publisher belongs to is told a moment after the publisher.
    says = "/noise: /cell/peer publishes it with best_effort, volatile, we have reliable, volatile"
    await true(lambda: any(says in str(one) for one in graph.problems()))
    assert [type(one) for one in graph.problems()] == [IncompatibleQos]
    assert not got


async def test_a_service_answers(graph: RosGraph) -> None:
    assert await repeated(graph, "ab", 2) == ["ab", "ab"]
    answers = await asyncio.gather(*(repeated(graph, str(n), 3) for n in range(12)))
    assert answers == [[str(n)] * 3 for n in range(12)]


async def test_a_service_that_does_not_answer_is_told_apart_from_one_that_is_not_there(
    graph: RosGraph,
) -> None:
    with pytest.raises(ServiceUnavailable, match="nobody serves /subtract"):
        await graph.call("/subtract", REPEAT, {}, 0.2)
    assert await repeated(graph, "a", 1) == ["a"]
    with pytest.raises(CallTimeout, match=r"/repeat did not answer within 0\.3 s"):
        await repeated(graph, "a", 99, 0.3)
    with pytest.raises(CallTimeout):
        await repeated(graph, "a", 13, 0.3)
    assert await repeated(graph, "a", 2) == ["a", "a"]


async def test_a_request_that_does_not_fit_is_never_sent(graph: RosGraph) -> None:
    with pytest.raises(BadMessage, match=r"ListParameters_Request, depth: 1\.5 is not a whole number"):
        await graph.call("/repeat", REPEAT, {"depth": 1.5})
    with pytest.raises(BadMessage, match='no field "c"'):
        await graph.call("/repeat", REPEAT, {"c": 1})


async def test_we_are_asked_and_answer(graph: RosGraph) -> None:
    async def answer(request: dict[str, Any]) -> dict[str, Any]:
        assert request == {}
        return {"success": True, "message": "here"}

    async def fail(_: dict[str, Any]) -> dict[str, Any]:
        raise RuntimeError("no")

    good = await graph.serve("/ours", "std_srvs/srv/Trigger", answer)
    bad = await graph.serve("/failing", "std_srvs/srv/Trigger", fail)
    got: asyncio.Queue[Any] = asyncio.Queue()
    heard = await graph.subscribe("/asked", "std_msgs/msg/String", got.put_nowait)
    ask = await graph.publisher("/ask", "std_msgs/msg/String")
    assert await heard.matched(10)
    assert await ask.matched(10)
    ask.publish({"data": "/ours"})
    assert (await asyncio.wait_for(got.get(), 10)).message == {"data": "here"}
    ask.publish({"data": "/failing"})
    assert (await asyncio.wait_for(got.get(), 10)).message == {"data": "CallTimeout"}
    assert (good.calls, good.failed) == (1, 0)
    assert (bad.calls, bad.failed) == (1, 1)
    assert bad.last_error == "RuntimeError: no"


async def test_a_goal_runs_to_its_end_with_feedback(graph: RosGraph) -> None:
    action = await graph.action_client("/fibonacci", FIBONACCI)
    assert await action.available(10)
    told: list[list[int]] = []
    goal = await action.send_goal(
        {"order": 6}, on_feedback=lambda one: told.append(one["sequence"].tolist()), timeout_s=10
    )
    ended = await goal.result(10)
    assert ended.status is GoalStatus.SUCCEEDED
    assert ended.result["sequence"].tolist() == [0, 1, 1, 2, 3, 5]
    assert goal.status is GoalStatus.SUCCEEDED
    assert len(goal.goal_id) == 16
    await true(lambda: told)
    assert told == [[0, 1, 1, 2, 3, 5][: len(one)] for one in told]


async def test_a_goal_is_cancelled(graph: RosGraph) -> None:
    action = await graph.action_client("/fibonacci", FIBONACCI)
    goal = await action.send_goal({"order": 900}, timeout_s=10)
    with pytest.raises(CallTimeout, match=r"the goal did not end within 0\.1 s"):
        await goal.result(0.1)
    assert await goal.cancel(10)
    ended = await goal.result(10)
    assert ended.status is GoalStatus.CANCELED
    assert ended.result["sequence"].tolist()[:2] == [0, 1]
    assert not await goal.cancel(10)


async def test_a_goal_is_refused_aborted_and_its_fault_survived(graph: RosGraph) -> None:
    action = await graph.action_client("/fibonacci", FIBONACCI)
    with pytest.raises(GoalRefused, match="/fibonacci: the server did not accept the goal"):
        await action.send_goal({"order": 5000}, timeout_s=10)
    aborted = await (await action.send_goal({"order": 40}, timeout_s=10)).result(10)
    assert aborted.status is GoalStatus.ABORTED
    assert aborted.result["sequence"].tolist() == [0, 1, 1, 2, 3]
    fault = await (await action.send_goal({"order": 41}, timeout_s=10)).result(10)
    assert fault.status is GoalStatus.ABORTED
    assert (
        await (await action.send_goal({"order": 3}, timeout_s=10)).result(10)
    ).status is GoalStatus.SUCCEEDED


async def test_goals_of_others_are_served(joined: Joined, graph: RosGraph) -> None:
    async def work(goal: ServedGoal) -> dict[str, Any]:
        goal.feedback({"sequence": [1]})
        await goal.wait_cancel_requested()
        raise GoalEnded(GoalStatus.CANCELED, {"sequence": [1, 2]})

    served = await graph.serve_action("work", FIBONACCI, work)
    async with joined(node="other") as other:
        action = await other.action_client("/work", FIBONACCI)
        told: list[Any] = []
        goal = await action.send_goal({"order": 1}, on_feedback=told.append, timeout_s=10)
        await true(lambda: goal.status is GoalStatus.EXECUTING)
        assert await goal.cancel(10)
        assert (await goal.result(10)).result["sequence"].tolist() == [1, 2]
        assert served.calls == 1


async def test_the_graph_is_read_with_types_qos_hashes_and_nodes(graph: RosGraph, store: TypeStore) -> None:
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


async def test_what_we_say_ourselves_is_heard_and_known_as_ours(graph: RosGraph) -> None:
    got: asyncio.Queue[Any] = asyncio.Queue()
    await graph.subscribe("mine", "std_msgs/msg/String", got.put_nowait, LATCHED)
    publisher = await graph.publisher("/mine", "std_msgs/msg/String", LATCHED)
    publisher.publish({"data": "echo"})
    received = await asyncio.wait_for(got.get(), 10)
    assert received.message == {"data": "echo"}
    assert received.ours in (True, None)


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
    waiting = asyncio.ensure_future(repeated(graph, "a", 99))
    await asyncio.sleep(0.1)
    await graph.close()
    with pytest.raises(GraphClosed):
        await waiting


@pytest.fixture
def only_cyclone(adapter: Adapter) -> None:
    if adapter is not Adapter.CYCLONE:
        pytest.skip("an installed ROS knows only types that were built for it")


def part(folder: Path, text: str) -> Path:
    file = folder / "cell_msgs" / "msg" / "Part.msg"
    file.parent.mkdir(parents=True)
    file.write_text(text)
    return folder


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
async def test_an_own_type_is_carried(joined: Joined, adapter: Any, domain_id: int, tmp_path: Path) -> None:
    folder = part(tmp_path, "string<=8 name\nuint32 count\nfloat64[3] size_m\n")
    with running_peer(adapter, domain_id, folder):
        async with joined(store=TypeStore([folder])) as graph:
            got: asyncio.Queue[Any] = asyncio.Queue()
            await graph.subscribe("/part", "cell_msgs/msg/Part", got.put_nowait)
            message = (await asyncio.wait_for(got.get(), 10)).message
            assert (message["name"], message["count"], message["size_m"].tolist()) == ("", 7, [0, 0, 0])


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


@pytest.mark.slow
async def test_a_server_that_is_killed_is_missed_and_its_successor_found(
    joined: Joined, adapter: Adapter, domain_id: int
) -> None:
    elsewhere = domain_id + 100
    async with joined(domain_id=elsewhere) as graph:
        action = await graph.action_client("/fibonacci", FIBONACCI)
        with running_peer(adapter, elsewhere) as peer:
            goal = await action.send_goal({"order": 900}, timeout_s=10)
            waiting = asyncio.ensure_future(goal.result())
            await asyncio.sleep(0.2)
            peer.kill()
            # DDS gives a program that says nothing ten seconds (ROS 2 Fast DDS: twenty).
            with pytest.raises(ServiceUnavailable, match=r"the server of .* went away before"):
                await asyncio.wait_for(waiting, 40)
        with running_peer(adapter, elsewhere):
            ended = await (await action.send_goal({"order": 4}, timeout_s=10)).result(10)
            assert ended.status is GoalStatus.SUCCEEDED
