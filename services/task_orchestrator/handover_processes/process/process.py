"""Process: one run of a definition, from its start to its end, and its Tasks.

Received changes, due timers and requests of people change a process; the consequences are collected in a
`Step`. The functions here are pure: they wait for nothing, perform no I/O and get the time as an argument. An
ended Task never reopens: a retry posts a new one. What cannot continue is an incident of its token; the rest
of the process continues.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import Any

from handover.errors import Problem
from handover.messages import Message as MessageText
from handover.messages import message, message_in, text_of, with_code
from handover.tasks.outcomes import OUTCOME_UNKNOWN_CODE, is_outcome_unknown, outcome_unknown
from handover.tasks.task_life import FINISHED, STARTED, is_reachable
from handover_bpmn.execution.graph import Plan
from handover_bpmn.execution.queries import OpenActivity, OpenIncident
from handover_bpmn.execution.run import Run
from handover_bpmn.execution.span_places import SpanPlace
from handover_bpmn.execution.state import Library, RunFailed
from handover_bpmn.languages.base import ExpressionError
from handover_bpmn.model import PerformerLost
from handover_datamodels.entities import RequestedStatus, Task, TaskStatus
from handover_processes.allocation.allocator import Allocator, NoPerformer
from handover_processes.allocation.assignment import PerformerAssignment
from handover_processes.process import alerts, attempts
from handover_processes.process.open_tasks import OpenTasks
from handover_processes.process.span_reservations import SpanReservations
from handover_processes.process.tally import count_change, count_end, count_start, count_task
from handover_processes.process.task_creation import create_task, task_id_of, with_form_version
from handover_processes.records.entities import (
    MAX_LISTED_TASKS,
    definition_id,
    entity_of,
    execution_properties,
    outputs_property,
    status_property,
    status_request,
)
from handover_processes.records.messages import MessageKind
from handover_processes.records.processes import (
    Act,
    IncidentRecord,
    ProcessRecord,
    ReservationRecord,
    ReservationState,
    Unallocated,
)
from handover_processes.records.step import Step
from handover_processes.records.tasks import Move, TaskRecord
from handover_processes.records.timers import Timer, TimerKind
from handover_processes.settings import OrchestratorSettings
from handover_processes.timing.escalations import due_in, escalation_times, with_groups

CANCELLED = "cancelled"
MAX_TITLE = 200
REPORTED_TASKS = 10
"""Beyond `MAX_LISTED_TASKS` the Process entity is written with every so many new Tasks."""
REFUSALS = frozenset({"task.definition_refused", "task.specification_refused"})
"""Codes of reasons that say themselves what was refused."""
NO_REASON = message("task.no_reason", "no reason given")


@dataclass(frozen=True, slots=True)
class _StatusChange:
    """The new status of a Task."""

    status: TaskStatus
    observed_at: datetime | None
    outputs: Mapping[str, Any]
    repeats: bool = False
    """Whether the activity of a failed Task is tried again whatever its outcome."""

    @property
    def final(self) -> bool:
        return self.status in FINISHED


@dataclass(slots=True)
class Process:
    """A process in memory; `run` is None after its end.

    `composed` are the ids of all its Tasks.
    """

    settings: OrchestratorSettings
    record: ProcessRecord
    plan: Plan
    run: Run | None
    library: Library
    allocator: Allocator
    composed: list[str] = field(default_factory=list)
    open_tasks: OpenTasks = field(init=False)
    reservations: SpanReservations = field(init=False)
    reported: tuple[TaskStatus, int] | None = None
    """The status and the number of Tasks that were last written to the broker."""

    def __post_init__(self) -> None:
        self.open_tasks = OpenTasks(self.settings, self.allocator)
        self.reservations = SpanReservations(self.record.id, self.allocator, self.record.reservations)

    @property
    def tasks(self) -> dict[str, TaskRecord]:
        """Return the Tasks that have not ended, by id."""
        return self.open_tasks.records

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
        process._report_process(step, now)
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
            process.resume_waiting(run)
        return process

    @property
    def urn(self) -> str:
        """Return the id of its Process entity."""
        return self.settings.entity_id("Process", self.record.id)

    @property
    def over(self) -> bool:
        """Return whether it and all its Tasks have ended."""
        return self.run is None and not self.tasks

    def resume_waiting(self, run: Run) -> None:
        """Let the activities that wait for a performer wait again."""
        for known in self.record.unallocated:
            places = run.places(known.token)
            if run.visit(known.token) != known.visit or self.reservations.obstacle(places) is not None:
                continue
            open_ = run.open_activity(known.token, known.since)
            with suppress(ExpressionError):  # it becomes an incident when it is tried again
                assignment = self._request(open_)
                request = assignment.waiting_request
                if request is not None:
                    within = self.reservations.within(places).holders
                    self.allocator.add_waiting(self.record.id, known.token, request, known.since, within)
        self.allocator.has_changed = True

    def release(self) -> None:
        """Remove its Tasks and waiting activities from the allocator: it leaves the memory."""
        self.open_tasks.release()
        for each in self.record.unallocated:
            self.allocator.remove_waiting(self.record.id, each.token)
        self.reservations.leave()

    def allocate(self, step: Step, now: datetime) -> None:
        """Try again to find performers for the activities that wait for one."""
        run = self.run
        if run is None or self.record.status is TaskStatus.PAUSED:
            return
        if self.reservations.can_begin(run, now) or any(
            self._can_continue(run, known, now) for known in self.record.unallocated
        ):
            step.touched.add(self.record.id)
            self.update(step, now)

    def _can_continue(self, run: Run, known: Unallocated, now: datetime) -> bool:
        """Return whether there is news of an activity that waits for a performer."""
        places = run.places(known.token)
        if run.visit(known.token) != known.visit or self.reservations.obstacle(places) is not None:
            return False
        try:
            found = self._choose(run.open_activity(known.token, known.since), places, known.since, now)
        except ExpressionError:
            return True
        if not isinstance(found, NoPerformer) or found.is_final:
            return True
        # The holder of a named resource changes often; `reservations` show it.
        return found.request.resource is None and found.reason != known.reason

    def timers(self) -> tuple[Timer, ...]:
        """Return the timers, the earliest first."""
        return tuple(sorted(self._timers(), key=lambda timer: timer.due))

    def _timers(self) -> Iterator[Timer]:
        is_paused = self.record.status is TaskStatus.PAUSED
        if not is_paused and self.run is not None and (event := self.run.next_due()) is not None:
            yield Timer(TimerKind.EVENT, "", event)
        for task in self.tasks.values():
            if not is_paused or task.cancelled_at is not None:
                yield from self.open_tasks.timers_of(task)
        for retry in self.record.retries:
            if retry.due is not None and not is_paused:
                yield Timer(TimerKind.RETRY, retry.token, retry.due)

    def next_due(self) -> datetime | None:
        """Return when the first of the timers is due."""
        if self.record.status is TaskStatus.PAUSED:
            return min((timer.due for timer in self._timers()), default=None)
        moments = [self.open_tasks.next_due(), *(retry.due for retry in self.record.retries)]
        if self.run is not None:
            moments.append(self.run.next_due())
        return min((moment for moment in moments if moment is not None), default=None)

    def is_news(self, seen: Task) -> bool:
        """Return whether the Task as `seen` has a new status that can follow the known one."""
        task = self.tasks.get(seen.id)
        if task is None or seen.status.value is task.status:
            return False
        return is_reachable(task.status, seen.status.value)

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
        """Handle that the Task cannot be posted: it counts as failed."""
        task = self.tasks.get(task_id)
        if task is not None:
            step.touched.add(self.record.id)
            if not isinstance(reason, MessageText) or reason.code not in REFUSALS:
                reason = message("task.refused_by_broker", "the broker rejected the Task: {why}", why=reason)
            outputs = with_code("reason", reason)
            self._apply(task, _StatusChange(TaskStatus.FAILED, now, outputs), step, now)

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
            self._apply(self.tasks[task_id], _StatusChange(status, now, outputs), step, now)

    def performer_lost(self, task_id: str, holder: str, step: Step) -> None:
        """Raise the Alert that the performer of an accepted Task has lost the lease of its Device."""
        task = self.tasks.get(task_id)
        if task is not None and not task.alerted and task.status is not TaskStatus.PENDING:
            step.touched.add(self.record.id)
            self.record_task(task.changed(alerted=True), step)
            alerts.raise_performer_lost(step, task, holder)

    def performer_found(self, task_id: str, step: Step) -> None:
        """Clear that Alert: a performer has the lease again."""
        task = self.tasks.get(task_id)
        if task is not None and task.alerted and task.status is not TaskStatus.PENDING:
            step.touched.add(self.record.id)
            self.record_task(task.changed(alerted=False), step)
            alerts.clear_performer_lost(step, task)

    def unreadable(self, task_id: str, writer: str | None, rule: str, step: Step) -> bool:
        """Raise the Alert that `writer` has broken `rule` with the Task; return False if that is known."""
        task = self.tasks.get(task_id)
        if task is None or task.unreadable == rule:
            return False
        step.touched.add(self.record.id)
        self._clear_unreadable(task, step)
        is_overdue = task.alerted and task.status is TaskStatus.PENDING
        if is_overdue:
            alerts.clear_overdue(step, task)  # somebody has written it
        self.record_task(task.changed(unreadable=rule, alerted=task.alerted and not is_overdue), step)
        alerts.raise_unreadable(step, task, writer, rule)
        return True

    def readable(self, task_id: str, step: Step) -> None:
        """Clear that Alert: the Task matches the data model again."""
        task = self.tasks.get(task_id)
        if task is not None and task.unreadable is not None:
            step.touched.add(self.record.id)
            self._clear_unreadable(task, step)
            self.record_task(task.changed(unreadable=None), step)

    @staticmethod
    def _clear_unreadable(task: TaskRecord, step: Step) -> None:
        if task.unreadable is not None:
            alerts.clear_unreadable(step, task)

    def end_lost(self, task_id: str, step: Step, now: datetime) -> None:
        """End a Task in progress that nobody performs any more, as its activity says."""
        task, run = self.tasks.get(task_id), self.run
        if task is None or task.status not in STARTED:
            return
        is_left = task.cancelled_at is not None or run is None or not self.is_current(run, task)
        choice = PerformerLost.ASK if is_left or run is None else run.activity(task.token).performer_lost
        if choice is PerformerLost.WAIT:
            return
        step.touched.add(self.record.id)
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
        self._apply(task, _StatusChange(TaskStatus.FAILED, now, outputs, repeats=is_retried), step, now)

    def form_data(self, task: TaskRecord) -> dict[str, Any]:
        """Return what a form of an open Task knows: the variables and the parameters of the Task."""
        known: dict[str, Any] = {}
        if self.run is not None and self.is_current(self.run, task):
            known |= self.run.open_activity(task.token).variables
        return {**known, **task.entity["workParameters"]["value"]}

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
            step.enqueue(task.stream, MessageKind.CREATE, task.id, task.entity)
            self._report_process(step, now)
        else:
            self.record_task(task.changed(lost=task.lost + 1), step)
            if task.lost == 0:  # the broker may have lost the process with it
                self._report_process(step, now)
            if task.lost == 1:
                alerts.raise_lost(step, task)

    def tick(self, step: Step, now: datetime) -> None:
        """Process the timers that are due at `now`."""
        step.touched.add(self.record.id)
        due = self._due_timers(now)
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

    def _due_timers(self, now: datetime) -> list[Timer]:
        if self.record.status is TaskStatus.PAUSED:
            return [timer for timer in self.timers() if timer.due <= now]
        found = self.open_tasks.due_timers(now)
        event = None if self.run is None else self.run.next_due()
        if event is not None and event <= now:
            found.append(Timer(TimerKind.EVENT, "", event))
        found += [
            Timer(TimerKind.RETRY, retry.token, retry.due)
            for retry in self.record.retries
            if retry.due is not None and retry.due <= now
        ]
        return sorted(found, key=lambda timer: timer.due)

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

    def require_running(self) -> Run:
        """Return the run; raise `Problem` 409 if the process has ended."""
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
        return self.run

    # Consequences

    def _apply(self, task: TaskRecord, change: _StatusChange, step: Step, now: datetime) -> None:
        task = count_change(step, self.record, task, change.outputs, now)
        moves = task.moves + 1
        observed = [moment for moment in (task.observed_at, change.observed_at) if moment is not None]
        step.moves.append(Move(task.id, moves, change.status, change.observed_at, now))
        if task.alerted and task.status is TaskStatus.PENDING:
            alerts.clear_overdue(step, task)
        elif task.alerted:
            alerts.clear_performer_lost(step, task)
        self._clear_unreadable(task, step)
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
        if change.status is TaskStatus.FAILED and all(each.task != task.id for each in self.record.incidents):
            alerts.clear_unshown(step, self.record, task.id)

    def is_current(self, run: Run, task: TaskRecord) -> bool:
        """Return whether the activity that the Task was made for is still open."""
        return run.visit(task.token) == task.visit

    def _continue_run(self, run: Run, task: TaskRecord, change: _StatusChange, now: datetime) -> None:
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
        given = change.outputs.get("errorCode", change.outputs.get("outcome") if unhandled else None)
        is_unknown = is_outcome_unknown(change.outputs)
        if given is None and is_unknown:
            given = OUTCOME_UNKNOWN_CODE
        code = None if given is None else str(given)
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
            self._post_open(run, step, now)
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
                self._record_waiting([])
        self._cancel_left(run, step, now)
        if self.record.retries:
            self.revise(retries=attempts.present_retries(self.record, run))
        self._update_incidents(step)
        known = self.record.id in step.processes or self.record.id in step.new
        self.revise(
            revision=self.record.revision + (0 if known else 1),
            variables=run.variables() if run is not None else self.record.variables,
            waiting=run.waiting() if run is not None else (),
            reservations=self.reservations.records,
            state=state if run is not None else None,
        )
        step.processes[self.record.id] = self.record
        step.to_index[self.record.id] = None
        if self._is_report_due():
            self._report_process(step, now)

    def _set_title(self, run: Run) -> None:
        """Set the title that the definition gives, once its variables are there; then it stays."""
        naming = self.plan.definition.naming
        if naming is None or self.record.title is not None:
            return
        with suppress(ExpressionError):
            value = naming.value(run.visible_variables())
            title = "" if value is None else " ".join(str(value).replace("\0", "").split())
            self.revise(title=title[:MAX_TITLE] or None)

    def _update_incidents(self, step: Step) -> None:
        """Record the incidents; raise the Alerts of new ones and clear those of others."""
        known = {incident.token: incident for incident in self.record.incidents}
        present = {}
        for each in self.run.incidents() if self.run is not None else ():
            before = known.get(each.token)
            is_same = before is not None and (before.since, before.element) == (each.since, each.element)
            present[each.token] = before if before is not None and is_same else self._incident(each)
        for token, incident in known.items():
            if present.get(token) is not incident:
                alerts.clear_incident(step, self.record, self.urn, incident)
        for token, incident in present.items():
            if known.get(token) is not incident:
                alerts.raise_incident(step, self.record, self.urn, incident)
        self.revise(incidents=tuple(present.values()))

    def _incident(self, found: OpenIncident) -> IncidentRecord:
        failed = found.details.get("task")
        if not failed and found.visit:
            failed = task_id_of(self.settings, self.record.id, found.element, found.visit)
        code = found.details.get("code")
        return IncidentRecord(
            token=found.token,
            element=found.element,
            name=found.name,
            reason=found.reason,
            since=found.since,
            task=failed if failed in self.composed else None,
            code=None if code is None else str(code),
        )

    def _post_open(self, run: Run, step: Step, now: datetime) -> None:
        self._cancel_left(run, step, now)
        postponed = {(retry.token, retry.visit) for retry in self.record.retries if retry.due is not None}
        is_paused = self.record.status is TaskStatus.PAUSED
        unposted = [token for token, visit in self.open_tasks.unposted if (token, visit) not in postponed]
        self.reservations.update(run, unposted, now, reserves=not is_paused)
        if is_paused:
            self.reservations.pause()
            for waits in self.record.unallocated:
                self.allocator.remove_waiting(self.record.id, waits.token)
            return
        since = {(each.token, each.visit): each.since for each in self.record.unallocated}
        waiting: list[Unallocated] = []
        for token, visit in list(self.open_tasks.unposted):
            if (token, visit) in postponed or run.visit(token) != visit:
                continue
            try:
                began = since.get((token, visit), now)
                each = run.open_activity(token, began)
                places = run.places(token)
                obstacle = self.reservations.obstacle(places)
                if obstacle is not None:
                    waiting.append(self._wait_for(each, obstacle, began))
                    continue
                found = self._choose(each, places, began, now)
                if isinstance(found, NoPerformer):
                    waiting.append(self._wait(each, places, found, began))
                else:
                    self._post(each, found, step, now)
            except (ExpressionError, ValueError) as error:
                run.refuse(token, text_of(error), now)
        if waiting or since:
            self._record_waiting(waiting)

    def _choose(
        self, open_: OpenActivity, places: Sequence[SpanPlace], since: datetime, now: datetime
    ) -> PerformerAssignment | NoPerformer:
        assignment = self._request(open_)
        key = self.record.id, open_.token
        return self.allocator.choose(assignment, key, since, now, self.reservations.within(places))

    def _request(self, open_: OpenActivity) -> PerformerAssignment:
        declined = attempts.declined_by(self.record, open_)
        return self.allocator.rules.request(open_.activity, open_.variables, declined)

    def _wait(
        self, open_: OpenActivity, places: Sequence[SpanPlace], found: NoPerformer, since: datetime
    ) -> Unallocated:
        """Let an activity wait; raise `ValueError` if that would be useless."""
        if found.is_final:
            raise ValueError(found.reason)
        within = self.reservations.within(places).holders
        self.allocator.add_waiting(self.record.id, open_.token, found.request, since, within)
        return Unallocated(open_.token, open_.visit, open_.element, open_.activity.name, found.reason, since)

    def _wait_for(self, open_: OpenActivity, reservation: ReservationRecord, since: datetime) -> Unallocated:
        """Let an activity wait for a reservation; raise `ValueError` if that is impossible."""
        if reservation.state is ReservationState.IMPOSSIBLE:
            raise ValueError(reservation.reason)
        self.allocator.remove_waiting(self.record.id, open_.token)
        reason = reservation.reason
        return Unallocated(open_.token, open_.visit, open_.element, open_.activity.name, reason, since)

    def _record_waiting(self, waiting: Sequence[Unallocated]) -> None:
        """Record the activities that wait for a performer."""
        tokens = {each.token for each in waiting}
        for each in self.record.unallocated:
            if each.token not in tokens:
                self.allocator.remove_waiting(self.record.id, each.token)
        self.revise(unallocated=tuple(waiting))

    def _post(self, open_: OpenActivity, assignment: PerformerAssignment, step: Step, now: datetime) -> None:
        activity = with_form_version(
            assignment.activity, self.record, self.allocator.forms, self.library, now
        )
        task, row = create_task(self.settings, self.record, open_, assignment, activity=activity, now=now)
        step.new.add(task.id)
        self.composed.append(task.id)
        self.record_task(task, step)
        if row is None:
            step.enqueue(task.stream, MessageKind.CREATE, task.id, task.entity)
        else:
            step.enqueue(task.stream, MessageKind.SPECIFY, task.id, {"row": row, "task": task.entity})

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
            groups = [each.group for _, each in levels[: level + 1] if each is not None and each.group]
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
        self._apply(task, _StatusChange(TaskStatus.FAILED, now, outputs), step, now)

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

    def _is_report_due(self) -> bool:
        """Return whether the Process entity has to be written: at each state, and when it has more Tasks.

        The entity lists the last Tasks, and new ones of a long process are reported in groups, so that a step
        costs the same however long the process has run.
        """
        if self.reported is None or self.reported[0] is not self.record.status:
            return True
        listed = self.reported[1]
        new = len(self.composed) - listed
        return new >= (1 if listed < MAX_LISTED_TASKS else REPORTED_TASKS)

    def _report_process(self, step: Step, now: datetime) -> None:
        """Write the state of the process to the broker."""
        self.reported = (self.record.status, len(self.composed))
        defined_by = definition_id(self.settings, self.plan.definition)
        entity = entity_of(self.settings, self.record, defined_by, self.composed, now)
        step.enqueue(self.record.id, MessageKind.UPSERT, self.urn, [entity])

    def record_task(self, task: TaskRecord, step: Step) -> None:
        """Record a new or changed Task."""
        step.tasks[task.id] = task
        self.open_tasks.track(task)

    def record_act(self, act: Act, step: Step) -> None:
        """Add an act to the history, with whether its name is that of who is signed in."""
        self.revise(acts=(*self.record.acts, replace(act, verified=step.is_verified(act.by))))

    def revise(self, **changes: Any) -> None:
        """Change fields of the record."""
        self.record = replace(self.record, **changes)
