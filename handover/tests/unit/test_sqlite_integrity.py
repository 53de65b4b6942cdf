"""A database whose acknowledged content is no longer complete is refused; one that was only killed is not."""

import os
import random
import shutil
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from contextlib import closing, suppress
from pathlib import Path
from typing import Final

import pytest
from sqlalchemy import text

from handover.database import connect
from handover.database.sqlite_integrity.wal_file import read_wal
from handover.errors import UsageError
from handover.settings import Settings
from handover.tasks.finished_tasks import End, FinishedTasks
from handover_cell.check import DatabaseFaults, check_database
from handover_datamodels.entities import TaskStatus
from tests.kit.small_disk import small_disk

WRITES: Final = """
import sys
from sqlalchemy import text
from handover.database import connect
from handover.database.sqlite_integrity import checkpoints
checkpoints.INTERVAL_S, checkpoints.MIN_INTERVAL_S = float(sys.argv[2]), 0.0
engine = connect(f"sqlite:///{sys.argv[1]}")
with engine.begin() as connection:
    connection.execute(text("CREATE TABLE IF NOT EXISTS lamps (id INTEGER PRIMARY KEY, name TEXT)"))
for number in range(100_000):
    with engine.begin() as connection:
        statement = text("INSERT INTO lamps (name) VALUES (:name)")
        key = connection.execute(statement, {"name": f"lamp {number} " * (number % 90)}).lastrowid
    print(key, flush=True)
"""


