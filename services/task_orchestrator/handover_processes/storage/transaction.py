"""Transaction: writes all changes of a step with a constant number of statements a table."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, TypeVar

import orjson
from sqlalchemy import Connection, Table, bindparam, delete, insert, select, tuple_, update
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.exc import IntegrityError

from handover.errors import HandoverError
from handover.security.audit_trail import record_request
from handover_processes.records.definitions import DefinitionRecord
from handover_processes.records.processes import ProcessRecord
from handover_processes.records.step import Step
from handover_processes.storage import schema
from handover_processes.storage.rollups import write_tally
from handover_processes.storage.rows import (
    CONSTANT_COLUMNS,
    as_column,
    changed_process_row,
    mapping_row,
    message_row,
    offer_row,
    plain_row,
    process_row,
    task_row,
)
from handover_processes.tally import MAX_RESOURCE_LENGTH

_CHANGING = (
    *("element", "name", "status", "observed_at", "moves", "ended_at", "cancelled_at"),
    *("alerted", "lost", "outputs", "escalates_at", "escalated"),
    *("status_since", "working_ms", "paused_ms"),
    *("claims", "claimed_by", "declined_by", "unreadable"),
)
"""Columns of a Task that change."""
_UPDATE_PROCESS = (
    update(schema.processes)
    .where(schema.processes.c.id == bindparam("its_id"), schema.processes.c.revision == bindparam("before"))
    .values(
        {
            column.name: bindparam(column.name)
            for column in schema.processes.c
            if column.name not in CONSTANT_COLUMNS
        }
    )
)
_UPDATE_TASK = (
    update(schema.tasks)
    .where(schema.tasks.c.id == bindparam("its_id"))
    .values({name: bindparam(name) for name in (*_CHANGING, "took_ms")})
)


_INSERT_RESOURCES = {
    "sqlite": sqlite.insert(schema.process_resources).on_conflict_do_nothing(),
    "postgresql": postgresql.insert(schema.process_resources).on_conflict_do_nothing(),
}
MAX_IDS = 500
"""Parameters of one statement: databases limit them."""


T = TypeVar("T", str, int)


class Conflict(HandoverError):
    """Another orchestrator has changed the same process, or used the same key, in this database."""


def write_step(connection: Connection, step: Step) -> None:
    """Write a step; raise `Conflict` if another orchestrator has written one of its processes."""
    _write_definitions(connection, step.definitions)
    _insert(connection, schema.mappings, [mapping_row(table) for table in step.mappings])
    _write_processes(connection, step)
    _write_numbers(connection, step)
    _write_tasks(connection, step)
    _write_resources(connection, step)
    write_tally(connection, step.tally)
    _insert(connection, schema.inbox, [plain_row(move) for move in step.moves])
    _insert(connection, schema.task_acts, [plain_row(act) for act in step.task_acts])
    _insert(connection, schema.forms, [plain_row(form) for form in step.forms])
    for definition, starts in step.start_timers.items():
        table = schema.start_timers
        connection.execute(delete(table).where(table.c.definition == definition))
        _insert(connection, table, [plain_row(start) for start in starts])
    _insert(connection, schema.outbox, [message_row(message) for message in step.messages])
    _write_archived(connection, step.archived)
    _write_stored_messages(connection, step)
    _write_entities_seen(connection, step)
    _write_holds(connection, step)
    _write_offers(connection, step)
    for request in step.requests:
        record_request(connection, request)
    for delivered in in_parts(step.delivered):
        connection.execute(delete(schema.outbox).where(schema.outbox.c.seq.in_(delivered)))


def in_parts(ids: Sequence[T]) -> Iterator[Sequence[T]]:
    """Yield `ids` in parts: databases limit the parameters of a statement."""
    for start in range(0, len(ids), MAX_IDS):
        yield ids[start : start + MAX_IDS]


def _write_definitions(connection: Connection, definitions: Sequence[DefinitionRecord]) -> None:
    _insert(connection, schema.definitions, [plain_row(definition) for definition in definitions])


def _write_processes(connection: Connection, step: Step) -> None:
    new = [process_row(process) for process in step.processes.values() if process.id in step.new]
    try:
        _insert(connection, schema.processes, new)
    except IntegrityError as error:
        names = ", ".join(row["id"] for row in new)
        raise Conflict(f"one of the processes {names}, or its key, exists already") from error
    changed = [process for process in step.processes.values() if process.id not in step.new]
    if not changed:
        return
    if connection.execute(
        _UPDATE_PROCESS, [changed_process_row(process) for process in changed]
    ).rowcount == len(changed):
        return
    written = {process.id: process.revision for process in changed}
    table = schema.processes.c
    revisions = {
        row.id: row.revision
        for some in in_parts(list(written))
        for row in connection.execute(select(table.id, table.revision).where(table.id.in_(some)))
    }
    names = ", ".join(process for process, revision in written.items() if revisions.get(process) != revision)
    raise Conflict(f"another orchestrator has changed {names} in this database; stop one of them")


def _write_numbers(connection: Connection, step: Step) -> None:
    table = schema.process_numbers
    for some in in_parts(list(step.numbers)):
        connection.execute(delete(table).where(table.c.definition.in_(some)))
    rows = [{"definition": definition, "number": number} for definition, number in step.numbers.items()]
    _insert(connection, table, rows)


def _write_stored_messages(connection: Connection, step: Step) -> None:
    stored = [record for record in step.messages_stored.values() if record.id not in step.messages_taken]
    _insert(
        connection,
        schema.messages,
        [{**plain_row(record), "key": orjson.dumps(record.key).decode()} for record in stored],
    )
    for taken in in_parts(list(step.messages_taken)):
        connection.execute(delete(schema.messages).where(schema.messages.c.id.in_(taken)))


def _write_holds(connection: Connection, step: Step) -> None:
    table = schema.definition_holds
    for definition, kind in step.holds:
        connection.execute(delete(table).where(table.c.definition == definition, table.c.kind == kind.value))
    _insert(connection, table, [plain_row(hold) for hold in step.holds.values() if hold is not None])
    _insert(connection, schema.deleted_versions, [plain_row(version) for version in step.deleted_versions])


def _write_offers(connection: Connection, step: Step) -> None:
    changed = list({*step.offers, *step.offers_deleted})
    for some in in_parts(changed):
        connection.execute(delete(schema.offers).where(schema.offers.c.id.in_(some)))
    for some in in_parts(list({*step.offer_files, *step.offers_deleted})):
        connection.execute(delete(schema.offer_files).where(schema.offer_files.c.offer.in_(some)))
    kept = [offer for offer in step.offers.values() if offer.id not in step.offers_deleted]
    _insert(connection, schema.offers, [offer_row(offer) for offer in kept])
    files = [{"offer": offer, "xml": xml} for offer, xml in step.offer_files.items()]
    _insert(connection, schema.offer_files, files)


def _write_entities_seen(connection: Connection, step: Step) -> None:
    table = schema.entities_seen
    pairs = list(step.entities_seen)
    for start in range(0, len(pairs), MAX_IDS):
        some = pairs[start : start + MAX_IDS]
        connection.execute(delete(table).where(tuple_(table.c.filter, table.c.entity).in_(some)))
    seen = [
        {"filter": key, "entity": entity, "digest": digest}
        for (key, entity), digest in step.entities_seen.items()
        if digest is not None
    ]
    _insert(connection, table, seen)


def _write_archived(connection: Connection, archived: Sequence[ProcessRecord]) -> None:
    for process in archived:
        unchanged = (schema.processes.c.id == process.id) & (
            schema.processes.c.revision == process.revision - 1
        )
        changes = {"archived_at": as_column(process.archived_at), "revision": process.revision}
        if connection.execute(update(schema.processes).where(unchanged).values(changes)).rowcount != 1:
            raise Conflict(f"{process.id} was changed meanwhile")


def _write_tasks(connection: Connection, step: Step) -> None:
    _insert(connection, schema.tasks, [task_row(t) for t in step.tasks.values() if t.id in step.new])
    changed = [
        {
            **{name: as_column(getattr(task, name)) for name in _CHANGING},
            "took_ms": task.took_ms,
            "its_id": task.id,
        }
        for task in step.tasks.values()
        if task.id not in step.new
    ]
    if changed:
        connection.execute(_UPDATE_TASK, changed)


def _write_resources(connection: Connection, step: Step) -> None:
    """Write which resources the new Tasks of processes involve."""
    row_keys: dict[tuple[str, str], None] = {}
    for task in step.tasks.values():
        if task.id in step.new:
            for resource in task.involved:
                row_keys[task.process, resource[:MAX_RESOURCE_LENGTH]] = None
    started = {process: as_column(record.started_at) for process, record in step.processes.items()}
    rows = [
        {"process": process, "resource": resource, "started_at": started[process]}
        for process, resource in row_keys
        if process in started
    ]
    if rows:
        connection.execute(_INSERT_RESOURCES[connection.dialect.name], rows)


def _insert(connection: Connection, table: Table, rows: Sequence[Mapping[str, Any]]) -> None:
    if rows:
        connection.execute(insert(table), list(rows))
