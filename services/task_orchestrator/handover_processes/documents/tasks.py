"""Documents of Tasks, and what other documents say of Tasks."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from typing_extensions import TypedDict

from handover.messages import message_in
from handover_bpmn.model import Activity
from handover_datamodels.entities import TaskStatus
from handover_datamodels.times import iso
from handover_processes.documents.document import From, Moment, OptionalMoment, coded, document, documents
from handover_processes.documents.reasons import Allocated, Reason
from handover_processes.records.tasks import Move, TaskRecord


def name_of(task: TaskRecord) -> str:
    """Return the drawn name of the activity of a Task, or its element."""
    return task.name or task.element


def inputs_of(task: TaskRecord) -> Mapping[str, Any]:
    """Return the parameters of a Task."""
    inputs: Mapping[str, Any] = task.entity["workParameters"]["value"]
    return inputs


def description_of(task: TaskRecord, activity: Activity | None) -> str | None:
    """Return the description of a Task, else that of its activity."""
    described = inputs_of(task).get("description")
    if isinstance(described, str):
        return described
    return None if activity is None else activity.description


def deadline_of(task: TaskRecord) -> str | None:
    """Return until when a performer accepts a Task; None if people may at any time."""
    return iso(task.deadline) if "deadline" in task.entity else None


def priority_of(task: TaskRecord) -> int | None:
    """Return the priority of a Task, if it has one."""
    priority: int | None = task.entity.get("priority", {}).get("value")
    return priority


def due_date_of(task: TaskRecord) -> str | None:
    """Return until when a Task should be completed."""
    return _moment_of(task, "dueDate")


def follow_up_date_of(task: TaskRecord) -> str | None:
    """Return from when on a Task is of interest."""
    return _moment_of(task, "followUpDate")


def _moment_of(task: TaskRecord, name: str) -> str | None:
    attribute = task.entity.get(name)
    return None if attribute is None else str(attribute["value"]["@value"])


def _involved(task: TaskRecord) -> list[str]:
    return [link["object"] for link in task.entity["involves"]["value"]]


def _failure_of(task: TaskRecord) -> str | None:
    return (message_in(task.outputs or {}, "reason") or None) if task.status is TaskStatus.FAILED else None


class StatusChange(TypedDict):
    """A status of a Task, and when it was reached."""

    status: TaskStatus
    at: Annotated[str, From(lambda move: iso(move.observed_at or move.received_at))]


class TaskView(Reason, Allocated):
    """A Task of a process.

    Until `deadline` a performer accepts it, null if people may at any time; until `dueDate` it should be
    completed.
    """

    id: str
    element: str
    name: Annotated[str, From(name_of)]
    visit: int
    description: str | None
    status: TaskStatus
    involves: Annotated[list[str], From(_involved)]
    workParameters: Annotated[Mapping[str, Any], From(inputs_of)]
    outputParameters: Annotated[Mapping[str, Any] | None, From(lambda task: task.outputs)]
    createdAt: Moment
    deadline: Annotated[str | None, From(deadline_of)]
    priority: Annotated[int | None, From(priority_of)]
    dueDate: Annotated[str | None, From(due_date_of)]
    followUpDate: Annotated[str | None, From(follow_up_date_of)]
    endedAt: OptionalMoment
    cancelled: Annotated[bool, From(lambda task: task.cancelled_at is not None)]
    history: list[StatusChange]


def task_view(task: TaskRecord, activity: Activity | None, moves: Sequence[Move]) -> TaskView:
    """Return a Task of a process."""
    return document(
        TaskView,
        task,
        description=description_of(task, activity),
        history=documents(StatusChange, moves),
        **coded("reason", _failure_of(task)),
    )
