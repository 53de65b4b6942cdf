"""The file of a backup: what was written is read again, and any change of the file is refused."""

import io
import os
from pathlib import Path
from typing import Any

import orjson
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from handover.backup import archive, sealed_stream
from handover.backup.archive import read_archive, written
from handover.backup.contents import data_files, files_of_setting
from handover.backup.restoring import restore
from handover.backup.sealed_stream import SealedReader, SealedWriter
from handover.errors import UsageError

PASSPHRASE = "seven wet otters climb"


@pytest.fixture(autouse=True)
def quick_keys(monkeypatch: pytest.MonkeyPatch) -> None:
    """A key in little time: how long a guess takes is no subject of these tests."""
    monkeypatch.setattr(sealed_stream, "_SCRYPT_N", 2)
    monkeypatch.setattr(sealed_stream, "CHUNK_BYTES", 64)


def sealed(content: bytes, passphrase: str = PASSPHRASE) -> bytes:
    target = io.BytesIO()
    with SealedWriter(target, passphrase) as writer:
        writer.write(content)
    return target.getvalue()


def opened(content: bytes, passphrase: str = PASSPHRASE) -> bytes:
    return io.BufferedReader(SealedReader(io.BytesIO(content), passphrase)).read()


no_reset = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)


@no_reset
@given(st.binary(max_size=300))
def test_what_is_encrypted_is_decrypted(content: bytes) -> None:
    assert opened(sealed(content)) == content


@no_reset
@given(st.binary(min_size=1, max_size=300), st.data())
def test_no_change_and_no_cut_of_an_encrypted_file_is_accepted(content: bytes, data: st.DataObject) -> None:
    whole = sealed(content)
    at = data.draw(st.integers(len(sealed_stream.MAGIC), len(whole) - 1))
    changed = bytearray(whole)
    changed[at] ^= data.draw(st.integers(1, 255))
    for wrong in (bytes(changed), whole[:at], whole + whole[at:]):
        with pytest.raises(UsageError):
            opened(wrong)
    with pytest.raises(UsageError, match="passphrase is wrong"):
        opened(whole, "another passphrase")


def backup_of(folder: Path, file: Path, passphrase: str | None = None) -> None:
    with written(file, passphrase) as target:
        for name, path in data_files(folder):
            target.add(name, path)


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    folder = tmp_path / "cell"
    (folder / "security" / "service-tokens").mkdir(parents=True)
    (folder / "accounts-keys.json").write_text("{}")
    (folder / "accounts-keys.json").chmod(0o600)
    (folder / "security" / "service-tokens" / "webui").write_text("token")
    (folder / "logs").mkdir()
    for name in ("logs/webui.log", "orchestrator.db", "orchestrator.db-wal", "orchestrator.db.lock"):
        (folder / name).write_text(name)
    (folder / "ink.stamp").write_text("no database is beside it")
    return folder


def test_a_backup_has_the_files_of_the_cell_and_not_what_can_be_made_again(
    cell: Path, tmp_path: Path
) -> None:
    backup_of(cell, tmp_path / "b")
    _, manifest = read_archive(tmp_path / "b", None, tmp_path / "out")
    assert sorted(manifest.files) == [
        "data/accounts-keys.json",
        "data/ink.stamp",
        "data/orchestrator.db",
        "data/security/service-tokens/webui",
    ]
    if os.name == "posix":
        assert (tmp_path / "out" / "data" / "accounts-keys.json").stat().st_mode & 0o777 == 0o600


@pytest.mark.parametrize("passphrase", [None, PASSPHRASE])
def test_a_backup_that_was_cut_or_changed_restores_nothing(
    cell: Path, tmp_path: Path, passphrase: str | None
) -> None:
    whole = tmp_path / "whole"
    backup_of(cell, whole, passphrase)
    content = whole.read_bytes()
    changed = content[:200] + bytes([content[200] ^ 1]) + content[201:]
    for number, damaged in enumerate(
        (content[: len(content) // 2], content[:-1], changed, b"", b"no backup")
    ):
        file = tmp_path / f"damaged-{number}"
        file.write_bytes(damaged)
        with pytest.raises(UsageError):
            restore(file, passphrase, tmp_path / "new", {}, lambda _: [])
    assert sorted(path.name for path in tmp_path.iterdir() if path.is_dir()) == ["cell"]
    restore(whole, passphrase, tmp_path / "new", {}, lambda _: [])
    assert (tmp_path / "new" / "accounts-keys.json").read_text() == "{}"


def test_a_backup_of_a_newer_release_is_refused_by_its_name(
    cell: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as newer:
        newer.setattr(archive, "release", lambda: "99.10.0")
        backup_of(cell, tmp_path / "b")
    with pytest.raises(UsageError, match=r"Handover 99\.10\.0, and this is \d"):
        restore(tmp_path / "b", None, tmp_path / "new", {}, lambda _: [])
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("name", ["../outside", "/etc/outside", "data/../../outside", "other/file"])
def test_a_name_that_leads_out_of_the_folder_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "content").write_text("x")
    with written(tmp_path / "b", None) as target:
        target.add(name, tmp_path / "content")
    with pytest.raises(UsageError, match="never writes"):
        restore(tmp_path / "b", None, tmp_path / "cell" / "new", {}, lambda _: [])
    assert not list(tmp_path.rglob("outside"))


def test_a_damaged_database_restores_nothing(cell: Path, tmp_path: Path) -> None:
    backup_of(cell, tmp_path / "b")
    with pytest.raises(UsageError, match="page 3"):
        restore(tmp_path / "b", None, tmp_path / "new", {}, lambda _: ["page 3 is not as it was written"])
    assert not (tmp_path / "new").exists()


def test_a_cell_file_takes_with_it_what_it_names_beside_it(tmp_path: Path) -> None:
    files: dict[str, Any] = {
        "cell.yaml": "scene: scenes/table.yaml\nrobots: {a: {model: arm/arm.urdf}, b: {model: ur10}}\n",
        "scenes/table.yaml": "bins: []\n",
        "arm/arm.urdf": "<robot/>",
        "arm/meshes/link.stl": "solid",
        "unrelated.txt": "x",
    }
    for name, content in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True, parents=True)
        (tmp_path / name).write_text(content)
    taken = dict(files_of_setting("HANDOVER_CELL_FILE", tmp_path / "cell.yaml"))
    assert sorted(taken) == sorted(
        f"settings/HANDOVER_CELL_FILE/{name}" for name in files if name != "unrelated.txt"
    )


def test_the_manifest_is_plain_json(cell: Path, tmp_path: Path) -> None:
    backup_of(cell, tmp_path / "b")
    _, manifest = read_archive(tmp_path / "b", None, None)
    assert orjson.loads(orjson.dumps(manifest))["files"]["data/accounts-keys.json"]["size"] == 2
