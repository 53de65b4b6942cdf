"""Tasks and changes call services and send goals; a node of the graph requests a Task."""

import asyncio
import itertools
from datetime import UTC, datetime
from typing import Any

import pytest

from handover_datamodels.entities import Task, TaskStatus
from handover_datamodels.times import iso
from handover_ros.graph.port import GoalEnded, GoalStatus, Message, ServedGoal
from ros_fiware_bridge.tests.integration.conftest import Shop
from tests.kit.waiting import scaled

pytestmark = pytest.mark.slow

ARM = "urn:ngsi-ld:Device:demo:arm"
LAMP = "urn:ngsi-ld:Device:demo:lamp"

_numbers = itertools.count(1)


@pytest.fixture(scope="module")
def at_work(shared_shop: Shop) -> Shop:
    return shared_shop


def prop(value: Any) -> dict[str, Any]:
    return {"type": "Property", "value": value, "observedAt": iso(datetime.now(UTC))}


async def ask(shop: Any, operation: str, status: str = "pending", **parameters: Any) -> str:
    task_id = f"urn:ngsi-ld:Task:demo:{operation}-{next(_numbers)}"
    await shop.broker.create(
        {
            "id": task_id,
            "type": "Task",
            "isDefinedBy": {"type": "Relationship", "object": "urn:ngsi-ld:TaskDefinition:demo:work"},
            "status": prop(status),
            "involves": {"type": "Property", "value": [{"type": "Relationship", "object": ARM}]},
            "workParameters": {"type": "Property", "value": {"operation": operation, **parameters}},
        }
    )
    return task_id


async def end_of(shop: Any, task_id: str) -> tuple[str, dict[str, Any]]:
    async def ended() -> Task | None:
        task: Task = await shop.broker.get(task_id, Task)
        return task if task.status.value in {TaskStatus.COMPLETED, TaskStatus.FAILED} else None

    task = await shop.until(ended, 25.0, f"{task_id} never ended")
    return task.status.value.value, dict(task.output_parameters.value) if task.output_parameters else {}


async def test_a_task_calls_a_service(shop: Any) -> None:
    asked: list[Message] = []

    async def reset(request: Message) -> Message:
        asked.append(request)
        return {"success": not request["data"], "message": "hard is forbidden" if request["data"] else "done"}

    served = await shop.robot.serve("/arm/reset", "std_srvs/srv/SetBool", reset)
    try:
        assert await end_of(shop, await ask(shop, "reset")) == ("completed", {"words": "done"})
        status, outputs = await end_of(shop, await ask(shop, "reset", hard=True))
        assert status == "failed"
        assert outputs["reason"] == "/arm/reset did not succeed: hard is forbidden"
        status, outputs = await end_of(shop, await ask(shop, "reset", hard="very"))
        assert (status, "'very' is not true or false" in outputs["reason"]) == ("failed", True)
        assert asked == [{"data": False}, {"data": True}]
    finally:
        await served.close()


@pytest.mark.nightly
async def test_a_task_for_an_unavailable_service_fails_with_the_reason(shop: Any) -> None:
    status, outputs = await end_of(shop, await ask(shop, "reset"))
    assert status == "failed"
    assert "/arm/reset" in outputs["reason"]
    status, outputs = await end_of(shop, await ask(shop, "dance"))
    assert outputs["reason"] == (
        f'the ROS bridge has no rule for "dance" of {ARM}; it has rules for reset, lock, count, hasty, once'
    )


async def test_a_request_contains_attributes_of_the_resource(shop: Any) -> None:
    received: list[Message] = []

    async def lock(request: Message) -> Message:
        received.append(request)
        return {"success": True}

    served = await shop.robot.serve("/arm/lock", "std_srvs/srv/SetBool", lock)
    try:
        status, outputs = await end_of(shop, await ask(shop, "lock"))
        assert (status, "resource.isLocked" in outputs["reason"]) == ("failed", True)
        await shop.broker.upsert([{"id": ARM, "type": "Device", "isLocked": prop(True)}])
        assert (await end_of(shop, await ask(shop, "lock")))[0] == "completed"
        assert received == [{"data": True}]
    finally:
        await served.close()


