"""The event log: each event once, in order, across restarts, and a limited number."""

from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import text

from handover.database import connect
from handover_datamodels.times import iso
from handover_web.live import event_log as event_log_module
from handover_web.live.event_log import Event, EventLog

BEGAN = "2026-01-01T00:00:00.000Z"


def event(number: int, subject: str = "lamp", at: str = "2999-01-01T00:00:00.000Z") -> Event:
    return Event(subject, f"{number}", "lamp.lit", "lamp-1", f"lit {number}", at, values={"n": number})


class Listener:
    """Collects the published events."""

    def __init__(self) -> None:
        self.seqs: list[int] = []

    def __call__(self, seq: int, event: Any) -> None:
        assert event["seq"] == seq
        self.seqs.append(seq)


def log_in(folder: Path, listener: Listener | None = None) -> EventLog:
    return EventLog(connect(f"sqlite:///{folder / 'webui.db'}"), listener or Listener())


async def test_repeated_events_are_recorded_once(tmp_path: Path) -> None:
    async with log_in(tmp_path) as log:
        assert log.record(event(1))
        assert not log.record(event(1))
        assert log.record(event(1, subject="another lamp"))
    async with log_in(tmp_path) as log:
        assert not log.record(event(1))
        assert [event["seq"] for event in await log.after(0, 10)] == [1, 2]


async def test_sequence_numbers_continue_and_events_are_published_again_after_a_restart(
    tmp_path: Path,
) -> None:
    async with log_in(tmp_path) as log:
        log.record(event(1))
        log.record(event(2))
    listener = Listener()
    async with log_in(tmp_path, listener) as log:
        assert listener.seqs == [1, 2]
        log.record(event(3))
    assert listener.seqs == [1, 2, 3]


async def test_events_older_than_the_log_are_not_recorded(tmp_path: Path) -> None:
    async with log_in(tmp_path) as log:
        assert not log.record(event(1, at=BEGAN))
        assert log.record(event(2))
    async with log_in(tmp_path) as log:  # the oldest stored event
        assert log.oldest_at == event(2).at


async def test_current_events_are_recorded_although_they_are_older_than_the_log(tmp_path: Path) -> None:
    old = Event("alert-1", "raised", "alert.raised", "conveyor-1", "alert: blocked", BEGAN)
    async with log_in(tmp_path) as log:
        assert not log.record(old)
        assert log.record(old, is_current=True)
        assert not log.record(old, is_current=True)
        assert log.record(event(2))
    async with log_in(tmp_path) as log:
        assert not log.record(old, is_current=True)
        assert log.oldest_at == event(2).at, "an old Alert does not make the log older"


async def test_a_new_log_accepts_clocks_that_are_minutes_slow(tmp_path: Path) -> None:
    slow = iso(datetime.now(UTC) - timedelta(minutes=2), "milliseconds")
    async with log_in(tmp_path) as log:
        assert log.record(event(1, at=slow))


async def test_events_are_read_after_and_before_a_sequence_number(tmp_path: Path) -> None:
    async with log_in(tmp_path) as log:
        for number in range(1, 11):
            log.record(event(number))
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


async def test_the_log_keeps_the_newest_events_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(event_log_module, "MAX_EVENTS", 300)
    async with log_in(tmp_path) as log:
        for number in range(1, 1001):
            log.record(event(number))
    engine = connect(f"sqlite:///{tmp_path / 'webui.db'}")
    with engine.connect() as connection:
        count, first, last = connection.execute(
            text("select count(*), min(seq), max(seq) from webui_events")
        ).one()
    engine.dispose()
    assert (count, first, last) == (300, 701, 1000)


async def test_events_are_published_when_the_disk_fails(tmp_path: Path) -> None:
    listener = Listener()
    async with log_in(tmp_path, listener) as log:
        spoiler = connect(f"sqlite:///{tmp_path / 'webui.db'}")
        with spoiler.begin() as connection:
            connection.execute(text("drop table webui_events"))
        spoiler.dispose()
        log.record(event(1))
    assert listener.seqs == [1]


def test_timestamps_are_normalized() -> None:
    assert event_log_module.normalized_timestamp("2026-01-01T13:00:00+01:00") == "2026-01-01T12:00:00.000Z"
    assert event_log_module.normalized_timestamp("2026-01-01T12:00:00.123456Z") == "2026-01-01T12:00:00.123Z"
    assert event_log_module.normalized_timestamp("soon") > BEGAN
