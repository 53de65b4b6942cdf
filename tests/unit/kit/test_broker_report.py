"""The report at the end of a run with another broker."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.kit.other_broker.report import ABILITIES

CONFTEST = """
from pathlib import Path

from tests.kit.other_broker import report

report.NEEDS = Path(__file__).with_name("needs.toml")


def pytest_configure(config):
    config.pluginmanager.register(report.BrokerReport())
"""
TESTS = """
import pytest


@pytest.fixture
def history():
    assert False


def test_reads_history(history): pass
def test_needs_nothing(): pass
def test_reads_a_page_of_history(): assert False
@pytest.mark.parametrize("name", ["a", "b"])
def test_listed(name): assert name == "a"
"""
NEEDS = """
[history]
"test_cell.py::test_reads_history" = "it reads the history"
"test_cell.py::test_reads_a_page_of_history" = "it reads the history"
"test_cell.py::test_listed[a]" = "not any more"
"""


@pytest.fixture
def run(tmp_path: Path) -> str:
    for name, text in (("conftest.py", CONFTEST), ("test_cell.py", TESTS), ("needs.toml", NEEDS)):
        (tmp_path / name).write_text(text)
    return str(tmp_path)


def output(folder: str, broker: str, *arguments: str) -> tuple[int, str]:
    environment = {name: text for name, text in os.environ.items() if name != ABILITIES}
    ran = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--rootdir", folder, *arguments],
        cwd=folder,
        env={**environment, "HANDOVER_TEST_BROKER": broker},
        capture_output=True,
        text=True,
    )
    return ran.returncode, ran.stdout


def listed(text: str, title: str) -> list[str]:
    lines = text[text.index(f"\n{title}: ") :].strip().splitlines()
    count = int(lines[0].rpartition(" ")[2])
    return sorted(line.strip().removeprefix("test_cell.py::") for line in lines[1 : count + 1])


@pytest.mark.nightly
@pytest.mark.parametrize("workers", [(), ("-n", "2")])
def test_expected_failures_are_reported_and_do_not_fail_the_run(run: str, workers: tuple[str, ...]) -> None:
    code, text = output(run, "strict", *workers)
    assert "not there  history" in text
    assert listed(text, "failed, as the broker lacks what they need") == [
        "test_reads_a_page_of_history  needs history: it reads the history",
        "test_reads_history  needs history: it reads the history",
    ]
    assert listed(text, "passed, although the list says that they need what the broker lacks") == [
        "test_listed[a]  needs history: not any more"
    ]
    assert listed(text, "failed") == ["test_listed[b]"]
    assert code == 1


@pytest.mark.nightly
def test_where_the_ability_is_there_nothing_is_expected_to_fail(run: str) -> None:
    code, text = output(run, "strict -history")
    assert "there      history" in text
    assert listed(text, "failed, as the broker lacks what they need") == []
    assert listed(text, "failed") == ["test_listed[b]", "test_reads_a_page_of_history"]
    assert listed(text, "failed before they began, or at their end") == ["test_reads_history"]
    assert code == 1
