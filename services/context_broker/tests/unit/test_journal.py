"""The journal between releases: files of other formats are refused and left unchanged."""

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from handover.errors import UsageError
from handover_broker.storage.database import SqliteDatabase
from handover_broker.storage.entries import DocumentKind, EntityRow, Entries
from handover_broker.storage.journal import SCHEMA_VERSION, Journal


def version_of(file: Path) -> int:
    with closing(sqlite3.connect(file)) as database:
        (version,) = database.execute("PRAGMA user_version").fetchone()
    return int(version)


def written(file: Path) -> None:
    journal = Journal(SqliteDatabase(file))
    journal.open()
    journal.commit(
        Entries(
            entities={1: EntityRow("", "urn:e", b"one")},
            documents={(DocumentKind.CONTEXT, "", "http://context"): b"{}"},
        )
    )
    journal.close()


def test_a_new_journal_has_the_version_of_this_release(tmp_path: Path) -> None:
    written(tmp_path / "broker.db")
    assert version_of(tmp_path / "broker.db") == SCHEMA_VERSION


def test_a_journal_is_read_again(tmp_path: Path) -> None:
    written(tmp_path / "broker.db")
    journal = Journal(SqliteDatabase(tmp_path / "broker.db"))
    journal.open()
    assert list(journal.entities()) == [("", b"one")]
    assert list(journal.documents(DocumentKind.CONTEXT)) == [("", "http://context", b"{}")]
    journal.close()


def test_a_journal_of_a_newer_release_is_refused_and_left_as_it_is(tmp_path: Path) -> None:
    file = tmp_path / "broker.db"
    written(file)
    with closing(sqlite3.connect(file)) as database:
        database.execute(f"PRAGMA user_version = {SCHEMA_VERSION + 1}")
    before = file.read_bytes()
    journal = Journal(SqliteDatabase(file))
    with pytest.raises(UsageError, match=r"broker\.db was written by a newer version of Handover"):
        journal.open()
    journal.close()
    assert version_of(file) == SCHEMA_VERSION + 1
    assert file.read_bytes() == before


def test_an_invalid_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "broker.db").write_bytes(b"not a database at all, but long enough to look at" * 100)
    journal = Journal(SqliteDatabase(tmp_path / "broker.db"))
    with pytest.raises(UsageError, match=r"damaged data: .*broker\.db: file is not a database; restore"):
        journal.open()
    journal.close()


BEFORE_THE_FIRST_RELEASE = """
CREATE TABLE entities (seq INTEGER PRIMARY KEY, body BLOB NOT NULL);
INSERT INTO entities VALUES (7, 'seven');
PRAGMA user_version = {version};
"""


@pytest.mark.parametrize("version", [1, 2, 3, 4])
def test_a_file_of_before_the_first_release_is_refused_and_left_unchanged(
    tmp_path: Path, version: int
) -> None:
    file = tmp_path / "broker.db"
    with closing(sqlite3.connect(file)) as database:
        database.executescript(BEFORE_THE_FIRST_RELEASE.format(version=version))
    before = file.read_bytes()
    journal = Journal(SqliteDatabase(file))
    reason = rf"broker\.db has the format {version} of a version before the first release"
    with pytest.raises(UsageError, match=rf"{reason}.* move the data directory away"):
        journal.open()
    journal.close()
    assert file.read_bytes() == before
    assert sorted(one.name for one in tmp_path.iterdir()) == ["broker.db", "broker.db.lock"]
