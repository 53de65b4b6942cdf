"""Services and actions of every adapter of the port, between two processes."""

import asyncio
from typing import Any

import pytest

from handover_ros.errors import (
    BadMessage,
    CallTimeout,
    GoalRefused,
    ServerLost,
    ServiceUnavailable,
)
from handover_ros.graph.joining import Adapter
from handover_ros.graph.port import GoalEnded, GoalStatus, RosGraph, ServedGoal
from ros_fiware_bridge.tests.integration.graph.conftest import (
    REPEAT,
    Joined,
    repeated,
    running_peer,
    true,
)
from tests.kit.waiting import scaled

FIBONACCI = "test_msgs/action/Fibonacci"
pytestmark = pytest.mark.usefixtures("peer")


async def test_a_service_answers(graph: RosGraph) -> None:
    assert await repeated(graph, "ab", 2) == ["ab", "ab"]
    answers = await asyncio.gather(*(repeated(graph, str(n), 3) for n in range(12)))
    assert answers == [[str(n)] * 3 for n in range(12)]


async def test_a_timeout_and_a_missing_service_raise_different_errors(
    graph: RosGraph,
) -> None:
    with pytest.raises(ServiceUnavailable, match="no node serves /subtract"):
        await graph.call("/subtract", REPEAT, {}, 0.2)
    assert await repeated(graph, "a", 1) == ["a"]
    with pytest.raises(CallTimeout, match=r"/repeat did not answer within 0\.3 s"):
        await repeated(graph, "a", 99, 0.3)
    with pytest.raises(CallTimeout):
        await repeated(graph, "a", 13, 0.3)
    assert await repeated(graph, "a", 2) == ["a", "a"]


async def test_an_invalid_request_is_not_sent(graph: RosGraph) -> None:
    with pytest.raises(BadMessage, match=r"ListParameters_Request, depth: 1\.5 is not a whole number"):
        await graph.call("/repeat", REPEAT, {"depth": 1.5})
    with pytest.raises(BadMessage, match='no field "c"'):
        await graph.call("/repeat", REPEAT, {"c": 1})


async def test_our_services_answer_other_nodes(graph: RosGraph) -> None:
    async def answer(request: dict[str, Any]) -> dict[str, Any]:
        assert request == {}
        return {"success": True, "message": "here"}

    async def fail(_: dict[str, Any]) -> dict[str, Any]:
        raise RuntimeError("no")

    good = await graph.serve("/ours", "std_srvs/srv/Trigger", answer)
    bad = await graph.serve("/failing", "std_srvs/srv/Trigger", fail)
    got: asyncio.Queue[Any] = asyncio.Queue()
    subscription = await graph.subscribe("/asked", "std_msgs/msg/String", got.put_nowait)
    ask = await graph.publisher("/ask", "std_msgs/msg/String")
    assert await subscription.matched(scaled(10))
    assert await ask.matched(scaled(10))
    ask.publish({"data": "/ours"})
    assert (await asyncio.wait_for(got.get(), scaled(10))).message == {"data": "here"}
    ask.publish({"data": "/failing"})
    assert (await asyncio.wait_for(got.get(), scaled(10))).message == {"data": "CallTimeout"}
    assert (good.calls, good.failed) == (1, 0)
    assert (bad.calls, bad.failed) == (1, 1)
    assert bad.last_error == "RuntimeError: no"


async def test_a_goal_succeeds_with_feedback(graph: RosGraph) -> None:
    action = await graph.action_client("/fibonacci", FIBONACCI)
    assert await action.available(10)
    feedback: list[list[int]] = []
    goal = await action.send_goal(
        {"order": 6}, on_feedback=lambda one: feedback.append(one["sequence"].tolist()), timeout_s=120
    )
    ended = await goal.result(120)
    assert ended.status is GoalStatus.SUCCEEDED
    assert ended.result["sequence"].tolist() == [0, 1, 1, 2, 3, 5]
    assert goal.status is GoalStatus.SUCCEEDED
    assert len(goal.goal_id) == 16
    await true(lambda: feedback)
    assert feedback == [[0, 1, 1, 2, 3, 5][: len(one)] for one in feedback]


async def test_a_goal_is_cancelled(graph: RosGraph) -> None:
    action = await graph.action_client("/fibonacci", FIBONACCI)
    goal = await action.send_goal({"order": 900}, timeout_s=120)
    with pytest.raises(CallTimeout, match=r"the goal did not end within 0\.1 s"):
        await goal.result(0.1)
    assert await goal.cancel(10)
    ended = await goal.result(120)
    assert ended.status is GoalStatus.CANCELED
    assert ended.result["sequence"].tolist()[:2] == [0, 1]
    assert not await goal.cancel(10)


