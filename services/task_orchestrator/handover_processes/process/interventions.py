"""Interventions: what an engineer does with a process that runs, or is stuck.

Each is recorded in the history of the process, with the person and the reason as given.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import datetime

from handover.errors import Problem
from handover.messages import text_of
from handover_bpmn.execution.graph import Plan
from handover_bpmn.execution.migration import Finding
from handover_bpmn.execution.run import Run
from handover_bpmn.execution.state import RunFailed
from handover_datamodels.entities import RequestedStatus, TaskStatus
from handover_processes.process import attempts
from handover_processes.process.process import CANCELLED, Process
from handover_processes.records.entities import execution_properties, status_request
from handover_processes.records.messages import MessageKind
from handover_processes.records.processes import Act, ActKind
from handover_processes.records.step import Step


@dataclass(frozen=True, slots=True)
class MigrationReport:
    """What differs for a process in another version; with an obstacle it cannot be migrated."""

    process: str
    source: int
    target: int
    findings: tuple[Finding, ...]
    tasks: Mapping[str, str]
    """The open Tasks, by token."""

    @property
    def is_possible(self) -> bool:
        """Return whether there is no obstacle."""
        return not any(finding.is_obstacle for finding in self.findings)


def pause(process: Process, act: Act, step: Step, now: datetime) -> None:
    """Pause the process and request that of its Tasks; raise `Problem` 409 if it has ended.

    While it is paused no Task is posted and no timer is processed. Results and messages are accepted.
    """
    process.require_running()
    if process.record.status is not TaskStatus.PAUSED:
        _change_pace(process, TaskStatus.PAUSED, act, step, now)


def resume_work(process: Process, act: Act, step: Step, now: datetime) -> None:
    """Continue a paused process, with the timers that were due meanwhile.

    Raises `Problem` 409 if it has ended.
    """
    run = process.require_running()
    if process.record.status is TaskStatus.PAUSED:
        run.advance(now)
        _change_pace(process, TaskStatus.IN_PROGRESS, act, step, now)


def _change_pace(process: Process, status: TaskStatus, act: Act, step: Step, now: datetime) -> None:
    requested = RequestedStatus(status.value)
    step.touched.add(process.record.id)
    process.record_act(act, step)
    process.revise(status=status)
    for task in process.tasks.values():
        if task.cancelled_at is None:
            request = status_request(requested, now)
            step.enqueue(task.stream, MessageKind.APPEND, task.id, request)
    process.update(step, now)


def cancel(process: Process, by: str | None, step: Step, now: datetime) -> None:
    """End the process as failed and cancel its Tasks; raise `Problem` 409 if it has ended."""
    process.require_running()
    step.touched.add(process.record.id)
    process.record_act(Act(now, ActKind.CANCEL, by), step)
    process.end(TaskStatus.FAILED, f"{CANCELLED} by {by}" if by else CANCELLED, step, now)
    process.update(step, now)


def release_reservation(process: Process, act: Act, key: str, step: Step, now: datetime) -> None:
    """Release a reservation that is held, though a token is within.

    The next activity within it reserves again. Raises `Problem` 404 if there is none, 409 if it is not
    held.
    """
    process.require_running()
    released = process.reservations.release(key, now, act.by or "")
    step.touched.add(process.record.id)
    process.record_act(replace(act, element=released.element), step)
    process.update(step, now)


def incident_of(process: Process, task_id: str) -> str:
    """Return the token of the incident that the failed Task `task_id` is the reason of.

    Raises `Problem` 404 if the Task is none of this process, 409 if it is the reason of no incident.
    """
    if task_id not in process.composed:
        raise Problem.translated(
            404,
            "No such Task",
            "process.no_such_task",
            '{process} has no Task "{task_id}"',
            process=process.record.id,
            task_id=task_id,
        )
    for incident in process.record.incidents:
        if incident.task == task_id:
            return incident.token
    why = f"{task_id} is not a failed Task that {process.record.id} waits for"
    waited_for = [incident.task for incident in process.record.incidents if incident.task is not None]
    if waited_for:
        why += f"; retry {waited_for[0]}"
    raise Problem(409, "Cannot be retried", why)


def mend(
    process: Process, act: Act, token: str | None, step: Step, now: datetime, *, scope: str | None = None
) -> None:
    """Do what a person has decided about a token, or about the variables, and record it.

    With `scope` the variables are those of an inner scope.
    Raises `Problem` 404 if there is no such token, 409 if the act is impossible.
    """
    run = process.require_running()
    if token is not None:
        element = run.element(token)
        if element is None:
            raise Problem.translated(
                404, "No such token", "process.no_such_token", 'there is no token "{token}"', token=token
            )
        act = replace(act, element=element)
    if scope is not None:
        inner_scope = next((inner for inner in run.inner_scopes() if inner.scope == scope), None)
        act = replace(act, element=None if inner_scope is None else inner_scope.element)
    step.touched.add(process.record.id)
    if act.act is ActKind.RETRY and token is not None:
        process.record = attempts.forget_declined(
            process.record, token, act.element or ""
        )  # all are asked again
    try:
        if act.act is ActKind.RETRY and token is not None and attempts.is_postponed(process.record, token):
            run.set_variables(act.values or {}, now, token=token)
            process.record = attempts.repeat(process.record, run, token, now)
        else:
            _apply_to(run, act, token, now, scope=scope)
    except RunFailed as failure:
        assert process.record.state is not None  # noqa: S101 - a running process has one
        identity = execution_properties(process.settings, process.record, process.plan.definition)
        process.run = Run.resume(process.plan, process.record.state, process.library, identity=identity)
        raise Problem(409, "Not possible", text_of(failure)) from failure
    process.record_act(act, step)
    process.update(step, now)


def migrate(
    process: Process, plan: Plan, act: Act, step: Step, now: datetime, *, dry: bool = False
) -> MigrationReport:
    """Continue in the version of `plan`, unless there is an obstacle; with `dry` only report.

    Open Tasks and due dates of timers stay. Raises `Problem` 409 if the process has ended, has that
    version, or cannot be read.
    """
    run = process.require_running()
    source, target = process.record.version, plan.version
    if source == target:
        raise Problem.translated(
            409,
            "Has this version",
            "process.has_version",
            "{process} has version {version} already",
            process=process.record.id,
            version=source,
        )
    open_tasks = {task.token: task.id for task in process.tasks.values() if process.is_current(run, task)}
    mapping = act.mapping or {}
    try:
        identity = execution_properties(process.settings, process.record, plan.definition)
        migrated = Run.resume(process.plan, run.snapshot(), process.library, identity=identity)
        findings = migrated.migrate(plan, mapping, act.values or {}, now)
    except RunFailed as failure:
        raise Problem(409, "Cannot be migrated", text_of(failure)) from failure
    report = MigrationReport(process.record.id, source, target, tuple(findings), open_tasks)
    if dry or not report.is_possible:
        return report
    step.touched.add(process.record.id)
    process.run, process.plan = migrated, plan
    process.revise(version=target)
    process.record_act(replace(act, to=str(target)), step)
    _rename_elements(process, migrated, step)
    process.update(step, now)
    return report


def _rename_elements(process: Process, run: Run, step: Step) -> None:
    """Give open Tasks, incidents and declined activities the elements of the present version."""
    for task in list(process.tasks.values()):
        element = run.element(task.token) if process.is_current(run, task) else None
        if element is not None and element != task.element:
            key = attempts.declined_key(task.token, task.element)
            if key in process.record.declined:
                declined = dict(process.record.declined)
                declined[attempts.declined_key(task.token, element)] = declined.pop(key)
                process.revise(declined=declined)
            name = run.activity(task.token).name
            process.record_task(task.changed(element=element, name=name), step)
    incidents = {incident.token: incident for incident in run.incidents()}
    process.revise(
        incidents=tuple(
            replace(incident, element=incidents[incident.token].element, name=incidents[incident.token].name)
            if incident.token in incidents
            else incident
            for incident in process.record.incidents
        ),
        retries=tuple(
            replace(retry, element=run.element(retry.token) or "", name=run.activity(retry.token).name)
            for retry in process.record.retries
        ),
    )


def _apply_to(run: Run, act: Act, token: str | None, now: datetime, *, scope: str | None) -> None:
    values = act.values or {}
    if scope is not None:
        run.set_scope_variables(scope, values, now)
        return
    if act.act is ActKind.SET_VARIABLES or token is None:
        run.set_variables(values, now, token=token)
        return
    if values and act.act is not ActKind.SKIP:
        run.set_variables(values, now, token=token)
    match act.act:
        case ActKind.RETRY:
            run.retry(token, now)
        case ActKind.SKIP:
            run.skip(token, values, now)
        case ActKind.MOVE:
            run.move(token, act.to or "", now)
        case ActKind.CANCEL_BRANCH:
            run.cancel_token(token, now)
