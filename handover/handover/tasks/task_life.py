"""The life cycle of a Task: the legal transitions, and which observations are accepted.

A Task is `pending`, then `assigned` to its performer, `inProgress`, possibly `paused`, and ends `completed`
or `failed`; a finished Task never reopens. Notifications may be late, duplicated or lost, so an observer
applies states, not events: it may miss steps, but never goes back in time.
"""

from collections.abc import Iterable, Mapping
from functools import cache

from handover_datamodels.entities import Task, TaskStatus

FINISHED = frozenset({TaskStatus.COMPLETED, TaskStatus.FAILED})
STARTED = frozenset({TaskStatus.IN_PROGRESS, TaskStatus.PAUSED})
"""The states of a Task whose work may have begun."""
UNFINISHED_QUERY = "status==" + ",".join(f'"{status}"' for status in TaskStatus if status not in FINISHED)
"""The `q` of the Tasks and Processes that have not ended."""

PASSIVE_TYPES = frozenset({"Material", "Asset"})
"""Types of what a Task uses: they never perform it."""

_NEXT: Mapping[TaskStatus, frozenset[TaskStatus]] = {
    TaskStatus.PENDING: frozenset({TaskStatus.ASSIGNED, TaskStatus.FAILED}),
    TaskStatus.ASSIGNED: frozenset({TaskStatus.IN_PROGRESS, TaskStatus.PAUSED, TaskStatus.FAILED}),
    TaskStatus.IN_PROGRESS: frozenset({TaskStatus.PAUSED, TaskStatus.COMPLETED, TaskStatus.FAILED}),
    TaskStatus.PAUSED: frozenset({TaskStatus.IN_PROGRESS, TaskStatus.FAILED}),
    TaskStatus.COMPLETED: frozenset(),
    TaskStatus.FAILED: frozenset(),
}


def type_of(entity_id: str) -> str | None:
    """Return the entity type in an id such as `urn:ngsi-ld:Device:demo:ur10-1`; None if it has none."""
    parts = entity_id.split(":", 3)
    return parts[2] if len(parts) == 4 and parts[:2] == ["urn", "ngsi-ld"] else None


def performers_of(involved: Iterable[str]) -> list[str]:
    """Return those of the involved resources that may perform the Task, in their order."""
    return [resource for resource in involved if type_of(resource) not in PASSIVE_TYPES]


def is_for_people(involved: Iterable[str]) -> bool:
    """Return whether people perform a Task that involves these: nobody performs it, or a Person first."""
    performers = performers_of(involved)
    return not performers or type_of(performers[0]) == "Person"


def is_legal(before: TaskStatus, after: TaskStatus) -> bool:
    """Return whether a writer may change a Task from `before` to `after` in one step."""
    return after in _NEXT[before]


@cache
def is_reachable(before: TaskStatus, after: TaskStatus) -> bool:
    """Return whether `after` can follow `before` by one or more legal steps, observed or not."""
    seen: set[TaskStatus] = set()
    following = set(_NEXT[before])
    while following - seen:
        seen |= following
        following = {after for status in following for after in _NEXT[status]}
    return after in seen


def is_news(earlier: Task | None, seen: Task) -> bool:
    """Return whether an observer that knows the Task as `earlier` accepts the state `seen`.

    A state that no chain of legal steps can reach is refused. `observedAt` refuses nothing, since clocks
    differ: what a notification says is only a hint, and of two reads of the broker the later one counts.
    """
    if earlier is None:
        return True
    before, after = earlier.status.value, seen.status.value
    return before not in FINISHED and (before == after or is_reachable(before, after))