async def test_a_task_sends_a_goal_and_reports_its_feedback(shop: Any) -> None:
    async def count(goal: ServedGoal) -> Message:
        order = goal.request["order"]
        if order > 10:
            raise GoalEnded(GoalStatus.ABORTED, {"sequence": [0]})
        sequence = [0, 1]
        goal.feedback({"sequence": sequence})
        if order == 7:
            await goal.wait_cancel_requested()
            raise GoalEnded(GoalStatus.CANCELED)
        while len(sequence) <= order:
            sequence.append(sequence[-1] + sequence[-2])
        return {"sequence": sequence}

    served = await shop.robot.serve_action("/arm/count", "example_interfaces/action/Fibonacci", count)
    try:
        assert await end_of(shop, await ask(shop, "count", upTo=5)) == (
            "completed",
            {"sequence": [0, 1, 1, 2, 3, 5]},
        )
        status, outputs = await end_of(shop, await ask(shop, "count", upTo=11))
        assert (status, outputs["reason"], outputs["sequence"]) == ("failed", "/arm/count gave up", [0])
        status, outputs = await end_of(shop, await ask(shop, "count"))
        assert (status, "there is no upTo" in outputs["reason"]) == ("failed", True)

        task_id = await ask(shop, "count", upTo=7)

        async def has_feedback() -> bool:
            entity = await shop.broker.retrieve(task_id)
            return entity.get("outputParameters", {}).get("value", {}).get("sequence") == [0, 1]

        await shop.until(has_feedback, why="the feedback never came")
        await shop.broker.append(task_id, {"requestedStatus": prop("cancelled")})
        status, outputs = await end_of(shop, task_id)
        assert (status, outputs["reason"]) == ("failed", "cancelled")
    finally:
        await served.close()


async def test_a_goal_over_its_time_limit_is_cancelled_and_its_task_fails(shop: Any) -> None:
    cancelled = asyncio.Event()

    async def count(goal: Any) -> Message:
        await goal.wait_cancel_requested()
        cancelled.set()
        raise GoalEnded(GoalStatus.CANCELED)

    served = await shop.robot.serve_action("/arm/count", "example_interfaces/action/Fibonacci", count)
    try:
        status, outputs = await end_of(shop, await ask(shop, "hasty"))
        assert (status, "did not end within 1" in outputs["reason"]) == ("failed", True)
        await shop.until(cancelled.is_set, why="the robot continues")
    finally:
        await served.close()


async def test_a_change_of_an_attribute_calls_a_service_once(shop: Any) -> None:
    asked: list[Message] = []

    async def on(request: Message) -> Message:
        asked.append(request)
        return {"success": True, "message": f"lit {len(asked)}"}

    served = await shop.robot.serve("/lamp/on", "std_srvs/srv/SetBool", on)
    try:
        await shop.broker.upsert([{"id": LAMP, "type": "Device", "wanted": prop(False)}])
        await shop.broker.update(LAMP, {"wanted": prop(True)})
        await shop.becomes(LAMP, "answer", "lit 1")
        assert asked == [{"data": True}]
        await shop.broker.update(LAMP, {"wanted": prop(True)})
        await shop.becomes(LAMP, "answer", "lit 2")
    finally:
        await served.close()


async def test_a_node_requests_a_task_and_receives_its_result(shop: Any) -> None:
    answering = asyncio.create_task(
        shop.robot.call("/ask_for_help", "std_srvs/srv/SetBool", {"data": True}, scaled(30.0))
    )

    async def asked() -> Any:
        return [one for one in await shop.broker.query(type="Task") if ":ask-" in one["id"]]

    (task,) = await shop.until(asked)
    assert task["workParameters"]["value"] == {
        "commandId": 3,
        "urgent": True,
        "description": "Please help the arm",
    }
    assert task["isDefinedBy"]["object"] == "urn:ngsi-ld:TaskDefinition:demo:help"
    for status in ("assigned", "inProgress", "completed"):
        await shop.broker.append(task["id"], {"status": prop(status)})
    assert await answering == {"success": True, "message": f"completed {task['id']}"}


async def test_a_goal_with_again_false_is_not_sent_after_a_restart(shop: Any) -> None:
    status, outputs = await end_of(shop, await ask(shop, "once", status="inProgress"))
    assert status == "failed"
    assert outputs["reason"].endswith("stopped while /arm/count was active; such a goal is not sent again")
