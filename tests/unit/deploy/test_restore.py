"""A backup is restored into a cell without data that does not run; otherwise nothing is touched."""

import os
import re
import subprocess
import tarfile
from pathlib import Path

import pytest

from tests.kit.paths import REPOSITORY

ENGINE = r"""#!/bin/bash
echo "$*" >>"$CALLS"
case "$*" in
  "ps "*label=*) echo "$RUNNING" ;;
  "ps "*volume=*) echo "$USERS" ;;
  "volume ls"*) echo "$LABELLED" ;;
  "volume inspect"*) [[ " $EXISTING " == *" $3 "* ]] ;;
esac
"""
"""A container engine that knows of what the environment names."""


class Machine:
    """A machine with a backup and an engine, which notes what it is asked for."""

    def __init__(self, folder: Path) -> None:
        self.calls = folder / "calls"
        self._engine = folder / "engine"
        self._engine.write_text(ENGINE)
        self._engine.chmod(0o755)
        self.backup = folder / "cell.tar.gz"
        (folder / "cell" / "broker-data").mkdir(parents=True)
        (folder / "cell" / "broker-data" / "broker.db").write_text("data")
        with tarfile.open(self.backup, "w:gz") as archive:
            archive.add(folder / "cell", arcname=".")

    def restore(self, **known: str) -> subprocess.CompletedProcess[str]:
        self.calls.write_text("")
        nothing = {"RUNNING": "", "USERS": "", "LABELLED": "", "EXISTING": ""}
        return subprocess.run(
            [REPOSITORY / "deploy" / "restore", self.backup],
            env={**os.environ, **nothing, **known, "ENGINE": str(self._engine), "CALLS": str(self.calls)},
            capture_output=True,
            text=True,
        )

    def changes(self) -> list[str]:
        return [
            one for one in self.calls.read_text().splitlines() if one.startswith(("run", "volume create"))
        ]


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


def test_a_backup_is_restored_where_there_is_no_cell(machine: Machine) -> None:
    done = machine.restore()
    assert done.returncode == 0, done.stderr
    created, extracted = machine.changes()
    assert created.endswith("handover_broker-data")
    assert "handover_broker-data:/cell/broker-data" in extracted


@pytest.mark.parametrize(
    ("known", "says"),
    [
        (
            {"RUNNING": "handover-webui-1"},
            "handover runs: handover-webui-1; .* docker compose -p handover down",
        ),
        (
            {"EXISTING": "handover_broker-data", "USERS": "my-broker"},
            "my-broker uses the volume handover_broker-data; .* stop my-broker",
        ),
        ({"EXISTING": "handover_broker-data"}, "has data already, in handover_broker-data; .* volume rm"),
        ({"LABELLED": "handover_study-data"}, "has data already, in handover_study-data; .* down --volumes"),
    ],
)
def test_nothing_is_restored_over_a_cell_that_runs_or_has_data(
    machine: Machine, known: dict[str, str], says: str
) -> None:
    done = machine.restore(**known)
    assert done.returncode == 2
    assert machine.changes() == []
    assert "nothing was restored" in done.stderr
    assert re.search(says, done.stderr), done.stderr
