"""Attempts: an activity is performed again after a failure, or by another agent if one has declined it.

The functions return the changed record of the process.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Any

from handover_bpmn.execution.queries import OpenActivity
from handover_bpmn.execution.run import Run
from handover_processes.records.processes import ProcessRecord, Retry
from handover_processes.records.tasks import TaskRecord
from handover_processes.timing.retries import attempts_of, is_retried, retry_at

MAX_LOST_ATTEMPTS = 3
"""How often a Task is tried in all whose performer is lost, where the activity does not say it."""


@dataclass(frozen=True, slots=True)
class Failure:
    """Why a Task has failed: the error code or outcome, if any, and what its performer reported."""

    code: str | None
    reason: str
    outputs: Mapping[str, Any]


def declined_key(token: str, element: str) -> str:
    """Return the key of an activity in `ProcessRecord.declined`."""
    return f"{token} {element}"


def postpone(
    record: ProcessRecord, run: Run, task: TaskRecord, failure: Failure, now: datetime
) -> ProcessRecord | None:
    """Let a failed activity wait for its next attempt; return None if it has none."""
    open_ = run.open_activity(task.token)
    policy = open_.activity.retry
    is_caught = run.catches(task.token, failure.code)
    if policy is None or not is_retried(policy, failure.code, failure.outputs, is_caught=is_caught):
        return None
    due = retry_at(policy, _failed(record, task) + 1, now)
    attempts = attempts_of(policy, open_.variables)
    return _next_attempt(record, open_, task, failure.reason, attempts=attempts, due=due)


def _failed(record: ProcessRecord, task: TaskRecord) -> int:
    return next((retry.failed for retry in record.retries if retry.token == task.token), 0)


def _next_attempt(
    record: ProcessRecord, open_: OpenActivity, task: TaskRecord, reason: str, *, attempts: int, due: datetime
) -> ProcessRecord | None:
    failed = _failed(record, task) + 1
    if failed >= attempts:
        return None
    retry = Retry(
        token=task.token,
        visit=task.visit,
        element=open_.element,
        name=open_.activity.name,
        task=task.id,
        failed=failed,
        attempts=attempts,
        reason=reason,
        due=due,
    )
    return replace(record, retries=(*(other for other in record.retries if other.token != task.token), retry))


def repeat_lost(
    record: ProcessRecord, run: Run, task: TaskRecord, reason: str, now: datetime
) -> ProcessRecord | None:
    """Let an activity whose performer was lost wait for its next attempt; None if it was tried too often."""
    open_ = run.open_activity(task.token)
    policy = open_.activity.retry
    attempts = MAX_LOST_ATTEMPTS if policy is None else attempts_of(policy, open_.variables)
    return _next_attempt(record, open_, task, reason, attempts=attempts, due=now)


def repeat(record: ProcessRecord, run: Run, token: str, now: datetime) -> ProcessRecord:
    """Begin the next attempt of an activity, if it waits for it."""
    waiting = next((e for e in record.retries if e.token == token and e.due is not None), None)
    if waiting is None or run.visit(token) != waiting.visit:
        return record
    run.repeat(token, now)
    present = replace(waiting, visit=run.visit(token) or 0, due=None)
    return replace(record, retries=tuple(present if e is waiting else e for e in record.retries))


def is_postponed(record: ProcessRecord, token: str) -> bool:
    """Return whether the activity of a token waits for its next attempt."""
    return any(retry.token == token and retry.due is not None for retry in record.retries)


def present_retries(record: ProcessRecord, run: Run | None) -> tuple[Retry, ...]:
    """Return the retries of the activities that are still open, with their present visits."""
    visits = {retry.token: None if run is None else run.visit(retry.token) for retry in record.retries}
    return tuple(
        replace(retry, visit=visit)  # another agent may have been asked
        for retry in record.retries
        if (visit := visits[retry.token]) is not None and (retry.due is None or visit == retry.visit)
    )


def offers_others(task: TaskRecord) -> bool:
    """Return whether users or groups are offered a Task that its assignee declines."""
    candidates = task.entity["workParameters"]["value"].get("candidates")
    return (
        bool(task.performer)
        and isinstance(candidates, Mapping)
        and bool(candidates.get("users") or candidates.get("groups"))
    )


def ask_next(record: ProcessRecord, run: Run, task: TaskRecord, now: datetime) -> ProcessRecord:
    """Open the activity again: its performer has declined it, so that another gets it."""
    key = declined_key(task.token, task.element)
    declined = (*record.declined.get(key, ()), task.performer)
    changed = replace(record, declined={**record.declined, key: declined})
    run.repeat(task.token, now)
    return changed


def forget_declined(record: ProcessRecord, token: str, element: str) -> ProcessRecord:
    """Let an activity be offered to all again."""
    key = declined_key(token, element)
    if key not in record.declined:
        return record
    others = {other: agents for other, agents in record.declined.items() if other != key}
    return replace(record, declined=others)


def declined_by(record: ProcessRecord, open_: OpenActivity) -> frozenset[str]:
    """Return the agents that have declined an activity."""
    return frozenset(record.declined.get(declined_key(open_.token, open_.element), ()))