async def test_goals_are_refused_aborted_and_faults_are_survived(graph: RosGraph) -> None:
    action = await graph.action_client("/fibonacci", FIBONACCI)
    with pytest.raises(GoalRefused, match="/fibonacci: the server did not accept the goal"):
        await action.send_goal({"order": 5000}, timeout_s=120)
    aborted = await (await action.send_goal({"order": 40}, timeout_s=120)).result(120)
    assert aborted.status is GoalStatus.ABORTED
    assert aborted.result["sequence"].tolist() == [0, 1, 1, 2, 3]
    fault = await (await action.send_goal({"order": 41}, timeout_s=120)).result(120)
    assert fault.status is GoalStatus.ABORTED
    assert (
        await (await action.send_goal({"order": 3}, timeout_s=120)).result(120)
    ).status is GoalStatus.SUCCEEDED


async def test_our_actions_serve_other_nodes(joined: Joined, graph: RosGraph) -> None:
    async def work(goal: ServedGoal) -> dict[str, Any]:
        goal.feedback({"sequence": [1]})
        await goal.wait_cancel_requested()
        raise GoalEnded(GoalStatus.CANCELED, {"sequence": [1, 2]})

    served = await graph.serve_action("work", FIBONACCI, work)
    async with joined(node="other") as other:
        action = await other.action_client("/work", FIBONACCI)
        feedback: list[Any] = []
        goal = await action.send_goal({"order": 1}, on_feedback=feedback.append, timeout_s=120)
        await true(lambda: goal.status is GoalStatus.EXECUTING)
        assert await goal.cancel(10)
        assert (await goal.result(120)).result["sequence"].tolist() == [1, 2]
        assert served.calls == 1


async def test_a_goal_whose_result_is_invalid_or_that_nobody_cancelled_is_aborted(
    joined: Joined, graph: RosGraph
) -> None:
    async def work(goal: ServedGoal) -> dict[str, Any]:
        if goal.request["order"] == 1:
            return {"sequence": "not numbers"}
        raise GoalEnded(GoalStatus.CANCELED, {"sequence": [2]})

    served = await graph.serve_action("work", FIBONACCI, work)
    async with joined(node="other") as other:
        action = await other.action_client("/work", FIBONACCI)
        invalid = await (await action.send_goal({"order": 1}, timeout_s=120)).result(120)
        assert invalid.status is GoalStatus.ABORTED
        assert (served.failed, "sequence" in str(served.last_error)) == (1, True)
        uncancelled = await (await action.send_goal({"order": 2}, timeout_s=120)).result(120)
        assert uncancelled.status is GoalStatus.ABORTED
        assert uncancelled.result["sequence"].tolist() == [2]


@pytest.mark.nightly
@pytest.mark.slow
async def test_a_killed_server_fails_the_goal_and_its_successor_is_found(
    joined: Joined, adapter: Adapter, domain_id: int
) -> None:
    elsewhere = domain_id + 1
    async with joined(domain_id=elsewhere) as graph:
        action = await graph.action_client("/fibonacci", FIBONACCI)
        with running_peer(adapter, elsewhere) as peer:
            goal = await action.send_goal({"order": 900}, timeout_s=120)
            waiting = asyncio.ensure_future(goal.result())
            await asyncio.sleep(0.2)
            peer.kill()
            # DDS detects a silent program after ten seconds (Fast DDS: twenty).
            with pytest.raises(ServerLost, match=r"the server of .* went away before"):
                await asyncio.wait_for(waiting, scaled(40))
        with running_peer(adapter, elsewhere):
            ended = await (await action.send_goal({"order": 4}, timeout_s=120)).result(120)
            assert ended.status is GoalStatus.SUCCEEDED


@pytest.mark.nightly
@pytest.mark.usefixtures("only_cyclone")
async def test_a_goal_fails_when_another_server_replaces_its_own(graph: RosGraph, joined: Joined) -> None:
    async def work(_: ServedGoal) -> dict[str, Any]:
        await asyncio.Event().wait()
        return {}

    action = await graph.action_client("/replaced", FIBONACCI)
    async with joined(node="first") as first:
        await first.serve_action("/replaced", FIBONACCI, work)
        goal = await action.send_goal({"order": 1}, timeout_s=120)
        waiting = asyncio.ensure_future(goal.result())
        async with joined(node="second") as second:
            await second.serve_action("/replaced", FIBONACCI, work)
            await true(
                lambda: len(next(one for one in graph.actions() if one.name == "/replaced").servers) == 2
            )
            # Leave like a killed process: goals are not ended.
            first._opened.clear()  # type: ignore[attr-defined]
            await first.close()
            with pytest.raises(ServerLost, match="went away before it answered"):
                await asyncio.wait_for(waiting, scaled(40))
