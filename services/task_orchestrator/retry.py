"""Retry: whether a failed process can continue, and in which state.

Only a process that a failed Task has ended can be retried: after another failure its state is unknown.
"""

from collections.abc import Collection

from datamodels.entities import TaskStatus
from handover.errors import Problem
from handover.messages import message
from services.task_orchestrator.engine import Plan, Run, RunFailed
from services.task_orchestrator.records import ProcessRecord


def run_to_retry(plan: Plan, record: ProcessRecord, composed: Collection[str], task_id: str) -> Run:
    """Return the run of `record` before the Task `task_id` failed and ended it.

    `composed` are the ids of all its Tasks. Raises `Problem` 404 if the Task is none of them, 409 with the
    reason if it cannot be retried.
    """
    if task_id not in composed:
        raise Problem(
            404,
            "No such Task",
            message(
                "process.no_such_task",
                '{process} has no Task "{task_id}"',
                process=record.id,
                task_id=task_id,
            ),
        )
    if record.status is not TaskStatus.FAILED:
        raise _refusal(f"{record.id} is {record.status}, and only a failed process can be retried")
    if record.failed_by is None or record.state is None:
        why = f"{record.id} was not ended by a failed Task that can be retried ({record.reason})"
        raise _refusal(f"{why}; start a new process")
    if record.failed_by != task_id:
        raise _refusal(f"another Task has ended {record.id}; retry {record.failed_by}")
    try:
        return plan.resume(record.state)
    except RunFailed as failure:
        raise _refusal(f"{failure}; start a new process") from failure


def _refusal(why: str) -> Problem:
    return Problem(409, "Cannot be retried", why)
