"""Programs that no other test starts, such as the benchmarks and the kill test, can still be imported."""

import subprocess
import sys

import pytest

from tests.kit.paths import REPOSITORY

IMPORT = "import importlib, sys; [importlib.import_module(name) for name in sys.argv[1:]]"


@pytest.mark.parametrize("folder", ["benchmarks", "tests/load"])
def test_every_program_can_be_imported(folder: str) -> None:
    files = sorted(file for file in (REPOSITORY / folder).rglob("*.py") if not file.name.startswith("test_"))
    names = [".".join(file.relative_to(REPOSITORY).with_suffix("").parts) for file in files]
    command = [sys.executable, "-c", IMPORT, *(name.removesuffix(".__init__") for name in names)]
    done = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
