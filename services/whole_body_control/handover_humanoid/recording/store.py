"""Recordings in the database; their files are in a directory beside it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from sqlalchemy import (
    BigInteger,
    Column,
    Engine,
    Float,
    Integer,
    MetaData,
    String,
    Table,
    delete,
    insert,
    select,
    update,
)

from handover.database.migrations import migrate
from handover.security.audit_trail import record_request

VERSION: Final = 1

_meta = MetaData()
_recordings = Table(
    "humanoid_recording",
    _meta,
    Column("id", String(32), primary_key=True),
    Column("humanoid", String(64), nullable=False),
    Column("label", String(200), nullable=False),
    Column("started_by", String(200), nullable=False),
    Column("started_s", Float, nullable=False),
    Column("ended_s", Float),
    Column("end_reason", String(16)),
    Column("sha256", String(64)),
    Column("size", BigInteger, nullable=False, default=0),
    Column("messages", Integer, nullable=False, default=0),
)


@dataclass(frozen=True, slots=True)
class RecordingRow:
    """A recording; times are in s since 1970, and the last ones are None or 0 until it has ended."""

    id: str
    humanoid: str
    label: str
    started_by: str
    started_s: float
    ended_s: float | None = None
    end_reason: str | None = None
    sha256: str | None = None
    size: int = 0
    messages: int = 0


class RecordingStore:
    """Every method blocks for the disk."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def prepare(self) -> None:
        """Create the table, or bring it forward."""
        migrate(self._engine, _meta, component="humanoid_recordings", version=VERSION)

    def all(self) -> list[RecordingRow]:
        """Return the recordings, newest first."""
        with self._engine.connect() as connection:
            rows = connection.execute(select(_recordings).order_by(_recordings.c.started_s.desc()))
            return [RecordingRow(**row._mapping) for row in rows]

    def find(self, recording: str) -> RecordingRow | None:
        """Return a recording, None if there is none."""
        with self._engine.connect() as connection:
            row = connection.execute(select(_recordings).where(_recordings.c.id == recording)).one_or_none()
        return None if row is None else RecordingRow(**row._mapping)

    def add(self, values: Mapping[str, Any]) -> None:
        """Add a recording."""
        with self._engine.begin() as connection:
            connection.execute(insert(_recordings).values(**values))
            record_request(connection)

    def change(self, recording: str, values: Mapping[str, Any]) -> None:
        """Write what has changed."""
        with self._engine.begin() as connection:
            connection.execute(update(_recordings).where(_recordings.c.id == recording).values(**values))
            record_request(connection)

    def delete(self, recording: str) -> None:
        """Delete a recording."""
        with self._engine.begin() as connection:
            connection.execute(delete(_recordings).where(_recordings.c.id == recording))
            record_request(connection)
