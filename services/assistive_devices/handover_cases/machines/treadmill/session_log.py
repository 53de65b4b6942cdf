"""The log of sessions and interventions, in the database: what is acknowledged survives `kill -9`.

It has times, advice, words and the course of a session, and nothing of who the person is: no name, no
pseudonym, no heart rate. An intervention is written when it is decided, and its words when they are known,
so that a slow language model delays neither. A session without an end was interrupted, and is closed at the
next start.
"""

import uuid
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from sqlalchemy import (
    BigInteger,
    Boolean,
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
from handover_cases.machines.treadmill.coach import Advice, Decision, Intensity, Reason
from handover_cases.machines.treadmill.wording import Words

VERSION: Final = 1
COMPONENT: Final = "treadmill_trainer"
INTERRUPTED: Final = "interrupted"
MAX_SESSIONS: Final = 200

meta = MetaData()
sessions = Table(
    "treadmill_session",
    meta,
    Column("id", String(32), primary_key=True),
    Column("started_us", BigInteger, nullable=False, index=True),
    Column("duration_s", Float, nullable=False),
    Column("intensity", String(16), nullable=False),
    Column("language", String(8), nullable=False),
    Column("consents_to_model", Boolean, nullable=False),
    Column("ended_us", BigInteger),
    Column("end_reason", String(32)),
    Column("distance_m", Float),
)
interventions = Table(
    "treadmill_intervention",
    meta,
    Column("session", String(32), primary_key=True),
    Column("number", Integer, primary_key=True),
    Column("at_us", BigInteger, nullable=False),
    Column("advice", String(8), nullable=False),
    Column("reason", String(16), nullable=False),
    Column("text", String(200)),
    Column("source", String(16)),
    Column("problem", String(200)),
)


@dataclass(frozen=True, slots=True)
class SessionRow:
    """A session. Times are microseconds since 1970; `ended_us` and what follows is None while it lasts."""

    id: str
    started_us: int
    duration_s: float
    intensity: Intensity
    language: str
    consents_to_model: bool
    ended_us: int | None = None
    end_reason: str | None = None
    distance_m: float | None = None


@dataclass(frozen=True, slots=True)
class InterventionRow:
    """An intervention, from 1 on in its session; without words until they are known."""

    session: str
    number: int
    at_us: int
    advice: Advice
    reason: Reason
    text: str | None = None
    source: str | None = None
    problem: str | None = None


def new_id() -> str:
    """Return the id of a new session."""
    return uuid.uuid4().hex


class SessionLog:
    """Reads and writes the log. Every method blocks."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def open(self, now_us: int, keep_days: float) -> None:
        """Create the tables, close interrupted sessions, and delete those older than `keep_days`."""
        migrate(self._engine, meta, component=COMPONENT, version=VERSION, steps={})
        oldest_us = now_us - round(keep_days * 86_400e6)
        with self._engine.begin() as connection:
            last = (
                select(interventions.c.at_us)
                .where(interventions.c.session == sessions.c.id)
                .order_by(interventions.c.at_us.desc())
                .limit(1)
                .scalar_subquery()
            )
            ended = {"ended_us": last, "end_reason": INTERRUPTED}
            open_now = sessions.c.ended_us.is_(None)
            connection.execute(update(sessions).where(open_now, last.is_not(None)).values(ended))
            ended = {"ended_us": sessions.c.started_us, "end_reason": INTERRUPTED}
            connection.execute(update(sessions).where(sessions.c.ended_us.is_(None)).values(ended))
            old = select(sessions.c.id).where(sessions.c.started_us < oldest_us)
            connection.execute(delete(interventions).where(interventions.c.session.in_(old)))
            connection.execute(delete(sessions).where(sessions.c.started_us < oldest_us))

    def begin(self, row: SessionRow) -> None:
        """Add a session."""
        with self._engine.begin() as connection:
            connection.execute(insert(sessions).values(_values(row)))

    def add(self, session: str, number: int, decision: Decision, at_us: int) -> None:
        """Add an intervention."""
        row = InterventionRow(session, number, at_us, decision.advice, decision.reason)
        with self._engine.begin() as connection:
            connection.execute(insert(interventions).values(_values(row)))

    def word(self, session: str, number: int, words: Words) -> None:
        """Add the words of an intervention."""
        is_intervention = (interventions.c.session == session) & (interventions.c.number == number)
        values = {"text": str(words.text), "source": words.source, "problem": words.problem[:200]}
        with self._engine.begin() as connection:
            connection.execute(update(interventions).where(is_intervention).values(values))

    def end(self, session: str, at_us: int, reason: str, distance_m: float) -> None:
        """End a session; the first end stays."""
        is_open = (sessions.c.id == session) & sessions.c.ended_us.is_(None)
        values = {"ended_us": at_us, "end_reason": reason, "distance_m": distance_m}
        with self._engine.begin() as connection:
            connection.execute(update(sessions).where(is_open).values(values))

    def sessions(self) -> Sequence[SessionRow]:
        """Return the last sessions, the newest first."""
        query = select(sessions).order_by(sessions.c.started_us.desc()).limit(MAX_SESSIONS)
        with self._engine.connect() as connection:
            rows = connection.execute(query).mappings().all()
        return [SessionRow(**{**row, "intensity": Intensity(row["intensity"])}) for row in rows]

    def interventions(self, session: str) -> Sequence[InterventionRow]:
        """Return the interventions of a session in their order."""
        query = (
            select(interventions).where(interventions.c.session == session).order_by(interventions.c.number)
        )
        with self._engine.connect() as connection:
            rows = connection.execute(query).mappings().all()
        return [
            InterventionRow(**{**row, "advice": Advice(row["advice"]), "reason": Reason(row["reason"])})
            for row in rows
        ]


def _values(row: SessionRow | InterventionRow) -> dict[str, Any]:
    return {name: getattr(row, name) for name in row.__dataclass_fields__}
