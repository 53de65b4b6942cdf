"""The log of sessions: complete after a crash, without a trace of who the person is."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from sqlalchemy import Engine

from handover.database import connect
from handover.settings import Settings
from handover_cases.machines.treadmill import session_log
from handover_cases.machines.treadmill.coach import Advice, Decision, Intensity, Reason
from handover_cases.machines.treadmill.session_log import INTERRUPTED, SessionLog, SessionRow
from handover_cases.machines.treadmill.wording import Words

DAY_US = 86_400_000_000
FASTER = Decision(Advice.FASTER, Reason.BELOW, 30.0)


def session(name: str, started_us: int = 5 * DAY_US) -> SessionRow:
    return SessionRow(name, started_us, 600.0, Intensity.LIGHT, "en", consents_to_model=False)


@pytest.fixture
def engine(tmp_path: Path) -> Iterator[Engine]:
    made = connect(Settings(data_dir=tmp_path).database("assistive-devices"))
    yield made
    made.dispose()


@pytest.fixture
def log(engine: Engine) -> SessionLog:
    made = SessionLog(engine)
    made.open(5 * DAY_US, keep_days=30)
    return made


def test_interventions_are_logged_with_time_advice_and_words(log: SessionLog) -> None:
    log.begin(session("s"))
    log.add("s", 1, FASTER, 30)
    undecided = log.interventions("s")
    log.word("s", 1, Words("Walk a little faster.", "model"))
    log.add("s", 2, Decision(Advice.KEEP, Reason.INSIDE, 60.0), 60)
    log.end("s", 600, "time", 512.5)
    log.end("s", 700, "person", 1.0)
    assert [(one.text, one.advice) for one in undecided] == [(None, Advice.FASTER)]
    found = log.interventions("s")
    assert [(one.number, one.at_us, one.advice, one.text) for one in found] == [
        (1, 30, Advice.FASTER, "Walk a little faster."),
        (2, 60, Advice.KEEP, None),
    ]
    ended = log.sessions()[0]
    assert (ended.ended_us, ended.end_reason, ended.distance_m) == (600, "time", 512.5)


def test_what_was_interrupted_is_closed_and_what_is_old_is_deleted(log: SessionLog) -> None:
    for name, started_us in (("old", DAY_US), ("cut", 40 * DAY_US), ("silent", 41 * DAY_US)):
        log.begin(session(name, started_us))
    log.add("old", 1, FASTER, DAY_US + 30)
    log.add("cut", 1, FASTER, 40 * DAY_US + 30)
    log.open(42 * DAY_US, keep_days=30)
    assert [(one.id, one.ended_us, one.end_reason) for one in log.sessions()] == [
        ("silent", 41 * DAY_US, INTERRUPTED),
        ("cut", 40 * DAY_US + 30, INTERRUPTED),
    ]
    assert not log.interventions("old")


def test_no_column_says_who_the_person_is_or_how_the_heart_beats() -> None:
    names = {column.name for table in session_log.meta.tables.values() for column in table.columns}
    assert names == {
        *("id", "started_us", "duration_s", "intensity", "language", "consents_to_model", "ended_us"),
        *("end_reason", "distance_m", "session", "number", "at_us", "advice", "reason", "text", "source"),
        "problem",
    }


def test_what_was_acknowledged_survives_a_kill(tmp_path: Path) -> None:
    code = f"""
import sys
from pathlib import Path
sys.path.insert(0, {str(Path(__file__).parent)!r})
from test_session_log import *
log = SessionLog(connect(Settings(data_dir=Path({str(tmp_path)!r})).database("assistive-devices")))
log.open(0, 30)
log.begin(session("s"))
for number in range(1, 10_000):
    log.add("s", number, FASTER, number)
    print(number, flush=True)
"""
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as writer:
        assert writer.stdout is not None
        acknowledged = [int(writer.stdout.readline()) for _ in range(5)][-1]
        os.kill(writer.pid, signal.SIGKILL)
        rest = writer.stdout.read().split()
    acknowledged = max([acknowledged, *(int(line) for line in rest if line.isdigit())])
    engine = connect(Settings(data_dir=tmp_path).database("assistive-devices"))
    log = SessionLog(engine)
    log.open(0, 30)
    assert [one.number for one in log.interventions("s")][:acknowledged] == [*range(1, acknowledged + 1)]
    assert log.sessions()[0].end_reason == INTERRUPTED
    engine.dispose()
