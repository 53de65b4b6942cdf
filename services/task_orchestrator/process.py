"""Process: one run of a definition, from its start to its end, and its Tasks.

Received changes, due timers and requests of people change a process; the consequences are collected in a
`Step`. The functions here are pure: they wait for nothing, perform no I/O and get the time as an argument. An
ended Task never reopens. A process that a failed Task has ended can be retried; it then posts a new Task.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from typing import Any

from datamodels.entities import Task, TaskStatus
from handover.errors import Problem
from handover.messages import Message as MessageText
from handover.messages import message, message_in, text_of, with_code
from handover.task_life import FINISHED, is_news
from services.task_orchestrator import process_alerts
from services.task_orchestrator.engine import Open, Plan, Run, RunFailed
from services.task_orchestrator.entities import (
    cancel_request,
    outputs_property,
    process_entity,
    status_property,
    task_entity,
)
from services.task_orchestrator.languages.native import ExpressionError
from services.task_orchestrator.records import (
    Act,
    ActKind,
    MessageKind,
    Move,
    ProcessRecord,
    Step,
    TaskRecord,
    Timer,
    TimerKind,
)
from services.task_orchestrator.retry import run_to_retry
from services.task_orchestrator.settings import OrchestratorSettings

CANCELLED = "cancelled"
NO_REASON = message("task.no_reason", "no reason given")


@dataclass(frozen=True, slots=True)
class _StatusChange:
    """The new status of a Task."""

    status: TaskStatus
    observed_at: datetime | None
    outputs: Mapping[str, Any]

    @property
    def final(self) -> bool:
        return self.status in FINISHED


def entity_of(
    settings: OrchestratorSettings, record: ProcessRecord, composed: Iterable[str], now: datetime
) -> dict[str, Any]:
    """Return the Process entity of `record`, whose Tasks have the ids `composed`."""
    outputs: dict[str, Any] | None = None
    if record.status is TaskStatus.COMPLETED:
        outputs = {n: v for n, v in record.variables.items() if n not in record.parameters}
    elif record.status is TaskStatus.FAILED:
        outputs = with_code("reason", record.reason or "")
    elif record.acts:
        outputs = {}  # a retried process has none, whatever was written before
    return process_entity(
        settings,
        record.id,
        record.definition,
        status=record.status,
        at=record.ended_at or now,
        parameters=record.parameters,
        tasks=composed,
        outputs=outputs,
    )


@dataclass
class Process:
    """A process in memory; `run` is None after its end.

    `tasks` are the Tasks that have not ended, `composed` the ids of all its Tasks. `completed_after_cancel`
    are, by token, the Tasks that were completed although they had been cancelled.
    """

    settings: OrchestratorSettings
    record: ProcessRecord
    plan: Plan
    run: Run | None
    tasks: dict[str, TaskRecord] = field(default_factory=dict)
    composed: list[str] = field(default_factory=list)
    completed_after_cancel: dict[str, TaskRecord] = field(default_factory=dict)
    reported: tuple[TaskStatus, int] | None = None
    """The status and the number of Tasks that were last written to the broker."""

    @classmethod
    def start(
        cls, settings: OrchestratorSettings, plan: Plan, record: ProcessRecord, step: Step, now: datetime
    ) -> "Process":
        """Start a process with the parameters of `record`, and post its first Tasks."""
        process = cls(settings, record, plan, None)
        step.new.add(record.id)
        step.touched.add(record.id)
        process._report_process(step, now)
        try:
            process.run = plan.start(record.parameters, now)
        except RunFailed as failure:
            process._fail(str(failure), step, now)
        process._update(step, now)
        return process

    @classmethod
    def resume(
        cls, settings: OrchestratorSettings, plan: Plan, record: ProcessRecord, tasks: Iterable[TaskRecord]
    ) -> "Process":
        """Return a stored process; raise `RunFailed` if this release cannot continue it."""
        running = record.state if record.ended_at is None else None
        process = cls(settings, record, plan, plan.resume(running) if running is not None else None)
        for task in tasks:
            process.composed.append(task.id)
            process._track(task)
        process.reported = (record.status, len(process.composed))
        return process

    @property
    def urn(self) -> str:
        """Return the id of its Process entity."""
        return self.settings.entity_id("Process", self.record.id)

    @property
    def over(self) -> bool:
        """Return whether it and all its Tasks have ended."""
        return self.run is None and not self.tasks

    def timers(self) -> tuple[Timer, ...]:
        """Return the timers, the earliest first."""
        timers = []
        if self.run is not None and (event := self.run.next_due()) is not None:
            timers.append(Timer(TimerKind.EVENT, "", event))
        for task in self.tasks.values():
            if task.status is not TaskStatus.PENDING:
                continue
            if task.cancelled_at is not None:
                grace = timedelta(seconds=self.settings.cancel_grace_s)
                timers.append(Timer(TimerKind.GRACE, task.id, task.cancelled_at + grace))
            elif not task.alerted:
                timers.append(Timer(TimerKind.DEADLINE, task.id, task.deadline))
        return tuple(sorted(timers, key=lambda timer: timer.due))

    def is_news(self, seen: Task) -> bool:
        """Return whether the Task as `seen` has a new status that can follow the known one."""
        task = self.tasks.get(seen.id)
        if task is None or seen.status.value is task.status:
            return False
        known = {
            **{name: task.entity[name] for name in ("id", "type", "isDefinedBy")},
            "status": status_property(task.status, task.observed_at or task.created_at),
        }
        return is_news(Task.from_ngsild(known), seen)

    def receive(self, seen: Task, step: Step, now: datetime) -> bool:
        """Apply the Task as `seen`; return whether its status was new."""
        if not self.is_news(seen):
            return False
        step.touched.add(self.record.id)
        given = seen.output_parameters
        outputs = dict(given.value) if given is not None and isinstance(given.value, Mapping) else {}
        change = _StatusChange(seen.status.value, seen.status.observed_at, outputs)
        self._apply(self.tasks[seen.id], change, step, now)
        return True

    def reject(self, task_id: str, reason: str, step: Step, now: datetime) -> None:
        """Handle that the broker rejected the Task: it counts as failed."""
        task = self.tasks.get(task_id)
        if task is not None:
            step.touched.add(self.record.id)
            outputs = with_code(
                "reason", message("task.refused_by_broker", "the broker rejected the Task: {why}", why=reason)
            )
            self._apply(task, _StatusChange(TaskStatus.FAILED, now, outputs), step, now)

    def missing(self, task_id: str, step: Step, now: datetime) -> None:
        """Handle that the broker does not have the Task: post it again if no performer has started it.

        A started Task is not posted again; an Alert is raised when it is still missing at the next check.
        """
        task = self.tasks.get(task_id)
        if task is None:
            return
        step.touched.add(self.record.id)
        if task.cancelled_at is not None:
            self._apply(task, _StatusChange(TaskStatus.FAILED, now, {"reason": CANCELLED}), step, now)
        elif task.status is TaskStatus.PENDING:
            step.enqueue(self.record.id, MessageKind.CREATE, task.id, task.entity)
            self._report_process(step, now)
        else:
            self._record_task(task.changed(lost=task.lost + 1), step)
            if task.lost == 1:
                process_alerts.raise_lost(step, task)

    def tick(self, step: Step, now: datetime) -> None:
        """Process the timers that are due at `now`."""
        step.touched.add(self.record.id)
        due = [timer for timer in self.timers() if timer.due <= now]
        for timer in due:
            task = self.tasks.get(timer.subject)
            if timer.kind is TimerKind.DEADLINE and task is not None:
                self._record_task(task.changed(alerted=True), step)
                process_alerts.raise_overdue(step, task)
            elif timer.kind is TimerKind.GRACE and task is not None:
                self._close_cancelled(task, step, now)
        if any(timer.kind is TimerKind.EVENT for timer in due) and self.run is not None:
            try:
                self.run.advance(now)
            except RunFailed as failure:
                self._fail(text_of(failure), step, now)
        if due:
            self._update(step, now)

    def cancel(self, by: str | None, step: Step, now: datetime) -> None:
        """End the process as failed and cancel its Tasks; raise `Problem` 409 if it has ended."""
        if self.run is None:
            raise Problem(
                409,
                "Process has ended",
                message(
                    "process.process_has_ended",
                    "{process} is {status} already",
                    process=self.record.id,
                    status=self.record.status,
                ),
            )
        step.touched.add(self.record.id)
        self._record_act(Act(now, ActKind.CANCEL, by))
        self._end(TaskStatus.FAILED, f"{CANCELLED} by {by}" if by else CANCELLED, step, now)
        self._update(step, now)

    def retry(self, task_id: str, by: str, step: Step, now: datetime) -> None:
        """Continue the process where the failed Task has ended it, with a new Task for the same activity.

        Activities whose Tasks were cancelled then get new Tasks as well, once those have ended. A Task that
        was completed in spite of its cancellation counts. Raises `Problem` 404 or 409 with the reason.
        """
        run = run_to_retry(self.plan, self.record, self.composed, task_id)
        step.touched.add(self.record.id)
        step.ended.discard(self.record.id)
        process_alerts.clear_failed(step, self.record, self.urn)
        self._record_act(Act(now, ActKind.RETRY, by, task_id))
        self._revise(
            status=TaskStatus.IN_PROGRESS, reason=None, ended_at=None, failed_by=None, archived_at=None
        )
        self.run = run
        try:
            run.restart_timers(now)
            for open_ in run.open():
                done = self.completed_after_cancel.get(open_.token)
                if done is not None and run.is_open(open_.token):
                    run.complete(open_.token, self._results(done, done.outputs or {}), now)
        except RunFailed as failure:
            self._fail(str(failure), step, now)
        self._update(step, now)

    # Consequences

    def _apply(self, task: TaskRecord, change: _StatusChange, step: Step, now: datetime) -> None:
        moves = task.moves + 1
        step.moves.append(Move(task.id, moves, change.status, change.observed_at, now))
        if task.alerted:
            process_alerts.clear_overdue(step, task)
        self._record_task(
            task.changed(
                status=change.status,
                observed_at=change.observed_at,
                moves=moves,
                alerted=False,
                lost=0,
                ended_at=now if change.final else None,
                outputs=change.outputs if change.final else None,
            ),
            step,
        )
        if change.final and self.run is not None and self.run.is_open(task.token):
            try:
                self._continue_run(self.run, task, change, step, now)
            except RunFailed as failure:
                self._fail(str(failure), step, now)
        self._update(step, now)

    def _continue_run(
        self, run: Run, task: TaskRecord, change: _StatusChange, step: Step, now: datetime
    ) -> None:
        activity = self.plan.definition.activities[task.element]
        # Even if the performer reports "completed", an outcome that is not handled must not start a robot.
        unhandled = activity.unhandled(change.outputs)
        if change.status is TaskStatus.COMPLETED and unhandled is None:
            run.complete(task.token, self._results(task, change.outputs), now)
            return
        if task.cancelled_at is not None:
            return  # cancelled when the process failed, and retried since: a new Task is posted
        reason = message_in(change.outputs, "reason") or unhandled or NO_REASON
        if "\0" in reason or not isinstance(reason, MessageText):
            reason = str(reason).replace("\0", "")  # PostgreSQL does not accept it
        code = change.outputs.get("errorCode", change.outputs.get("outcome") if unhandled else None)
        error = {"activity": task.element, "reason": str(reason), "code": None if code is None else str(code)}
        if not run.fail(task.token, error, now):
            self._revise(failed_by=task.id, state=run.snapshot())
            self._fail(
                message(
                    "process.task_failed", '"{task}" failed: {reason}', task=activity.name, reason=reason
                ),
                step,
                now,
            )

    def _results(self, task: TaskRecord, outputs: Mapping[str, Any]) -> dict[str, Any]:
        return self.plan.definition.activities[task.element].results(outputs)

    def _update(self, step: Step, now: datetime) -> None:
        """Post Tasks for open activities, cancel Tasks of left ones, and record the state of the process."""
        state = self.record.state if self.record.failed_by is not None else None
        if self.run is not None:
            try:
                self._post_open(self.run, step, now)
                state = self.run.snapshot()
            except (RunFailed, ExpressionError, ValueError) as failure:
                self._fail(str(failure), step, now)
        if self.run is not None and self.run.completed:
            self._end(TaskStatus.COMPLETED, None, step, now)
        run = self.run
        self._cancel_left({open_.token for open_ in run.open()} if run is not None else set(), step, now)
        known = self.record.id in step.processes or self.record.id in step.new
        self._revise(
            revision=self.record.revision + (0 if known else 1),
            variables=run.variables() if run is not None else self.record.variables,
            waiting=run.waiting() if run is not None else (),
            state=state if run is not None or self.record.failed_by is not None else None,
        )
        step.processes[self.record.id] = self.record
        step.timers[self.record.id] = self.timers()
        if self.reported != (self.record.status, len(self.composed)):
            self._report_process(step, now)

    def _post_open(self, run: Run, step: Step, now: datetime) -> None:
        tokens = {task.token for task in self.tasks.values()}
        for open_ in run.open():
            if open_.token not in tokens:
                self._post(self._new_visit(run, open_), step, now)

    def _new_visit(self, run: Run, open_: Open) -> Open:
        """Return `open_`, as a further visit if it already had a Task."""
        return run.visit_again(open_.token) if self._task_id(open_) in self.composed else open_

    def _task_id(self, open_: Open) -> str:
        return self.settings.entity_id("Task", f"{self.record.id}-{open_.element}-{open_.visit}")

    def _post(self, open_: Open, step: Step, now: datetime) -> None:
        activity = self.plan.definition.activities[open_.element]
        task_id = self._task_id(open_)
        allowed = timedelta(seconds=self.settings.task_deadline_s)
        deadline = activity.deadline.after(now) if activity.deadline is not None else now + allowed
        entity = task_entity(self.settings, task_id, activity, open_.variables, at=now, deadline=deadline)
        task = TaskRecord(
            id=task_id,
            process=self.record.id,
            element=open_.element,
            visit=open_.visit,
            token=open_.token,
            status=TaskStatus.PENDING,
            observed_at=now,
            moves=0,
            created_at=now,
            deadline=deadline,
            entity=entity,
        )
        step.new.add(task_id)
        self.composed.append(task_id)
        self._record_task(task, step)
        step.enqueue(self.record.id, MessageKind.CREATE, task_id, entity)

    def _cancel_left(self, open_tokens: set[str], step: Step, now: datetime) -> None:
        for task in list(self.tasks.values()):
            if task.cancelled_at is None and task.token not in open_tokens:
                self._record_task(task.changed(cancelled_at=now), step)
                step.enqueue(self.record.id, MessageKind.APPEND, task.id, cancel_request(now))

    def _close_cancelled(self, task: TaskRecord, step: Step, now: datetime) -> None:
        """Close a cancelled Task that no performer has accepted."""
        outputs = {"reason": CANCELLED}
        closing = {
            "status": status_property(TaskStatus.FAILED, now),
            "outputParameters": outputs_property(outputs, now),
        }
        step.enqueue(self.record.id, MessageKind.APPEND, task.id, closing)
        self._apply(task, _StatusChange(TaskStatus.FAILED, now, outputs), step, now)

    def _fail(self, reason: str, step: Step, now: datetime) -> None:
        self._end(TaskStatus.FAILED, reason, step, now)
        process_alerts.raise_failed(step, self.record, self.urn)

    def _end(self, status: TaskStatus, reason: str | None, step: Step, now: datetime) -> None:
        step.ended.add(self.record.id)
        variables = self.run.variables() if self.run is not None else self.record.variables
        self.run = None
        self._revise(status=status, reason=reason, ended_at=now, variables=variables)

    def _report_process(self, step: Step, now: datetime) -> None:
        """Write the state of the process to the broker."""
        self.reported = (self.record.status, len(self.composed))
        entity = entity_of(self.settings, self.record, self.composed, now)
        step.enqueue(self.record.id, MessageKind.UPSERT, self.urn, [entity])

    def _record_task(self, task: TaskRecord, step: Step) -> None:
        step.tasks[task.id] = task
        self._track(task)

    def _track(self, task: TaskRecord) -> None:
        if not task.finished:
            self.tasks[task.id] = task
            return
        self.tasks.pop(task.id, None)
        unhandled = self.plan.definition.activities[task.element].unhandled(task.outputs or {})
        if task.cancelled_at is not None and task.status is TaskStatus.COMPLETED and unhandled is None:
            self.completed_after_cancel[task.token] = task

    def _record_act(self, act: Act) -> None:
        self._revise(acts=(*self.record.acts, act))

    def _revise(self, **changes: Any) -> None:
        self.record = replace(self.record, **changes)
