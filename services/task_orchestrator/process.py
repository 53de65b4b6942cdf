"""Process: one instance of a definition, from its start to its end, and the Tasks it has handed out.

What is heard, what is due and what people ask move it; what follows is gathered in a `Step`. Nothing here
waits or talks to anyone, and time comes as an argument.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from typing import Any

from datamodels.entities import Task, TaskStatus
from handover.errors import Problem
from handover.task_life import FINISHED, is_news
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
    Move,
    ProcessRecord,
    Saying,
    Step,
    TaskRecord,
    Timer,
    TimerKind,
)
from services.task_orchestrator.settings import OrchestratorSettings

CANCELLED = "cancelled"


@dataclass(frozen=True, slots=True)
class _News:
    """What is new about a Task."""

    status: TaskStatus
    observed_at: datetime | None
    outputs: Mapping[str, Any]

    @property
    def final(self) -> bool:
        return self.status in FINISHED


@dataclass
class Process:
    """A process as it is held in memory; `run` is None once it has ended.

    `tasks` are those that have not ended, `composed` the ids of all it ever had.
    """

    settings: OrchestratorSettings
    record: ProcessRecord
    plan: Plan
    run: Run | None
    tasks: dict[str, TaskRecord] = field(default_factory=dict)
    composed: list[str] = field(default_factory=list)
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
            outputs = {"reason": f"the broker refused the Task: {reason}"}
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
                self._raise_alert(
                    step,
                    f"{task.id.rsplit(':', 1)[-1]} lost",
                    source=task.id,
                    category="taskLost",
                    description=f"The broker no longer has the Task {task.id}, which was {task.status}. "
                    f"See what came of it, then cancel the process {self.record.id}",
                )

    def tick(self, step: Step, now: datetime) -> None:
        """Let happen what is due at `now`."""
        step.touched.add(self.record.id)
        due = [timer for timer in self.timers() if timer.due <= now]
        for timer in due:
            task = self.tasks.get(timer.subject)
            if timer.kind is TimerKind.DEADLINE and task is not None:
                self._alert_not_taken_up(task, step)
            elif timer.kind is TimerKind.GRACE and task is not None:
                self._close_cancelled(task, step, now)
        if any(timer.kind is TimerKind.EVENT for timer in due) and self.run is not None:
            try:
                self.run.advance(now)
            except RunFailed as failure:
                self._fail(str(failure), step, now)
        if due:
            self._follow(step, now)

    def cancel(self, step: Step, now: datetime) -> None:
        """End the process as failed and call its Tasks back; raise `Problem` 409 if it has ended."""
        step.touched.add(self.record.id)
        if self.run is None:
            raise Problem(409, "Process has ended", f"{self.record.id} is {self.record.status} already")
        self._end(TaskStatus.FAILED, CANCELLED, step, now)
        self._follow(step, now)

    # What follows from it

    def _take_in(self, task: TaskRecord, news: _News, step: Step, now: datetime) -> None:
        moves = task.moves + 1
        step.moves.append(Move(task.id, moves, news.status, news.observed_at, now))
        if task.alerted:
            step.say(self.record.id, Saying.CLEAR, task.id, {"key": _overdue_key(task)})
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
        if news.final and task.cancelled_at is None and self.run is not None:
            try:
                self._go_on(self.run, task, news, step, now)
            except RunFailed as failure:
                self._fail(str(failure), step, now)
        self._follow(step, now)

    def _go_on(self, run: Run, task: TaskRecord, news: _News, step: Step, now: datetime) -> None:
        activity = self.plan.definition.activities[task.element]
        if news.status is TaskStatus.COMPLETED:
            run.complete(task.token, activity.results(news.outputs), now)
            return
        reason = str(news.outputs.get("reason") or "no reason given").replace("\0", "")
        code = news.outputs.get("errorCode")
        error = {"activity": task.element, "reason": reason, "code": None if code is None else str(code)}
        if not run.fail(task.token, error, now):
            self._fail(f'"{activity.name}" failed: {reason}', step, now)

    def _follow(self, step: Step, now: datetime) -> None:
        """Hand out the activities that were reached, call back those that were left, and note it all."""
        state: bytes | None = None
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
            state=state if run is not None else None,
        )
        step.processes[self.record.id] = self.record
        step.timers[self.record.id] = self.timers()
        if self.told != (self.record.status, len(self.composed)):
            self._tell(step, now)

    def _hand_out(self, run: Run, step: Step, now: datetime) -> None:
        tokens = {task.token for task in self.tasks.values()}
        for open_ in run.open():
            if open_.token not in tokens:
                self._post(open_, step, now)

    def _post(self, open_: Open, step: Step, now: datetime) -> None:
        activity = self.plan.definition.activities[open_.element]
        task_id = self.settings.entity_id("Task", f"{self.record.id}-{open_.element}-{open_.visit}")
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

    def _alert_not_taken_up(self, task: TaskRecord, step: Step) -> None:
        self._note(task.changed(alerted=True), step)
        involved = ", ".join(link["object"] for link in task.entity["involves"]["value"])
        self._raise_alert(
            step,
            _overdue_key(task),
            source=task.id,
            category="taskOverdue",
            sub_category="notTakenUp",
            description=f"Nobody has taken up the Task {task.id}; it involves {involved}",
        )

    def _fail(self, reason: str, step: Step, now: datetime) -> None:
        self._end(TaskStatus.FAILED, reason, step, now)
        self._raise_alert(
            step,
            f"{self.record.id} failed",
            source=self.urn,
            category="processFailed",
            description=f"The process {self.record.id} has failed: {reason}",
        )

    def _end(self, status: TaskStatus, reason: str | None, step: Step, now: datetime) -> None:
        step.ended.add(self.record.id)
        variables = self.run.variables() if self.run is not None else self.record.variables
        self.run = None
        self._revise(status=status, reason=reason, ended_at=now, variables=variables)

    def _tell(self, step: Step, now: datetime) -> None:
        """Tell the broker how the process stands."""
        record = self.record
        self.told = (record.status, len(self.composed))
        outputs: dict[str, Any] | None = None
        if record.status is TaskStatus.COMPLETED:
            outputs = {n: v for n, v in record.variables.items() if n not in record.parameters}
        elif record.status is TaskStatus.FAILED:
            outputs = {"reason": record.reason}
        entity = process_entity(
            self.settings,
            record.id,
            record.definition,
            status=record.status,
            at=record.ended_at or now,
            parameters=record.parameters,
            tasks=self.composed,
            outputs=outputs,
        )
        step.say(record.id, Saying.UPSERT, self.urn, [entity])

    def _raise_alert(self, step: Step, key: str, **alert: Any) -> None:
        step.say(self.record.id, Saying.RAISE, alert["source"], {"key": key, **alert})

    def _note(self, task: TaskRecord, step: Step) -> None:
        step.tasks[task.id] = task
        self.tasks[task.id] = task
        if task.finished:
            del self.tasks[task.id]

    def _revise(self, **changes: Any) -> None:
        self.record = replace(self.record, **changes)


def _overdue_key(task: TaskRecord) -> str:
    return f"{task.id.rsplit(':', 1)[-1]} not taken up"
