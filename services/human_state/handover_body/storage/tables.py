"""The tables of human state. Times are microseconds since 1970.

Health data has the pseudonym of a person; only `person` and `consent` connect it with the person.
"""

from typing import Final

from sqlalchemy import (
    BigInteger,
    Boolean,
    Column,
    Connection,
    Engine,
    Float,
    Integer,
    MetaData,
    String,
    Table,
    Text,
)

from handover.database.migrations import migrate

VERSION: Final = 2
COMPONENT: Final = "human_state"

meta = MetaData()
_NUMBER = BigInteger().with_variant(Integer, "sqlite")

persons = Table(
    "human_state_person",
    meta,
    Column("name", String(64), primary_key=True),
    Column("pseudonym", String(64), nullable=False, unique=True),
    Column("rest_bpm", Float, nullable=False),
    Column("maximum_bpm", Float, nullable=False),
    Column("baseline_method", String(16), nullable=False),
    Column("created_us", BigInteger, nullable=False),
)
consents = Table(
    "human_state_consent",
    meta,
    Column("id", _NUMBER, primary_key=True, autoincrement=True),
    Column("person", String(64), nullable=False, index=True),
    Column("purposes", Text, nullable=False),
    Column("given_us", BigInteger, nullable=False),
    Column("ends_us", BigInteger, nullable=False),
    Column("given_by", String(200), nullable=False),
    Column("withdrawn_us", BigInteger),
)
sensors = Table(
    "human_state_sensor",
    meta,
    Column("name", String(64), primary_key=True),
    Column("driver", String(64), nullable=False),
    Column("settings", Text, nullable=False),
    Column("person", String(64), nullable=False, index=True),
)
bindings = Table(
    "human_state_robot",
    meta,
    Column("robot", String(64), primary_key=True),
    Column("person", String(64), primary_key=True),
)
limits = Table(
    "human_state_limit",
    meta,
    Column("person", String(64), primary_key=True),
    Column("free_bpm", Float, nullable=False),
    Column("strained_bpm", Float, nullable=False),
    Column("least", Float, nullable=False),
    Column("is_stopped", Boolean, nullable=False),
)
history = Table(
    "human_state_value",
    meta,
    Column("subject", String(64), primary_key=True),
    Column("feature", String(32), primary_key=True),
    Column("at_us", BigInteger, primary_key=True),
    Column("number", Float),
    Column("text", String(64)),
    Column("quality", Float, nullable=False),
    Column("status", String(16), nullable=False),
)
recordings = Table(
    "human_state_recording",
    meta,
    Column("id", String(32), primary_key=True),
    Column("subject", String(64), nullable=False, index=True),
    Column("label", String(200), nullable=False),
    Column("started_us", BigInteger, nullable=False),
    Column("started_by", String(200), nullable=False),
    Column("ended_us", BigInteger),
    Column("end_reason", String(32)),
    Column("sha256", String(64)),
    Column("size", BigInteger),
    Column("messages", BigInteger),
)


def prepare(engine: Engine) -> None:
    """Create the tables, or bring them to this version."""
    migrate(engine, meta, component=COMPONENT, version=VERSION, steps={1: _add_recordings})


def _add_recordings(connection: Connection) -> None:
    recordings.create(connection)
