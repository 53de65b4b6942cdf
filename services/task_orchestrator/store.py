"""Store: definitions, processes, Tasks, inbox, outbox and timers in the database, SQLite or PostgreSQL.

One `write` is one transaction. A process carries a revision, so that two orchestrators on one database
cannot both move it.
"""

from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from typing import Any

import orjson
from sqlalchemy import (
    BigInteger,
    Boolean,
    Column,
    Connection,
    Engine,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    String,
    Table,
    Text,
    delete,
    func,
    insert,
    select,
    update,
)
from sqlalchemy.exc import IntegrityError

from datamodels.entities import TaskStatus
from handover.errors import HandoverError, UsageError
from services.task_orchestrator.records import (
    DefinitionRecord,
    Message,
    Move,
    ProcessRecord,
    Saying,
    Step,
    TaskRecord,
    Timer,
    TimerKind,
)

SCHEMA_VERSION = 1

_meta = MetaData()
_schema = Table("orchestrator_schema", _meta, Column("version", Integer, nullable=False))
_definitions = Table(
    "orchestrator_definitions",
    _meta,
    Column("name", String(64), primary_key=True),
    Column("version", Integer, primary_key=True),
    Column("digest", String(64), nullable=False),
    Column("title", Text, nullable=False),
    Column("label", Text),
    Column("xml", LargeBinary, nullable=False),
    Column("deployed_at", String(40), nullable=False),
)
_processes = Table(
    "orchestrator_processes",
    _meta,
    Column("id", String(100), primary_key=True),
    Column("definition", String(64), nullable=False),
    Column("version", Integer, nullable=False),
    Column("key", String(200), unique=True),
    Column("status", String(20), nullable=False, index=True),
    Column("parameters", Text, nullable=False),
    Column("variables", Text, nullable=False),
    Column("waiting", Text, nullable=False),
    Column("reason", Text),
    Column("started_at", String(40), nullable=False),
    Column("ended_at", String(40)),
    Column("revision", Integer, nullable=False),
    Column("state", LargeBinary),
)
_tasks = Table(
    "orchestrator_tasks",
    _meta,
    Column("id", String(300), primary_key=True),
    Column("process", String(100), nullable=False, index=True),
    Column("element", String(64), nullable=False),
    Column("visit", Integer, nullable=False),
    Column("token", String(36), nullable=False),
    Column("status", String(20), nullable=False, index=True),
    Column("observed_at", String(40)),
    Column("moves", Integer, nullable=False),
    Column("created_at", String(40), nullable=False),
    Column("deadline", String(40), nullable=False),
    Column("ended_at", String(40)),
    Column("cancelled_at", String(40)),
    Column("alerted", Boolean, nullable=False),
    Column("lost", Integer, nullable=False),
    Column("outputs", Text),
    Column("entity", Text, nullable=False),
)
_inbox = Table(
    "orchestrator_inbox",
    _meta,
    Column("task", String(300), primary_key=True),
    Column("nth", Integer, primary_key=True),
    Column("status", String(20), nullable=False),
    Column("observed_at", String(40)),
    Column("heard_at", String(40), nullable=False),
)
_outbox = Table(
    "orchestrator_outbox",
    _meta,
    Column("seq", BigInteger, primary_key=True, autoincrement=False),
    Column("stream", String(100), nullable=False),
    Column("saying", String(10), nullable=False),
    Column("subject", String(300), nullable=False),
    Column("body", Text, nullable=False),
)
_timers = Table(
    "orchestrator_timers",
    _meta,
    Column("process", String(100), primary_key=True),
    Column("kind", String(10), primary_key=True),
    Column("subject", String(300), primary_key=True),
    Column("due", String(40), nullable=False),
    Index("orchestrator_timers_due", "due"),
)
_MOMENTS = frozenset(
    {"deployed_at", "started_at", "ended_at", "observed_at", "created_at", "deadline", "cancelled_at"}
)
_DOCUMENTS = frozenset({"parameters", "variables", "waiting", "outputs", "entity"})


