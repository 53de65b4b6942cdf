"""The database of whole-body control: the stop that is in force, and the sessions of persons."""

from dataclasses import asdict

from sqlalchemy import Column, Engine, Float, MetaData, String, Table, delete, insert, select

from handover.migrations import migrate
from handover.security.audit_trail import record_request
from services.whole_body_control.running.motion import Stopped

VERSION = 1

_meta = MetaData()
_stops = Table(
    "humanoid_stop",
    _meta,
    Column("humanoid", String(64), primary_key=True),
    Column("by", String(200), nullable=False),
    Column("reason", String(200), nullable=False),
    Column("at_s", Float, nullable=False),
)


class Store:
    """Every method blocks for the disk."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def prepare(self) -> None:
        """Create the tables, or bring them forward."""
        migrate(self._engine, _meta, component="whole_body_control", version=VERSION)

    def stop_of(self, humanoid: str) -> Stopped | None:
        """Return the stop that was not reset, None without one."""
        with self._engine.connect() as connection:
            row = connection.execute(select(_stops).where(_stops.c.humanoid == humanoid)).one_or_none()
        return None if row is None else Stopped(row.by, row.reason, row.at_s)

    def keep_stop(self, humanoid: str, stop: Stopped | None) -> None:
        """Keep the stop, or that there is none."""
        with self._engine.begin() as connection:
            connection.execute(delete(_stops).where(_stops.c.humanoid == humanoid))
            if stop is not None:
                connection.execute(insert(_stops).values(humanoid=humanoid, **asdict(stop)))
            record_request(connection)
