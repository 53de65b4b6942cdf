"""Nothing installs `handover` from the package index: there, this name belongs to others."""

import re
import subprocess
import tomllib
from importlib.metadata import version

import pytest

from handover import distribution
from tests.kit.paths import REPOSITORY

INSTALLS = re.compile(
    r"(?:pip3?|pipx|uv tool|uv add|uvx|poetry add)\b(?:(?!&&)[^\n;|])*?[\s'\"=]handover(?![-_\w./\\])"
)
"""A command that would fetch the distribution of others."""
REQUIRES = re.compile(r"""["']handover(?:\[[\w,-]*\])?(?:\s*[<>=~!][^"']*)?["']""")
NAMES_IT = ("CHANGELOG.md", "docs/how-to/upgrade.md", "tests/unit/deploy/test_distribution_name.py")
"""They say that the name is not ours."""


def files(*patterns: str) -> list[str]:
    """Return the files of the repository that match."""
    listed = subprocess.run(
        ["git", "ls-files", *patterns], cwd=REPOSITORY, capture_output=True, text=True, check=True
    )
    return [name for name in listed.stdout.splitlines() if name not in NAMES_IT]


@pytest.mark.parametrize(
    "command",
    [
        "pip install handover",
        "pip install 'handover[ros]'",
        'python -m pip install -U "handover[motion]>=0.1"',
        "uv tool install handover && handover demo",
        "uvx handover demo",
    ],
)
def test_the_check_knows_such_a_command(command: str) -> None:
    assert INSTALLS.search(command)


@pytest.mark.parametrize(
    "command",
    [
        "pip install --find-links dist 'handover-cell[ros]'",
        "pip install handover_cell-0.1.0-py3-none-any.whl && handover demo",
        "pip install ./handover",
        "pip install example-robot-data; handover robot add",
    ],
)
def test_the_check_lets_ours_pass(command: str) -> None:
    assert not INSTALLS.search(command)


def test_no_text_installs_the_distribution_of_others() -> None:
    texts = files("*.md", "*.py", "*.yml", "*.yaml", "*.toml", "*.json", "*Dockerfile*", "Makefile", ".ci/*")
    assert len(texts) > 1000
    wrong = {
        f"{name}: {line.strip()}"
        for name in texts
        for line in (REPOSITORY / name).read_text("utf-8").splitlines()
        if "handover" in line and INSTALLS.search(line)
    }
    assert not wrong


def test_no_package_depends_on_the_distribution_of_others() -> None:
    documents = [tomllib.loads((REPOSITORY / name).read_text()) for name in files("*pyproject.toml")]
    projects = [document["project"] for document in documents if "project" in document]
    required = [name for project in projects for name in project.get("dependencies", [])]
    assert len([name for name in required if name.startswith("handover-")]) > 4
    assert not [name for name in required if REQUIRES.fullmatch(f'"{name}"')]


def test_the_distribution_is_ours() -> None:
    assert distribution.version() == version("handover-cell")
