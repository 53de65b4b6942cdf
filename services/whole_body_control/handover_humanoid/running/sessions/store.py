"""The sessions of persons in the database: written before they are acknowledged, deleted with their person.

SQLite overwrites what a deleted row held. A session that ran when the service was killed is ended by the
next start of the service.
"""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any, Final

import orjson
from sqlalchemy import (
    Column,
    Engine,
    Float,
    Integer,
    MetaData,
    Row,
    String,
    Table,
    Text,
    delete,
    func,
    insert,
    select,
    update,
)

from handover.database.migrations import migrate
from handover.security.audit_trail import record_request
from handover_humanoid.sessions.exercise import EndReason
from handover_humanoid.sessions.report import SessionFigures

VERSION: Final = 1
MAX_LISTED: Final = 200

_meta = MetaData()
_sessions = Table(
    "humanoid_session",
    _meta,
    Column("id", String(36), primary_key=True),
    Column("humanoid", String(64), nullable=False),
    Column("person", String(200), index=True),
    Column("application", String(16), nullable=False),
    Column("goal", Text, nullable=False),
    Column("task", String(400)),
    Column("started_at", String(40), nullable=False),
    Column("ended_at", String(40)),
    Column("ended_by", String(16)),
    Column("throws", Integer, nullable=False, default=0),
    Column("caught", Integer, nullable=False, default=0),
    Column("score", Integer, nullable=False, default=0),
    Column("exercised_s", Float, nullable=False, default=0.0),
    Column("level", Float, nullable=False, default=0.0),
    Column("distance_m", Float, nullable=False, default=0.0),
    Column("report", Text, nullable=False, default="{}"),
)

StoredSession = dict[str, Any]
"""The columns of a session; `goal` and `report` are objects."""


class SessionStore:
    """Every method blocks for the disk."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def prepare(self) -> None:
        """Create the tables, or bring them forward; end the sessions that a killed service has left."""
        migrate(self._engine, _meta, component="humanoid_sessions", version=VERSION)
        left = update(_sessions).where(_sessions.c.ended_at.is_(None))
        with self._engine.begin() as connection:
            connection.execute(
                left.values(ended_at=datetime.now(UTC).isoformat(), ended_by=EndReason.FAULT.value)
            )

    def add(self, session: Mapping[str, Any]) -> None:
        """Add a session."""
        with self._engine.begin() as connection:
            connection.execute(insert(_sessions).values(_row(session)))
            record_request(connection)

    def change(self, session: str, values: Mapping[str, Any]) -> None:
        """Write what has changed; a session that was deleted stays deleted."""
        with self._engine.begin() as connection:
            connection.execute(update(_sessions).where(_sessions.c.id == session).values(_row(values)))
            record_request(connection)

    def find(self, session: str) -> StoredSession | None:
        """Return a session, None if there is none."""
        with self._engine.connect() as connection:
            row = connection.execute(select(_sessions).where(_sessions.c.id == session)).one_or_none()
        return None if row is None else _stored(row)

    def newest(self, humanoid: str, person: str | None) -> list[StoredSession]:
        """Return the newest sessions, of one person or of all."""
        query = select(_sessions).where(_sessions.c.humanoid == humanoid)
        if person is not None:
            query = query.where(_sessions.c.person == person)
        query = query.order_by(_sessions.c.started_at.desc()).limit(MAX_LISTED)
        with self._engine.connect() as connection:
            return [_stored(row) for row in connection.execute(query)]

    def figures_of(self, person: str) -> Sequence[SessionFigures]:
        """Return the figures of all ended sessions of a person."""
        query = select(_sessions).where(_sessions.c.person == person, _sessions.c.ended_at.is_not(None))
        with self._engine.connect() as connection:
            return [
                SessionFigures(
                    started_at=datetime.fromisoformat(row.started_at),
                    throws=row.throws,
                    caught=row.caught,
                    score=row.score,
                    exercised_s=row.exercised_s,
                    level=row.level,
                    distance_m=row.distance_m,
                )
                for row in connection.execute(query)
            ]

    def delete_person(self, person: str) -> int:
        """Delete all sessions of a person; return how many there were."""
        theirs = _sessions.c.person == person
        with self._engine.begin() as connection:
            count = connection.execute(select(func.count()).select_from(_sessions).where(theirs)).scalar()
            connection.execute(delete(_sessions).where(theirs))
            record_request(connection)
        return int(count or 0)


def _row(values: Mapping[str, Any]) -> dict[str, Any]:
    return {
        name: orjson.dumps(value).decode() if name in {"goal", "report"} else value
        for name, value in values.items()
    }


def _stored(row: Row[Any]) -> StoredSession:
    values = dict(row._mapping)
    return {**values, "goal": orjson.loads(values["goal"]), "report": orjson.loads(values["report"])}
