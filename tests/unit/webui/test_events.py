"""The event log: each event once, in order, across restarts, and not more than is kept."""

from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import text

from handover.database import connect
from webui import events
from webui.events import EventLog, Happening

BEGAN = "2026-01-01T00:00:00.000Z"


def happening(number: int, subject: str = "lamp", at: str = "2999-01-01T00:00:00.000Z") -> Happening:
    return Happening(subject, f"{number}", "lamp.lit", "lamp-1", f"lit {number}", at, values={"n": number})


class Listener:
    """Remembers what the log passes on."""

    def __init__(self) -> None:
        self.seqs: list[int] = []

    def __call__(self, seq: int, event: Any) -> None:
        assert event["seq"] == seq
        self.seqs.append(seq)


def log_in(folder: Path, listener: Listener | None = None) -> EventLog:
    return EventLog(connect(f"sqlite:///{folder / 'webui.db'}"), listener or Listener())


async def test_what_is_told_twice_happened_once(tmp_path: Path) -> None:
    async with log_in(tmp_path) as log:
        assert log.record(happening(1))
        assert not log.record(happening(1))
        assert log.record(happening(1, subject="another lamp"))
    async with log_in(tmp_path) as log:
        assert not log.record(happening(1))
        assert [event["seq"] for event in await log.after(0, 10)] == [1, 2]


async def test_numbers_rise_across_restarts_and_the_last_events_are_told_again(tmp_path: Path) -> None:
    async with log_in(tmp_path) as log:
        log.record(happening(1))
        log.record(happening(2))
    listener = Listener()
    async with log_in(tmp_path, listener) as log:
        assert listener.seqs == [1, 2]
        log.record(happening(3))
    assert listener.seqs == [1, 2, 3]


async def test_what_happened_before_the_log_began_is_no_news(tmp_path: Path) -> None:
    async with log_in(tmp_path) as log:
        assert not log.record(happening(1, at=BEGAN))
        assert log.record(happening(2))
    async with log_in(tmp_path) as log:  # it began with what it holds
        assert log.began == happening(2).at


async def test_events_are_read_forwards_from_one_and_backwards_from_one(tmp_path: Path) -> None:
    async with log_in(tmp_path) as log:
        for number in range(1, 11):
            log.record(happening(number))
    async with log_in(tmp_path) as log:
        assert [event["seq"] for event in await log.after(4, 3)] == [5, 6, 7]
        assert [event["seq"] for event in await log.before(4, 2)] == [2, 3]
        newest = await log.before(None, 2)
        assert [event["seq"] for event in newest] == [9, 10]
        assert newest[-1] == {
            "seq": 10,
            "at": "2999-01-01T00:00:00.000Z",
            "level": "info",
            "source": "lamp-1",
            "key": "lamp.lit",
            "values": {"n": 10},
            "text": "lit 10",
        }


async def test_no_more_events_are_kept_than_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(events, "KEPT", 300)
    async with log_in(tmp_path) as log:
        for number in range(1, 1001):
            log.record(happening(number))
    engine = connect(f"sqlite:///{tmp_path / 'webui.db'}")
    with engine.connect() as connection:
        count, first, last = connection.execute(
            text("select count(*), min(seq), max(seq) from webui_events")
        ).one()
    engine.dispose()
    assert (count, first, last) == (300, 701, 1000)


async def test_on_a_broken_disk_people_still_see_what_happens(tmp_path: Path) -> None:
    listener = Listener()
    async with log_in(tmp_path, listener) as log:
        spoiler = connect(f"sqlite:///{tmp_path / 'webui.db'}")
        with spoiler.begin() as connection:
            connection.execute(text("drop table webui_events"))
        spoiler.dispose()
        log.record(happening(1))
    assert listener.seqs == [1]


def test_moments_are_compared_in_one_form() -> None:
    assert events.in_milliseconds("2026-01-01T13:00:00+01:00") == "2026-01-01T12:00:00.000Z"
    assert events.in_milliseconds("2026-01-01T12:00:00.123456Z") == "2026-01-01T12:00:00.123Z"
    assert events.in_milliseconds("soon") > BEGAN
