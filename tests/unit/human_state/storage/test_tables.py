"""A database of the version before recordings is brought to this one, with what it holds."""

from pathlib import Path

from sqlalchemy import MetaData

from handover.database import connect
from handover.migrations import migrate
from services.human_state.storage import tables
from services.human_state.storage.store import LimitRow, PersonRow, RecordingRow, Store


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
