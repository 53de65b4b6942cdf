"""People's acts: a person claims, returns, declines and completes a Task of the tasklist.

Persons are names; those of people who are signed in are verified. An act changes the process, its Tasks in
the broker and the history in one step, so that of two persons who claim a Task at once the second gets a
clear answer.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Final
from uuid import uuid4

from handover.errors import Problem
from handover.messages import message, with_code
from handover.tasks.outcomes import reason_of
from handover.tasks.task_life import is_for_people, performers_of
from handover_bpmn.forms import form
from handover_datamodels.entities import TaskStatus
from handover_datamodels.states import Outcome
from handover_processes.deployed_forms import FormRegistry
from handover_processes.process.process import Process
from handover_processes.records.step import Step
from handover_processes.records.tasks import TaskAct, TaskActKind, TaskRecord

BY_TASKLIST: Final = "tasklist"


@dataclass(frozen=True, slots=True)
class Offer:
    """Whom a Task is offered to: persons and groups; nobody in particular if both are empty."""

    persons: tuple[str, ...]
    groups: tuple[str, ...]

    def includes(self, person: str, groups: Collection[str]) -> bool:
        """Return whether a person with these groups is among them."""
        if not self.persons and not self.groups:
            return True
        names = {group.casefold() for group in groups}
        return is_named(person, self.persons) or any(group.casefold() in names for group in self.groups)


def is_named(person: str, names: Collection[str]) -> bool:
    """Return whether a person is among `names`, which may be URNs."""
    return person.casefold() in {name.rpartition(":")[2].casefold() for name in names}


def performer_of(task: TaskRecord) -> str | None:
    """Return the Person that a Task was given to, as a URN."""
    involved = (link["object"] for link in task.entity["involves"]["value"])
    return next(iter(performers_of(involved)), None)


def offer_of(task: TaskRecord) -> Offer:
    """Return whom a Task is offered to: its performer, its assignee, or users and groups.

    Once the assignee has declined it is offered to the users and groups, if there are any. The lane restricts
    nobody.
    """
    performer = performer_of(task)
    if performer is not None:
        return Offer((performer,), ())
    invited = task.entity["workParameters"]["value"].get("candidates")
    candidates: Mapping[str, Any] = invited if isinstance(invited, Mapping) else {}
    others = Offer(tuple(candidates.get("users", ())), tuple(candidates.get("groups", ())))
    assignee = candidates.get("assignee")
    has_declined = (
        assignee and is_named(str(assignee), task.declined_by) and (others.persons or others.groups)
    )
    return Offer((str(assignee),), ()) if assignee and not has_declined else others


def is_claimable(task: TaskRecord) -> bool:
    """Return whether people can claim a Task: no component has accepted it."""
    return task.status is TaskStatus.PENDING or task.claims > 0


def requires_pin(task: TaskRecord) -> bool:
    """Return whether the person who completes a Task gives the own PIN."""
    return task.entity["workParameters"]["value"].get("requirePin") is True


def form_of(task: TaskRecord, forms: FormRegistry) -> tuple[str | None, int | None, form.Schema | None]:
    """Return id, version and JSON of the form of a Task; a form written in the BPMN file has no id."""
    form_ = task.entity["workParameters"]["value"].get("form")
    if not isinstance(form_, Mapping):
        return None, None, None
    name = form_.get("id")
    if "components" in form_ or "properties" in form_ or not isinstance(name, str):
        return None, None, form_
    record = forms.find(name, form_.get("version"))
    return name, None if record is None else record.version, None if record is None else forms.schema(record)


class PeopleActs:
    """The acts of the person `by` on one Task, in one step."""

    def __init__(self, process: Process, task_id: str, by: str, step: Step, now: datetime) -> None:
        self._process = process
        self._id = task_id
        self._by = by
        self._step = step
        self._now = now
        self._task = self._open_task()

    def claim(self, groups: Collection[str], *, override: bool) -> None:
        """Start the Task as this person.

        Raises `Problem` 409 if somebody else has it, or, without `override`, if it is offered to others.
        """
        task = self._task
        self._refuse_others()
        if task.claimed_by is not None:
            return
        if not is_claimable(task):
            raise _performed(task)
        if self._process.record.status is TaskStatus.PAUSED:
            raise Problem.translated(
                409, "Process is paused", "tasklist.paused", "the process of this task is paused"
            )
        offer = offer_of(task)
        if not override and not offer.includes(self._by, groups):
            raise Problem(
                409,
                "Task is offered to others",
                message(
                    "tasklist.offered_to_others",
                    "this task is offered to {others}",
                    others=", ".join([*(name.rpartition(":")[2] for name in offer.persons), *offer.groups]),
                ),
                "urn:handover:offered-to-others",
            )
        is_new = task.status is TaskStatus.PENDING
        self._report(
            (TaskStatus.ASSIGNED, TaskStatus.IN_PROGRESS) if is_new else (),
            operator=self._by,
            claims=task.claims + 1,
            claimed_by=self._by,
            declined_by=tuple(name for name in task.declined_by if name != self._by),
        )
        self._record(TaskActKind.CLAIM)

    def give_back(self, why: str | None) -> None:
        """Return the Task, so that others can claim it.

        Raises `Problem` 409 if this person has not claimed it.
        """
        self._require_own()
        self._report((), claimed_by=None)
        self._record(TaskActKind.RETURN, why)

    def decline(self, why: str) -> None:
        """Decline the Task with a reason.

        One that was given to this person goes to the next suitable one or to the users and groups that its
        activity names, or fails; any other stays open for others, and fails when all persons it was offered
        to have declined it.
        """
        task = self._task
        self._refuse_others()
        if not is_claimable(task):
            raise _performed(task)
        declined = tuple(dict.fromkeys((*task.declined_by, self._by)))
        offer = offer_of(task.changed(declined_by=declined))
        self._record(TaskActKind.DECLINE, why)
        is_own = performer_of(task) is not None and is_named(self._by, offer.persons)
        is_left = any(not is_named(name.rpartition(":")[2], declined) for name in offer.persons)
        if not is_own and (not offer.persons or offer.groups or is_left):
            self._report((), claimed_by=None, declined_by=declined)
            return
        reason = message("tasklist.declined", "{who} declined: {why}", who=self._by, why=why)
        outputs = {"declined": True, "operator": self._by, "by": BY_TASKLIST, **with_code("reason", reason)}
        statuses = [TaskStatus.FAILED]
        self._process.report(
            self._id, statuses, outputs, self._step, self._now, claimed_by=None, declined_by=declined
        )

    def complete(
        self,
        outcome: Outcome,
        note: str,
        outputs: Mapping[str, Any],
        forms: FormRegistry,
        performed_by: str | None = None,
    ) -> None:
        """End the Task; raise `Problem` 422 with the faults by field if its form refuses the result.

        With another outcome than `ok` it fails, unless its process handles outcomes. `performed_by` is the
        Person who was signed in; a client never sets it.
        """
        self._require_own()
        inputs = self._task.entity["workParameters"]["value"]
        values = dict(outputs)
        if outcome is Outcome.OK:
            values = self._checked(outputs, forms)
        answer = {**values, "outcome": outcome.value, "operator": self._by, "by": BY_TASKLIST}
        if performed_by is not None:
            answer["performedBy"] = performed_by
        if note:
            answer["note"] = note
        status = TaskStatus.COMPLETED
        if outcome is not Outcome.OK and inputs.get("handlesOutcomes") is not True:
            status = TaskStatus.FAILED
            answer |= with_code("reason", reason_of(outcome, note or None))
        self._record(TaskActKind.COMPLETE, note or None)
        self._process.report(self._id, [status], answer, self._step, self._now)

    def _checked(self, outputs: Mapping[str, Any], forms: FormRegistry) -> dict[str, Any]:
        _, _, schema = form_of(self._task, forms)
        if schema is None:
            return dict(outputs)
        values, faults = form.check(schema, self._process.form_data(self._task), outputs)
        if faults:
            fields = ", ".join(fault.path or "-" for fault in faults)
            raise Problem(
                422,
                "Bad result",
                message("tasklist.bad_result", "the form refuses the result; see {fields}", fields=fields),
                "urn:handover:bad-result",
                {"faults": [{"field": fault.path, **with_code("reason", fault.reason)} for fault in faults]},
            )
        return values

    def _open_task(self) -> TaskRecord:
        task = self._process.tasks.get(self._id)
        if task is None:
            raise Problem.translated(409, "Task has ended", "tasklist.ended", "this task has ended already")
        if not is_for_people(link["object"] for link in task.entity["involves"]["value"]):
            raise Problem.translated(
                409,
                "Not a task of a person",
                "tasklist.not_for_people",
                "{task} is performed by a device",
                task=self._id,
            )
        return task

    def _refuse_others(self) -> None:
        who = self._task.claimed_by
        if who is not None and who != self._by:
            raise Problem.translated(
                409, "Task is taken", "tasklist.taken", "{who} has claimed this task", who=who
            )

    def _require_own(self) -> None:
        self._refuse_others()
        if self._task.claimed_by is None:
            raise Problem.translated(
                409,
                "Task is not claimed",
                "tasklist.not_claimed",
                "this task is {status}; claim it first",
                status=self._task.status.value,
            )

    def _report(
        self, statuses: Collection[TaskStatus], *, operator: str | None = None, **changes: Any
    ) -> None:
        """Change the Task, and show in the broker who has it and who has declined it."""
        declined = changes.get("declined_by", self._task.declined_by)
        outputs: dict[str, Any] = {"by": BY_TASKLIST}
        if operator is not None:
            outputs["operator"] = operator
        if declined:
            outputs["declinedBy"] = list(declined)
        self._process.report(self._id, statuses, outputs, self._step, self._now, **changes)

    def _record(self, kind: TaskActKind, text: str | None = None) -> None:
        verified, process = self._step.is_verified(self._by), self._process.record.id
        act = TaskAct(uuid4().hex, process, self._id, kind, self._by, self._now, text or None, verified)
        self._step.task_acts.append(act)


def _performed(task: TaskRecord) -> Problem:
    return Problem.translated(
        409,
        "Task is performed",
        "tasklist.performed",
        "a component performs this task; it is {status}",
        status=task.status.value,
    )
