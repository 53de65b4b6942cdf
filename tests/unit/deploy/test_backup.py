"""A backup is written where its caller says, and stops the services of the caller's settings."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.kit.paths import REPOSITORY

ENGINE = r"""#!/bin/bash
echo "engine $*" >>"$CALLS"
case "$*" in
  "volume ls"*) echo "${VOLUMES-handover_broker-data}" ;;
  run*) [[ ${BROKEN-} ]] && exit 1; echo packed ;;
esac
"""
COMPOSE = r"""#!/bin/bash
echo "compose $*" >>"$CALLS"
[[ $1 == --env-file ]] && grep CELL "$2" | sed 's/^/settings /' >>"$CALLS"
true
"""


class Machine:
    """A copy of the repository's part, an engine, and a folder in which its user works."""

    def __init__(self, folder: Path) -> None:
        self.repository, self.home, self.calls = folder / "repository", folder / "home", folder / "calls"
        (self.repository / "deploy").mkdir(parents=True)
        self.home.mkdir()
        shutil.copy(REPOSITORY / "deploy" / "backup", self.repository / "deploy" / "backup")
        (self.repository / ".env").write_text("CELL_UI_PORT=54400\nCELL_IMAGE_TAG=latest\n")
        for name, text in (("engine", ENGINE), ("compose", COMPOSE)):
            (folder / name).write_text(text)
            (folder / name).chmod(0o755)
        self.folder = folder

    def back_up(self, file: str, **settings: str) -> subprocess.CompletedProcess[str]:
        self.calls.write_text("")
        known = {"ENGINE": str(self.folder / "engine"), "COMPOSE": str(self.folder / "compose")}
        return subprocess.run(
            [self.repository / "deploy" / "backup", file],
            env={**os.environ, **known, "CALLS": str(self.calls), **settings},
            cwd=self.home,
            capture_output=True,
            text=True,
            check=False,
        )


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


def test_a_relative_file_is_beside_its_caller(machine: Machine) -> None:
    assert machine.back_up("cell.tar.gz").returncode == 0
    assert (machine.home / "cell.tar.gz").read_text() == "packed\n"
    assert (machine.home / "cell.tar.gz").stat().st_mode & 0o777 == 0o600
    assert not list(machine.repository.glob("*.tar.gz*"))


def test_the_settings_of_the_user_are_those_of_the_services_that_are_stopped(machine: Machine) -> None:
    (machine.repository / ".env.local").write_text("CELL_UI_PORT=8443\nCELL_IMAGE_TAG=mine")
    assert machine.back_up("cell.tar.gz").returncode == 0
    calls = machine.calls.read_text().splitlines()
    assert [call.split()[-1] for call in calls if call.startswith("compose")] == ["stop", "start"]
    assert calls[-1] == "settings CELL_IMAGE_TAG=mine"
    assert any("handover:mine tar" in call for call in calls)


def test_the_services_start_again_and_nothing_is_left_when_it_fails(machine: Machine) -> None:
    assert machine.back_up("cell.tar.gz", BROKEN="1").returncode != 0
    assert "compose" in machine.calls.read_text()
    assert machine.calls.read_text().splitlines()[-3].endswith("start")
    assert list(machine.home.iterdir()) == []


def test_a_cell_without_volumes_is_not_stopped(machine: Machine) -> None:
    refused = machine.back_up("cell.tar.gz", VOLUMES="")
    assert refused.returncode == 2
    assert "no volumes" in refused.stderr
    assert "stop" not in machine.calls.read_text()
