"""Alarms: for what a process calls a person, and when the call is over. They go out with the step."""

from typing import Any

from handover.messages import message, with_code
from services.task_orchestrator.records import ProcessRecord, Saying, Step, TaskRecord


def call_for_overdue(step: Step, task: TaskRecord) -> None:
    """Nobody has taken up the Task in time."""
    involved = ", ".join(link["object"] for link in task.entity["involves"]["value"])
    _raise(
        step,
        task.process,
        _overdue_key(task),
        source=task.id,
        category="taskOverdue",
        sub_category="notTakenUp",
        description=message(
            "alert.task_overdue",
            "Nobody has taken up the Task {task}; it involves {involved}",
            task=task.id,
            involved=involved,
        ),
    )


def end_overdue(step: Step, task: TaskRecord) -> None:
    """Somebody has taken up the Task after all, or it is not wanted any more."""
    step.say(task.process, Saying.CLEAR, task.id, {"key": _overdue_key(task)})


def call_for_lost(step: Step, task: TaskRecord) -> None:
    """The broker no longer has a Task that somebody had begun."""
    _raise(
        step,
        task.process,
        f"{_short(task)} lost",
        source=task.id,
        category="taskLost",
        description=message(
            "alert.task_lost",
            "The broker no longer has the Task {task}, which was {status}. See what came of it, then cancel "
            "the process {process}",
            task=task.id,
            status=task.status.value,
            process=task.process,
        ),
    )


def call_for_failed(step: Step, process: ProcessRecord, urn: str) -> None:
    """The process has failed."""
    _raise(
        step,
        process.id,
        _failed_key(process),
        source=urn,
        category="processFailed",
        description=message(
            "alert.process_failed",
            "The process {process} has failed: {reason}",
            process=process.id,
            reason=process.reason,
        ),
    )


def end_failed(step: Step, process: ProcessRecord, urn: str) -> None:
    """The process that had failed goes on."""
    step.say(process.id, Saying.CLEAR, urn, {"key": _failed_key(process)})


def _raise(step: Step, stream: str, key: str, **alert: Any) -> None:
    # The outbox keeps JSON, in which a message is its text, its code and its parameters.
    described = with_code("description", alert["description"])
    step.say(stream, Saying.RAISE, alert["source"], {"key": key, **alert, **described})


def _short(task: TaskRecord) -> str:
    return task.id.rsplit(":", 1)[-1]


def _overdue_key(task: TaskRecord) -> str:
    return f"{_short(task)} not taken up"


def _failed_key(process: ProcessRecord) -> str:
    return f"{process.id} failed"
