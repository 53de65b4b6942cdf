"""The README of each distribution is its page on a package index, where files of the repository are not."""

import re

import pytest

from requirements.subset import members
from tests.kit.paths import REPOSITORY

MEMBERS = {name: member for name, member in members().items() if name != "handover-cell"}
MAX_EXAMPLE_LINES = 32
"""Of code, without empty lines."""


@pytest.fixture(params=MEMBERS)
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def readme(name: str) -> str:
    return (REPOSITORY / MEMBERS[name]["folder"] / "README.md").read_text(encoding="utf-8")


def test_it_begins_with_its_name_and_how_to_install_it(name: str, readme: str) -> None:
    assert readme.startswith(f"# {name}\n\n")
    assert f"```sh\npip install --find-links dist {name}\n```" in readme.partition("\n## ")[0]


def test_it_shows_its_use_alone_in_a_short_program_with_public_names(readme: str) -> None:
    programs = re.findall(r"^```python\n(.*?)^```$", readme, re.MULTILINE | re.DOTALL)
    assert programs
    for program in programs:
        assert len([line for line in program.splitlines() if line.strip()]) <= MAX_EXAMPLE_LINES
        assert not re.search(r"(?:\.|import )_[a-z]", program)


def test_its_links_work_on_a_package_index_too(readme: str) -> None:
    links = re.findall(r"\]\(([^)\s]+)\)", readme)
    assert [link for link in links if not re.match(r"https?:|#", link)] == []
