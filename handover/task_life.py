"""How a Task lives: which moves are legal, and which news counts.

A Task is `pending`, then `assigned` to whoever performs it, `inProgress`, perhaps `paused`, and ends
`completed` or `failed`; a finished Task never reopens. Notifications may be late, doubled or lost, so an
observer applies states, not events: it may have missed steps, but never goes back in time.
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
    """Say whether whoever writes a Task may move it from `before` to `after` in one step."""
    return after in _NEXT[before]


def is_reachable(before: TaskStatus, after: TaskStatus) -> bool:
    """Say whether `after` can follow `before` by one or more legal steps, some of them unseen."""
    seen: set[TaskStatus] = set()
    ahead = set(_NEXT[before])
    while ahead - seen:
        seen |= ahead
        ahead = {after for status in ahead for after in _NEXT[status]}
    return after in seen


def is_news(known: Task | None, seen: Task) -> bool:
    """Say whether an observer who knows the Task as `known` should believe it to be as `seen`.

    Nothing older than what is known counts, and nothing that no chain of legal moves could have led to.
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
    """Compare in milliseconds: some brokers keep no finer time than that."""
    return (
        known is None or seen is None or seen >= known.replace(microsecond=known.microsecond // 1000 * 1000)
    )
