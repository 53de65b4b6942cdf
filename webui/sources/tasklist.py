"""The tasklist: Tasks that people claim and complete on a page, without a glove.

A Task belongs to the tasklist if it involves nobody, or a Person first. A claim assigns and starts it; the
name of the person is the member `operator` of its outputs, with `by` as "tasklist". A person who returns a
Task removes the name, and anybody can claim it again. The server applies claims one after the other.
"""

import asyncio
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any, Final

from jsonschema import Draft202012Validator
from jsonschema.exceptions import SchemaError

from datamodels.entities import Task, TaskStatus
from datamodels.states import Outcome
from datamodels.times import iso
from handover.broker import BrokerClient, NotFound
from handover.errors import Problem
from handover.messages import message, with_code
from handover.outcomes import reason_of
from handover.task_life import FINISHED, PASSIVE_TYPES, performers_of, type_of
from webui.live.live_state import LiveState
from webui.live.views import TasklistView

BY_TASKLIST: Final = "tasklist"


class Tasklist:
    """Publishes the open Tasks of people, and writes what they do to the broker."""

    def __init__(self, state: LiveState, broker: BrokerClient) -> None:
        self._state = state
        self._broker = broker
        self._writing = asyncio.Lock()

    def update(self, task: Task) -> None:
        """Publish a Task of a person that is not finished; remove any other."""
        topic = f"tasklist/{task.id}"
        if is_for_people(task) and task.status.value not in FINISHED:
            self._state.publish(topic, view_of(task))
        else:
            self.remove(task.id)

    def remove(self, task_id: str) -> None:
        """Remove a Task that has ended or was deleted."""
        self._state.remove(f"tasklist/{task_id}")

    async def claim(self, task_id: str, by: str) -> TasklistView:
        """Start a Task as `by`; raise `Problem` 409 if another person or component has it."""
        async with self._writing:
            task = await self._open(task_id)
            outputs = _outputs(task)
            if task.status.value is TaskStatus.PENDING:
                await self._write(task_id, TaskStatus.ASSIGNED)
            elif outputs.get("by") != BY_TASKLIST or outputs.get("operator") not in {None, by}:
                raise _taken(task, outputs)
            return await self._write(task_id, TaskStatus.IN_PROGRESS, {"by": BY_TASKLIST, "operator": by})

    async def give_back(self, task_id: str, by: str) -> TasklistView:
        """Return a Task that `by` has claimed, so that others can claim it."""
        async with self._writing:
            await self._own(task_id, by)
            return await self._write(task_id, TaskStatus.IN_PROGRESS, {"by": BY_TASKLIST})

    async def complete(
        self, task_id: str, by: str, outcome: Outcome, note: str, outputs: Mapping[str, Any]
    ) -> None:
        """End a Task that `by` has claimed; raise `Problem` 422 for outputs that its form does not allow.

        With another outcome than `ok` it fails, unless its process handles outcomes.
        """
        async with self._writing:
            task = await self._own(task_id, by)
            inputs = task.work_parameters.value if task.work_parameters else {}
            if outcome is Outcome.OK:
                _check(outputs, inputs.get("form"))
            given = {**outputs, "outcome": outcome.value, "operator": by, "by": BY_TASKLIST}
            if note:
                given["note"] = note
            status = TaskStatus.COMPLETED
            if outcome is not Outcome.OK and inputs.get("handlesOutcomes") is not True:
                status = TaskStatus.FAILED
                given |= with_code("reason", reason_of(outcome, note or None))
            await self._write(task_id, status, given)

    async def _open(self, task_id: str) -> Task:
        try:
            task = await self._broker.get(task_id, Task)
        except NotFound:
            raise Problem(
                404,
                "No such task",
                message(
                    "tasklist.unknown", "there is no task {task}; it may have been deleted", task=task_id
                ),
            ) from None
        if not is_for_people(task):
            raise Problem(
                409,
                "Not a task of a person",
                message("tasklist.not_for_people", "{task} is performed by a device", task=task_id),
            )
        if task.status.value in FINISHED:
            raise Problem(
                409, "Task has ended", message("tasklist.ended", "{task} has ended already", task=task_id)
            )
        return task

    async def _own(self, task_id: str, by: str) -> Task:
        task = await self._open(task_id)
        outputs = _outputs(task)
        if outputs.get("by") != BY_TASKLIST or outputs.get("operator") != by:
            raise _taken(task, outputs)
        return task

    async def _write(
        self, task_id: str, status: TaskStatus, outputs: Mapping[str, Any] | None = None
    ) -> TasklistView:
        stamp = iso(datetime.now(UTC))
        attributes: dict[str, Any] = {
            "status": {"type": "Property", "value": status.value, "observedAt": stamp}
        }
        if outputs is not None:
            attributes["outputParameters"] = {"type": "Property", "value": outputs, "observedAt": stamp}
        await self._broker.append(task_id, attributes)
        task = await self._broker.get(task_id, Task)
        self.update(task)
        return view_of(task)


