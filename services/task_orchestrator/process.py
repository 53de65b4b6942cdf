"""Process: one instance of a definition, from its start to its end, and the Tasks it has handed out.

What is heard, what is due and what people ask move it; what follows is gathered in a `Step`. Nothing here
waits or talks to anyone, and time comes as an argument. A Task that has ended never reopens; a process that a
failed Task has ended does, when somebody has that Task retried: with a new Task.
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
from services.task_orchestrator import alarms
from services.task_orchestrator.engine import Open, Plan, Run, RunFailed
from services.task_orchestrator.entities import (
    cancel_request,
    outputs_property,
    process_entity,
    status_property,
    task_entity,
)
from services.task_orchestrator.expressions import ExpressionError
from services.task_orchestrator.records import (
    Act,
    ActKind,
    Move,
    ProcessRecord,
    Saying,
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
class _News:
    """What is new about a Task."""

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
        outputs = {}  # a process that goes on again has none, whatever was told before
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
    """A process as it is held in memory; `run` is None once it has ended.

    `tasks` are those that have not ended, `composed` the ids of all it ever had, `done_anyway` those, by
    token, that were completed though they had been called back.
    """

    settings: OrchestratorSettings
    record: ProcessRecord
    plan: Plan
    run: Run | None
    tasks: dict[str, TaskRecord] = field(default_factory=dict)
    composed: list[str] = field(default_factory=list)
    done_anyway: dict[str, TaskRecord] = field(default_factory=dict)
    told: tuple[TaskStatus, int] | None = None
    """The status and the number of Tasks that the broker has been told."""

    @classmethod
    def begin(
        cls, settings: OrchestratorSettings, plan: Plan, record: ProcessRecord, step: Step, now: datetime
    ) -> "Process":
        """Start a process with the parameters of `record`, and hand out its first Tasks."""
        process = cls(settings, record, plan, None)
        step.new.add(record.id)
        step.touched.add(record.id)
        process._tell(step, now)
        try:
            process.run = plan.start(record.parameters, now)
        except RunFailed as failure:
            process._fail(str(failure), step, now)
        process._follow(step, now)
        return process

    @classmethod
    def resume(
        cls, settings: OrchestratorSettings, plan: Plan, record: ProcessRecord, tasks: Iterable[TaskRecord]
    ) -> "Process":
        """Return a process as it was written down; raise `RunFailed` if this release cannot go on with it."""
        running = record.state if record.ended_at is None else None
        process = cls(settings, record, plan, plan.resume(running) if running is not None else None)
        for task in tasks:
            process.composed.append(task.id)
            process._hold(task)
        process.told = (record.status, len(process.composed))
        return process

    @property
    def urn(self) -> str:
        """Return the id of its Process entity."""
        return self.settings.entity_id("Process", self.record.id)

    @property
    def over(self) -> bool:
        """Say whether it has ended and so have all its Tasks: nothing more can happen."""
        return self.run is None and not self.tasks

    def timers(self) -> tuple[Timer, ...]:
        """Return what is due, the earliest first."""
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
        """Say whether the Task as `seen` tells anything that is not known and can be believed."""
        task = self.tasks.get(seen.id)
        if task is None or seen.status.value is task.status:
            return False
        known = {
            **{name: task.entity[name] for name in ("id", "type", "isDefinedBy")},
            "status": status_property(task.status, task.observed_at or task.created_at),
        }
        return is_news(Task.from_ngsild(known), seen)

    def hear(self, seen: Task, step: Step, now: datetime) -> bool:
        """Take in the Task as `seen`; return whether it was news."""
        if not self.is_news(seen):
            return False
        step.touched.add(self.record.id)
        given = seen.output_parameters
        outputs = dict(given.value) if given is not None and isinstance(given.value, Mapping) else {}
        news = _News(seen.status.value, seen.status.observed_at, outputs)
        self._take_in(self.tasks[seen.id], news, step, now)
        return True

    def refused(self, task_id: str, reason: str, step: Step, now: datetime) -> None:
        """Take in that the broker does not accept the Task: it counts as failed."""
        task = self.tasks.get(task_id)
        if task is not None:
            step.touched.add(self.record.id)
            outputs = with_code(
                "reason", message("task.refused_by_broker", "the broker refused the Task: {why}", why=reason)
            )
            self._take_in(task, _News(TaskStatus.FAILED, now, outputs), step, now)

    def missing(self, task_id: str, step: Step, now: datetime) -> None:
        """Take in that the broker does not have the Task: post it again if nobody has begun it.

        One that had been begun is not done twice: when it stays away, an Alert asks a person.
        """
        task = self.tasks.get(task_id)
        if task is None:
            return
        step.touched.add(self.record.id)
        if task.cancelled_at is not None:
            self._take_in(task, _News(TaskStatus.FAILED, now, {"reason": CANCELLED}), step, now)
        elif task.status is TaskStatus.PENDING:
            step.say(self.record.id, Saying.CREATE, task.id, task.entity)
            self._tell(step, now)
        else:
            self._note(task.changed(lost=task.lost + 1), step)
            if task.lost == 1:
                alarms.call_for_lost(step, task)

    def tick(self, step: Step, now: datetime) -> None:
        """Let happen what is due at `now`."""
        step.touched.add(self.record.id)
        due = [timer for timer in self.timers() if timer.due <= now]
        for timer in due:
            task = self.tasks.get(timer.subject)
            if timer.kind is TimerKind.DEADLINE and task is not None:
                self._note(task.changed(alerted=True), step)
                alarms.call_for_overdue(step, task)
            elif timer.kind is TimerKind.GRACE and task is not None:
                self._close_cancelled(task, step, now)
        if any(timer.kind is TimerKind.EVENT for timer in due) and self.run is not None:
            try:
                self.run.advance(now)
            except RunFailed as failure:
                self._fail(text_of(failure), step, now)
        if due:
            self._follow(step, now)

    def cancel(self, by: str | None, step: Step, now: datetime) -> None:
        """End the process as failed and call its Tasks back; raise `Problem` 409 if it has ended."""
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
        self._keep_in_mind(Act(now, ActKind.CANCEL, by))
        self._end(TaskStatus.FAILED, f"{CANCELLED} by {by}" if by else CANCELLED, step, now)
        self._follow(step, now)

    def retry(self, task_id: str, by: str, step: Step, now: datetime) -> None:
        """Go on where the failed Task has ended the process: hand out its activity anew.

        So are those that were called back then, as soon as their Tasks have ended; what was completed anyway
        counts, since nothing is done twice. Raises `Problem` 404 or 409 that says why it cannot be.
        """
        run = run_to_retry(self.plan, self.record, self.composed, task_id)
        step.touched.add(self.record.id)
        step.ended.discard(self.record.id)
        alarms.end_failed(step, self.record, self.urn)
        self._keep_in_mind(Act(now, ActKind.RETRY, by, task_id))
        self._revise(
            status=TaskStatus.IN_PROGRESS, reason=None, ended_at=None, failed_by=None, archived_at=None
        )
        self.run = run
        try:
            run.restart_timers(now)
            for open_ in run.open():
                done = self.done_anyway.get(open_.token)
                if done is not None and run.is_open(open_.token):
                    run.complete(open_.token, self._results(done, done.outputs or {}), now)
        except RunFailed as failure:
            self._fail(str(failure), step, now)
        self._follow(step, now)

    # What follows from it

    def _take_in(self, task: TaskRecord, news: _News, step: Step, now: datetime) -> None:
        moves = task.moves + 1
        step.moves.append(Move(task.id, moves, news.status, news.observed_at, now))
        if task.alerted:
            alarms.end_overdue(step, task)
        self._note(
            task.changed(
                status=news.status,
                observed_at=news.observed_at,
                moves=moves,
                alerted=False,
                lost=0,
                ended_at=now if news.final else None,
                outputs=news.outputs if news.final else None,
            ),
            step,
        )
        if news.final and self.run is not None and self.run.is_open(task.token):
            try:
                self._go_on(self.run, task, news, step, now)
            except RunFailed as failure:
                self._fail(str(failure), step, now)
        self._follow(step, now)

    def _go_on(self, run: Run, task: TaskRecord, news: _News, step: Step, now: datetime) -> None:
        activity = self.plan.definition.activities[task.element]
        # Whatever its performer takes for completed: an outcome that is not handled must not start a robot.
        unhandled = activity.unhandled(news.outputs)
        if news.status is TaskStatus.COMPLETED and unhandled is None:
            run.complete(task.token, self._results(task, news.outputs), now)
            return
        if task.cancelled_at is not None:
            return  # called back when the process failed, wanted again since: it is handed out anew
        reason = message_in(news.outputs, "reason") or unhandled or NO_REASON
        if "\0" in reason or not isinstance(reason, MessageText):
            reason = str(reason).replace("\0", "")  # which PostgreSQL does not take
        code = news.outputs.get("errorCode", news.outputs.get("outcome") if unhandled else None)
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

    def _follow(self, step: Step, now: datetime) -> None:
        """Hand out the activities that were reached, call back those that were left, and note it all."""
        state = self.record.state if self.record.failed_by is not None else None
        if self.run is not None:
            try:
                self._hand_out(self.run, step, now)
                state = self.run.snapshot()
            except (RunFailed, ExpressionError, ValueError) as failure:
                self._fail(str(failure), step, now)
        if self.run is not None and self.run.completed:
            self._end(TaskStatus.COMPLETED, None, step, now)
        run = self.run
        self._call_back({open_.token for open_ in run.open()} if run is not None else set(), step, now)
        known = self.record.id in step.processes or self.record.id in step.new
        self._revise(
            revision=self.record.revision + (0 if known else 1),
            variables=run.variables() if run is not None else self.record.variables,
            waiting=run.waiting() if run is not None else (),
            state=state if run is not None or self.record.failed_by is not None else None,
        )
        step.processes[self.record.id] = self.record
        step.timers[self.record.id] = self.timers()
        if self.told != (self.record.status, len(self.composed)):
            self._tell(step, now)

    def _hand_out(self, run: Run, step: Step, now: datetime) -> None:
        tokens = {task.token for task in self.tasks.values()}
        for open_ in run.open():
            if open_.token not in tokens:
                self._post(self._not_yet_posted(run, open_), step, now)

    def _not_yet_posted(self, run: Run, open_: Open) -> Open:
        """Return `open_`, as a further visit if its Task has ended and it is to be done all the same."""
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
        self._note(task, step)
        step.say(self.record.id, Saying.CREATE, task_id, entity)

    def _call_back(self, open_tokens: set[str], step: Step, now: datetime) -> None:
        for task in list(self.tasks.values()):
            if task.cancelled_at is None and task.token not in open_tokens:
                self._note(task.changed(cancelled_at=now), step)
                step.say(self.record.id, Saying.APPEND, task.id, cancel_request(now))

    def _close_cancelled(self, task: TaskRecord, step: Step, now: datetime) -> None:
        """Close a cancelled Task that nobody has taken up, in the place of its performer."""
        outputs = {"reason": CANCELLED}
        closing = {
            "status": status_property(TaskStatus.FAILED, now),
            "outputParameters": outputs_property(outputs, now),
        }
        step.say(self.record.id, Saying.APPEND, task.id, closing)
        self._take_in(task, _News(TaskStatus.FAILED, now, outputs), step, now)

    def _fail(self, reason: str, step: Step, now: datetime) -> None:
        self._end(TaskStatus.FAILED, reason, step, now)
        alarms.call_for_failed(step, self.record, self.urn)

    def _end(self, status: TaskStatus, reason: str | None, step: Step, now: datetime) -> None:
        step.ended.add(self.record.id)
        variables = self.run.variables() if self.run is not None else self.record.variables
        self.run = None
        self._revise(status=status, reason=reason, ended_at=now, variables=variables)

    def _tell(self, step: Step, now: datetime) -> None:
        """Tell the broker how the process stands."""
        self.told = (self.record.status, len(self.composed))
        entity = entity_of(self.settings, self.record, self.composed, now)
        step.say(self.record.id, Saying.UPSERT, self.urn, [entity])

    def _note(self, task: TaskRecord, step: Step) -> None:
        step.tasks[task.id] = task
        self._hold(task)

    def _hold(self, task: TaskRecord) -> None:
        if not task.finished:
            self.tasks[task.id] = task
            return
        self.tasks.pop(task.id, None)
        unhandled = self.plan.definition.activities[task.element].unhandled(task.outputs or {})
        if task.cancelled_at is not None and task.status is TaskStatus.COMPLETED and unhandled is None:
            self.done_anyway[task.token] = task

    def _keep_in_mind(self, act: Act) -> None:
        self._revise(acts=(*self.record.acts, act))

    def _revise(self, **changes: Any) -> None:
        self.record = replace(self.record, **changes)
