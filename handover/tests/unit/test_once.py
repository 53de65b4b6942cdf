"""An act that must not be repeated is done at most once for a Task, over crashes of the performer."""

import math
from collections.abc import AsyncIterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from handover.broker import BrokerClient
from handover.job import Job, TaskFailed
from handover.messages import with_code
from handover.settings import Settings
from handover.tasks.finished_tasks import FinishedTasks
from handover.tasks.outcomes import is_outcome_unknown
from handover_datamodels.entities import Task

TASK = {
    "id": "urn:ngsi-ld:Task:demo:grip",
    "type": "Task",
    "isDefinedBy": {"type": "Relationship", "object": "urn:ngsi-ld:TaskDefinition:demo:grip"},
    "status": {"type": "Property", "value": "inProgress"},
}


class Gripper:
    """Counts how often it acts; `fault` is raised by an act that does not come to its end."""

    def __init__(self) -> None:
        self.acts = 0
        self.fault: BaseException | None = None

    async def act(self) -> Mapping[str, Any]:
        self.acts += 1
        if self.fault is not None:
            raise self.fault
        return {"part": f"part-{self.acts}"}


@pytest.fixture
async def records(tmp_path: Path) -> AsyncIterator[FinishedTasks]:
    opened = FinishedTasks(Settings.load(data_dir=tmp_path), "gripper")
    await opened.open()
    yield opened
    await opened.close()


def a_run_of_the_task(records: FinishedTasks) -> Job:
    return Job(Task.from_ngsild(TASK), "urn:ngsi-ld:Device:demo:g", BrokerClient(Settings.load()), records)


async def test_a_later_run_gets_the_recorded_result(records: FinishedTasks) -> None:
    gripper = Gripper()
    assert await a_run_of_the_task(records).once("grip", gripper.act) == {"part": "part-1"}
    assert await a_run_of_the_task(records).once("grip", gripper.act) == {"part": "part-1"}
    assert gripper.acts == 1


async def test_an_act_that_was_interrupted_has_an_unknown_outcome(records: FinishedTasks) -> None:
    gripper = Gripper()
    gripper.fault = KeyboardInterrupt()  # as an end of the process, it leaves no record of the act
    with pytest.raises(KeyboardInterrupt):
        await a_run_of_the_task(records).once("grip", gripper.act)
    gripper.fault = None
    with pytest.raises(TaskFailed, match='stopped during "grip"; look whether that was done') as failed:
        await a_run_of_the_task(records).once("grip", gripper.act)
    assert is_outcome_unknown({"reason": failed.value.reason})
    assert gripper.acts == 1
    assert await a_run_of_the_task(records).once("release", gripper.act) == {"part": "part-2"}


async def test_a_result_that_json_cannot_express_is_not_recorded_as_another_one(
    records: FinishedTasks,
) -> None:
    async def measure() -> Mapping[str, Any]:
        return {"forces": [1.0, math.nan]}

    with pytest.raises(TypeError, match=r"forces\.1"):
        await a_run_of_the_task(records).once("measure", measure)
    with pytest.raises(TaskFailed) as failed:
        await a_run_of_the_task(records).once("measure", measure)
    assert is_outcome_unknown(with_code("reason", failed.value.reason))
