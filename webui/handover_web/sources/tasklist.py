"""The tasklist: publishes the open Tasks of people, from their entities in the broker.

A Task belongs to it if it involves nobody who performs it, or a Person first, and if it is part of a Process.
The orchestrator writes who has claimed a Task as the member `operator` of its outputs, and who has declined
it as `declinedBy`. Claims, results and comments go to the orchestrator, which has forms and history.
"""

from collections import OrderedDict
from collections.abc import Mapping
from typing import Any, Final

from handover.security.resource_patterns import ANY_RESOURCE
from handover.service_addresses import ORCHESTRATOR
from handover.tasks.task_life import FINISHED, is_for_people, performers_of
from handover_datamodels.attributes import DateTime, Property
from handover_datamodels.entities import Task, TaskStatus
from handover_datamodels.times import iso
from handover_web.live.live_state import EVERYTHING, LiveState
from handover_web.live.views import TasklistView
from handover_web.sources.devices import short_name

BY_TASKLIST: Final = "tasklist"
MAX_COMMENTED: Final = 500


class Tasklist:
    """Publishes Tasks under the topics `tasklist/<urn>`."""

    def __init__(self, state: LiveState) -> None:
        self._state = state

    def update(self, task: Task) -> None:
        """Publish a Task of a person that is not finished; remove any other."""
        involved = tuple(link.object for link in task.involves or ())
        if task.is_part_of is not None and task.status.value not in FINISHED and is_for_people(involved):
            self._state.publish(f"tasklist/{task.id}", view_of(task), (*involved, self._definition_of(task)))
        else:
            self.remove(task.id)

    def _definition_of(self, task: Task) -> str:
        """Return the ProcessDefinition of a Task, as far as its process is known here; else everything."""
        process = (
            self._state.resources(f"process/{short_name(task.is_part_of.object)}") if task.is_part_of else ()
        )
        return process[0] if process else ANY_RESOURCE

    def remove(self, task_id: str) -> None:
        """Remove a Task that has ended or was deleted."""
        self._state.remove(f"tasklist/{task_id}")


class CommentCounts:
    """Publishes that a page has sent a comment, so that other pages read the comments again."""

    def __init__(self, state: LiveState) -> None:
        self._state = state
        self._counts: OrderedDict[str, int] = OrderedDict()

    def on_write(self, service: str, path: str) -> None:
        """Count a comment: a successful request to `tasks/<id>/comments` or `processes/<id>/comments`."""
        match path.strip("/").split("/"):
            case ["tasks" | "processes", subject, "comments"] if service == ORCHESTRATOR:
                name = short_name(subject)
                self._counts[name] = self._counts.pop(name, 0) + 1
                if len(self._counts) > MAX_COMMENTED:
                    self._counts.popitem(last=False)
                self._state.publish("comments", {"counts": dict(self._counts)}, EVERYTHING)
            case _:
                pass


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
