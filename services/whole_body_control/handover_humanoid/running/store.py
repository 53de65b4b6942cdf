"""The database of whole-body control: the stop that is in force, and the gains that people have chosen."""

from collections.abc import Mapping
from dataclasses import asdict

from sqlalchemy import Column, Engine, Float, MetaData, String, Table, delete, insert, select

from handover.database.migrations import migrate
from handover.security.audit_trail import record_request
from handover_humanoid.running.gains import Shares
from handover_humanoid.running.motion import Stopped

VERSION = 2

_meta = MetaData()
_stops = Table(
    "humanoid_stop",
    _meta,
    Column("humanoid", String(64), primary_key=True),
    Column("by", String(200), nullable=False),
    Column("reason", String(200), nullable=False),
    Column("at_s", Float, nullable=False),
)

_gains = Table(
    "humanoid_gains",
    _meta,
    Column("humanoid", String(64), primary_key=True),
    Column("chain", String(64), primary_key=True),
    Column("stiffness", Float, nullable=False),
    Column("damping", Float, nullable=False),
)


class Store:
    """Every method blocks for the disk."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def prepare(self) -> None:
        """Create the tables, or bring them forward."""
        migrate(
            self._engine, _meta, component="whole_body_control", version=VERSION, steps={1: _gains.create}
        )

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

    def gains_of(self, humanoid: str) -> dict[str, Shares]:
        """Return the gains that were chosen, by chain."""
        with self._engine.connect() as connection:
            rows = connection.execute(select(_gains).where(_gains.c.humanoid == humanoid))
            return {row.chain: Shares(row.stiffness, row.damping) for row in rows}

    def keep_gains(self, humanoid: str, gains: Mapping[str, Shares]) -> None:
        """Keep the gains, in place of all others of the humanoid."""
        with self._engine.begin() as connection:
            connection.execute(delete(_gains).where(_gains.c.humanoid == humanoid))
            rows = [
                {"humanoid": humanoid, "chain": chain, **asdict(shares)} for chain, shares in gains.items()
            ]
            if rows:
                connection.execute(insert(_gains), rows)
            record_request(connection)
