"""Store: definitions, processes, Tasks, inbox and outbox in the database, SQLite or PostgreSQL.

One `write` is one transaction. The revision of a process detects two orchestrators on one database.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import orjson
from sqlalchemy import Column, ColumnElement, Engine, delete, exists, select

from handover.database import DatabaseLock
from handover_datamodels.entities import TaskStatus
from handover_processes.allocation.mapping import MappingEntry, MappingTable
from handover_processes.deployed_forms import FormRecord
from handover_processes.records.definitions import DefinitionHold, DefinitionRecord, DeletedVersion, HoldKind
from handover_processes.records.messages import Message, MessageKind, MessageRecord
from handover_processes.records.offers import OfferRecord
from handover_processes.records.processes import ProcessRecord
from handover_processes.records.step import Step
from handover_processes.records.tasks import Move, TaskAct, TaskRecord
from handover_processes.records.timers import StartTimer
from handover_processes.storage import schema
from handover_processes.storage.counts import PeriodCount, VersionCount, count_period, count_version
from handover_processes.storage.process_filter import EVERY_PROCESS, ProcessFilter, processes_page
from handover_processes.storage.reports import Reports
from handover_processes.storage.rollups import delete_rollups
from handover_processes.storage.rows import (
    as_column,
    to_moment,
    to_offer,
    to_process,
    to_task,
    to_task_act,
    to_time,
    to_values,
)
from handover_processes.storage.transaction import in_parts, write_step
from handover_processes.tally import hour_of

_NOT_LISTED = {"state": None, "parameters": "{}", "variables": "{}", "acts": "[]"}
"""Columns that lists of processes do not show, with what stands for them."""


@dataclass(frozen=True, slots=True)
class EndedProcess:
    """A process that has ended (without the engine's state), and the ids of all its Tasks."""

    process: ProcessRecord
    tasks: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class EndedTask:
    """A Task that has ended, and whether its process is archived."""

    task: TaskRecord
    archived: bool


class Store:
    """Durable state. Every method blocks; one thread writes, and others may read meanwhile."""

    def __init__(self, engine: Engine) -> None:
        self.engine = engine
        self.lock = DatabaseLock(engine, "handover task orchestrator")
        self.reports = Reports(engine)

    def migrate(self) -> None:
        """Bring the tables to the version of this release; raise `UsageError` if that is not possible."""
        schema.migrate(self.engine)

    def probe(self) -> None:
        """Raise an exception if the database does not answer."""
        with self.engine.connect() as connection:
            connection.execute(select(1))

    def close(self) -> None:
        """Release the lock and close all connections."""
        self.lock.release()
        self.engine.dispose()

    def write(self, step: Step) -> None:
        """Write all of `step` or nothing.

        Raises `Conflict` if another orchestrator wrote a process, `LockLost` if another one has taken over.
        """
        with self.lock.transaction() as connection:
            write_step(connection, step)

    def delete_ended(self, ended_before: datetime, at_most: int, *, archived_only: bool = False) -> int:
        """Delete processes that ended before a time, with their Tasks; return how many were deleted.

        With `archived_only` a process stays whose entities may still be in the broker.
        """
        processes, tasks = schema.processes, schema.tasks
        with self.engine.begin() as connection:
            old = select(processes.c.id).where(
                processes.c.ended_at < as_column(ended_before), ~_has_open_tasks()
            )
            if archived_only:
                old = old.where(processes.c.archived_at.is_not(None))
            ids = list(connection.scalars(old.limit(at_most)))
            theirs = select(tasks.c.id).where(tasks.c.process.in_(ids))
            connection.execute(delete(schema.inbox).where(schema.inbox.c.task.in_(theirs)))
            connection.execute(delete(schema.task_acts).where(schema.task_acts.c.process.in_(ids)))
            connection.execute(delete(tasks).where(tasks.c.process.in_(ids)))
            resources = schema.process_resources
            connection.execute(delete(resources).where(resources.c.process.in_(ids)))
            connection.execute(delete(processes).where(processes.c.id.in_(ids)))
        return len(ids)

    def delete_statistics(self, before: datetime) -> None:
        """Delete the counts of the hours that ended before a time."""
        with self.engine.begin() as connection:
            delete_rollups(connection, hour_of(before))

    def definitions(self) -> list[DefinitionRecord]:
        """Return all versions of all definitions, oldest first."""
        statement = select(schema.definitions).order_by(
            schema.definitions.c.name, schema.definitions.c.version
        )
        return [DefinitionRecord(**to_values(row)) for row in self._rows(statement)]

    def forms(self) -> list[FormRecord]:
        """Return all versions of all forms, oldest first."""
        statement = select(schema.forms).order_by(schema.forms.c.id, schema.forms.c.version)
        return [FormRecord(**to_values(row)) for row in self._rows(statement)]

    def task(self, task_id: str) -> TaskRecord | None:
        """Return a Task; None if there is none."""
        rows = list(self._rows(select(schema.tasks).where(schema.tasks.c.id == task_id)))
        return to_task(rows[0]) if rows else None

    def task_acts(self, process: str) -> list[TaskAct]:
        """Return what people did with the Tasks of a process, and all comments, in order."""
        table = schema.task_acts
        statement = select(table).where(table.c.process == process).order_by(table.c.at, table.c.id)
        return [to_task_act(row) for row in self._rows(statement)]

    def mapping(self, version: int | None = None) -> MappingTable | None:
        """Return a version of the mapping, by default the latest; None if there is none."""
        table = schema.mappings
        statement = select(table).order_by(table.c.version.desc()).limit(1)
        if version is not None:
            statement = statement.where(table.c.version == version)
        for row in self._rows(statement):
            entries = tuple(MappingEntry.model_validate(entry) for entry in orjson.loads(row["entries"]))
            by, verified = row["confirmed_by"], bool(row["verified"])
            return MappingTable(row["version"], entries, by, row["why"], to_time(row["at"]), verified)
        return None

    def offers(self) -> list[OfferRecord]:
        """Return all offers, in the order in which they were found."""
        statement = select(schema.offers).order_by(schema.offers.c.found_at, schema.offers.c.id)
        return [to_offer(row) for row in self._rows(statement)]

    def offer_file(self, offer: str) -> bytes | None:
        """Return the BPMN file of an offer, if it has one."""
        statement = select(schema.offer_files.c.xml).where(schema.offer_files.c.offer == offer)
        return next((bytes(row["xml"]) for row in self._rows(statement)), None)

    def processes(self, ids: Sequence[str]) -> list[ProcessRecord]:
        """Return those of the processes `ids` that exist."""
        statement = select(schema.processes).where(schema.processes.c.id.in_(ids))
        return [to_process(row) for row in self._rows(statement)]

    def page(
        self, wanted: ProcessFilter = EVERY_PROCESS, *, before: str | None = None, limit: int | None = None
    ) -> list[ProcessRecord]:
        """Return processes without the engine's state, variables and acts, the latest first.

        `before` is the id of a process: only those started before it are returned. Raises `Problem` 404 for
        an unknown one.
        """
        shown = [column for column in schema.processes.c if column.name not in _NOT_LISTED]
        with self.engine.connect() as connection:
            statement = processes_page(connection, shown, wanted, before=before, limit=limit)
            rows = [dict(row) for row in connection.execute(statement).mappings().all()]
        return [to_process({**row, **_NOT_LISTED}) for row in rows]

    def histories(
        self, wanted: ProcessFilter, limit: int
    ) -> list[tuple[ProcessRecord, list[TaskRecord], list[Move]]]:
        """Return processes with their Tasks and the changes of these, the latest first."""
        records = self.page(wanted, limit=limit)
        ids = [record.id for record in records]
        tasks: dict[str, list[TaskRecord]] = {}
        for some in in_parts(ids):
            for task in self._tasks_of(schema.tasks.c.process.in_(some)):
                tasks.setdefault(task.process, []).append(task)
        moves: dict[str, list[Move]] = {}
        for some in in_parts(ids):
            for process, move in self._moves_of(schema.tasks.c.process.in_(some)):
                moves.setdefault(process, []).append(move)
        return [(record, tasks.get(record.id, []), moves.get(record.id, [])) for record in records]

    def unfinished(self) -> list[ProcessRecord]:
        """Return the processes that have not ended or still have Tasks that have not."""
        open_tasks = select(schema.tasks.c.process).where(schema.tasks.c.ended_at.is_(None))
        statement = select(schema.processes).where(
            schema.processes.c.ended_at.is_(None) | schema.processes.c.id.in_(open_tasks)
        )
        return [to_process(row) for row in self._rows(statement)]

    def unfinished_tasks(self) -> dict[str, list[TaskRecord]]:
        """Return the Tasks that have not ended, by process, in the order of their creation."""
        table = schema.tasks.c
        statement = select(schema.tasks).where(table.ended_at.is_(None)).order_by(table.created_at, table.id)
        tasks_of: dict[str, list[TaskRecord]] = {}
        for row in self._rows(statement):
            tasks_of.setdefault(row["process"], []).append(to_task(row))
        return tasks_of

    def task_ids(self, processes: Sequence[str]) -> dict[str, list[str]]:
        """Return the ids of all Tasks of processes, in the order of their creation."""
        table = schema.tasks.c
        ids_of: dict[str, list[str]] = {process: [] for process in processes}
        for some in in_parts(processes):
            statement = select(table.id, table.process).where(table.process.in_(some))
            for row in self._rows(statement.order_by(table.created_at, table.id)):
                ids_of[row["process"]].append(row["id"])
        return ids_of

    def to_archive(self, ended_before: datetime, at_most: int) -> list[EndedProcess]:
        """Return the processes that ended first, before a time, and are complete.

        All their Tasks have ended, and all their messages were delivered.
        """
        table = schema.processes.c
        statement = (
            select(*_without_state())
            .where(table.archived_at.is_(None), table.ended_at < as_column(ended_before))
            .where(~_has_open_tasks(), ~_has_messages())
            .order_by(table.ended_at)
            .limit(at_most)
        )
        return self._with_tasks([to_process({**row, "state": None}) for row in self._rows(statement)])

    def ended_processes(self, ids: Sequence[str]) -> list[EndedProcess]:
        """Return those of the processes `ids` that have ended."""
        table = schema.processes.c
        records = []
        for some in in_parts(ids):
            statement = select(*_without_state()).where(table.id.in_(some), table.ended_at.is_not(None))
            records += [to_process({**row, "state": None}) for row in self._rows(statement)]
        return self._with_tasks(records)

    def ended_tasks(self, ids: Sequence[str]) -> list[EndedTask]:
        """Return those of the Tasks `ids` that have ended."""
        of_process = schema.processes.c.id == schema.tasks.c.process
        statement = select(schema.tasks, schema.processes.c.archived_at).join(schema.processes, of_process)
        statement = statement.where(schema.tasks.c.ended_at.is_not(None))
        rows = [
            row for some in in_parts(ids) for row in self._rows(statement.where(schema.tasks.c.id.in_(some)))
        ]
        return [EndedTask(archived=row.pop("archived_at") is not None, task=to_task(row)) for row in rows]

    def archived(self, entities: Sequence[str], processes: Sequence[str]) -> dict[str, str]:
        """Return those of the Tasks and of the processes that are archived, each with the process's id."""
        of_process = schema.processes.c.id == schema.tasks.c.process
        is_archived = schema.processes.c.archived_at.is_not(None)
        of_tasks = select(schema.tasks.c.id, schema.tasks.c.process).join(schema.processes, of_process)
        texts: dict[str, str] = {}
        for some in in_parts(entities):
            statement = of_tasks.where(schema.tasks.c.id.in_(some), is_archived)
            texts |= {row["id"]: row["process"] for row in self._rows(statement)}
        for some in in_parts(processes):
            ids = select(schema.processes.c.id).where(schema.processes.c.id.in_(some), is_archived)
            texts |= {row["id"]: row["id"] for row in self._rows(ids)}
        return texts

    def by_key(self, key: str) -> ProcessRecord | None:
        """Return the process that was started with the idempotency key `key`."""
        rows = list(self._rows(select(schema.processes).where(schema.processes.c.key == key)))
        return to_process(rows[0]) if rows else None

    def counts(self, definition: str, version: int, now: datetime) -> VersionCount:
        """Return the statistics of a version of a definition."""
        with self.engine.connect() as connection:
            return count_version(connection, definition, version, now)

    def counts_since(self, since: datetime, now: datetime, until: datetime | None = None) -> PeriodCount:
        """Return the statistics of the processes that ended at `since` or later, and before `until`."""
        with self.engine.connect() as connection:
            return count_period(connection, since, now, until)

    def tasks(self, process: str) -> list[TaskRecord]:
        """Return the Tasks of a process in the order of their creation."""
        return self._tasks_of(schema.tasks.c.process == process)

    def moves(self, process: str) -> list[Move]:
        """Return the changes of the Tasks of a process, in order."""
        return [move for _, move in self._moves_of(schema.tasks.c.process == process)]

    def _tasks_of(self, condition: ColumnElement[bool]) -> list[TaskRecord]:
        statement = select(schema.tasks).where(condition)
        rows = self._rows(statement.order_by(schema.tasks.c.created_at, schema.tasks.c.id))
        return [to_task(row) for row in rows]

    def _moves_of(self, condition: ColumnElement[bool]) -> list[tuple[str, Move]]:
        """Return changes of Tasks, each with the process."""
        statement = (
            select(schema.inbox, schema.tasks.c.process)
            .join(schema.tasks, schema.tasks.c.id == schema.inbox.c.task)
            .where(condition)
            .order_by(schema.inbox.c.task, schema.inbox.c.nth)
        )
        return [
            (
                r["process"],
                Move(
                    r["task"],
                    r["nth"],
                    TaskStatus(r["status"]),
                    to_moment(r["observed_at"]),
                    to_time(r["received_at"]),
                ),
            )
            for r in self._rows(statement)
        ]

    def everything(self, process: str) -> tuple[ProcessRecord, list[TaskRecord], list[Move]] | None:
        """Return a process with its Tasks and their changes; None if there is no such process."""
        records = self.processes([process])
        return (records[0], self.tasks(process), self.moves(process)) if records else None

    def start_timers(self) -> dict[str, tuple[StartTimer, ...]]:
        """Return the start timers by definition."""
        timers: dict[str, tuple[StartTimer, ...]] = {}
        for row in self._rows(select(schema.start_timers)):
            timer = StartTimer(**{**row, "due": to_time(row["due"])})
            timers[timer.definition] = (*timers.get(timer.definition, ()), timer)
        return timers

    def process_numbers(self) -> dict[str, int]:
        """Return the last number that was given to a process of each definition."""
        return {row["definition"]: row["number"] for row in self._rows(select(schema.process_numbers))}

    def definition_holds(self) -> list[DefinitionHold]:
        """Return what is withheld from definitions."""
        return [
            DefinitionHold(**{**row, "kind": HoldKind(row["kind"]), "at": to_time(row["at"])})
            for row in self._rows(select(schema.definition_holds))
        ]

    def deleted_versions(self) -> list[DeletedVersion]:
        """Return the deleted versions of definitions."""
        rows = self._rows(select(schema.deleted_versions))
        return [DeletedVersion(**{**row, "at": to_time(row["at"])}) for row in rows]

    def stored_messages(self) -> list[MessageRecord]:
        """Return the messages to processes that nobody waited for yet, in the order of their sending."""
        return [
            MessageRecord(
                row["id"],
                row["name"],
                orjson.loads(row["key"]),
                orjson.loads(row["variables"]),
                row["sender"],
                to_time(row["sent_at"]),
                to_time(row["expires_at"]),
                row["process"],
            )
            for row in self._rows(select(schema.messages).order_by(schema.messages.c.sent_at))
        ]

    def entities_seen(self) -> list[tuple[str, str, str]]:
        """Return filter, id and digest of the entities that were seen."""
        statement = select(schema.entities_seen)
        return [(row["filter"], row["entity"], row["digest"]) for row in self._rows(statement)]

    def business_keys(self, keys: Sequence[str]) -> dict[str, str]:
        """Return those of the business keys that processes have, with the name of their definition."""
        table = schema.processes.c
        digests: dict[str, str] = {}
        for some in in_parts(keys):
            statement = select(table.key, table.definition).where(table.key.in_(some))
            digests |= {row["key"]: row["definition"] for row in self._rows(statement)}
        return digests

    def outbox(self) -> list[Message]:
        """Return the messages that were not delivered yet, in order."""
        return [
            Message(r["seq"], r["stream"], MessageKind(r["kind"]), r["subject"], orjson.loads(r["body"]))
            for r in self._rows(select(schema.outbox).order_by(schema.outbox.c.seq))
        ]

    def _with_tasks(self, ended: Sequence[ProcessRecord]) -> list[EndedProcess]:
        tasks = self.task_ids([record.id for record in ended])
        return [EndedProcess(record, tuple(tasks[record.id])) for record in ended]

    def _rows(self, statement: Any) -> list[dict[str, Any]]:
        with self.engine.connect() as connection:
            return [dict(row) for row in connection.execute(statement).mappings().all()]


def _without_state() -> list[Column[Any]]:
    return [column for column in schema.processes.c if column.name != "state"]


def _has_open_tasks() -> ColumnElement[bool]:
    """Return the condition that some Task of a process has not ended."""
    return exists().where(schema.tasks.c.process == schema.processes.c.id, schema.tasks.c.ended_at.is_(None))


def _has_messages() -> ColumnElement[bool]:
    """Return the condition that the outbox holds messages about a process."""
    return exists().where(schema.outbox.c.stream == schema.processes.c.id)
