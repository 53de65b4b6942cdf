"""The tasklist: publishes the open Tasks of people, from their entities in the broker.

A Task belongs to it if it involves nobody who performs it, or a Person first, and if it is part of a Process.
Claims, results and comments go to the orchestrator, which has forms and history. What a Task shows is in
`live/tasklist_view.py`.
"""

from collections import OrderedDict
from typing import Final

from handover.security.resource_patterns import ANY_RESOURCE
from handover.service_addresses import ORCHESTRATOR
from handover.tasks.task_life import FINISHED, is_for_people
from handover_datamodels.entities import Task
from handover_web.live.live_state import EVERYTHING, LiveState
from handover_web.live.tasklist_view import view_of
from handover_web.sources.devices import short_name

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
