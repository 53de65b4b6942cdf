"""Every test belongs to one part of `make test`, and every part of `make nightly` is run by somebody."""

import re
from pathlib import Path

import pytest
import yaml

from tests import nightly
from tests.kit.paths import REPOSITORY, TEST_FOLDERS
from tests.nightly import PARTS

MAKEFILE = (REPOSITORY / "Makefile").read_text(encoding="utf-8")
FOLDERS = dict(re.findall(r"^TESTS_(\w+) := (.*)$", MAKEFILE, re.MULTILINE))
NAMES = re.search(r"^PARTS := ((?:.*\\\n)*.*)$", MAKEFILE, re.MULTILINE)


def test_every_test_is_in_one_part() -> None:
    files = [file.relative_to(REPOSITORY) for folder in TEST_FOLDERS for file in folder.rglob("test_*.py")]
    assert len(files) > 700
    for file in files:
        parts = [
            name
            for name, folders in FOLDERS.items()
            if any(file.is_relative_to(folder) for folder in folders.split())
        ]
        assert len(parts) == 1, f"{file} is in {parts}; it belongs to one TESTS_ of the Makefile"


def test_every_part_is_run() -> None:
    assert NAMES is not None
    names = NAMES[1].replace("\\\n", " ").split()
    assert sorted(names) == sorted(FOLDERS)
    assert {f"nightly-{name}" for name in names} <= {part.target for part in PARTS}


def test_every_part_of_nightly_is_a_target_that_the_workflow_runs() -> None:
    targets = set(re.findall(r"^([a-z-]+):", MAKEFILE, re.MULTILINE))
    workflow = yaml.safe_load((REPOSITORY / ".github/workflows/nightly.yml").read_text(encoding="utf-8"))
    run = {word for words in workflow["jobs"]["part"]["strategy"]["matrix"]["part"] for word in words.split()}
    for part in PARTS:
        assert part.target in targets or part.target.removeprefix("nightly-") in FOLDERS
        assert part.target in run | {"containers"}, f"{part.target} is in no job of nightly.yml"
        assert all((REPOSITORY / folder).exists() for folder in part.folders)


def test_a_part_that_failed_without_a_failed_test_is_not_repeated_and_counts_as_failed(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("tests.kit.failed_tests.CACHES", tmp_path)
    monkeypatch.setattr(nightly, "_make", lambda target: False)
    assert nightly.run([PARTS[0]], minutes=None) == 1


def test_the_arguments_of_make_are_not_those_of_the_parts(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "Makefile").write_text('shown:\n\t@test -z "$(ARGS)"\n')
    monkeypatch.setattr(nightly, "REPOSITORY", tmp_path)
    monkeypatch.setenv("ARGS", "--changed")
    monkeypatch.setenv("MAKEFLAGS", " -- ARGS=--changed")
    assert nightly._make("shown")
