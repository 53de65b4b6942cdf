"""A copy of a broker's files that is made while it writes has every change acknowledged before."""

import sqlite3
import threading
from contextlib import closing
from pathlib import Path

from handover_broker.storage import check
from handover_broker.storage.database import SqliteDatabase
from handover_broker.storage.entries import EntityRow, Entries
from handover_broker.storage.journal import Journal
from handover_broker.storage.online_copy import snapshot_with_log

ROUNDS = 8
BODY_BYTES = 3_000
"""Large changes, so that the two files of the log are overwritten again and again."""


def numbers_in(path: Path) -> list[int]:
    """Return the numbers of the entities in a copy, after a start has recovered its log."""
    journal = Journal(SqliteDatabase(path))
    journal.open()
    journal.close()
    with closing(sqlite3.connect(path)) as reader:
        return [number for (number,) in reader.execute("SELECT seq FROM entities ORDER BY seq")]


def test_each_copy_is_sound_and_has_what_was_acknowledged(tmp_path: Path) -> None:
    journal = Journal(SqliteDatabase(tmp_path / "broker.db"))
    journal.open()
    acknowledged, is_enough = 0, threading.Event()

    def write() -> None:
        nonlocal acknowledged
        while not is_enough.is_set():
            number = acknowledged + 1
            row = EntityRow("", f"urn:{number}", bytes([number % 251]) * BODY_BYTES)
            journal.commit(Entries(entities={number: row}))
            acknowledged = number

    writer = threading.Thread(target=write)
    writer.start()
    try:
        for number in range(ROUNDS):
            folder = tmp_path / f"copy-{number}"
            folder.mkdir()
            before = acknowledged
            snapshot = snapshot_with_log(tmp_path / "broker.db", folder)
            snapshot.write(folder / "broker.db")
            snapshot.close()
            assert list(check.faults_in(folder / "broker.db")) == []
            found = numbers_in(folder / "broker.db")
            assert found == list(range(1, len(found) + 1)), "a change is missing"
            assert len(found) >= before, "an acknowledged change is missing"
    finally:
        is_enough.set()
        writer.join()
        journal.close()
