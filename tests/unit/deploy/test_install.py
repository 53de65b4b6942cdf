"""`make` installs the packages of Python, or reports in one sentence why it cannot."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.kit.paths import REPOSITORY
from tests.kit.ports import next_free_port

INSTALLED_FROM = ("Makefile", "pyproject.toml", "requirements/tools.lock", "requirements/handover.lock")


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """What `make` reads to install packages, without an environment."""
    for name in INSTALLED_FROM:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        shutil.copy(REPOSITORY / name, tmp_path / name)
    return tmp_path


def reported(checkout: Path) -> list[str]:
    """Let `make` install from an index that cannot be reached; return what was reported besides by itself."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("PIP_", "UV_", "MAKE"))}
    index = f"http://127.0.0.1:{next_free_port()}/simple"
    settings = {"PIP_CONFIG_FILE": os.devnull, "PIP_INDEX_URL": index, "PIP_RETRIES": "1"}
    done = subprocess.run(
        ["make", "--no-print-directory", ".venv/.ready"],
        cwd=checkout,
        env={**kept, **settings},
        capture_output=True,
        text=True,
    )
    assert done.returncode != 0
    assert done.stdout == ""
    return [line for line in done.stderr.splitlines() if not line.startswith("make: ")]


@pytest.mark.nightly
def test_without_a_network_there_is_one_message_with_the_way_out(checkout: Path) -> None:
    (line,) = reported(checkout)
    assert line.startswith(
        "the packages of Python cannot be installed: check that this machine reaches the network"
    )
    assert "Connection refused" in (checkout / ".venv" / "install.log").read_text()


@pytest.mark.nightly
def test_another_fault_is_reported_as_it_is(checkout: Path) -> None:
    (checkout / "requirements" / "tools.lock").write_text("uv=\n")
    assert any("Invalid requirement" in line for line in reported(checkout))
