"""The ends of Tasks survive a restart, and are kept for longer than a broker holds finished Tasks."""

from pathlib import Path

import pytest

from handover.errors import UsageError
from handover.settings import Settings
from handover.tasks.finished_tasks import DELETE_OLD_EVERY, MIN_KEEP_H, End, FinishedTasks, KnownAct
from handover_datamodels.entities import TaskStatus

LIT = End(TaskStatus.COMPLETED, {"lit": True, "note": "größer"})
HOUR_S = 3600.0


def settings(folder: Path, retention_h: float = 24.0) -> Settings:
    return Settings.load(data_dir=folder, retention_h=retention_h)


async def test_what_was_recorded_is_found_after_a_restart(tmp_path: Path) -> None:
    before = FinishedTasks(settings(tmp_path), "lamp/1")
    await before.open()
    assert await before.find("urn:t") is None
    await before.record("urn:t", End(TaskStatus.FAILED, {"reason": "cancelled"}))
    await before.record("urn:t", LIT)
    after = FinishedTasks(settings(tmp_path), "lamp/1")
    await after.open()  # the first is still open, as after kill -9
    assert await after.find("urn:t") == LIT
    await after.record("urn:t", End(TaskStatus.FAILED, {"reason": "cancelled"}))
    assert await after.find("urn:t") == LIT, "what was done stays done"
    await after.close()
    await before.close()
    assert before.path.parent == tmp_path


@pytest.mark.nightly
@pytest.mark.parametrize(("retention_h", "kept_h"), [(24.0, MIN_KEEP_H), (2000.0, 4000.0), (0.0, MIN_KEEP_H)])
async def test_records_outlive_the_task_in_the_broker(
    tmp_path: Path, retention_h: float, kept_h: float
) -> None:
    now_s = 0.0
    tasks = FinishedTasks(settings(tmp_path, retention_h), "lamp", clock=lambda: now_s)
    await tasks.open()
    await tasks.record("old", LIT)
    for hours, is_kept in ((kept_h - 1, True), (kept_h + 1, False)):
        now_s = hours * HOUR_S
        for n in range(DELETE_OLD_EVERY):
            await tasks.record(f"new-{n}", LIT)
        assert (await tasks.find("old") is not None) is is_kept
    await tasks.close()


async def test_an_act_that_was_begun_is_known_after_a_restart_with_its_result(tmp_path: Path) -> None:
    before = FinishedTasks(settings(tmp_path), "lamp")
    await before.open()
    assert await before.begin_act("urn:t", "grip") is None
    assert await before.begin_act("urn:t", "release") is None
    await before.end_act("urn:t", "grip", {"part": "größer"})
    after = FinishedTasks(settings(tmp_path), "lamp")
    await after.open()  # the first is still open, as after kill -9
    assert await after.begin_act("urn:t", "grip") == KnownAct({"part": "größer"})
    assert await after.begin_act("urn:t", "release") == KnownAct(None)
    assert await after.begin_act("urn:other", "release") is None
    await after.record("urn:t", LIT)
    assert await after.begin_act("urn:t", "grip") is None, "the end of the Task counts now"
    await after.close()
    await before.close()


async def test_a_file_that_is_no_database_is_refused_with_the_way_out(tmp_path: Path) -> None:
    tasks = FinishedTasks(settings(tmp_path), "lamp")
    tasks.path.write_bytes(b"this is not a database at all " * 100)
    with pytest.raises(UsageError, match=r"lamp\.finished\.db: file is not a database; restore"):
        await tasks.open()
    await tasks.close()


async def test_outputs_that_are_no_json_are_refused(tmp_path: Path) -> None:
    tasks = FinishedTasks(settings(tmp_path), "lamp")
    await tasks.open()
    with pytest.raises(TypeError):
        await tasks.record("urn:t", End(TaskStatus.COMPLETED, {"lit": {1, 2}}))
    assert await tasks.find("urn:t") is None
    await tasks.close()
