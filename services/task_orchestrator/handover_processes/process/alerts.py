"""Alerts about processes and Tasks; they are put into the outbox with the step that causes them."""

from typing import Any

from handover.alerts import unshown_key
from handover.alerts.catalogue import (
    PROCESS_FAILED,
    PROCESS_INCIDENT,
    TASK_LOST,
    TASK_NOT_ACCEPTED,
    TASK_PAST_DUE,
    TASK_PERFORMER_LOST,
    TASK_UNREADABLE,
    AlertType,
)
from handover.messages import with_code
from handover_bpmn.model import Escalation
from handover_processes.records.messages import MessageKind
from handover_processes.records.processes import IncidentRecord, ProcessRecord
from handover_processes.records.step import Step
from handover_processes.records.tasks import TaskRecord


def raise_overdue(step: Step, task: TaskRecord) -> None:
    """Raise the Alert that no performer accepted the Task in time."""
    involved = ", ".join(link["object"].rpartition(":")[2] for link in task.entity["involves"]["value"])
    if involved:
        description = TASK_NOT_ACCEPTED.describe(
            "alert.task_overdue",
            task=_name(task),
            involved=involved,
        )
    else:
        description = TASK_NOT_ACCEPTED.describe("alert.task_unclaimed", task=_name(task))
    _raise(
        step,
        task.process,
        TASK_NOT_ACCEPTED,
        key=_overdue_key(task),
        source=task.id,
        description=description,
    )


def clear_overdue(step: Step, task: TaskRecord) -> None:
    """Clear the Alert: a performer has accepted the Task, or it was cancelled."""
    step.enqueue(task.process, MessageKind.CLEAR, task.id, {"key": _overdue_key(task)})


def raise_past_due(step: Step, task: TaskRecord, level: int, escalation: Escalation | None) -> None:
    """Raise the Alert that the Task has not ended in time; `level` 0 is the due date."""
    if escalation is not None and escalation.group is not None:
        description = TASK_PAST_DUE.describe(
            "alert.task_escalated_to",
            task=_name(task),
            group=escalation.group,
        )
    elif escalation is not None:
        description = TASK_PAST_DUE.describe(
            "alert.task_escalated",
            task=_name(task),
            code=escalation.code,
        )
    else:
        description = TASK_PAST_DUE.describe("alert.task_past_due", task=_name(task))
    key = _past_due_key(task, level)
    _raise(step, task.process, TASK_PAST_DUE, key=key, source=task.id, description=description)


def clear_past_due(step: Step, task: TaskRecord) -> None:
    """Clear the Alerts of all levels: the Task has ended."""
    for level in range(task.escalated):
        step.enqueue(task.process, MessageKind.CLEAR, task.id, {"key": _past_due_key(task, level)})


def raise_performer_lost(step: Step, task: TaskRecord, holder: str) -> None:
    """Raise the Alert that the performer of an accepted Task has lost the lease of its Device."""
    _raise(
        step,
        task.process,
        TASK_PERFORMER_LOST,
        key=_performer_lost_key(task),
        source=task.id,
        description=TASK_PERFORMER_LOST.describe(
            "alert.task_performer_lost",
            task=_name(task),
            holder=holder,
            status=task.status.value,
        ),
    )


def clear_performer_lost(step: Step, task: TaskRecord) -> None:
    """Clear the Alert: a performer has the Device again, or the Task has moved."""
    step.enqueue(task.process, MessageKind.CLEAR, task.id, {"key": _performer_lost_key(task)})


def raise_lost(step: Step, task: TaskRecord) -> None:
    """Raise the Alert that the broker no longer has a Task that was started."""
    _raise(
        step,
        task.process,
        TASK_LOST,
        key=f"{_short(task)} lost",
        source=task.id,
        description=TASK_LOST.describe(
            "alert.task_lost",
            task=_name(task),
            status=task.status.value,
            process=task.process,
        ),
    )


def raise_unreadable(step: Step, task: TaskRecord, writer: str | None, rule: str) -> None:
    """Raise the Alert that a program has written the Task against the data model."""
    if writer is not None:
        description = TASK_UNREADABLE.describe(
            "alert.task_unreadable",
            task=_name(task),
            id=task.id,
            writer=writer,
            rule=rule,
            process=task.process,
        )
    else:
        description = TASK_UNREADABLE.describe(
            "alert.task_unreadable_unknown",
            task=_name(task),
            id=task.id,
            rule=rule,
            process=task.process,
        )
    _raise(
        step,
        task.process,
        TASK_UNREADABLE,
        key=_unreadable_key(task),
        source=task.id,
        description=description,
    )


def clear_unreadable(step: Step, task: TaskRecord) -> None:
    """Clear the Alert: the Task matches the data model again, or it has ended."""
    step.enqueue(task.process, MessageKind.CLEAR, task.id, {"key": _unreadable_key(task)})


def raise_failed(step: Step, process: ProcessRecord, urn: str) -> None:
    """Raise the Alert that the process has failed."""
    _raise(
        step,
        process.id,
        PROCESS_FAILED,
        key=_failed_key(process),
        source=urn,
        description=PROCESS_FAILED.describe(
            "alert.process_failed",
            process=process.id,
            reason=process.reason,
        ),
    )


def raise_incident(step: Step, process: ProcessRecord, urn: str, incident: IncidentRecord) -> None:
    """Raise the Alert that a token of the process cannot continue."""
    _raise(
        step,
        process.id,
        PROCESS_INCIDENT,
        key=_incident_key(process, incident),
        source=urn,
        description=PROCESS_INCIDENT.describe(
            "alert.process_incident",
            process=process.id,
            element=incident.name,
            reason=incident.reason,
        ),
    )


def clear_incident(step: Step, process: ProcessRecord, urn: str, incident: IncidentRecord) -> None:
    """Clear the Alert, and that of a Task that could not be shown: the token continues, or has gone."""
    step.enqueue(process.id, MessageKind.CLEAR, urn, {"key": _incident_key(process, incident)})
    if incident.task is not None:
        clear_unshown(step, process, incident.task)


def clear_unshown(step: Step, process: ProcessRecord, task_id: str) -> None:
    """Clear the Alert that the gesture of a Task cannot be shown: nobody has to deal with the Task."""
    step.enqueue(process.id, MessageKind.CLEAR, task_id, {"key": unshown_key(task_id)})


def _raise(
    step: Step, stream: str, alert_type: AlertType, *, key: str, source: str, description: str
) -> None:
    # The outbox stores JSON, in which a message is its text, its code and its parameters.
    body: dict[str, Any] = {
        "key": key,
        "source": source,
        "category": alert_type.category,
        "sub_category": alert_type.sub_category,
        "severity": alert_type.severity.value,
        **with_code("description", description),
    }
    step.enqueue(stream, MessageKind.RAISE, source, body)


def _name(task: TaskRecord) -> str:
    return task.name or task.element


def _short(task: TaskRecord) -> str:
    return task.id.rsplit(":", 1)[-1]


def _overdue_key(task: TaskRecord) -> str:
    return f"{_short(task)} not accepted"


def _performer_lost_key(task: TaskRecord) -> str:
    return f"{_short(task)} performer lost"


def _unreadable_key(task: TaskRecord) -> str:
    return f"{_short(task)} unreadable"


def _past_due_key(task: TaskRecord, level: int) -> str:
    return f"{_short(task)} past due {level}"


def _incident_key(process: ProcessRecord, incident: IncidentRecord) -> str:
    return f"{process.id} incident {incident.token}"


def _failed_key(process: ProcessRecord) -> str:
    return f"{process.id} failed"
