"""When a recording ends by itself, and what happens at once: real parts, without a broker or sensors."""

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

pytest.importorskip("mcap", reason="the extra [human-state] is not installed")

from handover.database import connect
from handover.errors import Problem
from handover.runtime.background_tasks import BackgroundTasks
from handover.security.service_access import ServiceAccess
from handover_body.formats.json_messages import Marker
from handover_body.fusion.baseline import Baseline
from handover_body.monitoring.monitoring import Monitoring
from handover_body.monitoring.processors import pipeline_of
from handover_body.people.consent import Purpose
from handover_body.people.people import People, now_us
from handover_body.recording import recordings as module
from handover_body.recording.archive import Archive
from handover_body.recording.recordings import Recordings
from handover_body.settings import HumanStateSettings
from handover_body.storage import tables
from handover_body.storage.store import RecordingRow, Store
from tests.kit.waiting import until

ALLOWED = frozenset({Purpose.LIVE, Purpose.RECORDING})


@pytest.fixture
async def recordings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Recordings]:
    monkeypatch.setattr(module, "SEAL_EVERY_S", 0.02)
    settings = HumanStateSettings.load(data_dir=tmp_path)
    engine = connect(f"sqlite:///{tmp_path / 'human-state.db'}")
    tables.prepare(engine)
    store = Store(engine)
    people = People(store)
    async with BackgroundTasks("test") as tasks:
        access = ServiceAccess(settings, "human-state")
        monitoring = Monitoring(
            settings, people, access, tasks, pipeline_of=pipeline_of, classifier_of=lambda: None
        )
        people.on_changed = monitoring.apply
        await people.put("aino", Baseline(60.0, 180.0, "given"), (90.0, 125.0, 0.2))
        await people.consent("aino", ALLOWED, now_us() + 3_600_000_000, "aino")
        archive = Archive(tmp_path / "recordings", bytes(32))
        made = Recordings(archive, store, people, monitoring, tasks, 30.0)
        tasks.start(made.run)
        yield made
        await made.close()
    engine.dispose()


async def ended(recordings: Recordings, row: RecordingRow) -> RecordingRow:
    def found() -> RecordingRow | None:
        now = recordings.recording(row.id, row.subject)
        return now if now.ended_us is not None else None

    made: RecordingRow = await until(found)
    return made


@pytest.mark.parametrize(
    ("limit", "value", "reason"),
    [("MIN_FREE_BYTES", 2**62, "disk"), ("MAX_HOURS", 0.0, "tooLong")],
)
async def test_a_recording_ends_at_its_limits(
    recordings: Recordings, monkeypatch: pytest.MonkeyPatch, limit: str, value: float, reason: str
) -> None:
    row = await recordings.start("aino", "", "Eero")
    recordings.mark(row, Marker(row.started_us / 1e6, "one"))
    monkeypatch.setattr(module, limit, value)
    done = await ended(recordings, row)
    assert (done.end_reason, done.messages) == (reason, 1)


async def test_a_disk_that_is_too_slow_ends_a_recording_with_what_was_taken(
    recordings: Recordings, monkeypatch: pytest.MonkeyPatch
) -> None:
    row = await recordings.start("aino", "", "Eero")
    monkeypatch.setattr(module, "MAX_WAITING", 3)
    for number in range(5):  # nothing is written between them: there is no await
        if recordings.is_running(row):
            recordings.mark(row, Marker(row.started_us / 1e6, str(number)))
    assert not recordings.is_running(row)
    assert (await ended(recordings, row)).end_reason == "disk"


async def test_a_full_disk_and_a_second_recording_are_refused(
    recordings: Recordings, monkeypatch: pytest.MonkeyPatch
) -> None:
    both = await asyncio.gather(
        *(recordings.start("aino", "", "Eero") for _ in range(2)), return_exceptions=True
    )
    (refused,) = (one for one in both if isinstance(one, Problem))
    assert refused.status == 409
    (row,) = (one for one in both if isinstance(one, RecordingRow))
    stopped = await asyncio.gather(*(recordings.stop(row) for _ in range(3)))
    assert {one.end_reason for one in stopped} == {"stopped"}
    monkeypatch.setattr(module, "MIN_FREE_BYTES", 2**62)
    with pytest.raises(Problem, match="free for recordings"):
        await recordings.start("aino", "", "Eero")


async def test_one_that_runs_can_be_deleted(recordings: Recordings, tmp_path: Path) -> None:
    row = await recordings.start("aino", "", "Eero")
    await recordings.delete(row)
    assert recordings.all() == []
    assert list((tmp_path / "recordings").iterdir()) == []
