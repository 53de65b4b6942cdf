"""Tasks: each move of each becomes an event, and has the process it belongs to looked at."""

from collections.abc import Callable, Collection, Mapping
from typing import Any, Final

from datamodels.entities import Task, TaskStatus
from datamodels.times import iso
from handover.messages import message_in, with_code
from handover.task_life import FINISHED, is_news
from webui.events import EventLog, Happening, Level, in_milliseconds
from webui.settings import BROKER
from webui.sources.devices import Devices, short
from webui.sources.entities import Kind
from webui.sources.services import Services

UNFINISHED: Final = ",".join(f'"{status}"' for status in TaskStatus if status not in FINISHED)

LEVELS: Final[Mapping[TaskStatus, Level]] = {TaskStatus.FAILED: "stop", TaskStatus.PAUSED: "attention"}

WORDS: Final[Mapping[TaskStatus, str]] = {
    TaskStatus.PENDING: "is asked of",
    TaskStatus.ASSIGNED: "is taken up by",
    TaskStatus.IN_PROGRESS: "is begun by",
    TaskStatus.PAUSED: "is paused by",
    TaskStatus.COMPLETED: "is completed by",
    TaskStatus.FAILED: "fails with",
}


class Tasks(Kind):
    """Follows the Tasks that are not finished."""

    ngsi_type = "Task"
    open_q = f"status=={UNFINISHED}"

    def __init__(
        self,
        events: EventLog,
        devices: Devices,
        services: Services,
        process_moves: Callable[[str], None],
    ) -> None:
        self._events = events
        self._devices = devices
        self._services = services
        self._process_moves = process_moves
        self._open: dict[str, Task | None] = {}
        self._looked_back = False

    def take(self, entity: Mapping[str, Any]) -> None:
        """Take a Task as it is now."""
        task = Task.from_ngsild(entity)
        known = self._open.get(task.id)
        if known is not None and not is_news(known, task):
            return
        if task.status.value in FINISHED:
            self._open.pop(task.id, None)
        else:
            self._open[task.id] = task
        if known is None or _move(known) != _move(task):
            self._process_moves(task.id)
            self._log(task)
        elif task.output_parameters != known.output_parameters:
            self._process_moves(task.id)

    def still_open(self) -> Collection[str]:
        """Return the Tasks that were not finished when last seen, before a restart of this server too."""
        if not self._looked_back:
            self._looked_back = True
            for subject, mark in self._events.subjects().items():
                if subject.startswith("urn:ngsi-ld:Task:") and mark.partition("@")[0] not in FINISHED:
                    self._open.setdefault(subject, None)
        return self._open.keys()

    def gone(self, entity_id: str) -> None:
        """Forget a Task."""
        self._open.pop(entity_id, None)
        self._process_moves(entity_id)

    def _log(self, task: Task) -> None:
        status, at = _move(task)
        who = next((link.object for link in task.involves or ()), "")
        asked = dict(task.work_parameters.value) if task.work_parameters else {}
        given = dict(task.output_parameters.value) if task.output_parameters else {}
        kind = short(task.is_defined_by.object)
        said = asked.get("description") or (task.description.value if task.description else None)
        name = str(said or asked.get("operation") or kind)
        reason = (message_in(given, "reason") or "") if status is TaskStatus.FAILED else ""
        text = f'"{name}" {WORDS[status]} {short(who) or "nobody"}' + (f": {reason}" if reason else "")
        self._services.heard(self._devices.performer_of(who) or BROKER, text, at)
        self._events.record(
            Happening(
                subject=task.id,
                mark=f"{status.value}@{at}",
                key=f"task.{status.value}",
                source=short(who) or kind,
                text=text,
                at=at,
                level="attention" if reason == "cancelled" else LEVELS.get(status, "info"),
                values={
                    "task": task.id,
                    "kind": kind,
                    "name": name,
                    "who": short(who),
                    **with_code("reason", reason),
                    "by": str(given.get("operator") or given.get("by") or ""),
                    "outcome": str(given.get("outcome", "")),
                    "note": str(given.get("note", "")),
                },
            )
        )


def _move(task: Task) -> tuple[TaskStatus, str]:
    seen = task.status.observed_at
    return task.status.value, in_milliseconds(iso(seen)) if seen else ""
