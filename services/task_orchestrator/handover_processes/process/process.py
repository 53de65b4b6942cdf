"""Process: one run of a definition, from its start to its end, and its Tasks.

Received changes, due timers and requests of people change a process; the consequences are collected in a
`Step`. The functions here are pure: they wait for nothing, perform no I/O and get the time as an argument. An
ended Task never reopens: a retry posts a new one. What cannot continue is an incident of its token; the rest
of the process continues.
"""

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from handover.errors import Problem
from handover.messages import Message as MessageText
from handover.messages import message, message_in, text_of
from handover.tasks.outcomes import OUTCOME_UNKNOWN_CODE, is_outcome_unknown
from handover.tasks.task_life import FINISHED
from handover_bpmn.execution.graph import Plan
from handover_bpmn.execution.run import Run
from handover_bpmn.execution.state import Library, RunFailed
from handover_bpmn.languages.base import ExpressionError
from handover_datamodels.entities import RequestedStatus, Task, TaskStatus
from handover_processes.allocation.allocator import Allocator
from handover_processes.process import alerts, attempts, posting, state_report
from handover_processes.process.process_state import ProcessState
from handover_processes.process.tally import count_change, count_end, count_start, count_task
from handover_processes.records.entities import (
    execution_properties,
    outputs_property,
    status_property,
    status_request,
)
from handover_processes.records.messages import MessageKind
from handover_processes.records.processes import ProcessRecord
from handover_processes.records.step import Step
from handover_processes.records.tasks import Move, TaskRecord
from handover_processes.records.timers import TimerKind
from handover_processes.settings import OrchestratorSettings
from handover_processes.timing.escalations import due_in, escalation_times, with_groups

CANCELLED = "cancelled"
MAX_TITLE = 200
NO_REASON = message("task.no_reason", "no reason given")


@dataclass(frozen=True, slots=True)
class TaskChange:
    """The new status of a Task."""

    status: TaskStatus
    observed_at: datetime | None
    outputs: Mapping[str, Any]
    repeats: bool = False
    """Whether the activity of a failed Task is tried again whatever its outcome."""

    @property
    def final(self) -> bool:
        """Return whether the Task has ended with it."""
        return self.status in FINISHED


