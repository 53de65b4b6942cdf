"""The database: SQLite or PostgreSQL, and a readable word for anything else."""

import os
import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import psycopg
import pytest
from sqlalchemy import text

from handover.database import connect
from handover.database.sqlite_files import renew_marks
from handover.errors import UsageError
from handover_broker.storage.postgres import PostgresDatabase
from tests.kit.certificates import Certificates
from tests.kit.postgres_tls import tls_in_front_of


def test_sqlite_loses_nothing_that_was_committed(tmp_path: Path) -> None:
    engine = connect(f"sqlite:///{tmp_path / 'new' / 'lamp.db'}")
    with engine.connect() as connection:
        assert connection.execute(text("PRAGMA journal_mode")).scalar() == "wal"
        assert connection.execute(text("PRAGMA synchronous")).scalar() == 2
    engine.dispose()


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_a_connection_that_a_thread_still_uses_is_closed_once_it_is_returned(
    kind: str, new_database: Callable[[], str], tmp_path: Path
) -> None:
    engine = connect(new_database() if kind == "postgresql" else f"sqlite:///{tmp_path / 'lamp.db'}")
    with engine.connect() as connection:
        driver: Any = connection.connection.driver_connection
        engine.dispose()
        assert connection.execute(text("SELECT 1")).scalar() == 1
    with pytest.raises((sqlite3.ProgrammingError, psycopg.OperationalError), match="closed"):
        driver.execute("SELECT 1")


@pytest.mark.parametrize("url", ["mysql://lamp", "lamp", "", "oracle://a:b@c/d"])
def test_another_database_is_refused_by_name(url: str) -> None:
    with pytest.raises(UsageError, match="HANDOVER_DATABASE_URL"):
        connect(url)


def test_postgresql_is_reached_by_its_plain_url(new_database: Callable[[], str]) -> None:
    engine = connect(new_database())
    with engine.connect() as connection:
        assert "PostgreSQL" in str(connection.execute(text("SELECT version()")).scalar())
    engine.dispose()


def test_a_database_that_is_away_is_said_in_one_line_without_its_password() -> None:
    with pytest.raises(UsageError, match=r"cannot be used: .*HANDOVER_DATABASE_URL") as away:
        connect("postgresql://lamp:secret@127.0.0.1:1/lamp")
    assert "secret" not in str(away.value)
    assert "\n" not in str(away.value)


def test_a_file_that_cannot_be_opened_is_named(tmp_path: Path) -> None:
    (tmp_path / "lamp.db").mkdir()
    with pytest.raises(UsageError, match=r"lamp\.db cannot be used"):
        connect(f"sqlite:///{tmp_path / 'lamp.db'}")


def test_a_file_that_is_no_database_is_named_with_its_setting(tmp_path: Path) -> None:
    (tmp_path / "lamp.db").write_text("a letter, not a database\n" * 50)
    with pytest.raises(UsageError, match=r"lamp\.db: file is not a database; restore .*HANDOVER_LAMP"):
        connect(f"sqlite:///{tmp_path / 'lamp.db'}", setting="HANDOVER_LAMP")


def filled(folder: Path, name: str = "lamp") -> Path:
    """A database of a service that has stopped."""
    file = folder / f"{name}.db"
    engine = connect(f"sqlite:///{file}")
    with engine.begin() as connection:
        connection.execute(text("CREATE TABLE lamps (id INTEGER PRIMARY KEY, name TEXT UNIQUE)"))
        for number in range(500):
            connection.execute(
                text("INSERT INTO lamps VALUES (:id, :name)"), {"id": number, "name": f"lamp {number}"}
            )
    engine.dispose()
    return file


def test_a_sound_database_is_opened_again(tmp_path: Path) -> None:
    file = filled(tmp_path)
    engine = connect(f"sqlite:///{file}")
    with engine.connect() as connection:
        assert connection.execute(text("SELECT count(*) FROM lamps")).scalar() == 500
    engine.dispose()


def deleted(file: Path) -> None:
    file.unlink()


def emptied(file: Path) -> None:
    os.truncate(file, 0)


def replaced_by_an_empty_one(file: Path) -> None:
    file.unlink()
    with closing(sqlite3.connect(file)) as database:
        database.execute("VACUUM")


def replaced_by_another(file: Path) -> None:
    shutil.copy(filled(file.parent, "other"), file)


def without_stamp(file: Path) -> None:
    file.with_name("lamp.db.stamp").unlink()


def without_checksums(file: Path) -> None:
    file.with_name("lamp.db.pages").unlink()


