"""A Python process that we start imports nothing from the folder of the user."""

import ast
import asyncio
import subprocess
import sys
from pathlib import Path

import pytest

from handover.runtime.offload import Offload
from handover.runtime.python_processes import code_command, module_command
from handover_web.messages import python_sources
from tests.kit.namesakes import NAMESAKES, leave_namesakes_in
from tests.kit.paths import REPOSITORY

SHIPPED = ("datamodels", "deploy", "glove_sdk_bridge", "handover", "ros_fiware_bridge", "services", "webui")

POOL = """
import math, multiprocessing
from concurrent.futures import ProcessPoolExecutor
from handover.runtime.python_processes import safe_path_in_workers

if __name__ == "__main__":
    with safe_path_in_workers(), ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        print(pool.submit(math.factorial, 5).result())
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working directory of a user, with files that have the names of modules."""
    leave_namesakes_in(tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_modules_and_code_come_from_the_installation(folder: Path) -> None:
    imports = "import " + ", ".join(NAMESAKES)
    subprocess.run(code_command(imports), cwd=folder, check=True)
    subprocess.run(
        [*module_command("glove_sdk_bridge"), "--help"], cwd=folder, check=True, capture_output=True
    )


def test_offloaded_work_comes_from_the_installation(folder: Path) -> None:
    assert asyncio.run(Offload().run(ast.literal_eval, "[1, 2]")) == [1, 2]


def test_workers_of_a_pool_come_from_the_installation(
    folder: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    program = tmp_path_factory.mktemp("program") / "pool.py"
    program.write_text(POOL)
    done = subprocess.run([sys.executable, program], cwd=folder, capture_output=True, text=True)
    assert done.stdout == "120\n", done.stderr


@pytest.mark.nightly
def test_every_command_with_this_interpreter_has_a_safe_path() -> None:
    unsafe = []
    for package in SHIPPED:
        for file in python_sources(REPOSITORY / package):
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
                words = _words(node)
                if "sys.executable" in words and words & {"'-m'", "'-c'"} and "'-P'" not in words:
                    unsafe.append(f"{file.relative_to(REPOSITORY)}: {ast.unparse(node)}")
    assert unsafe == [], "use handover.runtime.python_processes"


def _words(node: ast.AST) -> set[str]:
    """Return the items of a list, tuple or call, as they stand in the source."""
    if isinstance(node, ast.Call):
        return set(map(ast.unparse, node.args))
    return set(map(ast.unparse, node.elts)) if isinstance(node, ast.List | ast.Tuple) else set()
