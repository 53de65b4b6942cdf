"""The script of the CI runs for a contributor without root too."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.kit.paths import REPOSITORY

PROGRAMS = ("make", "python3", "chromium", "mosquitto", "openssl", "ip", "haproxy")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A folder that is the whole PATH: a shell, and `make` and `python3` that do nothing."""
    for program in ("bash", "env", "dirname", "mktemp"):
        found = shutil.which(program)
        assert found is not None
        (tmp_path / program).symlink_to(found)
    for program in PROGRAMS:
        (tmp_path / program).write_text(f'#!{tmp_path}/bash\necho "{program} $*"\n')
        (tmp_path / program).chmod(0o755)
    return tmp_path


def run(path: Path) -> subprocess.CompletedProcess[str]:
    script = (REPOSITORY / ".ci" / "run").read_text()
    file = path / "checkout" / ".ci" / "run"
    file.parent.mkdir(parents=True, exist_ok=True)
    # EUID is read-only in bash; PATH must not be extended by the system's folders.
    file.write_text(script.replace("EUID", "TEST_EUID").replace("PATH=$PATH:/usr/sbin:/sbin", ""))
    return subprocess.run(
        [path / "bash", file],
        env={"PATH": str(path), "TEST_EUID": "1000", "TMPDIR": os.fspath(path)},
        capture_output=True,
        text=True,
    )


def test_missing_packages_are_named_without_root(path: Path) -> None:
    (path / "chromium").unlink()
    (path / "ip").unlink()
    done = run(path)
    assert done.returncode == 2
    assert done.stderr.strip().endswith("sudo apt install chromium iproute2")
    assert "make" not in done.stdout


def test_everything_runs_without_root_when_nothing_is_missing(path: Path) -> None:
    done = run(path)
    assert done.returncode == 0, done.stderr
    made = [line for line in done.stdout.splitlines() if line.startswith("make")]
    assert made[0] == "make test"
    assert made[1].startswith("make demo ONCE=1")
    assert made[2:] == ["make nightly ARGS=--changed --minutes 50"]
