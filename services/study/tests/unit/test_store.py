"""The store: kept at once, in order, once; and really gone when it is deleted. On SQLite and PostgreSQL."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from sqlalchemy import Engine

from handover.database import connect
from handover.errors import Problem
from handover_study.model.protocol import FINISHED, STEPS, Session, StepAnswer
from handover_study.storage.store import StudyStore

AT = "2026-03-02T09:00:00.000000Z"


@pytest.fixture(params=["sqlite", "postgresql"])
def engine(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Engine]:
    sqlite = f"sqlite:///{tmp_path / 'controller.db'}"
    made = connect(sqlite if request.param == "sqlite" else request.getfixturevalue("new_database")())
    yield made
    made.dispose()


@pytest.fixture
def store(engine: Engine) -> StudyStore:
    made = StudyStore(engine)
    made.prepare()
    return made


def session(nth: int = 1) -> Session:
    return Session(f"s{nth}", "gestures", f"P{nth:02}", "fi", AT)


def answer(store: StudyStore, session_id: str, step: str, lot: float = 0.0, **content: object) -> None:
    known = store.session(session_id)
    assert known is not None
    store.answer(known, step, StepAnswer(content, "fi", AT, AT), lot)


def test_a_session_goes_through_all_steps_and_keeps_every_answer(store: StudyStore) -> None:
    store.add(session())
    for nth, step in enumerate(STEPS):
        answer(store, "s1", step, nth=nth)
    found = store.session("s1")
    assert found is not None
    assert (found.step, found.ended_at) == (FINISHED, AT)
    assert [dict(found.answers[step].content) for step in STEPS] == [
        {"nth": nth} for nth in range(len(STEPS))
    ]


def test_a_step_is_answered_once(store: StudyStore) -> None:
    store.add(session())
    late = store.session("s1")
    answer(store, "s1", "consent", agreed=True)
    assert late is not None
    with pytest.raises(Problem, match="has been answered meanwhile"):
        store.answer(late, "consent", StepAnswer({"agreed": False}, "fi", AT, AT), 0.0)
    found = store.session("s1")
    assert found is not None
    assert found.answers["consent"].content == {"agreed": True}


def test_orders_are_balanced_among_those_who_consented(store: StudyStore) -> None:
    for nth in range(8):
        store.add(session(nth))
        if nth != 3:
            answer(store, f"s{nth}", "consent", lot=0.9, agreed=True)
    firsts = [one.first for one in store.sessions()]
    assert firsts.count(None) == 1
    assert [first.value for first in firsts if first][:2] == ["predefined", "personal"]
    assert (
        abs(sum(first == "personal" for first in firsts) - sum(first == "predefined" for first in firsts))
        == 1
    )


def test_a_pseudonym_is_taken_once_in_a_study(store: StudyStore) -> None:
    store.add(session())
    with pytest.raises(Problem, match='"P01" takes part in "gestures" already'):
        store.add(replace(session(), id="s2"))
    store.add(replace(session(), id="s3", study="another"))
    assert [one.id for one in store.sessions("another")] == ["s3"]


def test_nothing_of_a_deleted_session_is_left_in_the_files(tmp_path: Path) -> None:
    database = connect(f"sqlite:///{tmp_path / 'controller.db'}")
    store = StudyStore(database)
    store.prepare()
    for nth in (1, 2):
        store.add(session(nth))
        answer(store, f"s{nth}", "consent", agreed=True)
    answer(store, "s1", "introduction", secret="unmistakable words" * 400)

    def found() -> list[str]:
        return [file.name for file in tmp_path.iterdir() if b"unmistakable words" in file.read_bytes()]

    assert found(), "it was written, before it is deleted"
    assert store.delete("s1") is True
    assert found() == []
    assert store.session("s1") is None
    assert store.session("s2") is not None
    assert store.delete("s1") is False
    database.dispose()
