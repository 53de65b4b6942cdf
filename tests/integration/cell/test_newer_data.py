"""Data of a newer release: a service that cannot use them ends and says why in one line."""

import os
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from handover_broker.storage.database import APPLICATION_ID


def of_a_newer_broker(folder: Path) -> Path:
    file = folder / "broker.db"
    with closing(sqlite3.connect(file)) as database:
        database.execute(f"PRAGMA application_id = {APPLICATION_ID}")
        database.execute("PRAGMA user_version = 99")
    return file


def of_a_newer_orchestrator(folder: Path) -> Path:
    file = folder / "orchestrator.db"
    with closing(sqlite3.connect(file)) as database:
        database.execute("CREATE TABLE orchestrator_version (version INTEGER NOT NULL)")
        database.execute("INSERT INTO orchestrator_version VALUES (99)")
        database.commit()
    return file


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("service", "port_setting", "make"),
    [
        ("context-broker", "HANDOVER_BROKER_PORT", of_a_newer_broker),
        ("task-orchestrator", "HANDOVER_ORCHESTRATOR_PORT", of_a_newer_orchestrator),
    ],
)
def test_a_service_says_why_it_does_not_start_on_them(
    service: str,
    port_setting: str,
    make: Callable[[Path], Path],
    tmp_path: Path,
    free_port: Callable[[], int],
) -> None:
    make(tmp_path)
    ended = subprocess.run(
        [sys.executable, "-m", "handover_cell", "run", service, "--data-dir", str(tmp_path)],
        env={**os.environ, port_setting: str(free_port())},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert ended.returncode == 2, ended.stderr
    last_line = ended.stderr.strip().splitlines()[-1]
    assert last_line.startswith(f"{service}: ")
    assert "newer" in last_line
    assert "Traceback" not in ended.stderr
