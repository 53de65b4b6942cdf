"""`handover check`: all databases in the data directory, looked at completely."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from handover.database import connect
from handover_broker.storage.database import SqliteDatabase
from handover_broker.storage.entries import EntityRow, Entries
from handover_broker.storage.history_archive import HistoryRow
from handover_broker.storage.journal import Journal


def checked(folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "handover_cell", "check", "--data-dir", str(folder), *options],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


@pytest.fixture
def data_dir(tmp_path: Path) -> Path:
    """What a broker and an orchestrator have left."""
    tmp_path.chmod(0o700)
    journal = Journal(SqliteDatabase(tmp_path / "broker.db"))
    journal.open()
    for place in range(1, 50):
        row = HistoryRow(place, place, None, None, 0, b"past %d" % place * 20)
        body = b"present %d" % place * 20
        journal.commit(Entries(entities={place: EntityRow("", f"urn:{place}", body)}, history=[row]))
    journal.close()
    connect(f"sqlite:///{tmp_path / 'orchestrator.db'}").dispose()
    for file in tmp_path.iterdir():
        file.chmod(0o600)
    return tmp_path


def flip(file: Path, text: bytes) -> None:
    content = bytearray(file.read_bytes())
    content[content.index(text)] ^= 1
    file.write_bytes(content)


@pytest.mark.nightly
def test_sound_data_are_found_sound_also_while_a_broker_uses_them(data_dir: Path) -> None:
    journal = Journal(SqliteDatabase(data_dir / "broker.db"))
    for is_used in (False, True):
        if is_used:
            journal.open()
        reported = checked(data_dir)
        assert reported.returncode == 0, reported.stdout
        assert reported.stdout.splitlines() == [
            f"ok       {data_dir / 'broker.db'}",
            f"ok       {data_dir / 'orchestrator.db'}",
        ]
    journal.close()


def past(folder: Path) -> None:
    flip(folder / "broker.db", b"past 7past 7")


def present(folder: Path) -> None:
    flip(folder / "broker.db", b"present 7present 7")


def deleted(folder: Path) -> None:
    (folder / "orchestrator.db").unlink()


def without_database(folder: Path) -> None:
    (folder / "broker.db").unlink()


def cut(folder: Path) -> None:
    os.truncate(folder / "broker.db", 40_000)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("harm", "words"),
    [
        (past, "broker.db: history: the row 7, 7, None is not as it was written"),
        (present, "broker.db: entities: the row 7,  is not as it was written"),
        (deleted, "orchestrator.db is missing, but orchestrator.db.stamp shows that it was created"),
        (without_database, "broker.db is missing, while broker.log-1 and broker.log-2 beside it"),
        (cut, "broker.db: "),
    ],
)
def test_damage_is_listed_with_the_remedy(data_dir: Path, harm: Callable[[Path], None], words: str) -> None:
    harm(data_dir)
    reported = checked(data_dir)
    assert reported.returncode == 1, reported.stdout + reported.stderr
    damaged = [line for line in reported.stdout.splitlines() if line.startswith("damaged  ")]
    assert any(words in line for line in damaged), reported.stdout
    assert "deploy/restore" in reported.stdout.splitlines()[-1]
    assert "Traceback" not in reported.stderr


@pytest.mark.nightly
def test_an_empty_folder_has_nothing_to_check(tmp_path: Path) -> None:
    tmp_path.chmod(0o700)
    reported: Any = checked(tmp_path)
    assert reported.returncode == 0
    assert "there is no database in" in reported.stdout


@pytest.mark.nightly
def test_a_folder_that_is_missing_is_named(tmp_path: Path) -> None:
    reported = checked(tmp_path, "--data-dir", str(tmp_path / "elsewhere"))
    assert reported.returncode == 2
    assert f"there is no data directory {tmp_path / 'elsewhere'}" in reported.stderr
    assert not (tmp_path / "elsewhere").exists()


@pytest.mark.nightly
def test_what_could_not_be_checked_is_no_success(data_dir: Path) -> None:
    (data_dir / "orchestrator.db").unlink()
    (data_dir / "orchestrator.db").mkdir()
    reported = checked(data_dir)
    assert reported.returncode == 1, reported.stdout + reported.stderr
    assert "orchestrator.db" in reported.stdout


@pytest.mark.nightly
def test_what_others_can_read_is_no_success(data_dir: Path) -> None:
    (data_dir / "broker.db").chmod(0o644)
    reported = checked(data_dir)
    assert reported.returncode == 1
    assert "broker.db can be read by others" in reported.stdout
