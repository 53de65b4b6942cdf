"""Tasks whose request was sent and not answered: their outcome is unknown, and no goal is executed later."""

import itertools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from handover.tasks.outcomes import is_outcome_unknown
from handover_datamodels.times import iso
from handover_ros.graph.joining import Adapter, installed
from ros_fiware_bridge.tests.integration.conftest import Shop
from ros_fiware_bridge.tests.integration.graph.conftest import TYPES, running_script

pytestmark = pytest.mark.slow

ARM = "urn:ngsi-ld:Device:demo:arm"
MAPPING = f"""
type_paths: [{TYPES}]
services:
  press: {{service: /slow_call, type: std_srvs/Trigger, task: press, resource: Device:arm, timeout_s: 20}}
  look:
    service: /slow_call
    type: std_srvs/Trigger
    task: look
    resource: Device:arm
    timeout_s: 20
    again: true
actions:
  hurry: {{action: /slow, type: test_msgs/Fibonacci, task: hurry, resource: Device:arm, timeout_s: 20}}
  work: {{action: /slow, type: test_msgs/Fibonacci, task: work, resource: Device:arm, timeout_s: 600}}
"""
GENUINE = Adapter.RCLPY in installed()
_numbers = itertools.count(1)


class Slow:
    """The slow server, and what it has written."""

    def __init__(self, folder: Path, domain: int) -> None:
        self.folder = folder
        self._domain = str(domain)

    @contextmanager
    def running(self) -> Iterator[Any]:
        script = ["genuine_slow_peer.py"] if GENUINE else ["slow_peer.py", Adapter.CYCLONE.value]
        with running_script(*script, self._domain, str(self.folder)) as process:
            yield process

    def answer(self) -> None:
        (self.folder / "answer").touch()

    def log(self) -> list[str]:
        file = self.folder / "log"
        return file.read_text().split() if file.exists() else []

    def has(self, word: str) -> Callable[[], bool]:
        return lambda: word in self.log()


@pytest.fixture
def slow(at_work: Shop, tmp_path: Path) -> Slow:
    return Slow(tmp_path, at_work.domain)


def prop(value: Any) -> dict[str, Any]:
    return {"type": "Property", "value": value, "observedAt": iso(datetime.now(UTC))}


async def ask(shop: Shop, operation: str) -> str:
    task_id = f"urn:ngsi-ld:Task:demo:{operation}-{next(_numbers)}"
    await shop.broker.create(
        {
            "id": task_id,
            "type": "Task",
            "isDefinedBy": {"type": "Relationship", "object": "urn:ngsi-ld:TaskDefinition:demo:work"},
            "status": prop("pending"),
            "involves": {"type": "Property", "value": [{"type": "Relationship", "object": ARM}]},
            "workParameters": {"type": "Property", "value": {"operation": operation}},
        }
    )
    return task_id


async def failure(shop: Shop, task_id: str) -> dict[str, Any]:
    async def ended() -> dict[str, Any] | None:
        task: dict[str, Any] = await shop.broker.retrieve(task_id)
        return task if task["status"]["value"] in {"completed", "failed"} else None

    task = await shop.until(ended, 120.0, f"{task_id} never ended")
    assert task["status"]["value"] == "failed"
    outputs: dict[str, Any] = task["outputParameters"]["value"]
    return outputs


async def has_alert(shop: Shop, task_id: str) -> None:
    async def stands() -> bool:
        alerts = await shop.broker.query(type="Alert")
        return any(
            task_id in one["description"]["value"] and "validTo" not in one
            for one in alerts
            if "description" in one
        )

    await shop.until(stands, 60.0, f"no Alert about {task_id}")


@pytest.mark.nightly
async def test_a_goal_that_is_accepted_late_is_cancelled_and_its_task_has_an_unknown_outcome(
    shop: Shop, slow: Slow
) -> None:
    with slow.running():
        task_id = await ask(shop, "hurry")
        outputs = await failure(shop, task_id)
        assert is_outcome_unknown(outputs), outputs
        assert "did not answer within" in outputs["reason"]
        await has_alert(shop, task_id)
        slow.answer()
        await shop.until(slow.has("cancelled"), 120.0, "the goal is executed")


@pytest.mark.nightly
async def test_a_call_without_an_answer_has_an_unknown_outcome_unless_it_may_be_repeated(
    shop: Shop, slow: Slow
) -> None:
    with slow.running():
        task_id = await ask(shop, "press")
        assert is_outcome_unknown(await failure(shop, task_id))
        await has_alert(shop, task_id)
        outputs = await failure(shop, await ask(shop, "look"))
        assert not is_outcome_unknown(outputs)
        assert outputs["reason"].startswith("/slow_call did not answer within")
        slow.answer()


@pytest.mark.nightly
async def test_a_server_that_is_killed_and_started_again_does_not_hold_up_its_robot(
    shop: Shop, slow: Slow
) -> None:
    slow.answer()
    with slow.running() as first:
        task_id = await ask(shop, "work")
        await shop.until(slow.has("started"), 120.0, "the goal never started")
        first.kill()
        first.wait()
        with slow.running():  # within the lease of the first
            outputs = await failure(shop, task_id)
            assert is_outcome_unknown(outputs), outputs
            await has_alert(shop, task_id)
            second = await ask(shop, "work")
            await shop.until(lambda: slow.log().count("started") == 2, 120.0, "the next Task waits")
            await shop.broker.append(second, {"requestedStatus": prop("cancelled")})
            assert (await failure(shop, second))["reason"] == "cancelled"


@pytest.mark.nightly
async def test_a_goal_that_outlives_the_bridge_is_cancelled_and_its_outcome_is_unknown(
    shop: Shop, slow: Slow
) -> None:
    slow.answer()
    with slow.running():
        task_id = await ask(shop, "work")
        await shop.until(slow.has("started"), 120.0, "the goal never started")
        shop.cell.kill("ros_fiware_bridge")
        assert "cancelled" not in slow.log()
        shop.cell.start("ros_fiware_bridge", within_s=90.0)
        await shop.until(slow.has("cancelled"), 120.0, "the goal is still executed")
        assert is_outcome_unknown(await failure(shop, task_id))
        await has_alert(shop, task_id)


@pytest.mark.nightly
async def test_a_call_that_the_bridge_did_not_survive_is_not_sent_again(shop: Shop, slow: Slow) -> None:
    with slow.running():
        task_id = await ask(shop, "press")
        await shop.until(slow.has("asked"), 120.0, "the service was never called")
        shop.cell.kill("ros_fiware_bridge")
        shop.cell.start("ros_fiware_bridge", within_s=90.0)
        assert is_outcome_unknown(await failure(shop, task_id))
        assert slow.log() == ["asked"]
        slow.answer()
