"""A Task in the tasklist: its fields for the page, and how each is read from the entity in the broker.

A new column is a field here, with its value, and its place in `app/src/tasks/TaskList.tsx`;
`python -m handover_web.types` generates the TypeScript type. The orchestrator writes who has claimed a Task
as the member `operator` of its outputs, and who has declined it as `declinedBy`.
"""

from collections.abc import Mapping
from typing import Any, Final, Literal

from typing_extensions import TypedDict

from handover.tasks.task_life import performers_of
from handover_datamodels.attributes import DateTime, Property
from handover_datamodels.entities import Task, TaskStatus
from handover_datamodels.times import iso

BY_TASKLIST: Final = "tasklist"
Status = Literal["pending", "assigned", "inProgress", "completed", "paused", "failed"]


class TasklistView(TypedDict):
    """Topic `tasklist/<urn>`: an open Task for people, without its form and history.

    It is offered to `persons` (names or URNs) and `groups`. `claimedBy` is the person who has claimed it,
    `declinedBy` are those who have declined it. A Task that a component performs is not claimable.
    """

    id: str
    name: str
    description: str | None
    process: str
    element: str
    status: Status
    persons: list[str]
    groups: list[str]
    claimedBy: str | None
    declinedBy: list[str]
    isClaimable: bool
    since: str | None
    deadline: str | None
    dueDate: str | None
    followUpDate: str | None
    priority: int | None


def view_of(task: Task) -> TasklistView:
    """Return the Task as the page shows it."""
    inputs = dict(task.work_parameters.value) if task.work_parameters else {}
    outputs = dict(task.output_parameters.value) if task.output_parameters else {}
    listed = inputs.get("candidates")
    candidates: Mapping[str, Any] = listed if isinstance(listed, Mapping) else {}
    performer = next(iter(performers_of(link.object for link in task.involves or ())), None)
    assignee = candidates.get("assignee")
    persons = [performer] if performer else [assignee] if assignee else candidates.get("users")
    lane = candidates.get("lane")
    kind = task.is_defined_by.object.rpartition(":")[2]
    is_ours = outputs.get("by") == BY_TASKLIST
    operator = outputs.get("operator")
    declined = outputs.get("declinedBy")
    described = inputs.get("description") or (task.description.value if task.description else None)
    seen = task.status.observed_at
    return {
        "id": task.id,
        "name": task.name.value if task.name else kind,
        "description": described if isinstance(described, str) else None,
        "process": task.is_part_of.object.rpartition(":")[2] if task.is_part_of else "",
        "element": task.element.value if task.element else "",
        "status": task.status.value.value,
        "persons": _texts(persons),
        "groups": list(dict.fromkeys([*_texts(candidates.get("groups")), *_texts([lane])])),
        "claimedBy": operator if isinstance(operator, str) and is_ours else None,
        "declinedBy": _texts(declined),
        "isClaimable": task.status.value is TaskStatus.PENDING or is_ours,
        "since": iso(seen) if seen else None,
        "deadline": _moment(task.deadline),
        "dueDate": _moment(task.due_date),
        "followUpDate": _moment(task.follow_up_date),
        "priority": task.priority.value if task.priority else None,
    }


def _texts(values: Any) -> list[str]:
    return [value for value in values if isinstance(value, str)] if isinstance(values, list) else []


def _moment(attribute: Property[DateTime] | None) -> str | None:
    return iso(attribute.value) if attribute else None