@dataclass(slots=True)
class Process(ProcessState):
    """A process in memory, and what changes it."""

    @classmethod
    def start(
        cls,
        settings: OrchestratorSettings,
        plan: Plan,
        record: ProcessRecord,
        step: Step,
        now: datetime,
        *,
        library: Library,
        allocator: Allocator | None = None,
        at: str | None = None,
        results: Mapping[str, Any] | None = None,
    ) -> "Process":
        """Start a process with the parameters of `record`, and post its first Tasks.

        It starts at the event `at`, which brings the variables `results`, or at the none start event. Raises
        `Problem` 422 if it cannot be started so.
        """
        try:
            run = Run.start(
                plan,
                record.parameters,
                now,
                library,
                at=at,
                results=results,
                identity=execution_properties(settings, record, plan.definition),
            )
        except RunFailed as failure:
            raise Problem(422, "Process cannot start", text_of(failure)) from failure
        process = cls(settings, record, plan, run, library, allocator or Allocator(settings))
        step.new.add(record.id)
        step.touched.add(record.id)
        count_start(step, record)
        state_report.report_state(process, step, now)
        process.update(step, now)
        return process

    @classmethod
    def resume(
        cls,
        settings: OrchestratorSettings,
        plan: Plan,
        record: ProcessRecord,
        tasks: Iterable[TaskRecord],
        library: Library,
        *,
        allocator: Allocator | None = None,
        all_tasks: Sequence[str] | None = None,
    ) -> "Process":
        """Return a stored process; raise `RunFailed` if this release cannot continue it.

        `tasks` are all its Tasks or, with the ids of `all_tasks`, at least those that have not ended.
        """
        running = record.state if record.ended_at is None else None
        identity = execution_properties(settings, record, plan.definition)
        run = Run.resume(plan, running, library, identity=identity) if running is not None else None
        process = cls(settings, record, plan, run, library, allocator or Allocator(settings))
        for task in tasks:
            if all_tasks is None:
                process.composed.append(task.id)
            process.open_tasks.track(task)
        process.composed += all_tasks or ()
        process.reported = (record.status, len(process.composed))
        process.reservations.resume(run)
        if record.status is TaskStatus.PAUSED:
            process.reservations.pause()
        elif run is not None:
            posting.resume_waiting(process, run)
        return process

    def release(self) -> None:
        """Remove its Tasks and waiting activities from the allocator: it leaves the memory."""
        self.open_tasks.release()
        for waiting in self.record.unallocated:
            self.allocator.remove_waiting(self.record.id, waiting.token)
        self.reservations.leave()

    def allocate(self, step: Step, now: datetime) -> None:
        """Try again to find performers for the activities that wait for one."""
        run = self.run
        if run is None or self.record.status is TaskStatus.PAUSED:
            return
        if self.reservations.can_begin(run, now) or any(
            posting.can_continue(self, run, waiting, now) for waiting in self.record.unallocated
        ):
            step.touched.add(self.record.id)
            self.update(step, now)

    def receive(self, seen: Task, step: Step, now: datetime) -> bool:
        """Apply the Task as `seen`; return whether its status was new."""
        if not self.is_news(seen):
            return False
        step.touched.add(self.record.id)
        reported = seen.output_parameters
        outputs = dict(reported.value) if reported is not None and isinstance(reported.value, Mapping) else {}
        change = TaskChange(seen.status.value, seen.status.observed_at, outputs)
        self.apply(self.tasks[seen.id], change, step, now)
        return True

    def report(
        self,
        task_id: str,
        statuses: Iterable[TaskStatus],
        outputs: Mapping[str, Any],
        step: Step,
        now: datetime,
        **changes: Any,
    ) -> None:
        """Write what a person has done with a Task to the records and to the broker.

        `statuses` are the statuses that it goes through, `changes` those of its record.
        """
        step.touched.add(self.record.id)
        self.record_task(self.tasks[task_id].changed(**changes), step)
        statuses = list(statuses)
        for status in statuses or [self.tasks[task_id].status]:
            attributes = {
                "status": status_property(status, now),
                "outputParameters": outputs_property(outputs, now),
            }
            step.enqueue(self.tasks[task_id].stream, MessageKind.APPEND, task_id, attributes)
        for status in statuses:
            self.apply(self.tasks[task_id], TaskChange(status, now, outputs), step, now)

    def tick(self, step: Step, now: datetime) -> None:
        """Process the timers that are due at `now`."""
        step.touched.add(self.record.id)
        due = self.due_timers(now)
        for timer in due:
            task = self.tasks.get(timer.subject)
            if timer.kind is TimerKind.DEADLINE and task is not None:
                self.record_task(task.changed(alerted=True), step)
                alerts.raise_overdue(step, task)
            elif timer.kind is TimerKind.GRACE and task is not None:
                self._close_cancelled(task, step, now)
            elif timer.kind is TimerKind.ESCALATION and task is not None:
                self._escalate(task, step, now)
            elif timer.kind is TimerKind.RETRY and self.run is not None:
                self.record = attempts.repeat(self.record, self.run, timer.subject, now)
        if any(timer.kind is TimerKind.EVENT for timer in due) and self.run is not None:
            self.run.advance(now)
        if due:
            self.update(step, now)

    def deliver(self, wait: int, variables: Mapping[str, Any], step: Step, now: datetime) -> None:
        """Let a message or signal occur that the process waits for."""
        if self.run is not None:
            step.touched.add(self.record.id)
            self.run.deliver(wait, variables, now)
            self.update(step, now)

    def judge(
        self, wait: int, entity: str, variables: Mapping[str, Any] | None, step: Step, now: datetime
    ) -> bool:
        """Evaluate a condition that the process waits for, for an entity; None: it is no longer selected.

        Returns whether the process has changed.
        """
        if self.run is None or not self.run.judge(wait, entity, variables, now):
            return False
        step.touched.add(self.record.id)
        self.update(step, now)
        return True

    def apply(self, task: TaskRecord, change: TaskChange, step: Step, now: datetime) -> None:
        """Apply the new status of a Task, with its consequences."""
        task = count_change(step, self.record, task, change.outputs, now)
        moves = task.moves + 1
        observed = [moment for moment in (task.observed_at, change.observed_at) if moment is not None]
        step.moves.append(Move(task.id, moves, change.status, change.observed_at, now))
        if task.alerted and task.status is TaskStatus.PENDING:
            alerts.clear_overdue(step, task)
        elif task.alerted:
            alerts.clear_performer_lost(step, task)
        if task.unreadable is not None:
            alerts.clear_unreadable(step, task)
        if change.final:
            alerts.clear_past_due(step, task)
            if task.specification == task.id:
                step.enqueue(task.stream, MessageKind.SPECIFY, task.id, {"row": {"id": task.id}})
        changed = task.changed(
            status=change.status,
            observed_at=max(observed, default=None),  # the clocks of performers differ
            moves=moves,
            alerted=False,
            unreadable=None,
            lost=0,
            ended_at=now if change.final else None,
            outputs=change.outputs if change.final else None,
        )
        count_task(step, self.record, changed)
        self.record_task(changed, step)
        if change.final and self.run is not None and self.is_current(self.run, task):
            self._continue_run(self.run, task, change, now)
        self.update(step, now)
        if change.status is TaskStatus.FAILED and all(
            incident.task != task.id for incident in self.record.incidents
        ):
            alerts.clear_unshown(step, self.record, task.id)

    def _continue_run(self, run: Run, task: TaskRecord, change: TaskChange, now: datetime) -> None:
        activity = run.activity(task.token)
        is_declined = change.status is TaskStatus.FAILED and change.outputs.get("declined") is True
        if is_declined and (task.chosen or attempts.offers_others(task)):
            self.record = attempts.ask_next(self.record, run, task, now)
            return
        self.record = attempts.forget_declined(self.record, task.token, task.element)
        # Even if the performer reports "completed", an outcome that is not handled must not start a robot.
        unhandled = activity.unhandled(change.outputs)
        if change.status is TaskStatus.COMPLETED and unhandled is None:
            run.complete(task.token, activity.results(change.outputs), now)
            return
        reason = message_in(change.outputs, "reason") or unhandled or NO_REASON
        if "\0" in reason or not isinstance(reason, MessageText):
            reason = str(reason).replace("\0", "") or NO_REASON  # PostgreSQL does not accept it
        error_code = change.outputs.get("errorCode", change.outputs.get("outcome") if unhandled else None)
        is_unknown = is_outcome_unknown(change.outputs)
        if error_code is None and is_unknown:
            error_code = OUTCOME_UNKNOWN_CODE
        code = None if error_code is None else str(error_code)
        failure = attempts.Failure(code, reason, change.outputs)
        if change.repeats:
            postponed = attempts.repeat_lost(self.record, run, task, reason, now)
        else:
            postponed = attempts.postpone(self.record, run, task, failure, now)
        if postponed is None:
            run.fail(task.token, code, reason, now, task=task.id, only_named=is_unknown)
        else:
            self.record = postponed

    def update(self, step: Step, now: datetime) -> None:
        """Post Tasks for open activities, cancel Tasks of left ones, and record the state of the process."""
        run = self.run
        state = None
        if run is not None:
            self._set_title(run)
            self._cancel_left(run, step, now)
            posting.post_open(self, run, step, now)
            state = run.snapshot()
            step.effects += [(self.record.id, effect) for effect in run.effects]
            run.effects = []
            if run.failure is not None:
                self._fail(run.failure, step, now)
            elif run.completed:
                self.end(TaskStatus.COMPLETED, None, step, now)
        run = self.run
        if run is None:
            self.reservations.update(None, (), now, reserves=False)
            if self.record.unallocated:
                posting.record_waiting(self, [])
        self._cancel_left(run, step, now)
        if self.record.retries:
            self.revise(retries=attempts.present_retries(self.record, run))
        state_report.update_incidents(self, step)
        is_counted = self.record.id in step.processes or self.record.id in step.new
        self.revise(
            revision=self.record.revision + (0 if is_counted else 1),
            variables=run.variables() if run is not None else self.record.variables,
            waiting=run.waiting() if run is not None else (),
            reservations=self.reservations.records,
            state=state if run is not None else None,
        )
        step.processes[self.record.id] = self.record
        step.to_index[self.record.id] = None
        if state_report.is_report_due(self):
            state_report.report_state(self, step, now)

    def _set_title(self, run: Run) -> None:
        """Set the title that the definition gives, once its variables are there; then it stays."""
        naming = self.plan.definition.naming
        if naming is None or self.record.title is not None:
            return
        with suppress(ExpressionError):
            value = naming.value(run.visible_variables())
            title = "" if value is None else " ".join(str(value).replace("\0", "").split())
            self.revise(title=title[:MAX_TITLE] or None)

    def _escalate(self, task: TaskRecord, step: Step, now: datetime) -> None:
        """Handle that a Task has not ended when a level of its escalation is due."""
        run = self.run
        if run is None or not self.is_current(run, task):
            self.record_task(task.changed(escalates_at=None), step)
            return
        level = task.escalated
        levels = escalation_times(run.activity(task.token), due_in(task.entity), task.created_at)
        escalation = levels[level][1] if level < len(levels) else None
        following = levels[level + 1][0] if level + 1 < len(levels) else None
        if level < len(levels):
            alerts.raise_past_due(step, task, level, escalation)
        self.record_task(task.changed(escalates_at=following, escalated=level + 1), step)
        if escalation is not None and escalation.group is not None:
            groups = [
                escalated.group
                for _, escalated in levels[: level + 1]
                if escalated is not None and escalated.group
            ]
            parameters = with_groups(task.entity, groups)
            if parameters is not None:
                present = self.tasks[task.id]
                self.record_task(present.changed(entity={**present.entity, **parameters}), step)
                step.enqueue(task.stream, MessageKind.APPEND, task.id, parameters)
        if escalation is not None and escalation.code is not None:
            details = {"activity": task.element, "code": escalation.code, "task": task.id}
            run.escalate(task.token, escalation.code, details, now)

    def _cancel_left(self, run: Run | None, step: Step, now: datetime) -> None:
        """Cancel the Tasks of activities that were left, all of them at the end of the process."""
        for task in list(self.tasks.values()) if run is None else self.open_tasks.compare(run):
            self._cancel_task(task, step, now)

    def _cancel_task(self, task: TaskRecord, step: Step, now: datetime) -> None:
        if task.cancelled_at is None:
            self.record_task(task.changed(cancelled_at=now), step)
            request = status_request(RequestedStatus.CANCELLED, now)
            step.enqueue(task.stream, MessageKind.APPEND, task.id, request)

    def _close_cancelled(self, task: TaskRecord, step: Step, now: datetime) -> None:
        """Close a cancelled Task that no performer has accepted."""
        outputs = {"reason": CANCELLED}
        closing = {
            "status": status_property(TaskStatus.FAILED, now),
            "outputParameters": outputs_property(outputs, now),
        }
        step.enqueue(task.stream, MessageKind.APPEND, task.id, closing)
        self.apply(task, TaskChange(TaskStatus.FAILED, now, outputs), step, now)

    def _fail(self, reason: str, step: Step, now: datetime) -> None:
        self.end(TaskStatus.FAILED, reason, step, now)
        alerts.raise_failed(step, self.record, self.urn)

    def end(self, status: TaskStatus, reason: str | None, step: Step, now: datetime) -> None:
        """End the process with the variables that it has; `update` writes it."""
        step.ended.add(self.record.id)
        variables = self.run.variables() if self.run is not None else self.record.variables
        self.run = None
        self.revise(status=status, reason=reason, ended_at=now, variables=variables)
        count_end(step, self.record)
