"""Archiving: deletes the entities of ended processes from the broker, and corrects those that reappear."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from datetime import datetime
from typing import Any

from handover_processes.records.entities import entity_of, final_attributes
from handover_processes.records.messages import MessageKind
from handover_processes.records.step import Step
from handover_processes.steps.step_writer import StepWriter
from handover_processes.steps.working_state import WorkingState
from handover_processes.storage.store import EndedProcess, EndedTask

MAX_DELETED_ENTITIES = 50
"""Entities deleted in one request, so that the broker serves other requests in between."""


class Archiving:
    """Changes of processes that have ended."""

    def __init__(self, state: WorkingState, writer: StepWriter) -> None:
        self._state = state
        self._writer = writer

    async def archive(self, ended: Iterable[EndedProcess]) -> list[str]:
        """Mark processes as archived and delete their entities from the broker; return their ids.

        One transaction marks them and puts the deletions into the outbox. A process that was retried
        meanwhile is skipped.
        """

        def act(step: Step) -> list[str]:
            now = self._state.clock()
            archived = []
            for ended_process in ended:
                record = ended_process.process
                if record.id not in self._state.active_processes.processes:
                    step.archived.append(replace(record, archived_at=now, revision=record.revision + 1))
                    self._enqueue_delete(step, record.id, (*ended_process.tasks, self._state.urn(record.id)))
                    archived.append(record.id)
            return archived

        return await self._writer.apply(act)

    async def delete_archived(self, entities: Mapping[str, Iterable[str]]) -> None:
        """Delete entities of archived processes, by process, that have reappeared in the broker."""

        def act(step: Step) -> None:
            for process_id, ids in entities.items():
                if process_id not in self._state.active_processes.processes:
                    self._enqueue_delete(step, process_id, tuple(ids))

        await self._writer.apply(act)

    async def restate(self, tasks: Iterable[EndedTask], processes: Iterable[EndedProcess]) -> int:
        """Report the end of Tasks and processes again that the broker shows as unfinished.

        Archived ones are deleted instead. Returns how many messages that takes.
        """
        active_processes, outbox = self._state.active_processes, self._writer.outbox

        def act(step: Step) -> int:
            now, before = self._state.clock(), len(step.messages)
            for ended_task in tasks:
                task = ended_task.task
                if active_processes.owner(task.id) is not None or outbox.is_pending(task.id):
                    continue
                if ended_task.archived:
                    self._enqueue_delete(step, task.process, (task.id,))
                else:
                    step.enqueue(task.process, MessageKind.APPEND, task.id, final_attributes(task))
            for ended in processes:
                record, urn = ended.process, self._state.urn(ended.process.id)
                if record.id in active_processes.processes or outbox.is_pending(urn):
                    continue
                if record.archived_at is not None:
                    self._enqueue_delete(step, record.id, (urn,))
                else:
                    entity = self._entity(ended, now)
                    step.enqueue(record.id, MessageKind.UPSERT, urn, [entity])
            return len(step.messages) - before

        return await self._writer.apply(act)

    def _enqueue_delete(self, step: Step, process_id: str, ids: Sequence[str]) -> None:
        for start in range(0, len(ids), MAX_DELETED_ENTITIES):
            some = list(ids[start : start + MAX_DELETED_ENTITIES])
            step.enqueue(process_id, MessageKind.DELETE, self._state.urn(process_id), some)

    def _entity(self, ended: EndedProcess, now: datetime) -> dict[str, Any]:
        record = ended.process
        defined_by = self._state.registry.entity_id(record.definition, record.version)
        return entity_of(self._state.settings, record, defined_by, ended.tasks, now)
