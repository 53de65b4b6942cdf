"""Private files: others read nothing that services store; folders with certificates stay readable."""

import os
import stat
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from handover.files.durable_files import replace_durably
from handover.files.private_files import faults_of, make_private, owner_of
from tests.kit.paths import REPOSITORY

pytestmark = pytest.mark.skipif(os.name != "posix", reason="files have no modes on this system")


@pytest.fixture(autouse=True)
def umask() -> Iterator[None]:
    before = os.umask(0o022)
    yield
    os.umask(before)


def mode_of(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def stored(folder: Path, *names: str) -> None:
    for name in names:
        file = folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("x")


def test_what_is_there_is_repaired_with_one_line(tmp_path: Path) -> None:
    data_dir = tmp_path / "data"
    stored(data_dir, "broker.db", "broker.db-wal", "logs/webui.log", "recordings/a/b.csv")
    stored(data_dir, "tls/authority.pem", "security/public-keys.json", "cell/tls-webui/certificate.pem")
    assert len(list(faults_of(data_dir))) > 0
    (line,) = make_private(data_dir)
    assert str(data_dir) in line
    assert mode_of(data_dir) == 0o700
    assert mode_of(data_dir / "broker.db-wal") == 0o600
    assert mode_of(data_dir / "logs") == 0o700
    assert mode_of(data_dir / "logs" / "webui.log") == 0o600
    for shared in ("tls/authority.pem", "security/public-keys.json", "cell/tls-webui/certificate.pem"):
        assert mode_of(data_dir / shared) == 0o644
    assert list(make_private(data_dir)) == []
    assert list(faults_of(data_dir)) == []
    stored(data_dir, "new.db")
    assert mode_of(data_dir / "new.db") == 0o600


def test_a_folder_that_others_share_is_left_alone(tmp_path: Path) -> None:
    stored(tmp_path, "another.txt")
    tmp_path.chmod(0o1777)
    (line,) = make_private(tmp_path)
    assert "of its own" in line
    assert mode_of(tmp_path) == 0o1777
    assert mode_of(tmp_path / "another.txt") == 0o644


def test_links_are_not_followed(tmp_path: Path) -> None:
    stored(tmp_path / "elsewhere", "secret.txt")
    (tmp_path / "data").mkdir(mode=0o700)
    (tmp_path / "data" / "link").symlink_to(tmp_path / "elsewhere")
    assert list(make_private(tmp_path / "data")) == []
    assert mode_of(tmp_path / "elsewhere" / "secret.txt") == 0o644


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root gives files away")
def test_the_group_of_another_owner_is_accepted_and_check_says_so(tmp_path: Path) -> None:
    """As Kubernetes mounts a volume with `fsGroup`."""
    data_dir = tmp_path / "data"
    stored(data_dir, "webui.db")
    for path, mode in ((data_dir, 0o770), (data_dir / "webui.db", 0o660)):
        path.chmod(mode)
        os.chown(path, 4711, 10001)
    assert list(make_private(data_dir)) == []
    assert list(faults_of(data_dir)) == []
    assert (mode_of(data_dir), mode_of(data_dir / "webui.db")) == (0o770, 0o660)
    accepted = owner_of(data_dir)
    assert accepted is not None
    assert "fsGroup" in accepted
    (data_dir / "webui.db").chmod(0o664)
    (fault,) = make_private(data_dir)
    assert "belongs to user 4711" in fault


def test_an_explicit_mode_holds_whatever_the_umask(tmp_path: Path) -> None:
    os.umask(0o077)
    replace_durably(tmp_path / "public-keys.json", b"{}", mode=0o644)
    replace_durably(tmp_path / "cell.json", b"{}")
    assert mode_of(tmp_path / "public-keys.json") == 0o644
    assert mode_of(tmp_path / "cell.json") == 0o600


@pytest.mark.nightly
def test_check_names_what_others_can_read(tmp_path: Path) -> None:
    tmp_path.chmod(0o755)
    checked = subprocess.run(
        [sys.executable, "-m", "handover_cell", "check", "--data-dir", str(tmp_path)],
        capture_output=True,
        text=True,
        cwd=REPOSITORY,
    )
    assert f"open     {tmp_path} can be read by others (mode 0755)" in checked.stdout


@pytest.mark.nightly
def test_a_command_that_makes_accounts_makes_private_files(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "data"
    command = [sys.executable, "-m", "handover_cell", "accounts", "set-up", "--data-dir", str(folder)]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    assert mode_of(folder) == 0o700
    stored_files = [path for path in folder.rglob("*") if path.is_file() and "security" not in path.parts]
    assert {path.name for path in stored_files} >= {"accounts.db"}
    assert {path.name: mode_of(path) for path in stored_files if mode_of(path) & 0o077} == {}
