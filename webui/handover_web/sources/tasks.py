"""Tasks: records an event for each change of status, and has the Task's process refreshed."""

from collections.abc import Callable, Collection, Mapping
from typing import Any, Final

from handover.messages import message_in, with_code
from handover.service_addresses import BROKER
from handover.tasks.task_life import FINISHED, is_news, performers_of
from handover_datamodels.entities import Task, TaskStatus
from handover_datamodels.times import iso
from handover_web.live.event_log import Event, EventLog, Level, normalized_timestamp
from handover_web.sources.broker_entities import EntityHandler
from handover_web.sources.devices import Devices, short_name
from handover_web.sources.services import ServiceMonitor
from handover_web.sources.tasklist import Tasklist

ACTIVE_STATUSES: Final = ",".join(f'"{status}"' for status in TaskStatus if status not in FINISHED)

LEVELS: Final[Mapping[TaskStatus, Level]] = {TaskStatus.FAILED: "stop", TaskStatus.PAUSED: "attention"}

STATUS_TEXTS: Final[Mapping[TaskStatus, str]] = {
    TaskStatus.PENDING: "created for",
    TaskStatus.ASSIGNED: "accepted by",
    TaskStatus.IN_PROGRESS: "started by",
    TaskStatus.PAUSED: "paused by",
    TaskStatus.COMPLETED: "completed by",
    TaskStatus.FAILED: "failed with",
}


class Tasks(EntityHandler):
    """Handles the Tasks that are not finished."""

    ngsi_type = "Task"
    active_q = f"status=={ACTIVE_STATUSES}"

    def __init__(
        self,
        events: EventLog,
        devices: Devices,
        services: ServiceMonitor,
        refresh_process: Callable[[str], None],
        tasklist: Tasklist,
    ) -> None:
        self._events = events
        self._devices = devices
        self._services = services
        self._refresh_process = refresh_process
        self._tasklist = tasklist
        self._active: dict[str, Task | None] = {}
        self._is_restored = False

    def update(self, entity: Mapping[str, Any]) -> None:
        """Handle the current state of a Task."""
        task = Task.from_ngsild(entity)
        before = self._active.get(task.id)
        if before is not None and not is_news(before, task):
            return
        if task.status.value in FINISHED:
            self._active.pop(task.id, None)
        else:
            self._active[task.id] = task
        self._tasklist.update(task)
        if before is None or _status_and_time(before) != _status_and_time(task):
            self._refresh_process(task.id)
            self._log(task)
        elif task.output_parameters != before.output_parameters:
            self._refresh_process(task.id)

    def active_ids(self) -> Collection[str]:
        """Return the Tasks known to be unfinished, including those from before a restart."""
        if not self._is_restored:
            self._is_restored = True
            for subject, mark in self._events.last_marks().items():
                if subject.startswith("urn:ngsi-ld:Task:") and mark.partition("@")[0] not in FINISHED:
                    self._active.setdefault(subject, None)
        return self._active.keys()

    def remove(self, entity_id: str) -> None:
        """Forget a Task."""
        self._active.pop(entity_id, None)
        self._tasklist.remove(entity_id)
        self._refresh_process(entity_id)

    def _log(self, task: Task) -> None:
        status, at = _status_and_time(task)
        who = next(iter(performers_of(link.object for link in task.involves or ())), "")
        inputs = dict(task.work_parameters.value) if task.work_parameters else {}
        outputs = dict(task.output_parameters.value) if task.output_parameters else {}
        kind = short_name(task.is_defined_by.object)
        description = inputs.get("description") or (task.description.value if task.description else None)
        name = str(description or inputs.get("operation") or kind)
        reason = (message_in(outputs, "reason") or "") if status is TaskStatus.FAILED else ""
        text = f'"{name}" {STATUS_TEXTS[status]} {short_name(who) or "a person"}'
        text += f": {reason}" if reason else ""
        self._services.record_message(self._devices.performer_of(who) or BROKER, text, at)
        self._events.record(
            Event(
                subject=task.id,
                mark=f"{status.value}@{at}",
                key=f"task.{status.value}",
                source=short_name(who) or kind,
                text=text,
                at=at,
                level="attention" if reason == "cancelled" else LEVELS.get(status, "info"),
                values={
                    "task": task.id,
                    "kind": kind,
                    "name": name,
                    "who": short_name(who),
                    **with_code("reason", reason),
                    "by": str(outputs.get("operator") or outputs.get("by") or ""),
                    "outcome": str(outputs.get("outcome", "")),
                    "note": str(outputs.get("note", "")),
                },
            )
        )


def _status_and_time(task: Task) -> tuple[TaskStatus, str]:
    seen = task.status.observed_at
    return task.status.value, normalized_timestamp(iso(seen)) if seen else ""
