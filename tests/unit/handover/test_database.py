"""The database: SQLite or PostgreSQL, and a readable word for anything else."""

from collections.abc import Callable
from pathlib import Path

import pytest
from sqlalchemy import text

from handover.database import connect
from handover.errors import UsageError


def test_sqlite_loses_nothing_that_was_committed(tmp_path: Path) -> None:
    engine = connect(f"sqlite:///{tmp_path / 'new' / 'lamp.db'}")
    with engine.connect() as connection:
        assert connection.execute(text("PRAGMA journal_mode")).scalar() == "wal"
        assert connection.execute(text("PRAGMA synchronous")).scalar() == 2
    engine.dispose()


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
    with pytest.raises(UsageError, match=r"lamp\.db cannot be used: file is not a database; .*HANDOVER_LAMP"):
        connect(f"sqlite:///{tmp_path / 'lamp.db'}", setting="HANDOVER_LAMP")