def cut(file: Path) -> None:
    os.truncate(file, file.stat().st_size // 2)


def overwritten(file: Path) -> None:
    content = bytearray(file.read_bytes())
    content[8192:12288] = bytes(reversed(content[8192:12288]))
    file.write_bytes(content)


@pytest.mark.parametrize(
    "harm", [deleted, emptied, replaced_by_an_empty_one, replaced_by_another, cut, overwritten]
)
def test_a_damaged_database_is_refused_in_one_line_with_the_remedy(
    tmp_path: Path, harm: Callable[[Path], None]
) -> None:
    file = filled(tmp_path)
    harm(file)
    before = file.read_bytes() if file.exists() else None
    with pytest.raises(UsageError, match=r"damaged data: .*lamp\.db.*; restore .*deploy/restore") as refused:
        connect(f"sqlite:///{file}")
    assert "\n" not in str(refused.value)
    assert (file.read_bytes() if file.exists() else None) == before


def test_a_database_whose_log_alone_is_left_is_refused(tmp_path: Path) -> None:
    file = filled(tmp_path)
    file.with_name("lamp.db.stamp").unlink()
    file.rename(file.with_name("lamp.db-wal"))
    with pytest.raises(UsageError, match=r"lamp\.db is missing, but lamp\.db-wal beside it has changes"):
        connect(f"sqlite:///{file}")


@pytest.mark.parametrize("harm", [replaced_by_another, without_stamp, without_checksums])
def test_a_database_without_its_marks_is_taken_once_they_are_renewed_as_the_error_says(
    tmp_path: Path, harm: Callable[[Path], None]
) -> None:
    file = filled(tmp_path)
    harm(file)
    with pytest.raises(UsageError, match=r"lamp\.db\..*`handover check --restamp` accepts it"):
        connect(f"sqlite:///{file}")
    renew_marks(file)
    connect(f"sqlite:///{file}").dispose()


MAKES_A_TABLE = """
import sys
from sqlalchemy import text
from handover.database import connect
url, table = sys.argv[1:]
print("ready", flush=True)
sys.stdin.readline()
with connect(url).begin() as connection:
    connection.execute(text(f"CREATE TABLE {table} (id INTEGER PRIMARY KEY)"))
"""


@pytest.mark.nightly
@pytest.mark.parametrize("is_new", [True, False])
def test_services_that_share_a_database_make_it_at_the_same_time(tmp_path: Path, is_new: bool) -> None:
    tables = ["lamps", "fans", "belts"]
    files = [tmp_path / f"shared-{number}.db" for number in range(3)]
    for file in files:
        if not is_new:  # of a version that made no stamps
            with closing(sqlite3.connect(file)) as database:
                database.execute("PRAGMA journal_mode=WAL")
                database.execute("VACUUM")
        services = [
            subprocess.Popen(
                [sys.executable, "-c", MAKES_A_TABLE, f"sqlite:///{file}", table],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
            for table in tables
        ]
        for service in services:
            assert service.stdout is not None
            assert service.stdout.readline() == "ready\n"
        for service in services:
            assert service.stdin is not None
            service.stdin.write("\n")
            service.stdin.flush()
        assert [service.communicate()[1] for service in services] == ["", "", ""]
        with connect(f"sqlite:///{file}").begin() as connection:
            found = connection.execute(text("SELECT name FROM sqlite_master WHERE type = 'table'")).scalars()
            assert set(found) == {*tables, "handover_commits"}


def test_postgresql_is_reached_over_tls_and_a_wrong_authority_is_refused(
    new_database: Callable[[], str], tmp_path: Path
) -> None:
    certificates, others = Certificates(tmp_path / "own"), Certificates(tmp_path / "other")
    files = certificates.make("localhost")
    wrong = others.make("localhost").authority
    with tls_in_front_of(new_database(), files) as url:
        trusted = f"{url}?sslmode=verify-full&sslrootcert={files.authority}"
        engine = connect(trusted)
        with engine.connect() as connection:
            driver: Any = connection.connection.driver_connection
            assert driver.pgconn.ssl_in_use
        engine.dispose()
        stored = PostgresDatabase(trusted)
        stored.open(1, "SELECT 1")
        stored.close()
        untrusted = f"{url}?sslmode=verify-full&sslrootcert={wrong}"
        verify = r"certificate verify failed \(name the authority .* with sslrootcert\); correct that or "
        with pytest.raises(UsageError, match=verify + "HANDOVER_DATABASE_URL$"):
            connect(untrusted)
        with pytest.raises(UsageError, match=verify + "HANDOVER_BROKER_DATABASE_URL$"):
            PostgresDatabase(untrusted).open(1, "SELECT 1")
        with pytest.raises(UsageError, match='root certificate file "/none" does not exist'):
            connect(f"{url}?sslmode=verify-full&sslrootcert=/none")
