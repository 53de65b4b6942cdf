"""A Task for a robot from the command line: post it, wait for its end, print its result."""

import asyncio
import uuid
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from handover.broker import BrokerClient
from handover.command_line.access import cli_access
from handover.errors import UsageError
from handover.settings import Settings
from handover.tasks.task_life import FINISHED
from handover_datamodels.entities import Task, TaskStatus
from handover_datamodels.times import iso

POLL_S = 0.3


async def perform(
    settings: Settings, robot: str, operation: str, parameters: Mapping[str, Any], timeout_s: float
) -> Mapping[str, Any]:
    """Return the result of an operation of a robot. Raises `UsageError` where it fails or takes too long."""
    task = Task.from_ngsild(
        {
            "id": settings.entity_id("Task", f"command-{uuid.uuid4().hex[:12]}"),
            "type": "Task",
            "isDefinedBy": settings.entity_id("TaskDefinition", operation),
            "status": {
                "type": "Property",
                "value": TaskStatus.PENDING.value,
                "observedAt": iso(datetime.now(UTC)),
            },
            "involves": {
                "type": "Property",
                "value": [{"type": "Relationship", "object": settings.entity_id("Device", robot)}],
            },
            "workParameters": {"type": "Property", "value": {"operation": operation, **parameters}},
        }
    )
    async with cli_access(settings) as access, BrokerClient(settings, credentials=access) as broker:
        await broker.create(task)
        try:
            async with asyncio.timeout(timeout_s):
                while task.status.value not in FINISHED:
                    await asyncio.sleep(POLL_S)
                    task = await broker.get(task.id, Task)
        except TimeoutError:
            raise UsageError(
                f"{robot} did not end {operation} within {timeout_s:.0f} s; is the trajectory tool running? "
                f"The Task is {task.id}, {task.status.value.value}"
            ) from None
    result: Mapping[str, Any] = {} if task.output_parameters is None else task.output_parameters.value
    if task.status.value is not TaskStatus.COMPLETED:
        raise UsageError(f"{robot}: {operation} failed: {result.get('reason', 'no reason given')}")
    return result