class Conflict(HandoverError):
    """Another orchestrator has moved the same process, or taken the same key, in this database."""


class Store:
    """What survives. Every method blocks; none may be called from two threads at once."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def migrate(self) -> None:
        """Bring the tables to the version of this release; raise `UsageError` if they are of a later one."""
        with self._engine.begin() as connection:
            _meta.create_all(connection)
            version = connection.execute(select(func.max(_schema.c.version))).scalar()
            if version is None:
                connection.execute(insert(_schema).values(version=SCHEMA_VERSION))
                return
            if version > SCHEMA_VERSION:
                raise UsageError(
                    f"the database of the orchestrator has version {version}, newer than {SCHEMA_VERSION}; "
                    "install the newer release or take another database"
                )
            for step in range(version, SCHEMA_VERSION):
                _MIGRATIONS[step](connection)
            connection.execute(update(_schema).values(version=SCHEMA_VERSION))

    def probe(self) -> None:
        """Return if the database answers."""
        with self._engine.connect() as connection:
            connection.execute(select(1))

    def close(self) -> None:
        """Let go of the database."""
        self._engine.dispose()

    def write(self, step: Step) -> None:
        """Write all of `step` or nothing; raise `Conflict` if somebody else was faster."""
        with self._engine.begin() as connection:
            _write_definitions(connection, step.definitions)
            _write_processes(connection, step)
            _write_tasks(connection, step)
            _insert(connection, _inbox, [_row(move) for move in step.moves])
            for process, timers in step.timers.items():
                connection.execute(delete(_timers).where(_timers.c.process == process))
                _insert(connection, _timers, [{"process": process, **_row(timer)} for timer in timers])
            _insert(connection, _outbox, [_message_row(message) for message in step.messages])
            if step.delivered:
                connection.execute(delete(_outbox).where(_outbox.c.seq.in_(step.delivered)))

    def definitions(self) -> list[DefinitionRecord]:
        """Return all versions of all definitions, oldest first."""
        statement = select(_definitions).order_by(_definitions.c.name, _definitions.c.version)
        return [DefinitionRecord(**_values(row)) for row in self._rows(statement)]

    def processes(
        self, *, ids: Sequence[str] | None = None, status: str | None = None, limit: int | None = None
    ) -> list[ProcessRecord]:
        """Return processes, the latest first; `ids` and `status` narrow them down."""
        statement = select(_processes).order_by(_processes.c.started_at.desc(), _processes.c.id).limit(limit)
        if ids is not None:
            statement = statement.where(_processes.c.id.in_(ids))
        if status is not None:
            statement = statement.where(_processes.c.status == status)
        return [_process(row) for row in self._rows(statement)]

    def unfinished(self) -> list[ProcessRecord]:
        """Return the processes that have not ended or still have Tasks that have not."""
        open_tasks = select(_tasks.c.process).where(_tasks.c.ended_at.is_(None))
        statement = select(_processes).where(
            _processes.c.ended_at.is_(None) | _processes.c.id.in_(open_tasks)
        )
        return [_process(row) for row in self._rows(statement)]

    def by_key(self, key: str) -> ProcessRecord | None:
        """Return the process that was started with the idempotency key `key`."""
        rows = list(self._rows(select(_processes).where(_processes.c.key == key)))
        return _process(rows[0]) if rows else None

    def tasks(self, process: str) -> list[TaskRecord]:
        """Return the Tasks of a process in the order in which they came to be."""
        statement = (
            select(_tasks).where(_tasks.c.process == process).order_by(_tasks.c.created_at, _tasks.c.id)
        )
        return [_task(row) for row in self._rows(statement)]

    def moves(self, process: str) -> list[Move]:
        """Return what was heard of the Tasks of a process, in order."""
        statement = (
            select(_inbox)
            .join(_tasks, _tasks.c.id == _inbox.c.task)
            .where(_tasks.c.process == process)
            .order_by(_inbox.c.task, _inbox.c.nth)
        )
        return [
            Move(
                r["task"],
                r["nth"],
                TaskStatus(r["status"]),
                _moment(r["observed_at"]),
                _surely(r["heard_at"]),
            )
            for r in self._rows(statement)
        ]

    def timers(self) -> dict[str, tuple[Timer, ...]]:
        """Return what is due, by process."""
        found: dict[str, tuple[Timer, ...]] = {}
        for row in self._rows(select(_timers).order_by(_timers.c.due)):
            timer = Timer(TimerKind(row["kind"]), row["subject"], _surely(row["due"]))
            found[row["process"]] = (*found.get(row["process"], ()), timer)
        return found

    def outbox(self) -> list[Message]:
        """Return what has not been told yet, in order."""
        return [
            Message(r["seq"], r["stream"], Saying(r["saying"]), r["subject"], orjson.loads(r["body"]))
            for r in self._rows(select(_outbox).order_by(_outbox.c.seq))
        ]

    def _rows(self, statement: Any) -> Iterator[Mapping[str, Any]]:
        with self._engine.connect() as connection:
            for row in connection.execute(statement).mappings().all():
                yield dict(row)


_MIGRATIONS: Mapping[int, Any] = {}
"""From version n to n + 1, a function of the connection."""


def _write_definitions(connection: Connection, definitions: Sequence[DefinitionRecord]) -> None:
    _insert(connection, _definitions, [_row(definition) for definition in definitions])


def _write_processes(connection: Connection, step: Step) -> None:
    for process in step.processes.values():
        values = _row(process)
        if process.id in step.new:
            try:
                connection.execute(insert(_processes).values(values))
            except IntegrityError as error:
                raise Conflict(f"the process {process.id} or its key is there already") from error
            continue
        mine = (_processes.c.id == process.id) & (_processes.c.revision == process.revision - 1)
        if connection.execute(update(_processes).where(mine).values(values)).rowcount != 1:
            raise Conflict(f"another orchestrator works on {process.id} in this database; stop one of them")


def _write_tasks(connection: Connection, step: Step) -> None:
    _insert(connection, _tasks, [_row(task) for task in step.tasks.values() if task.id in step.new])
    for task in step.tasks.values():
        if task.id not in step.new:
            values = {name: value for name, value in _row(task).items() if name != "entity"}
            connection.execute(update(_tasks).where(_tasks.c.id == task.id).values(values))


def _insert(connection: Connection, table: Table, rows: Sequence[Mapping[str, Any]]) -> None:
    if rows:
        connection.execute(insert(table), list(rows))


def _row(record: Any) -> dict[str, Any]:
    return {name: _written(getattr(record, name)) for name in record.__dataclass_fields__}


def _message_row(message: Message) -> dict[str, Any]:
    return {**_row(message), "body": orjson.dumps(message.body).decode()}


def _written(value: Any) -> Any:
    if isinstance(value, datetime):
        return value.isoformat()
    if isinstance(value, Mapping | tuple):
        return orjson.dumps(value).decode()
    return str(value) if isinstance(value, TaskStatus | TimerKind | Saying) else value


def _values(row: Mapping[str, Any]) -> dict[str, Any]:
    values = dict(row)
    for name, value in values.items():
        if value is not None and name in _MOMENTS:
            values[name] = datetime.fromisoformat(value)
        elif value is not None and name in _DOCUMENTS:
            values[name] = orjson.loads(value)
    return values


def _process(row: Mapping[str, Any]) -> ProcessRecord:
    values = _values(row)
    status, waiting = TaskStatus(values.pop("status")), tuple(values.pop("waiting"))
    return ProcessRecord(**values, status=status, waiting=waiting)


def _task(row: Mapping[str, Any]) -> TaskRecord:
    values = _values(row)
    return TaskRecord(**{**values, "status": TaskStatus(values["status"])})


def _moment(text: str | None) -> datetime | None:
    return None if text is None else datetime.fromisoformat(text)


def _surely(text: str) -> datetime:
    return datetime.fromisoformat(text)
