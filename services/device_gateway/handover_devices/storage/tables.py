"""The tables of the device gateway. Times are microseconds since 1970."""

from sqlalchemy import (
    BigInteger,
    Column,
    Float,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    String,
    Table,
    Text,
    UniqueConstraint,
)

meta = MetaData()

devices = Table(
    "device",
    meta,
    Column("name", String(64), primary_key=True),
    Column("description", Text, nullable=False),
    Column("token_sha256", String(64)),
    Column("certificate_sha256", String(64)),
    Column("certificate_end_us", BigInteger),
    Column("created_us", BigInteger, nullable=False),
    Column("updated_us", BigInteger, nullable=False),
)
files = Table(
    "device_file",
    meta,
    Column("device", String(64), primary_key=True),
    Column("kind", String(16), primary_key=True),
    Column("media_type", String(64), nullable=False),
    Column("content", LargeBinary, nullable=False),
)
commands = Table(
    "device_command",
    meta,
    Column("device", String(64), primary_key=True),
    Column("id", String(128), primary_key=True),
    Column("name", String(64), nullable=False),
    Column("kind", String(16), nullable=False),
    Column("parameters", Text, nullable=False),
    Column("created_us", BigInteger, nullable=False),
    Column("deadline_us", BigInteger, nullable=False),
    Column("state", String(16), nullable=False),
    Column("progress", Float),
    Column("result", Text),
    Column("reason", Text),
    Column("boot", String(64)),
    Column("reason_message", Text),
    Index("device_command_state", "state"),
    Index("device_command_created", "device", "created_us"),
)
# SQLite numbers rows by itself only if the key is an INTEGER.
_NUMBER = BigInteger().with_variant(Integer, "sqlite")
messages = Table(
    "device_message",
    meta,
    Column("id", _NUMBER, primary_key=True, autoincrement=True),
    Column("device", String(64), nullable=False),
    Column("at_us", BigInteger, nullable=False),
    Column("direction", String(3), nullable=False),
    Column("type", String(16), nullable=False),
    Column("body", Text, nullable=False),
    Column("answer", Text),
    Index("device_message_device", "device", "id"),
)
series = Table(
    "device_series",
    meta,
    Column("id", _NUMBER, primary_key=True, autoincrement=True),
    Column("device", String(64), nullable=False),
    Column("name", String(64), nullable=False),
    UniqueConstraint("device", "name", name="device_series_name"),
)
values = Table(
    "device_value",
    meta,
    Column("series", _NUMBER, primary_key=True, autoincrement=False),
    Column("t_us", BigInteger, primary_key=True),
    Column("value", Float, nullable=False),
    sqlite_with_rowid=False,
    postgresql_partition_by="RANGE (t_us)",  # see `partitions`
)


def _summary(name: str) -> Table:
    return Table(
        name,
        meta,
        Column("series", _NUMBER, primary_key=True, autoincrement=False),
        Column("t_us", BigInteger, primary_key=True),
        Column("n", BigInteger, nullable=False),
        Column("mean", Float, nullable=False),
        Column("min", Float, nullable=False),
        Column("max", Float, nullable=False),
        sqlite_with_rowid=False,
    )


minutes = _summary("device_value_minute")
hours = _summary("device_value_hour")

rules = Table(
    "device_rule",
    meta,
    Column("name", String(64), primary_key=True),
    Column("rule", Text, nullable=False),
    Column("updated_us", BigInteger, nullable=False),
)
watches = Table(
    "device_watch",
    meta,
    Column("rule", String(64), primary_key=True),
    Column("device", String(64), primary_key=True),
    Column("name", String(64), primary_key=True),
    Column("is_on", Integer, nullable=False),
    Column("reported", Integer, nullable=False),
    Column("changed_us", BigInteger, nullable=False),
    Column("measured", Float),
    Column("limit_value", Float),
    Column("process_us", BigInteger),
    Column("learned", Text),
)
leader = Table(  # of several replicas on one PostgreSQL database: how the others reach the one that leads
    "device_leader",
    meta,
    Column("id", Integer, primary_key=True, autoincrement=False),
    Column("term", BigInteger, nullable=False),
    Column("host", String(255), nullable=False),
    Column("device_port", Integer, nullable=False),
    Column("rest_port", Integer, nullable=False),
    Column("tls_name", String(255), nullable=False),
    Column("token", String(128), nullable=False),
)
edge_marks = Table(  # at the centre: what was stored of each edge
    "device_edge_mark",
    meta,
    Column("edge", String(64), primary_key=True),
    Column("stream", String(64), nullable=False),
    Column("seq", BigInteger, nullable=False),
)
outbox = Table(  # at an edge: what the centre has not acknowledged
    "device_outbox",
    meta,
    Column("seq", _NUMBER, primary_key=True, autoincrement=True),
    Column("device", String(64), nullable=False),
    Column("at_us", BigInteger, nullable=False),
    Column("body", Text, nullable=False),
    Column("size", Integer, nullable=False),
    sqlite_autoincrement=True,  # a number is never used twice
)
outbox_state = Table(
    "device_outbox_state",
    meta,
    Column("id", Integer, primary_key=True, autoincrement=False),
    Column("stream", String(64), nullable=False),
    Column("dropped", BigInteger, nullable=False),
    Column("refused", BigInteger, nullable=False),
)
