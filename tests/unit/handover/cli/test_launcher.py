"""The launcher looks before it starts anything."""

import shutil
from pathlib import Path
from typing import NamedTuple

import pytest

from handover.cli.launcher import make_room
from handover.errors import UsageError


class Usage(NamedTuple):
    total: int
    used: int
    free: int


def test_a_full_disk_is_said_in_one_line_with_the_way_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(10**9, 10**9, 2**20))
    with pytest.raises(UsageError, match=r"is full \(1 MB left, 50 MB needed\).*--data-dir") as full:
        make_room(tmp_path)
    assert "\n" not in str(full.value)


def test_a_directory_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match=r"file/data cannot be used.*--data-dir"):
        make_room(tmp_path / "file" / "data")


def test_a_new_directory_is_made_and_left_clean(tmp_path: Path) -> None:
    make_room(tmp_path / "a" / "b")
    assert list((tmp_path / "a" / "b").iterdir()) == []
