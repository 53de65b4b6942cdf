"""Schema: the tables of the orchestrator. `handover.database.migrations` creates and migrates them."""

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
    text,
)

from handover.database import migrations

SCHEMA_VERSION = 7

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
    Column("is_event_driven", Boolean, nullable=False),
    Column("source", Text),
)
definition_holds = Table(
    "orchestrator_definition_holds",
    _meta,
    Column("definition", String(64), primary_key=True),
    Column("kind", String(10), primary_key=True),
    Column("by", String(200), nullable=False),
    Column("why", Text),
    Column("at", String(40), nullable=False),
    Column("verified", Boolean, nullable=False),
)
deleted_versions = Table(
    "orchestrator_deleted_versions",
    _meta,
    Column("definition", String(64), primary_key=True),
    Column("version", Integer, primary_key=True, autoincrement=False),
    Column("by", String(200), nullable=False),
    Column("why", Text),
    Column("at", String(40), nullable=False),
    Column("verified", Boolean, nullable=False),
)
processes = Table(
    "orchestrator_processes",
    _meta,
    Column("id", String(100), primary_key=True),
    Column("definition", String(64), nullable=False),
    Column("version", Integer, nullable=False),
    Column("key", String(200), unique=True),
    Column("status", String(20), nullable=False, index=True),
    Column("waiting", Text, nullable=False),
    Column("reason", Text),
    Column("started_at", String(40), nullable=False),
    Column("ended_at", String(40)),
    Column("revision", Integer, nullable=False),
    Column("incidents", Text, nullable=False, server_default="[]"),
    Column("partner", String(100)),
    Column("archived_at", String(40)),
    Column("reason_message", Text),
    Column("unallocated", Text, nullable=False, server_default="[]"),
    Column("retries", Text, nullable=False, server_default="[]"),
    Column("declined", Text, nullable=False, server_default="{}"),
    Column("reservations", Text, nullable=False, server_default="[]"),
    Column("number", Integer, nullable=False, server_default="0"),
    Column("title", Text),
    # Large columns are last: SQLite reads a row from its beginning to the last column that it needs.
    Column("parameters", Text, nullable=False),
    Column("variables", Text, nullable=False),
    Column("acts", Text, nullable=False, server_default="[]"),
    Column("state", LargeBinary),
    Index("orchestrator_processes_started", "started_at", "id"),
    Index("orchestrator_processes_definition", "definition", "version"),
    # These keep lists of one status or definition fast, independent of the number of stored processes.
    Index("orchestrator_processes_status_started", "status", "started_at", "id"),
    Index("orchestrator_processes_definition_started", "definition", "started_at", "id"),
    Index("orchestrator_processes_ended", "ended_at"),
    Index("orchestrator_processes_to_archive", "archived_at", "ended_at"),
    Index(
        "orchestrator_processes_number",
        "definition",
        "number",
        unique=True,
        sqlite_where=text("number > 0"),
        postgresql_where=text("number > 0"),
    ),
    *(
        Index(
            f"orchestrator_processes_{name}",
            "started_at",
            "id",
            sqlite_where=text(f"{name} <> '[]'"),
            postgresql_where=text(f"{name} <> '[]'"),
        )
        for name in ("incidents", "unallocated")
    ),
)
process_numbers = Table(
    "orchestrator_process_numbers",
    _meta,
    Column("definition", String(64), primary_key=True),
    Column("number", Integer, nullable=False),
)
"""The last number that was given to a process of a definition; it stays when processes are deleted."""
tasks = Table(
    "orchestrator_tasks",
    _meta,
    Column("id", String(300), primary_key=True),
    Column("process", String(100), nullable=False, index=True),
    Column("element", String(1000), nullable=False),
    Column("name", Text, nullable=False, server_default=""),
    Column("visit", Integer, nullable=False),
    Column("token", String(20), nullable=False),
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
    Column("performer", String(300)),
    Column("status_since", String(40)),
    Column("working_ms", BigInteger, nullable=False, server_default="0"),
    Column("paused_ms", BigInteger, nullable=False, server_default="0"),
    Column("allocated", Text),
    Column("escalates_at", String(40)),
    Column("escalated", Integer, nullable=False, server_default="0"),
    Column("chosen", Boolean, nullable=False, server_default="0"),
    Column("claims", Integer, nullable=False, server_default="0"),
    Column("claimed_by", String(200)),
    Column("declined_by", Text, nullable=False, server_default="[]"),
    Column("unreadable", Text),
    Index("orchestrator_tasks_unfinished", "ended_at", "process"),
)
process_resources = Table(
    "orchestrator_process_resources",
    _meta,
    Column("resource", String(300), primary_key=True),
    Column("started_at", String(40), primary_key=True),
    Column("process", String(100), primary_key=True, index=True),
    sqlite_with_rowid=False,
)
"""The resources that the Tasks of a process involve, in the order in which processes are listed."""
statistics = Table(
    "orchestrator_statistics",
    _meta,
    Column("definition", String(64), primary_key=True),
    Column("version", Integer, primary_key=True, autoincrement=False),
    Column("hours", Integer, primary_key=True, autoincrement=False),
    Column("starts", Integer, primary_key=True, autoincrement=False),
    Column("element", String(1000), primary_key=True),
    Column("result", String(10), primary_key=True),
    Column("bin", Integer, primary_key=True, autoincrement=False),
    Column("counted", BigInteger, nullable=False),
    Column("duration_ms", BigInteger, nullable=False),
    Column("working_ms", BigInteger, nullable=False),
    Column("paused_ms", BigInteger, nullable=False),
    Index("orchestrator_statistics_period", "element", "hours", "starts"),
    sqlite_with_rowid=False,  # the rows of a period lie beside each other
)
"""What started and ended by hour (`hours` 1), by day (24) and by 30 days; `starts` counts from 1970."""
resource_work = Table(
    "orchestrator_resource_work",
    _meta,
    Column("hours", Integer, primary_key=True, autoincrement=False),
    Column("starts", Integer, primary_key=True, autoincrement=False),
    Column("resource", String(300), primary_key=True),
    Column("definition", String(64), primary_key=True),
    Column("version", Integer, primary_key=True, autoincrement=False),
    Column("working_ms", BigInteger, nullable=False),
    sqlite_with_rowid=False,
)
task_acts = Table(
    "orchestrator_task_acts",
    _meta,
    Column("id", String(32), primary_key=True),
    Column("process", String(100), nullable=False),
    Column("task", String(300)),
    Column("kind", String(10), nullable=False),
    Column("by", String(200), nullable=False),
    Column("at", String(40), nullable=False),
    Column("text", Text),
    Column("verified", Boolean),
    Index("orchestrator_task_acts_process", "process", "at"),
)
forms = Table(
    "orchestrator_forms",
    _meta,
    Column("id", String(200), primary_key=True),
    Column("version", Integer, primary_key=True, autoincrement=False),
    Column("title", Text, nullable=False),
    Column("file", String(300)),
    Column("digest", String(64), nullable=False),
    Column("content", LargeBinary, nullable=False),
    Column("deployed_at", String(40), nullable=False),
)
inbox = Table(
    "orchestrator_inbox",
    _meta,
    Column("task", String(300), primary_key=True),
    Column("nth", Integer, primary_key=True),
    Column("status", String(20), nullable=False),
    Column("observed_at", String(40)),
    Column("received_at", String(40), nullable=False),
)
outbox = Table(
    "orchestrator_outbox",
    _meta,
    Column("seq", BigInteger, primary_key=True, autoincrement=False),
    Column("stream", String(100), nullable=False),
    Column("kind", String(10), nullable=False),
    Column("subject", String(300), nullable=False),
    Column("body", Text, nullable=False),
)
messages = Table(
    "orchestrator_messages",
    _meta,
    Column("id", String(16), primary_key=True),
    Column("name", Text, nullable=False),
    Column("key", Text, nullable=False),
    Column("variables", Text, nullable=False),
    Column("sender", String(100)),
    Column("sent_at", String(40), nullable=False),
    Column("expires_at", String(40), nullable=False),
    Column("process", String(100)),
)
start_timers = Table(
    "orchestrator_start_timers",
    _meta,
    Column("definition", String(64), primary_key=True),
    Column("event", String(200), primary_key=True),
    Column("due", String(40), nullable=False),
    Column("text", Text),
    Column("count", Integer, nullable=False),
)
entities_seen = Table(
    "orchestrator_entities_seen",
    _meta,
    Column("filter", String(32), primary_key=True),
    Column("entity", String(2000), primary_key=True),
    Column("digest", String(32), nullable=False),
)
mappings = Table(
    "orchestrator_mappings",
    _meta,
    Column("version", Integer, primary_key=True, autoincrement=False),
    Column("confirmed_by", Text),
    Column("why", Text),
    Column("at", String(40), nullable=False),
    Column("entries", Text, nullable=False),
    Column("verified", Boolean),
)
offers = Table(
    "orchestrator_offers",
    _meta,
    Column("id", String(32), primary_key=True),
    Column("entity", String(2000), nullable=False),
    Column("type", String(40), nullable=False),
    Column("name", Text, nullable=False),
    Column("status", String(20), nullable=False),
    Column("found_at", String(40), nullable=False),
    Column("content", Text, nullable=False),
    Column("faults", Text, nullable=False),
    Column("warnings", Text, nullable=False),
    Column("has_file", Boolean, nullable=False),
    Column("times", Integer, nullable=False),
    Column("decisions", Text, nullable=False),
    Column("in_force", Boolean, nullable=False),
)
offer_files = Table(
    "orchestrator_offer_files",
    _meta,
    Column("offer", String(32), primary_key=True),
    Column("xml", LargeBinary, nullable=False),
)


