"""The tables of the alert router. Times are microseconds since 1970."""

from typing import Final

from sqlalchemy import BigInteger, Column, Engine, Index, Integer, MetaData, String, Table, Text

from handover.database.migrations import migrate

VERSION: Final = 1
COMPONENT: Final = "alert_router"

meta = MetaData()
_NUMBER = BigInteger().with_variant(Integer, "sqlite")

channels = Table(
    "alert_channel",
    meta,
    Column("name", String(64), primary_key=True),
    Column("channel", Text, nullable=False),
)
routes = Table(
    "alert_route",
    meta,
    Column("name", String(64), primary_key=True),
    Column("route", Text, nullable=False),
)
steps = Table(
    "alert_step",
    meta,
    Column("alert", String(512), primary_key=True),
    Column("issued_us", BigInteger, primary_key=True),
    Column("step", String(160), primary_key=True),
    Column("taken_us", BigInteger, nullable=False),
)
messages = Table(
    "alert_message",
    meta,
    Column("id", _NUMBER, primary_key=True, autoincrement=True),
    Column("alert", String(512), nullable=False),
    Column("route", String(64), nullable=False),
    Column("step", String(64), nullable=False),
    Column("channel", String(64), nullable=False),
    Column("subject", Text, nullable=False),
    Column("body", Text, nullable=False),
    Column("created_us", BigInteger, nullable=False),
    Column("state", String(16), nullable=False),
    Column("attempts", Integer, nullable=False),
    Column("ended_us", BigInteger),
    Column("error", Text),
    Index("alert_message_state", "state", "channel"),
)


def prepare(engine: Engine) -> None:
    """Create the tables, or bring them to this version."""
    migrate(engine, meta, component=COMPONENT, version=VERSION)
