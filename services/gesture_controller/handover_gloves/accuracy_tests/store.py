"""The store of accuracy tests: each test with its plan, and every trial as soon as it ends."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from datetime import datetime
from typing import Any

import orjson
from sqlalchemy import (
    Column,
    Engine,
    Float,
    Integer,
    MetaData,
    String,
    Table,
    Text,
    delete,
    insert,
    select,
    update,
)

from handover.database.migrations import migrate
from handover_datamodels.times import iso
from handover_gloves.accuracy_tests.trials import Attempt, Outcome, Phase, Plan, Trial

VERSION = 1

_meta = MetaData()
_tests = Table(
    "accuracy_test",
    _meta,
    Column("id", String(36), primary_key=True),
    Column("glove", String(64), nullable=False),
    Column("person", String(200)),
    Column("plan", Text, nullable=False),
    Column("phase", String(20), nullable=False),
    Column("reason", Text, nullable=False),
    Column("began_at", String(40), nullable=False, index=True),
    Column("ended_at", String(40)),
)
_trials = Table(
    "accuracy_trial",
    _meta,
    Column("test", String(36), primary_key=True),
    Column("number", Integer, primary_key=True, autoincrement=False),
    Column("round", Integer, nullable=False),
    Column("asked", String(200), nullable=False),
    Column("outcome", String(10), nullable=False),
    Column("tries", Text, nullable=False),
    Column("recognized_ms", Float),
    Column("repeats", Integer, nullable=False),
    Column("ended_at", String(40), nullable=False),
)


@dataclass(frozen=True, slots=True)
class AccuracyTest:
    """A stored accuracy test; times are ISO 8601 in UTC."""

    id: str
    glove: str
    person: str | None
    plan: Plan
    phase: Phase
    reason: str
    began_at: str
    ended_at: str | None


class AccuracyTestStore:
    """Accuracy tests in the database; every method blocks on the database."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def prepare(self) -> None:
        """Create or upgrade the tables."""
        migrate(self._engine, _meta, component="accuracy", version=VERSION)

    def add(self, test: AccuracyTest) -> None:
        """Write a new test."""
        row = {**_plain(test), "plan": orjson.dumps(asdict(test.plan)).decode()}
        with self._engine.begin() as connection:
            connection.execute(insert(_tests).values(row))

    def add_trial(self, test: str, trial: Trial, at: datetime) -> None:
        """Write a trial of the test with the id `test`, unless it is stored already."""
        row = {
            "test": test,
            "number": trial.number,
            "round": trial.round,
            "asked": trial.asked,
            "outcome": trial.outcome.value,
            "tries": orjson.dumps([asdict(attempt) for attempt in trial.tries]).decode(),
            "recognized_ms": trial.recognized_ms,
            "repeats": trial.repeats,
            "ended_at": iso(at),
        }
        is_trial = (_trials.c.test == test) & (_trials.c.number == trial.number)
        with self._engine.begin() as connection:
            if connection.execute(select(_trials.c.number).where(is_trial)).first() is None:
                connection.execute(insert(_trials).values(row))

    def set_phase(self, test: str, phase: Phase, reason: str, ended_at: datetime | None) -> None:
        """Write the phase of a test."""
        values = {"phase": phase.value, "reason": reason, "ended_at": iso(ended_at) if ended_at else None}
        with self._engine.begin() as connection:
            connection.execute(update(_tests).where(_tests.c.id == test).values(values))

    def delete(self, test: str) -> bool:
        """Delete a test with its trials; return False if there is none."""
        with self._engine.begin() as connection:
            connection.execute(delete(_trials).where(_trials.c.test == test))
            return connection.execute(delete(_tests).where(_tests.c.id == test)).rowcount > 0

    def tests(self) -> list[AccuracyTest]:
        """Return all tests, the latest first."""
        with self._engine.connect() as connection:
            rows = connection.execute(
                select(_tests).order_by(_tests.c.began_at.desc(), _tests.c.id)
            ).mappings()
            return [_test(dict(row)) for row in rows]

    def test(self, test: str) -> AccuracyTest | None:
        """Return the test with the id `test`, if any."""
        with self._engine.connect() as connection:
            row = connection.execute(select(_tests).where(_tests.c.id == test)).mappings().first()
        return _test(dict(row)) if row is not None else None

    def trials(self, test: str) -> list[tuple[Trial, str]]:
        """Return the trials of a test in order, each with its end time."""
        statement = select(_trials).where(_trials.c.test == test).order_by(_trials.c.number)
        with self._engine.connect() as connection:
            return [(_trial(dict(row)), row["ended_at"]) for row in connection.execute(statement).mappings()]


def _plain(test: AccuracyTest) -> dict[str, Any]:
    return {
        "id": test.id,
        "glove": test.glove,
        "person": test.person,
        "phase": test.phase.value,
        "reason": test.reason,
        "began_at": test.began_at,
        "ended_at": test.ended_at,
    }


def _test(row: Mapping[str, Any]) -> AccuracyTest:
    plan = orjson.loads(row["plan"])
    plan["order"] = tuple(tuple(one_round) for one_round in plan["order"])
    values = {**row, "plan": Plan(**plan), "phase": Phase(row["phase"])}
    return AccuracyTest(**values)


def _trial(row: Mapping[str, Any]) -> Trial:
    tries = tuple(Attempt(**attempt) for attempt in orjson.loads(row["tries"]))
    return Trial(row["number"], row["round"], row["asked"], Outcome(row["outcome"]), tries, row["repeats"])
