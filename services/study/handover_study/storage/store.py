"""The store of the study: sessions and answers, each in the database before it is acknowledged.

A session that is deleted is really gone: SQLite overwrites what it held, and its journal is emptied.
(PostgreSQL overwrites such space after it has vacuumed; copies that somebody else made are theirs to delete.)
"""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import orjson
from sqlalchemy import (
    Column,
    Connection,
    Engine,
    MetaData,
    String,
    Table,
    Text,
    UniqueConstraint,
    delete,
    func,
    insert,
    select,
    update,
)
from sqlalchemy.exc import IntegrityError

from handover.database import purge_log
from handover.database.migrations import migrate
from handover.errors import Problem
from handover.security.audit_trail import record_request
from handover_study.model.protocol import FINISHED, Condition, Session, StepAnswer, balanced, next_step

VERSION = 1

_meta = MetaData()
_sessions = Table(
    "study_session",
    _meta,
    Column("id", String(36), primary_key=True),
    Column("study", String(64), nullable=False),
    Column("pseudonym", String(64), nullable=False),
    Column("language", String(5), nullable=False),
    Column("began_at", String(40), nullable=False),
    Column("glove", String(64)),
    Column("person", String(200)),
    Column("first", String(12)),
    Column("step", String(20), nullable=False),
    Column("ended_at", String(40)),
    UniqueConstraint("study", "pseudonym", name="study_session_pseudonym"),
)
_answers = Table(
    "study_answer",
    _meta,
    Column("session", String(36), primary_key=True),
    Column("step", String(20), primary_key=True),
    Column("content", Text, nullable=False),
    Column("language", String(5), nullable=False),
    Column("opened_at", String(40), nullable=False),
    Column("answered_at", String(40), nullable=False),
)


class StudyStore:
    """Sessions of studies in the database; every method blocks for the disk."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def prepare(self) -> None:
        """Create the tables, or bring them forward."""
        migrate(self._engine, _meta, component="study", version=VERSION)

    def add(self, session: Session) -> None:
        """Keep a new session; raises `Problem` 409 if its pseudonym is taken in its study."""
        row = {name: value for name, value in asdict(session).items() if name != "answers"}
        try:
            with self._engine.begin() as connection:
                connection.execute(insert(_sessions).values(row))
                record_request(connection)
        except IntegrityError:
            raise Problem(
                409,
                "Pseudonym taken",
                f'"{session.pseudonym}" takes part in "{session.study}" already; '
                "go on with that session, or choose another pseudonym",
            ) from None

    def answer(self, session: Session, step: str, answer: StepAnswer, lot: float) -> None:
        """Keep the answer to the present step and move on; raises `Problem` 409 if somebody was faster.

        With "consent", the order of the conditions is drawn: the rarer one so far, else by `lot`.
        """
        following = next_step(step)
        with self._engine.begin() as connection:
            values: dict[str, Any] = {"step": following}
            if following == FINISHED:
                values["ended_at"] = answer.answered_at
            here = (_sessions.c.id == session.id) & (_sessions.c.step == step)
            if connection.execute(update(_sessions).where(here).values(values)).rowcount != 1:
                raise Problem(
                    409, "Another step", f'"{step}" has been answered meanwhile; load the session again'
                )
            if step == "consent":  # from here on nobody else writes, so the counts hold
                first = self._order(connection, session.study, lot)
                connection.execute(
                    update(_sessions).where(_sessions.c.id == session.id).values(first=first.value)
                )
            row = {**asdict(answer), "content": orjson.dumps(dict(answer.content)).decode()}
            connection.execute(insert(_answers).values(session=session.id, step=step, **row))
            record_request(connection)

    def delete(self, session_id: str) -> bool:
        """Delete a session and all its answers beyond recovery; say whether there was one."""
        is_sqlite = self._engine.dialect.name == "sqlite"
        with self._engine.connect() as connection:
            if is_sqlite:
                connection.exec_driver_sql("PRAGMA secure_delete=ON")
            connection.execute(delete(_answers).where(_answers.c.session == session_id))
            is_deleted = (
                connection.execute(delete(_sessions).where(_sessions.c.id == session_id)).rowcount > 0
            )
            record_request(connection)
            connection.commit()
        purge_log(self._engine)
        return is_deleted

    def session(self, session_id: str) -> Session | None:
        """Return the session with that id, if there is one."""
        matches = self._read(_sessions.c.id == session_id)
        return matches[0] if matches else None

    def sessions(self, study: str | None = None) -> list[Session]:
        """Return all sessions (of `study`) in the order in which they began."""
        return self._read(None if study is None else _sessions.c.study == study)

    def _read(self, where: Any) -> list[Session]:
        statement = select(_sessions).order_by(_sessions.c.began_at, _sessions.c.id)
        theirs = select(_answers)
        if where is not None:
            statement = statement.where(where)
            theirs = theirs.where(_answers.c.session.in_(select(_sessions.c.id).where(where)))
        answers: dict[str, dict[str, StepAnswer]] = defaultdict(dict)
        with self._engine.connect() as connection:
            rows = connection.execute(statement).mappings().all()
            for row in connection.execute(theirs).mappings():
                answers[row["session"]][row["step"]] = StepAnswer(
                    orjson.loads(row["content"]), row["language"], row["opened_at"], row["answered_at"]
                )
        return [_session(dict(row), answers[row["id"]]) for row in rows]

    def _order(self, connection: Connection, study: str, lot: float) -> Condition:
        counted = (
            select(_sessions.c.first, func.count())
            .where((_sessions.c.study == study) & _sessions.c.first.is_not(None))
            .group_by(_sessions.c.first)
        )
        counts = {row[0]: row[1] for row in connection.execute(counted)}
        return balanced(
            counts.get(Condition.PERSONAL.value, 0), counts.get(Condition.PREDEFINED.value, 0), lot
        )


def _session(row: Mapping[str, Any], answers: Mapping[str, StepAnswer]) -> Session:
    first = Condition(row["first"]) if row["first"] else None
    return Session(**{**row, "first": first, "answers": answers})