def is_for_people(task: Task) -> bool:
    """Return whether people perform the Task: it involves nobody, or a Person first."""
    first = _performer(task)
    return first is None or ":Person:" in first


def _performer(task: Task) -> str | None:
    return next(iter(performers_of(link.object for link in task.involves or ())), None)


def _used(task: Task) -> dict[str, list[str]]:
    """Return the names of the Materials and Assets that a Task uses, by type in lower case."""
    found: dict[str, list[str]] = {}
    for link in task.involves or ():
        type_ = type_of(link.object)
        if type_ in PASSIVE_TYPES:
            found.setdefault(f"{type_.lower()}s", []).append(link.object.rpartition(":")[2])
    return found


def view_of(task: Task) -> TasklistView:
    """Return the Task as the page shows it."""
    inputs = dict(task.work_parameters.value) if task.work_parameters else {}
    outputs = _outputs(task)
    described = inputs.get("description") or (task.description.value if task.description else None)
    operator = outputs.get("operator")
    form = inputs.get("form")
    return {
        "id": task.id,
        "kind": task.is_defined_by.object.rsplit(":", 1)[-1],
        "description": described if isinstance(described, str) else None,
        "status": task.status.value.value,
        "person": _performer(task),
        "claimedBy": operator if isinstance(operator, str) and outputs.get("by") == BY_TASKLIST else None,
        "isClaimable": task.status.value is TaskStatus.PENDING or outputs.get("by") == BY_TASKLIST,
        "deadline": iso(task.deadline.value) if task.deadline else None,
        "form": dict(form) if isinstance(form, Mapping) else None,
        "inputs": {
            **_used(task),
            **{name: value for name, value in inputs.items() if name not in {"description", "form"}},
        },
    }


def _outputs(task: Task) -> dict[str, Any]:
    return dict(task.output_parameters.value) if task.output_parameters else {}


def _taken(task: Task, outputs: Mapping[str, Any]) -> Problem:
    who = outputs.get("operator")
    if isinstance(who, str):
        return Problem(
            409, "Task is taken", message("tasklist.taken", "{who} has claimed this task", who=who)
        )
    return Problem(
        409,
        "Task is not claimed",
        message("tasklist.not_claimed", "this task is {status}; claim it first", status=task.status.value),
    )


def _check(outputs: Mapping[str, Any], form: Any) -> None:
    """Raise `Problem` 422 if the outputs do not match the JSON Schema of the form."""
    if not isinstance(form, Mapping):
        return
    try:
        Draft202012Validator.check_schema(form)
    except SchemaError:
        return  # nobody could complete the Task
    error = next(iter(Draft202012Validator(form).iter_errors(dict(outputs))), None)
    if error is not None:
        field = ".".join(str(part) for part in error.absolute_path)
        raise Problem(
            422,
            "Bad result",
            message(
                "tasklist.bad_result",
                "the result does not match the form: {field}: {fault}",
                field=field or "-",
                fault=error.message,
            ),
        )