def killed_while_writing(file: Path, lines: int, *, checkpoint_s: float) -> int:
    """Kill a process that writes rows after `lines` of them; return the last acknowledged id."""
    with subprocess.Popen(
        [sys.executable, "-c", WRITES, str(file), str(checkpoint_s)], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        for _ in range(lines):
            last = process.stdout.readline()
        process.send_signal(signal.SIGKILL)
        rest = process.stdout.read().splitlines()
    return int(rest[-1] if rest and rest[-1].isdigit() else last)


def count_of(file: Path) -> int:
    engine = connect(f"sqlite:///{file}")
    try:
        with engine.connect() as connection:
            return int(connection.execute(text("SELECT count(*) FROM lamps")).scalar() or 0)
    finally:
        engine.dispose()


def wal_of(file: Path) -> Path:
    return file.with_name(f"{file.name}-wal")


@pytest.mark.nightly
def test_a_database_whose_writer_was_killed_at_any_moment_is_complete_and_accepted(tmp_path: Path) -> None:
    file = tmp_path / "lamp.db"
    for commits in (1, 3, 40, 7, 120, 2, 64, 33):
        acknowledged = killed_while_writing(file, commits, checkpoint_s=0.0)
        assert check_database(file).faults == []
        assert count_of(file) >= acknowledged


def test_a_database_is_checked_while_a_service_writes_it(tmp_path: Path) -> None:
    file = tmp_path / "lamp.db"
    with subprocess.Popen(
        [sys.executable, "-c", WRITES, str(file), "0"], stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout is not None
            for _ in range(25):
                for _ in range(5):
                    process.stdout.readline()
                assert check_database(file).faults == []
        finally:
            process.kill()


def without_log(file: Path, _: random.Random) -> None:
    wal_of(file).unlink()
    with suppress(FileNotFoundError):
        file.with_name(f"{file.name}-shm").unlink()


def with_a_bit_of_the_log_flipped(file: Path, chance: random.Random) -> None:
    log = read_wal(file)
    assert log is not None
    committed = [number for number, frame in enumerate(log.frames(), start=1) if frame.database_pages]
    flip(wal_of(file), chance.randrange(0, 32 + committed[-2] * (24 + log.page_size)))


def with_an_older_copy(file: Path, _: random.Random) -> None:
    for copy in file.with_name("older").iterdir():
        shutil.copy(copy, file.with_name(copy.name))
    if not file.with_name("older").joinpath(wal_of(file).name).exists():
        wal_of(file).unlink(missing_ok=True)


def flip(file: Path, position: int) -> None:
    with file.open("r+b") as opened:
        opened.seek(position)
        byte = opened.read(1)[0]
        opened.seek(position)
        opened.write(bytes([byte ^ 1 << position % 8]))


@pytest.mark.nightly
@pytest.mark.parametrize("harm", [without_log, with_a_bit_of_the_log_flipped, with_an_older_copy])
@pytest.mark.parametrize("seed", range(3))
def test_lost_commits_are_reported_at_the_start_and_by_the_check(
    tmp_path: Path, harm: Callable[[Path, random.Random], None], seed: int
) -> None:
    file = tmp_path / "lamp.db"
    killed_while_writing(file, 20, checkpoint_s=3600.0)
    older = tmp_path / "older"
    older.mkdir()
    for part in (file, wal_of(file)):
        shutil.copy(part, older / part.name)
    killed_while_writing(file, 20, checkpoint_s=3600.0)
    harm(file, random.Random(seed))
    with pytest.raises(
        UsageError, match=r"damaged data: .*lamp\.db: the last \d+ of \d+ changes are missing"
    ):
        connect(f"sqlite:///{file}")
    assert any("changes are missing" in fault for fault in check_database(file).faults)


@pytest.mark.nightly
@pytest.mark.parametrize("is_killed", [True, False])
def test_any_flipped_bit_of_the_file_is_reported(tmp_path: Path, is_killed: bool) -> None:
    file = tmp_path / "lamp.db"
    killed_while_writing(file, 60, checkpoint_s=0.0)
    count_of(file)  # a clean end: everything is in the file
    if is_killed:
        killed_while_writing(file, 2, checkpoint_s=3600.0)
    newer = read_wal(file)
    replaced = {frame.page for frame in newer.frames()} if newer is not None else set()
    with closing(sqlite3.connect(f"{file.as_uri()}?mode=ro", uri=True)) as database:
        ((page_size,),) = database.execute("PRAGMA page_size")
    chance = random.Random(7)
    compared = [page for page in range(file.stat().st_size // page_size) if page + 1 not in replaced]
    for _ in range(40):
        position = chance.choice(compared) * page_size + chance.randrange(page_size)
        flip(file, position)
        with pytest.raises(UsageError, match=r"damaged data: .*lamp\.db"):
            connect(f"sqlite:///{file}")
        assert check_database(file).faults
        flip(file, position)
    count_of(file)


@pytest.mark.nightly
@pytest.mark.parametrize(
    "content", [b"\xff\xfe\x00", b"", b"6b8b4567", b"6b8b4567\n00000000000000000001 00000000\n"]
)
def test_a_stamp_that_is_none_is_named(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "lamp.db"
    killed_while_writing(file, 3, checkpoint_s=0.0)
    file.with_name("lamp.db.stamp").write_bytes(content)
    with pytest.raises(UsageError, match=r"damaged data: .*lamp\.db\.stamp is damaged; if you replaced"):
        connect(f"sqlite:///{file}")
    assert "lamp.db.stamp is damaged" in check_database(file).faults[0]


def test_a_file_that_another_program_has_checkpointed_is_accepted(tmp_path: Path) -> None:
    file = tmp_path / "lamp.db"
    acknowledged = killed_while_writing(file, 30, checkpoint_s=3600.0)
    with closing(sqlite3.connect(file)) as database:
        database.execute("SELECT count(*) FROM lamps").fetchall()
    assert not wal_of(file).exists()
    assert count_of(file) >= acknowledged
    with file.open("r+b") as opened:  # from now on its pages are compared again
        opened.seek(file.stat().st_size - 100)
        opened.write(os.urandom(50))
    with pytest.raises(UsageError, match="damaged data"):
        connect(f"sqlite:///{file}")


def test_a_killed_service_starts_and_commits_on_a_full_disk(tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk", 16) as disk:
        file = disk.folder / "lamp.db"
        killed_while_writing(file, 50, checkpoint_s=0.0)
        disk.fill()
        acknowledged = killed_while_writing(file, 50, checkpoint_s=3600.0)
        assert check_database(file).faults == []
        disk.free()
        assert count_of(file) >= acknowledged
        assert check_database(file) == DatabaseFaults([])


async def test_lost_ends_of_tasks_are_reported(tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path)
    tasks = FinishedTasks(settings, "arm")
    await tasks.open()
    older = tmp_path / "older"
    older.mkdir()
    shutil.copy(tasks.path, older / tasks.path.name)
    for number in range(3):
        await tasks.record(f"urn:ngsi-ld:Task:demo:{number}", End(TaskStatus.COMPLETED, {}))
    await tasks.close()
    shutil.copy(older / tasks.path.name, tasks.path)
    with pytest.raises(UsageError, match="the last 4 of 4 changes are missing"):
        await FinishedTasks(settings, "arm").open()
