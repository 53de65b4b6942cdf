"""A genuine ROS 2 node on Fast DDS performs Tasks by a service and an action."""

import itertools
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from handover_datamodels.times import iso
from handover_ros.graph.joining import Adapter, installed
from ros_fiware_bridge.tests.integration.conftest import Shop
from ros_fiware_bridge.tests.integration.graph.conftest import TYPES, running_peer
from tests.kit.skipping import NO_ROS

pytestmark = [pytest.mark.slow, pytest.mark.skipif(Adapter.RCLPY not in installed(), reason=NO_ROS)]

MAPPING = f"""
type_paths: [{TYPES}]
services:
  repeat:
    service: /repeat
    type: rcl_interfaces/ListParameters
    task: repeat
    resource: Device:robot
    request: {{prefixes: {{attribute: words}}, depth: {{attribute: times}}}}
    outputs: {{names: result.names}}
    timeout_s: 30
actions:
  count:
    action: /fibonacci
    type: test_msgs/Fibonacci
    task: count
    resource: Device:robot
    goal: {{order: {{attribute: upTo}}}}
    outputs: {{sequence: sequence}}
    timeout_s: 30
"""
_numbers = itertools.count(1)


@pytest.fixture(autouse=True)
def robot(at_work: Shop) -> Iterator[None]:
    with running_peer(Adapter.RCLPY, at_work.domain):
        yield


async def done(shop: Shop, operation: str, **parameters: Any) -> dict[str, Any]:
    task_id = f"urn:ngsi-ld:Task:demo:{operation}-{next(_numbers)}"
    robot = {"type": "Relationship", "object": "urn:ngsi-ld:Device:demo:robot"}
    status = {"type": "Property", "value": "pending", "observedAt": iso(datetime.now(UTC))}
    await shop.broker.create(
        {
            "id": task_id,
            "type": "Task",
            "isDefinedBy": {"type": "Relationship", "object": "urn:ngsi-ld:TaskDefinition:demo:work"},
            "status": status,
            "involves": {"type": "Property", "value": [robot]},
            "workParameters": {"type": "Property", "value": {"operation": operation, **parameters}},
        }
    )

    async def ended() -> dict[str, Any] | None:
        task: dict[str, Any] = await shop.broker.retrieve(task_id)
        return task if task["status"]["value"] in {"completed", "failed"} else None

    task = await shop.until(ended, 90.0, f"{task_id} never ended")
    outputs: dict[str, Any] = task["outputParameters"]["value"]
    assert task["status"]["value"] == "completed", outputs
    return outputs


async def test_a_service_and_an_action_on_fast_dds_perform_tasks(shop: Shop, tmp_path: Path) -> None:
    assert (await done(shop, "repeat", words=["ab"], times=2))["names"] == ["ab", "ab"]
    assert (await done(shop, "count", upTo=6))["sequence"] == [0, 1, 1, 2, 3, 5]
