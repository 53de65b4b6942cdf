"""A database of the version before recordings is brought to this one, with what it holds."""

from pathlib import Path

from sqlalchemy import MetaData

from handover.database import connect
from handover.database.migrations import migrate
from handover_body.storage import tables
from handover_body.storage.store import LimitRow, PersonRow, RecordingRow, Store, ValueRow
from tests.kit.databases import default_url


def test_a_database_without_recordings_gets_them(tmp_path: Path) -> None:
    engine = connect(f"sqlite:///{tmp_path / 'human-state.db'}")
    before = MetaData()
    for table in tables.meta.sorted_tables:
        if table is not tables.recordings:
            table.to_metadata(before)
    migrate(engine, before, component=tables.COMPONENT, version=1)
    store = Store(engine)
    person = PersonRow("aino", "P-1", 60.0, 180.0, "given", 1)
    store.save_person(person, LimitRow("aino", 90.0, 125.0, 0.2, is_stopped=False))
    for _ in range(2):
        tables.prepare(engine)
    recording = RecordingRow("R-1", "P-1", "lift", 2, "Eero")
    store.save_recording(recording)
    assert store.recordings() == [recording]
    assert store.load().persons == [person]
    engine.dispose()


def test_a_month_of_history_is_thinned_and_summed_up_where_it_is_stored(tmp_path: Path) -> None:
    engine = connect(default_url(tmp_path, "human-state") or f"sqlite:///{tmp_path / 'human-state.db'}")
    tables.prepare(engine)
    store = Store(engine)
    day_us = 86_400_000_000
    numbers = [
        ValueRow("P-1", "heartRate", at_s * 1_000_000, 60.0 + at_s % 86_400 / 3600, None, 1.0, "valid")
        for at_s in range(0, 720 * 3600, 3600)
    ]
    bad = ValueRow("P-1", "heartRate", 1_800_000_000, 250.0, None, 0.0, "implausible")
    store.add_values([*numbers, bad, ValueRow("P-2", "heartRate", 0, 10.0, None, 1.0, "valid")])
    points = store.points("P-1", "heartRate", 0, 30 * day_us - 1, 30)
    assert [point.values for point in points] == [24] * 30
    assert {(point.least, point.mean, point.most) for point in points} == {(60.0, 71.5, 83.0)}
    assert points[1].at_us == day_us + day_us // 2
    assert len(store.points("P-1", "heartRate", 0, 30 * day_us, 7)) == 7
    assert store.points("P-1", "spo2", 0, day_us, 10) == []

    texts = [(0, "lying", "valid"), (4, "upright", "valid"), (6, "upright", "stale"), (7, "lying", "valid")]
    store.add_values(
        [ValueRow("P-1", "posture", at * 1_000_000, None, text, 1.0, status) for at, text, status in texts]
    )
    found = store.durations("P-1", "posture", 0, day_us)
    assert found == [("lying", 14.0), ("upright", 2.0)], "the sensor was off after ten seconds"
    engine.dispose()
