"""Which of the jobs that wait for a resource is executed next."""

from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from handover.broker import BrokerClient
from handover.job import Job
from handover.performer import ResourceQueue
from handover.settings import Settings
from handover.tasks.finished_tasks import FinishedTasks
from handover_datamodels.entities import Task

LAMP = "urn:ngsi-ld:Device:demo:lamp-1"


def job(name: str, status: str = "pending", priority: int | None = None, due: str | None = None) -> Job:
    entity: dict[str, Any] = {
        "id": f"urn:ngsi-ld:Task:demo:{name}",
        "type": "Task",
        "isDefinedBy": {"type": "Relationship", "object": "urn:ngsi-ld:TaskDefinition:demo:light"},
        "status": {"type": "Property", "value": status},
    }
    if priority is not None:
        entity["priority"] = {"type": "Property", "value": priority}
    if due is not None:
        entity["dueDate"] = {"type": "Property", "value": {"@type": "DateTime", "@value": due}}
    settings = Settings(_env_file=None)
    return Job(Task.from_ngsild(entity), LAMP, BrokerClient(settings), FinishedTasks(settings, "lamp"))


def order(*jobs: Job) -> list[str]:
    queue = ResourceQueue()
    queue.waiting.extend(jobs)
    return [queue.take().task.id.rpartition(":")[2] for _ in jobs]


def test_priority_comes_first_then_the_due_date_then_the_arrival() -> None:
    first, second = job("first"), job("second")
    low, high = job("low", priority=10), job("high", priority=90)
    soon, later = job("soon", due="2026-05-04T08:00:00Z"), job("later", due="2026-05-05T08:00:00Z")
    assert order(low, first, later, second, soon, high) == ["high", "soon", "later", "first", "second", "low"]


def test_a_task_that_was_started_before_a_crash_comes_before_all_others() -> None:
    assert order(job("high", priority=100), job("started", "inProgress", priority=0)) == ["started", "high"]


@given(st.lists(st.integers(0, 100), min_size=1, max_size=8))
def test_every_job_is_taken_once(priorities: list[int]) -> None:
    jobs = [job(str(nth), priority=priority) for nth, priority in enumerate(priorities)]
    taken = order(*jobs)
    assert taken == sorted(taken, key=lambda name: (-priorities[int(name)], int(name)))
