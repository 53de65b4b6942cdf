"""Troubles of Tasks: lost performers, and Tasks that the broker rejects, lacks or has in another form."""

from datetime import datetime

from handover.messages import Message as MessageText
from handover.messages import message, with_code
from handover.tasks.outcomes import outcome_unknown
from handover.tasks.task_life import STARTED
from handover_bpmn.model import PerformerLost
from handover_datamodels.entities import TaskStatus
from handover_processes.process import alerts, state_report
from handover_processes.process.process import CANCELLED, Process, TaskChange
from handover_processes.records.entities import outputs_property, status_property
from handover_processes.records.messages import MessageKind
from handover_processes.records.step import Step

REFUSALS = frozenset({"task.definition_refused", "task.specification_refused"})
"""Codes of reasons that say themselves what was refused."""


def reject(process: Process, task_id: str, reason: str, step: Step, now: datetime) -> None:
    """Handle that the Task cannot be posted: it counts as failed."""
    task = process.tasks.get(task_id)
    if task is not None:
        step.touched.add(process.record.id)
        if not isinstance(reason, MessageText) or reason.code not in REFUSALS:
            reason = message("task.refused_by_broker", "the broker rejected the Task: {why}", why=reason)
        outputs = with_code("reason", reason)
        process.apply(task, TaskChange(TaskStatus.FAILED, now, outputs), step, now)


def performer_lost(process: Process, task_id: str, holder: str, step: Step) -> None:
    """Raise the Alert that the performer of an accepted Task has lost the lease of its Device."""
    task = process.tasks.get(task_id)
    if task is not None and not task.alerted and task.status is not TaskStatus.PENDING:
        step.touched.add(process.record.id)
        process.record_task(task.changed(alerted=True), step)
        alerts.raise_performer_lost(step, task, holder)


def performer_found(process: Process, task_id: str, step: Step) -> None:
    """Clear that Alert: a performer has the lease again."""
    task = process.tasks.get(task_id)
    if task is not None and task.alerted and task.status is not TaskStatus.PENDING:
        step.touched.add(process.record.id)
        process.record_task(task.changed(alerted=False), step)
        alerts.clear_performer_lost(step, task)


def unreadable(process: Process, task_id: str, writer: str | None, rule: str, step: Step) -> bool:
    """Raise the Alert that `writer` has broken `rule` with the Task; return False if that is known."""
    task = process.tasks.get(task_id)
    if task is None or task.unreadable == rule:
        return False
    step.touched.add(process.record.id)
    if task.unreadable is not None:
        alerts.clear_unreadable(step, task)
    is_overdue = task.alerted and task.status is TaskStatus.PENDING
    if is_overdue:
        alerts.clear_overdue(step, task)  # somebody has written it
    process.record_task(task.changed(unreadable=rule, alerted=task.alerted and not is_overdue), step)
    alerts.raise_unreadable(step, task, writer, rule)
    return True


def readable(process: Process, task_id: str, step: Step) -> None:
    """Clear that Alert: the Task matches the data model again."""
    task = process.tasks.get(task_id)
    if task is not None and task.unreadable is not None:
        step.touched.add(process.record.id)
        alerts.clear_unreadable(step, task)
        process.record_task(task.changed(unreadable=None), step)


def end_lost(process: Process, task_id: str, step: Step, now: datetime) -> None:
    """End a Task in progress that nobody performs any more, as its activity says."""
    task, run = process.tasks.get(task_id), process.run
    if task is None or task.status not in STARTED:
        return
    is_left = task.cancelled_at is not None or run is None or not process.is_current(run, task)
    choice = PerformerLost.ASK if is_left or run is None else run.activity(task.token).performer_lost
    if choice is PerformerLost.WAIT:
        return
    step.touched.add(process.record.id)
    reason = message(
        "task.performer_lost",
        "its performer does not answer any more; look what was done, then retry or skip it",
    )
    outputs = {"reason": CANCELLED} if is_left else with_code("reason", outcome_unknown(reason))
    failed = {
        "status": status_property(TaskStatus.FAILED, now),
        "outputParameters": outputs_property(outputs, now),
    }
    step.enqueue(task.stream, MessageKind.APPEND, task.id, failed)
    is_retried = choice is PerformerLost.RETRY
    process.apply(task, TaskChange(TaskStatus.FAILED, now, outputs, repeats=is_retried), step, now)


def missing(process: Process, task_id: str, step: Step, now: datetime) -> None:
    """Handle that the broker does not have the Task: post it again if no performer has started it.

    A started Task is not posted again; an Alert is raised when it is still missing at the next check.
    """
    task = process.tasks.get(task_id)
    if task is None:
        return
    step.touched.add(process.record.id)
    if task.cancelled_at is not None:
        process.apply(task, TaskChange(TaskStatus.FAILED, now, {"reason": CANCELLED}), step, now)
    elif task.status is TaskStatus.PENDING:
        step.enqueue(task.stream, MessageKind.CREATE, task.id, task.entity)
        state_report.report_state(process, step, now)
    else:
        process.record_task(task.changed(lost=task.lost + 1), step)
        if task.lost == 0:  # the broker may have lost the process with it
            state_report.report_state(process, step, now)
        if task.lost == 1:
            alerts.raise_lost(step, task)
