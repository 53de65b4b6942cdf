"""Tasklist: what people do with Tasks, and what they say of Tasks and processes."""

from collections.abc import Collection, Mapping
from contextlib import suppress
from typing import Any
from uuid import uuid4

from handover.broker import BrokerClient, BrokerError
from handover.errors import Problem
from handover_datamodels.entities import TaskStatus
from handover_datamodels.states import Outcome
from handover_processes.operations.broker_changes import BrokerChanges
from handover_processes.people_acts import PeopleActs, performer_of
from handover_processes.process.process import Process
from handover_processes.records.step import Step
from handover_processes.records.tasks import TaskAct, TaskActKind, TaskRecord
from handover_processes.steps.step_writer import StepWriter
from handover_processes.steps.working_state import WorkingState

MAX_COMMENTS = 500
"""Comments on a process and its Tasks."""


class Tasklist:
    """The requests of people about Tasks; each is in the history when it is answered."""

    def __init__(
        self, state: WorkingState, writer: StepWriter, changes: BrokerChanges, broker: BrokerClient
    ) -> None:
        self._state = state
        self._writer = writer
        self._changes = changes
        self._broker = broker

    async def task(self, task_id: str) -> TaskRecord:
        """Return a Task; raise `Problem` 404 if there is none."""
        task: TaskRecord | None = await self._state.on_disk(self._state.store.task, task_id)
        if task is None:
            raise Problem.translated(
                404,
                "No such task",
                "tasklist.unknown",
                "there is no task {task}; it may be deleted",
                task=task_id,
            )
        return task

    async def claim(
        self, task_id: str, by: str, groups: Collection[str] = (), *, override: bool = False
    ) -> None:
        """Claim a Task: see `PeopleActs.claim`."""
        task = await self.task(task_id)
        if performer_of(task) is not None and task.ended_at is None:
            await self._read(task_id)  # the person's glove may have begun it
        await self._act(task, by, lambda acts: acts.claim(groups, override=override))

    async def give_back(self, task_id: str, by: str, why: str | None = None) -> None:
        """Return a claimed Task: see `PeopleActs.give_back`."""
        await self._act(await self.task(task_id), by, lambda acts: acts.give_back(why))

    async def decline(self, task_id: str, by: str, why: str) -> None:
        """Decline a Task: see `PeopleActs.decline`."""
        await self._act(await self.task(task_id), by, lambda acts: acts.decline(why))

    async def complete(
        self,
        task_id: str,
        by: str,
        outcome: Outcome,
        note: str,
        outputs: Mapping[str, Any],
        *,
        performed_by: str | None = None,
    ) -> None:
        """Complete a claimed Task: see `PeopleActs.complete`. A repeated request has no effect."""
        task = await self.task(task_id)
        outputs = {
            name: value for name, value in outputs.items() if name != "performedBy"
        }  # the server sets it
        if _is_done(task, by, outcome, outputs):
            return
        forms = self._state.allocator.forms
        await self._act(task, by, lambda acts: acts.complete(outcome, note, outputs, forms, performed_by))

    async def comment(
        self, process_id: str, by: str, text: str, *, task_id: str | None = None, key: str | None = None
    ) -> TaskAct:
        """Record a comment and return it; the same `key` again has no effect.

        Raises `Problem` 404 if there is no such process, 409 if it has too many comments.
        """
        await self._state.require_process(process_id)
        acts: list[TaskAct] = await self._state.on_disk(self._state.store.task_acts, process_id)
        earlier = next((act for act in acts if act.id == key), None)
        if earlier is not None:
            return earlier
        stored = sum(act.kind is TaskActKind.COMMENT for act in acts)

        def record(step: Step) -> TaskAct:
            pending = [act for act in step.task_acts if act.process == process_id]
            repeated = next((act for act in pending if act.id == key), None)
            if repeated is not None:
                return repeated
            if stored + len(pending) >= MAX_COMMENTS:
                raise Problem.translated(
                    409,
                    "Too many comments",
                    "tasklist.too_many_comments",
                    "a process has at most {max} comments",
                    max=MAX_COMMENTS,
                )
            now = self._state.clock()
            verified, kind = step.is_verified(by), TaskActKind.COMMENT
            comment = TaskAct(key or uuid4().hex, process_id, task_id, kind, by, now, text, verified)
            step.task_acts.append(comment)
            return comment

        return await self._writer.apply(record)

    async def _act(self, task: TaskRecord, by: str, act: Any) -> None:
        def acting(process: Process, step: Step) -> None:
            act(PeopleActs(process, task.id, by, step, self._state.clock()))

        await self._writer.apply_to(task.process, acting)

    async def _read(self, task_id: str) -> None:
        """Apply a Task as the broker has it; one that cannot be read stays as it is."""
        with suppress(BrokerError):
            await self._changes.receive(await self._broker.query(type="Task", id=[task_id]))


def _is_done(task: TaskRecord, by: str, outcome: Outcome, outputs: Mapping[str, Any]) -> bool:
    """Return whether a person has completed a Task with this result already."""
    if task.status is not TaskStatus.COMPLETED or task.claimed_by != by or task.outputs is None:
        return False
    answer = {"outcome": outcome.value, **outputs}
    return all(task.outputs.get(name) == value for name, value in answer.items())