def migrate(engine: Engine) -> None:
    """Bring the tables to the version of this release.

    Raises `UsageError` if they are of a later release, or of a format that was never released.
    """
    migrations.migrate(
        engine,
        _meta,
        component="orchestrator",
        version=SCHEMA_VERSION,
        steps={
            1: _add_verified,
            2: _add_addressee,
            3: _add_holds,
            4: _add_unreadable,
            5: _add_numbers,
            6: _add_deleted_versions,
        },
    )


def _add_verified(connection: Connection) -> None:
    """Add whether names are verified; it is null, which is unverified, for what was stored before."""
    for table in (task_acts, mappings):
        connection.exec_driver_sql(f"ALTER TABLE {table.name} ADD COLUMN verified BOOLEAN")


def _add_addressee(connection: Connection) -> None:
    """Add the process for which a stored message is; it is null, which is any, for what was stored before."""
    connection.exec_driver_sql(f"ALTER TABLE {messages.name} ADD COLUMN process VARCHAR(100)")


def _add_holds(connection: Connection) -> None:
    """Add the table of paused, suspended and deleted definitions; none is."""
    definition_holds.create(connection)


def _add_unreadable(connection: Connection) -> None:
    connection.exec_driver_sql(f"ALTER TABLE {tasks.name} ADD COLUMN unreadable TEXT")


def _add_numbers(connection: Connection) -> None:
    """Number the processes of each definition in the order of their start."""
    for column in ("number INTEGER NOT NULL DEFAULT 0", "title TEXT"):
        connection.exec_driver_sql(f"ALTER TABLE {processes.name} ADD COLUMN {column}")
    connection.exec_driver_sql(
        "UPDATE orchestrator_processes SET number = numbered.number FROM (SELECT id, "
        "row_number() OVER (PARTITION BY definition ORDER BY started_at, id) AS number "
        "FROM orchestrator_processes) AS numbered WHERE numbered.id = orchestrator_processes.id"
    )
    next(index for index in processes.indexes if index.name == f"{processes.name}_number").create(connection)
    process_numbers.create(connection)
    connection.exec_driver_sql(
        "INSERT INTO orchestrator_process_numbers (definition, number) "
        "SELECT definition, max(number) FROM orchestrator_processes GROUP BY definition"
    )


def _add_deleted_versions(connection: Connection) -> None:
    """Add the table of deleted versions; none is."""
    deleted_versions.create(connection)
