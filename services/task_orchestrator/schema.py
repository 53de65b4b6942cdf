"""Schema: the tables of the orchestrator, and how those of an earlier release become today's.

A database is brought forward in one transaction, and a SQLite file is copied beside itself before. One that a
later release has written is left alone.
"""

from collections.abc import Mapping
from datetime import datetime

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
    select,
    update,
)
from sqlalchemy.schema import CreateIndex

from handover.tables import Step, bring_forward

SCHEMA_VERSION = 3

_meta = MetaData()
definitions = Table(
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
processes = Table(
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
    Column("failed_by", String(300)),
    Column("acts", Text, nullable=False, server_default="[]"),
    Column("archived_at", String(40)),
    Column("reason_message", Text),
    Index("orchestrator_processes_started", "started_at", "id"),
    Index("orchestrator_processes_definition", "definition", "version"),
    # A list of one status or definition is read in its order, however many processes are kept.
    Index("orchestrator_processes_status_started", "status", "started_at", "id"),
    Index("orchestrator_processes_definition_started", "definition", "started_at", "id"),
    Index("orchestrator_processes_ended", "ended_at"),
    Index("orchestrator_processes_to_archive", "archived_at", "ended_at"),
)
tasks = Table(
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
    Column("took_ms", BigInteger),
    Index("orchestrator_tasks_unfinished", "ended_at", "process"),
)
inbox = Table(
    "orchestrator_inbox",
    _meta,
    Column("task", String(300), primary_key=True),
    Column("nth", Integer, primary_key=True),
    Column("status", String(20), nullable=False),
    Column("observed_at", String(40)),
    Column("heard_at", String(40), nullable=False),
)
outbox = Table(
    "orchestrator_outbox",
    _meta,
    Column("seq", BigInteger, primary_key=True, autoincrement=False),
    Column("stream", String(100), nullable=False),
    Column("saying", String(10), nullable=False),
    Column("subject", String(300), nullable=False),
    Column("body", Text, nullable=False),
)
timers = Table(
    "orchestrator_timers",
    _meta,
    Column("process", String(100), primary_key=True),
    Column("kind", String(10), primary_key=True),
    Column("subject", String(300), primary_key=True),
    Column("due", String(40), nullable=False),
    Index("orchestrator_timers_due", "due"),
)


def migrate(engine: Engine) -> None:
    """Bring the tables to the version of this release; raise `UsageError` if they are of a later one."""
    bring_forward(engine, _meta, room="orchestrator", version=SCHEMA_VERSION, steps=_MIGRATIONS)


def _keep_what_a_retry_needs(connection: Connection) -> None:
    """1 to 2: who failed a process, what people did, how long Tasks took, and lists that come in pages.

    Processes that failed before were not kept so that they could go on; they stay as they are.
    """
    for table, column, kind in (
        (processes, "failed_by", "VARCHAR(300)"),
        (processes, "acts", "TEXT DEFAULT '[]' NOT NULL"),
        (tasks, "took_ms", "BIGINT"),
    ):
        connection.exec_driver_sql(f"ALTER TABLE {table.name} ADD COLUMN {column} {kind}")
    for index in processes.indexes:
        if index.name in {"orchestrator_processes_started", "orchestrator_processes_definition"}:
            connection.execute(CreateIndex(index))
    ended = select(tasks.c.id, tasks.c.created_at, tasks.c.ended_at).where(tasks.c.ended_at.is_not(None))
    for row in connection.execute(ended).all():
        took = datetime.fromisoformat(row.ended_at) - datetime.fromisoformat(row.created_at)
        took_ms = round(took.total_seconds() * 1000)
        connection.execute(update(tasks).where(tasks.c.id == row.id).values(took_ms=took_ms))


def _add_archive(connection: Connection) -> None:
    """2 to 3: which processes were archived, codes of reasons, and indexes for lists of many processes."""
    connection.exec_driver_sql(f"ALTER TABLE {processes.name} ADD COLUMN archived_at VARCHAR(40)")
    connection.exec_driver_sql(f"ALTER TABLE {processes.name} ADD COLUMN reason_message TEXT")
    for index in sorted((*processes.indexes, *tasks.indexes), key=lambda index: str(index.name)):
        if index.name in _INDEXES_OF_VERSION_3:
            connection.execute(CreateIndex(index))


_INDEXES_OF_VERSION_3 = frozenset(
    {
        "orchestrator_processes_status_started",
        "orchestrator_processes_definition_started",
        "orchestrator_processes_ended",
        "orchestrator_processes_to_archive",
        "orchestrator_tasks_unfinished",
    }
)
_MIGRATIONS: Mapping[int, Step] = {1: _keep_what_a_retry_needs, 2: _add_archive}
"""From version n to n + 1."""
