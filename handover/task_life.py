"""The life cycle of a Task: the legal transitions, and which observations are accepted.

A Task is `pending`, then `assigned` to its performer, `inProgress`, possibly `paused`, and ends `completed`
or `failed`; a finished Task never reopens. Notifications may be late, duplicated or lost, so an observer
applies states, not events: it may miss steps, but never goes back in time.
"""

from collections.abc import Mapping
from datetime import datetime

from datamodels.entities import Task, TaskStatus

FINISHED = frozenset({TaskStatus.COMPLETED, TaskStatus.FAILED})

_NEXT: Mapping[TaskStatus, frozenset[TaskStatus]] = {
    TaskStatus.PENDING: frozenset({TaskStatus.ASSIGNED, TaskStatus.FAILED}),
    TaskStatus.ASSIGNED: frozenset({TaskStatus.IN_PROGRESS, TaskStatus.PAUSED, TaskStatus.FAILED}),
    TaskStatus.IN_PROGRESS: frozenset({TaskStatus.PAUSED, TaskStatus.COMPLETED, TaskStatus.FAILED}),
    TaskStatus.PAUSED: frozenset({TaskStatus.IN_PROGRESS, TaskStatus.FAILED}),
    TaskStatus.COMPLETED: frozenset(),
    TaskStatus.FAILED: frozenset(),
}


def is_legal(before: TaskStatus, after: TaskStatus) -> bool:
    """Return whether a writer may change a Task from `before` to `after` in one step."""
    return after in _NEXT[before]


def is_reachable(before: TaskStatus, after: TaskStatus) -> bool:
    """Return whether `after` can follow `before` by one or more legal steps, observed or not."""
    seen: set[TaskStatus] = set()
    following = set(_NEXT[before])
    while following - seen:
        seen |= following
        following = {after for status in following for after in _NEXT[status]}
    return after in seen


def is_news(known: Task | None, seen: Task) -> bool:
    """Return whether an observer that knows the Task as `known` accepts the state `seen`.

    An older state is refused, and one that no chain of legal steps can reach.
    """
    if known is None:
        return True
    before, after = known.status, seen.status
    if before.value in FINISHED:
        return False
    if not _not_older(before.observed_at, after.observed_at):
        return False
    return before.value == after.value or is_reachable(before.value, after.value)


def _not_older(known: datetime | None, seen: datetime | None) -> bool:
    """Compare in milliseconds, the resolution of some brokers."""
    return (
        known is None or seen is None or seen >= known.replace(microsecond=known.microsecond // 1000 * 1000)
    )
