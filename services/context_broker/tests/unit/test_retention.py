"""Retention: deletion of old history, and of expired history."""

from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from handover_broker.model.validation import moment, timestamp
from handover_broker.storage.database import SqliteDatabase
from handover_broker.storage.entries import Entries
from handover_broker.storage.history_archive import TemporalOnlyRow
from handover_broker.storage.journal import Journal, NotStored
from handover_broker.temporal.history import HistoryRecorder, RowContent, TemporalOnlyEntity, micros_of
from handover_broker.temporal.retention import Retention

from .recorded_entities import START, RecordedEntity


@pytest.fixture
def own(tmp_path: Path) -> Iterator[Journal]:
    made = Journal(SqliteDatabase(tmp_path / "broker.db"))
    made.open()
    yield made
    made.close()


class Straight:
    """Commits at once, in the test's own thread."""

    def __init__(self, journal: Journal) -> None:
        self.journal = journal

    async def store(self, entries: Entries) -> None:
        self.journal.commit(entries)


async def test_old_history_and_departed_entities_are_deleted_in_small_commits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("handover_broker.temporal.retention.CHANGES_PER_COMMIT", 3)
    monkeypatch.setattr("handover_broker.temporal.retention.PAUSE_S", 0)
    monkeypatch.setattr("handover_broker.temporal.retention.ENTITIES_PER_SCAN", 1)
    own = Journal(SqliteDatabase(tmp_path / "broker.db"))
    own.open()
    living, gone, young = (
        RecordedEntity(own),
        RecordedEntity(own),
        RecordedEntity(own, now=START + timedelta(days=2)),
    )
    for life in (living, gone, young):
        life.create({"speed": 0})
        for number in range(8):
            life.change({"speed": number + 1})
    gone.take(None, gone.step())
    young.take(None, young.step())
    for life in (living, gone, young):
        life.commit()
    # A deletion is stamped by the clock on the wall; everything else here is of January 2026.
    before = micros_of(timestamp(START + timedelta(days=1)))
    retention = Retention(own.archive, Straight(own), 1)  # type: ignore[arg-type]  # all that it needs of them
    assert await retention.clear(before) == 6
    assert list(own.archive.history([living.place])) == []
    assert [one for one, _, _ in own.archive.temporal_only_entities("")] == [gone.place, young.place]
    assert len(list(own.archive.history([gone.place]))) == 1
    assert len(list(own.archive.history([young.place]))) == 10
    assert await retention.clear(micros_of(timestamp(datetime.now(UTC) + timedelta(days=1)))) > 0
    assert list(own.archive.temporal_only_entities("")) == []
    assert await retention.clear(2**62) == 0
    own.close()
    with pytest.raises(NotStored):
        Journal(SqliteDatabase(tmp_path / "none" / "broker.db")).archive.first_change(0)


async def test_expired_history_is_deleted_with_all_earlier_places(
    own: Journal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("handover_broker.temporal.retention.CHANGES_PER_COMMIT", 2)
    monkeypatch.setattr("handover_broker.temporal.retention.PAUSE_S", 0)
    at, end = "2026-01-01T00:00:00Z", "2026-01-02T00:00:00Z"
    recorder, entries = HistoryRecorder(), Entries()
    kept = {
        1: ("urn:x:gone", TemporalOnlyEntity(("urn:t",), (), at, at, at)),
        2: ("urn:x:stays", TemporalOnlyEntity(("urn:t",), (), at, at, None)),
        3: ("urn:x:gone", TemporalOnlyEntity(("urn:t",), (), at, at, None, end)),
        4: ("urn:x:gone", TemporalOnlyEntity(("urn:t",), (), at, at, None)),
    }
    for place, (entity_id, temporal_only) in kept.items():
        assert TemporalOnlyEntity.restored(temporal_only.stored()) == temporal_only
        entries.temporal_only[place] = TemporalOnlyRow("", entity_id, temporal_only.stored())
        for number in range(5):
            instance = {"type": "Property", "value": number, "observedAt": at}
            entries.history.append(recorder.row(place, RowContent({"urn:a": [instance]}), at))
    own.commit(entries)
    retention = Retention(own.archive, Straight(own), 0, tenants=lambda: [""])  # type: ignore[arg-type]
    end_s = moment(end) or 0.0
    assert await retention.end(end_s - 1) == 0
    assert await retention.end(end_s) == 2
    assert [place for place, _, _ in own.archive.temporal_only_entities("")] == [2, 4]
    assert [len(list(own.archive.history([place]))) for place in kept] == [0, 5, 0, 5]
