"""Process: one run of a definition, from its start to its end, and its Tasks.

Received changes, due timers and requests of people change a process; the consequences are collected in a
`Step`. The functions here are pure: they wait for nothing, perform no I/O and get the time as an argument. An
ended Task never reopens: a retry posts a new one. What cannot continue is an incident of its token; the rest
of the process continues.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from typing import Any

from datamodels.entities import RequestedStatus, Task, TaskStatus
from handover.errors import Problem
from handover.messages import Message as MessageText
from handover.messages import message, message_in, text_of, with_code
from handover.task_life import FINISHED, is_reachable
from services.task_orchestrator import process_alerts
from services.task_orchestrator.allocation.allocator import Allocator, Assignment, NoPerformer
from services.task_orchestrator.due_queue import DueQueue
from services.task_orchestrator.entities import (
    definition_id,
    outputs_property,
    process_entity,
    status_property,
    status_request,
    task_entity,
)
from services.task_orchestrator.escalations import due_in, escalation_times, with_groups
from services.task_orchestrator.execution.graph import Plan
from services.task_orchestrator.execution.migration import Finding
from services.task_orchestrator.execution.run import OpenActivity, OpenIncident, Run, SpanPlace
from services.task_orchestrator.execution.state import Library, RunFailed
from services.task_orchestrator.languages.base import ExpressionError
from services.task_orchestrator.model import Activity, FormBinding, Value
from services.task_orchestrator.notation.names import in_urn
from services.task_orchestrator.process_tally import count_change, count_end, count_start, count_task
from services.task_orchestrator.records import (
    Act,
    ActKind,
    IncidentRecord,
    MessageKind,
    Move,
    ProcessRecord,
    ReservationRecord,
    ReservationState,
    Retry,
    Step,
    TaskRecord,
    Timer,
    TimerKind,
    Unallocated,
)
from services.task_orchestrator.retries import attempts_of, is_retried, retry_at
from services.task_orchestrator.settings import OrchestratorSettings
from services.task_orchestrator.span_reservations import SpanReservations

CANCELLED = "cancelled"
EXACT_TASKS = 200
"""The Process entity lists every Task at once up to this number of Tasks."""
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


@dataclass(frozen=True, slots=True)
class _Failure:
    """Why a Task has failed: the error code or outcome, if any, and what its performer reported."""

    code: str | None
    reason: str
    outputs: Mapping[str, Any]


def entity_of(
    settings: OrchestratorSettings,
    record: ProcessRecord,
    defined_by: str,
    composed: Iterable[str],
    now: datetime,
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
        defined_by,
        status=record.status,
        at=record.ended_at or now,
        parameters=record.parameters,
        tasks=composed,
        outputs=outputs,
    )


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


@dataclass
class Process:
    """A process in memory; `run` is None after its end.

    `tasks` are the Tasks that have not ended, `composed` the ids of all its Tasks.
    """

    settings: OrchestratorSettings
    record: ProcessRecord
    plan: Plan
    run: Run | None
    library: Library
    allocator: Allocator
    tasks: dict[str, TaskRecord] = field(default_factory=dict)
    composed: list[str] = field(default_factory=list)
    reservations: SpanReservations = field(init=False)
    reported: tuple[TaskStatus, int] | None = None
    """The status and the number of Tasks that were last written to the broker."""
    _by_visit: dict[tuple[str, int], str] = field(default_factory=dict)
    """The Task that has not ended of each token and visit."""
    _unposted: dict[tuple[str, int], None] = field(default_factory=dict)
    """The open activities without a Task, as token and visit."""
    _compared: Run | None = None
    """The run of which `_unposted` is known; a run that takes its place is compared as a whole."""
    _task_dues: DueQueue[str] = field(default_factory=DueQueue)

    def __post_init__(self) -> None:
        self.reservations = SpanReservations(self.record.id, self.allocator, self.record.reservations)

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
                identity=_identity(settings, record, plan),
            )
        except RunFailed as failure:
            raise Problem(422, "Process cannot start", text_of(failure)) from failure
        process = cls(settings, record, plan, run, library, allocator or Allocator(settings))
        step.new.add(record.id)
        step.touched.add(record.id)
        count_start(step, record)
        process._report_process(step, now)
        process._update(step, now)
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
        identity = _identity(settings, record, plan)
        run = Run.resume(plan, running, library, identity=identity) if running is not None else None
        process = cls(settings, record, plan, run, library, allocator or Allocator(settings))
        for task in tasks:
            if all_tasks is None:
                process.composed.append(task.id)
            process._track(task)
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
                assignment = self.allocator.request(open_.activity, open_.variables, self._declined_by(open_))
                request = assignment.waiting_request
                if request is not None:
                    within = self.reservations.within(places).holders
                    self.allocator.add_waiting(self.record.id, known.token, request, known.since, within)
        self.allocator.has_changed = True

    def release(self) -> None:
        """Remove its Tasks and waiting activities from the allocator: it leaves the memory."""
        for task_id in self.tasks:
            self.allocator.remove_task(task_id)
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
            self._update(step, now)

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
                yield from self._timers_of(task)
        for retry in self.record.retries:
            if retry.due is not None and not is_paused:
                yield Timer(TimerKind.RETRY, retry.token, retry.due)

    def next_due(self) -> datetime | None:
        """Return when the first of the timers is due."""
        if self.record.status is TaskStatus.PAUSED:
            return min((timer.due for timer in self._timers()), default=None)
        moments = [self._task_dues.next_due(), *(retry.due for retry in self.record.retries)]
        if self.run is not None:
            moments.append(self.run.next_due())
        return min((moment for moment in moments if moment is not None), default=None)

    def _timers_of(self, task: TaskRecord) -> Iterator[Timer]:
        if task.escalates_at is not None and task.cancelled_at is None:
            yield Timer(TimerKind.ESCALATION, task.id, task.escalates_at)
        if task.status is not TaskStatus.PENDING and not task.claims:
            return
        if task.cancelled_at is not None:
            grace = timedelta(seconds=0 if task.claims else self.settings.cancel_grace_s)
            yield Timer(TimerKind.GRACE, task.id, task.cancelled_at + grace)
        elif not task.alerted and task.status is TaskStatus.PENDING:
            yield Timer(TimerKind.DEADLINE, task.id, task.deadline)

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
        """Handle that the broker rejected the Task: it counts as failed."""
        task = self.tasks.get(task_id)
        if task is not None:
            step.touched.add(self.record.id)
            outputs = with_code(
                "reason", message("task.refused_by_broker", "the broker rejected the Task: {why}", why=reason)
            )
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
        self._record_task(self.tasks[task_id].changed(**changes), step)
        statuses = list(statuses)
        for status in statuses or [self.tasks[task_id].status]:
            attributes = {
                "status": status_property(status, now),
                "outputParameters": outputs_property(outputs, now),
            }
            step.enqueue(self.record.id, MessageKind.APPEND, task_id, attributes)
        for status in statuses:
            self._apply(self.tasks[task_id], _StatusChange(status, now, outputs), step, now)

    def form_data(self, task: TaskRecord) -> dict[str, Any]:
        """Return what a form of an open Task knows: the variables and the parameters of the Task."""
        known: dict[str, Any] = {}
        if self.run is not None and self._is_current(self.run, task):
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
            step.enqueue(self.record.id, MessageKind.CREATE, task.id, task.entity)
            self._report_process(step, now)
        else:
            self._record_task(task.changed(lost=task.lost + 1), step)
            if task.lost == 1:
                process_alerts.raise_lost(step, task)

    def tick(self, step: Step, now: datetime) -> None:
        """Process the timers that are due at `now`."""
        step.touched.add(self.record.id)
        due = self._due_timers(now)
        for timer in due:
            task = self.tasks.get(timer.subject)
            if timer.kind is TimerKind.DEADLINE and task is not None:
                self._record_task(task.changed(alerted=True), step)
                process_alerts.raise_overdue(step, task)
            elif timer.kind is TimerKind.GRACE and task is not None:
                self._close_cancelled(task, step, now)
            elif timer.kind is TimerKind.ESCALATION and task is not None:
                self._escalate(task, step, now)
            elif timer.kind is TimerKind.RETRY and self.run is not None:
                self._repeat(self.run, timer.subject, now)
        if any(timer.kind is TimerKind.EVENT for timer in due) and self.run is not None:
            self.run.advance(now)
        if due:
            self._update(step, now)

    def _due_timers(self, now: datetime) -> list[Timer]:
        if self.record.status is TaskStatus.PAUSED:
            return [timer for timer in self.timers() if timer.due <= now]
        tasks = [self.tasks[task] for task in self._task_dues.due(now)]
        found = [each for task in tasks for each in self._timers_of(task) if each.due <= now]
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
            self._update(step, now)

    def judge(
        self, wait: int, entity: str, variables: Mapping[str, Any] | None, step: Step, now: datetime
    ) -> bool:
        """Evaluate a condition that the process waits for, for an entity; None: it is no longer selected.

        Returns whether the process has changed.
        """
        if self.run is None or not self.run.judge(wait, entity, variables, now):
            return False
        step.touched.add(self.record.id)
        self._update(step, now)
        return True

    def pause(self, act: Act, step: Step, now: datetime) -> None:
        """Pause the process and request that of its Tasks; raise `Problem` 409 if it has ended.

        While it is paused no Task is posted and no timer is processed. Results and messages are accepted.
        """
        self._require_running()
        if self.record.status is not TaskStatus.PAUSED:
            self._change_pace(TaskStatus.PAUSED, RequestedStatus.PAUSED, act, step, now)

    def resume_work(self, act: Act, step: Step, now: datetime) -> None:
        """Continue a paused process, with the timers that were due meanwhile.

        Raises `Problem` 409 if it has ended.
        """
        run = self._require_running()
        if self.record.status is TaskStatus.PAUSED:
            run.advance(now)
            self._change_pace(TaskStatus.IN_PROGRESS, RequestedStatus.IN_PROGRESS, act, step, now)

    def _change_pace(
        self, status: TaskStatus, requested: RequestedStatus, act: Act, step: Step, now: datetime
    ) -> None:
        step.touched.add(self.record.id)
        self._record_act(act)
        self._revise(status=status)
        for task in self.tasks.values():
            if task.cancelled_at is None:
                request = status_request(requested, now)
                step.enqueue(self.record.id, MessageKind.APPEND, task.id, request)
        self._update(step, now)

    def _require_running(self) -> Run:
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

    def cancel(self, by: str | None, step: Step, now: datetime) -> None:
        """End the process as failed and cancel its Tasks; raise `Problem` 409 if it has ended."""
        self._require_running()
        step.touched.add(self.record.id)
        self._record_act(Act(now, ActKind.CANCEL, by))
        self._end(TaskStatus.FAILED, f"{CANCELLED} by {by}" if by else CANCELLED, step, now)
        self._update(step, now)

    def release_reservation(self, act: Act, key: str, step: Step, now: datetime) -> None:
        """Release a reservation that is held, though a token is within.

        The next activity within it reserves again. Raises `Problem` 404 if there is none, 409 if it is not
        held.
        """
        self._require_running()
        released = self.reservations.release(key, now, act.by or "")
        step.touched.add(self.record.id)
        self._record_act(replace(act, element=released.element))
        self._update(step, now)

    def incident_of(self, task_id: str) -> str:
        """Return the token of the incident that the failed Task `task_id` is the reason of.

        Raises `Problem` 404 if the Task is none of this process, 409 if it is the reason of no incident.
        """
        if task_id not in self.composed:
            raise Problem(
                404,
                "No such Task",
                message(
                    "process.no_such_task",
                    '{process} has no Task "{task_id}"',
                    process=self.record.id,
                    task_id=task_id,
                ),
            )
        for incident in self.record.incidents:
            if incident.task == task_id:
                return incident.token
        why = f"{task_id} is not a failed Task that {self.record.id} waits for"
        waited_for = [incident.task for incident in self.record.incidents if incident.task is not None]
        if waited_for:
            why += f"; retry {waited_for[0]}"
        raise Problem(409, "Cannot be retried", why)

    def mend(self, act: Act, token: str | None, step: Step, now: datetime) -> None:
        """Do what a person has decided about a token, or about the variables, and record it.

        Raises `Problem` 404 if there is no such token, 409 if the act is impossible.
        """
        run = self._require_running()
        if token is not None:
            element = run.element(token)
            if element is None:
                raise Problem(
                    404,
                    "No such token",
                    message("process.no_such_token", 'there is no token "{token}"', token=token),
                )
            act = replace(act, element=element)
        step.touched.add(self.record.id)
        if act.act is ActKind.RETRY and token is not None:
            self._forget_declined(token, act.element or "")  # all are asked again
        try:
            if act.act is ActKind.RETRY and token is not None and self._is_waiting_for_retry(token):
                run.set_variables(act.values or {}, now, token=token)
                self._repeat(run, token, now)
            else:
                _mend(run, act, token, now)
        except RunFailed as failure:
            assert self.record.state is not None  # noqa: S101 - a running process has one
            identity = _identity(self.settings, self.record, self.plan)
            self.run = Run.resume(self.plan, self.record.state, self.library, identity=identity)
            raise Problem(409, "Not possible", text_of(failure)) from failure
        self._record_act(act)
        self._update(step, now)

    def migrate(
        self, plan: Plan, act: Act, step: Step, now: datetime, *, dry: bool = False
    ) -> MigrationReport:
        """Continue in the version of `plan`, unless there is an obstacle; with `dry` only report.

        Open Tasks and due dates of timers stay. Raises `Problem` 409 if the process has ended, has that
        version, or cannot be read.
        """
        run = self._require_running()
        source, target = self.record.version, plan.version
        if source == target:
            raise Problem(
                409,
                "Has this version",
                message(
                    "process.has_version",
                    "{process} has version {version} already",
                    process=self.record.id,
                    version=source,
                ),
            )
        open_tasks = {task.token: task.id for task in self.tasks.values() if self._is_current(run, task)}
        mapping = act.mapping or {}
        try:
            identity = _identity(self.settings, self.record, plan)
            migrated = Run.resume(self.plan, run.snapshot(), self.library, identity=identity)
            findings = migrated.migrate(plan, mapping, act.values or {}, now)
        except RunFailed as failure:
            raise Problem(409, "Cannot be migrated", text_of(failure)) from failure
        report = MigrationReport(self.record.id, source, target, tuple(findings), open_tasks)
        if dry or not report.is_possible:
            return report
        step.touched.add(self.record.id)
        self.run, self.plan = migrated, plan
        self._revise(version=target)
        self._record_act(replace(act, to=str(target)))
        self._rename_elements(migrated, step)
        self._update(step, now)
        return report

    def _rename_elements(self, run: Run, step: Step) -> None:
        """Give open Tasks, incidents and declined activities the elements of the present version."""
        for task in list(self.tasks.values()):
            element = run.element(task.token) if self._is_current(run, task) else None
            if element is not None and element != task.element:
                key = _declined_key(task.token, task.element)
                if key in self.record.declined:
                    declined = dict(self.record.declined)
                    declined[_declined_key(task.token, element)] = declined.pop(key)
                    self._revise(declined=declined)
                name = run.activity(task.token).name
                self._record_task(task.changed(element=element, name=name), step)
        found = {each.token: each for each in run.incidents()}
        self._revise(
            incidents=tuple(
                replace(each, element=found[each.token].element, name=found[each.token].name)
                if each.token in found
                else each
                for each in self.record.incidents
            ),
            retries=tuple(
                replace(each, element=run.element(each.token) or "", name=run.activity(each.token).name)
                for each in self.record.retries
            ),
        )

    def _is_waiting_for_retry(self, token: str) -> bool:
        return any(each.token == token and each.due is not None for each in self.record.retries)

    # Consequences

    def _apply(self, task: TaskRecord, change: _StatusChange, step: Step, now: datetime) -> None:
        task = count_change(step, self.record, task, change.outputs, now)
        moves = task.moves + 1
        observed = [moment for moment in (task.observed_at, change.observed_at) if moment is not None]
        step.moves.append(Move(task.id, moves, change.status, change.observed_at, now))
        if task.alerted:
            process_alerts.clear_overdue(step, task)
        if change.final:
            process_alerts.clear_past_due(step, task)
        changed = task.changed(
            status=change.status,
            observed_at=max(observed, default=None),  # the clocks of performers differ
            moves=moves,
            alerted=False,
            lost=0,
            ended_at=now if change.final else None,
            outputs=change.outputs if change.final else None,
        )
        count_task(step, self.record, changed)
        self._record_task(changed, step)
        if change.final and self.run is not None and self._is_current(self.run, task):
            self._continue_run(self.run, task, change, now)
        self._update(step, now)

    def _is_current(self, run: Run, task: TaskRecord) -> bool:
        """Return whether the activity that the Task was made for is still open."""
        return run.visit(task.token) == task.visit

    def _continue_run(self, run: Run, task: TaskRecord, change: _StatusChange, now: datetime) -> None:
        activity = run.activity(task.token)
        if change.status is TaskStatus.FAILED and task.chosen and change.outputs.get("declined") is True:
            self._ask_next(run, task, now)
            return
        self._forget_declined(task.token, task.element)
        # Even if the performer reports "completed", an outcome that is not handled must not start a robot.
        unhandled = activity.unhandled(change.outputs)
        if change.status is TaskStatus.COMPLETED and unhandled is None:
            run.complete(task.token, activity.results(change.outputs), now)
            return
        reason = message_in(change.outputs, "reason") or unhandled or NO_REASON
        if "\0" in reason or not isinstance(reason, MessageText):
            reason = str(reason).replace("\0", "") or NO_REASON  # PostgreSQL does not accept it
        given = change.outputs.get("errorCode", change.outputs.get("outcome") if unhandled else None)
        code = None if given is None else str(given)
        if not self._retry_later(run, task, _Failure(code, reason, change.outputs), now):
            run.fail(task.token, code, reason, now, task=task.id)

    def _retry_later(self, run: Run, task: TaskRecord, failure: _Failure, now: datetime) -> bool:
        """Let a failed activity wait for its next attempt; return False if it has none."""
        open_ = run.open_activity(task.token)
        policy = open_.activity.retry
        is_caught = run.catches(task.token, failure.code)
        if policy is None or not is_retried(policy, failure.code, failure.outputs, is_caught=is_caught):
            return False
        before = next((each for each in self.record.retries if each.token == task.token), None)
        failed = 1 if before is None else before.failed + 1
        attempts = attempts_of(policy, open_.variables)
        if failed >= attempts:
            return False
        retry = Retry(
            token=task.token,
            visit=task.visit,
            element=open_.element,
            name=open_.activity.name,
            task=task.id,
            failed=failed,
            attempts=attempts,
            reason=failure.reason,
            due=retry_at(policy, failed, now),
        )
        self._revise(retries=(*(each for each in self.record.retries if each is not before), retry))
        return True

    def _repeat(self, run: Run, token: str, now: datetime) -> bool:
        """Begin the next attempt of an activity that waits for it; return False if it does not wait."""
        waiting = next((e for e in self.record.retries if e.token == token and e.due is not None), None)
        if waiting is None or run.visit(token) != waiting.visit:
            return False
        run.repeat(token, now)
        present = replace(waiting, visit=run.visit(token) or 0, due=None)
        self._revise(retries=tuple(present if e is waiting else e for e in self.record.retries))
        return True

    def _ask_next(self, run: Run, task: TaskRecord, now: datetime) -> None:
        """Open the activity again: its performer has declined it, so that another gets it."""
        key = _declined_key(task.token, task.element)
        declined = (*self.record.declined.get(key, ()), task.performer)
        self._revise(declined={**self.record.declined, key: declined})
        run.repeat(task.token, now)

    def _forget_declined(self, token: str, element: str) -> None:
        key = _declined_key(token, element)
        if key in self.record.declined:
            others = {each: agents for each, agents in self.record.declined.items() if each != key}
            self._revise(declined=others)

    def _declined_by(self, open_: OpenActivity) -> frozenset[str]:
        return frozenset(self.record.declined.get(_declined_key(open_.token, open_.element), ()))

    def _update(self, step: Step, now: datetime) -> None:
        """Post Tasks for open activities, cancel Tasks of left ones, and record the state of the process."""
        run = self.run
        state = None
        if run is not None:
            self._post_open(run, step, now)
            state = run.snapshot()
            step.effects += [(self.record.id, effect) for effect in run.effects]
            run.effects = []
            if run.failure is not None:
                self._fail(run.failure, step, now)
            elif run.completed:
                self._end(TaskStatus.COMPLETED, None, step, now)
        run = self.run
        if run is None:
            self.reservations.update(None, (), now, reserves=False)
            if self.record.unallocated:
                self._record_waiting([])
        self._cancel_left(run, step, now)
        if self.record.retries:
            visits = {
                each.token: None if run is None else run.visit(each.token) for each in self.record.retries
            }
            self._revise(
                retries=tuple(
                    replace(each, visit=visit)  # another agent may have been asked
                    for each in self.record.retries
                    if (visit := visits[each.token]) is not None and (each.due is None or visit == each.visit)
                )
            )
        self._update_incidents(step)
        known = self.record.id in step.processes or self.record.id in step.new
        self._revise(
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
                process_alerts.clear_incident(step, self.record, self.urn, incident)
        for token, incident in present.items():
            if known.get(token) is not incident:
                process_alerts.raise_incident(step, self.record, self.urn, incident)
        self._revise(incidents=tuple(present.values()))

    def _incident(self, found: OpenIncident) -> IncidentRecord:
        failed = found.details.get("task") or (found.visit and self._task_id(found.element, found.visit))
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
        self._compare(run, step, now)
        postponed = {(retry.token, retry.visit) for retry in self.record.retries if retry.due is not None}
        is_paused = self.record.status is TaskStatus.PAUSED
        unposted = [token for token, visit in self._unposted if (token, visit) not in postponed]
        self.reservations.update(run, unposted, now, reserves=not is_paused)
        if is_paused:
            self.reservations.pause()
            for waits in self.record.unallocated:
                self.allocator.remove_waiting(self.record.id, waits.token)
            return
        since = {(each.token, each.visit): each.since for each in self.record.unallocated}
        waiting: list[Unallocated] = []
        for token, visit in list(self._unposted):
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
    ) -> Assignment | NoPerformer:
        assignment = self.allocator.request(open_.activity, open_.variables, self._declined_by(open_))
        key = self.record.id, open_.token
        return self.allocator.choose(assignment, key, since, now, self.reservations.within(places))

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
        self._revise(unallocated=tuple(waiting))

    def _task_id(self, element: str, visit: int) -> str:
        return self.settings.entity_id("Task", f"{self.record.id}-{in_urn(element)}-{visit}")

    def _post(self, open_: OpenActivity, assignment: Assignment, step: Step, now: datetime) -> None:
        activity = assignment.activity
        task_id = self._task_id(open_.element, open_.visit)
        allowed = timedelta(seconds=self.settings.task_deadline_s)
        deadline = activity.deadline.after(now) if activity.deadline is not None else now + allowed
        activity = self._with_form(activity, now)
        entity = task_entity(
            self.settings,
            task_id,
            activity,
            open_.variables,
            data=open_.data,
            at=now,
            deadline=deadline,
            candidates=assignment.candidates,
            part_of=(self.urn, open_.element),
        )
        if assignment.kind is not None:
            assignment.kind.check(entity["workParameters"]["value"])
        moments = escalation_times(activity, assignment.due, now)
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
            name=activity.name,
            allocated=assignment.reason,
            chosen=assignment.request is not None,
            escalates_at=moments[0][0] if moments else None,
        )
        step.new.add(task_id)
        self.composed.append(task_id)
        self._record_task(task, step)
        step.enqueue(self.record.id, MessageKind.CREATE, task_id, entity)

    def _with_form(self, activity: Activity, now: datetime) -> Activity:
        """Return the activity with the version of its form, which a later deployment does not change."""
        reference, forms = activity.form, self.allocator.forms
        if reference is None:
            return activity
        name = reference.name
        if reference.is_file:
            named = forms.find_file(name)
            name = name if named is None else named.id
        version = reference.version
        if version is None:
            is_bound = reference.binding is FormBinding.DEPLOYMENT
            deployed_at = self.library.deployed_at(self.record.definition, self.record.version)
            moment = deployed_at if is_bound and deployed_at is not None else now
            found = forms.deployed_by(name, moment)
            version = None if found is None else found.version
        form = Value({"id": name, "version": version})
        return replace(activity, parameters={**activity.parameters, "form": form})

    def _escalate(self, task: TaskRecord, step: Step, now: datetime) -> None:
        """Handle that a Task has not ended when a level of its escalation is due."""
        run = self.run
        if run is None or not self._is_current(run, task):
            self._record_task(task.changed(escalates_at=None), step)
            return
        level = task.escalated
        levels = escalation_times(run.activity(task.token), due_in(task.entity), task.created_at)
        escalation = levels[level][1] if level < len(levels) else None
        following = levels[level + 1][0] if level + 1 < len(levels) else None
        if level < len(levels):
            process_alerts.raise_past_due(step, task, level, escalation)
        self._record_task(task.changed(escalates_at=following, escalated=level + 1), step)
        if escalation is not None and escalation.group is not None:
            groups = [each.group for _, each in levels[: level + 1] if each is not None and each.group]
            parameters = with_groups(task.entity, groups)
            if parameters is not None:
                step.enqueue(self.record.id, MessageKind.APPEND, task.id, parameters)
        if escalation is not None and escalation.code is not None:
            details = {"activity": task.element, "code": escalation.code, "task": task.id}
            run.escalate(task.token, escalation.code, details, now)

    def _compare(self, run: Run, step: Step, now: datetime) -> None:
        """Note the open activities without a Task, and cancel the Tasks of those that were left."""
        changes = run.take_work_changes()
        opened, left = changes.opened, changes.left
        if self._compared is not run:
            self._compared = run
            self._unposted.clear()
            opened, left = tuple(run.open_visits().items()), tuple(self._by_visit)
        for each in left:
            self._unposted.pop(each, None)
            task = self.tasks.get(self._by_visit.get(each, ""))
            if task is not None and run.visit(each[0]) != each[1]:
                self._cancel_task(task, step, now)
        for each in opened:
            if each not in self._by_visit:
                self._unposted[each] = None

    def _cancel_left(self, run: Run | None, step: Step, now: datetime) -> None:
        """Cancel the Tasks of activities that were left, all of them at the end of the process."""
        if run is not None:
            self._compare(run, step, now)
            return
        for task in list(self.tasks.values()):
            self._cancel_task(task, step, now)

    def _cancel_task(self, task: TaskRecord, step: Step, now: datetime) -> None:
        if task.cancelled_at is None:
            self._record_task(task.changed(cancelled_at=now), step)
            request = status_request(RequestedStatus.CANCELLED, now)
            step.enqueue(self.record.id, MessageKind.APPEND, task.id, request)

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
        count_end(step, self.record)

    def _is_report_due(self) -> bool:
        """Return whether the Process entity has to be written: at each state, and when it has more Tasks.

        The entity lists all Tasks. A process of very many Tasks reports new ones in groups of a fiftieth, so
        that a step costs the same however long the process has run.
        """
        if self.reported is None or self.reported[0] is not self.record.status:
            return True
        listed = self.reported[1]
        return len(self.composed) - listed > max(listed - EXACT_TASKS, 0) // 50

    def _report_process(self, step: Step, now: datetime) -> None:
        """Write the state of the process to the broker."""
        self.reported = (self.record.status, len(self.composed))
        defined_by = definition_id(self.settings, self.plan.definition)
        entity = entity_of(self.settings, self.record, defined_by, self.composed, now)
        step.enqueue(self.record.id, MessageKind.UPSERT, self.urn, [entity])

    def _record_task(self, task: TaskRecord, step: Step) -> None:
        step.tasks[task.id] = task
        self._track(task)

    def _track(self, task: TaskRecord) -> None:
        visit = task.token, task.visit
        dues = () if task.finished else (timer.due for timer in self._timers_of(task))
        self._task_dues.set(task.id, min(dues, default=None))
        if task.finished:
            self.tasks.pop(task.id, None)
            self._by_visit.pop(visit, None)
            self.allocator.remove_task(task.id)
            return
        self.tasks[task.id] = task
        self._by_visit[visit] = task.id
        self._unposted.pop(visit, None)
        if task.performer:
            self.allocator.add_task(task.id, task.performer)

    def _record_act(self, act: Act) -> None:
        self._revise(acts=(*self.record.acts, act))

    def _revise(self, **changes: Any) -> None:
        self.record = replace(self.record, **changes)


def _declined_key(token: str, element: str) -> str:
    return f"{token} {element}"


def _mend(run: Run, act: Act, token: str | None, now: datetime) -> None:
    values = act.values or {}
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


def _identity(settings: OrchestratorSettings, record: ProcessRecord, plan: Plan) -> dict[str, Any]:
    """Return the properties of `execution` in JUEL."""
    return {
        "processInstanceId": record.id,
        "processBusinessKey": record.key,
        "businessKey": record.key,
        "processDefinitionId": definition_id(settings, plan.definition),
    }
