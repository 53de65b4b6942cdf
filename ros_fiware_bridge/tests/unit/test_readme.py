"""The examples of the README."""

import textwrap
from pathlib import Path

import pytest

import handover_ros
from handover_ros.mapping import parse
from handover_ros.rules import plan
from handover_ros.types.type_store import TypeStore

README = Path(handover_ros.__path__[0]).parent / "README.md"
SECTION = README.read_text().partition("## The mapping file")[2].partition("\n## ")[0]
BLOCKS = [
    textwrap.dedent(block)
    for block in SECTION.split("\n\n")
    if block.startswith("    ") and block.strip().split(":")[0].isidentifier()
]


def test_the_readme_has_examples_of_every_section() -> None:
    assert {block.split(":")[0] for block in BLOCKS} >= {"type_paths", "ros_to_ngsild", "ngsild_to_ros"}
    assert {block.split(":")[0] for block in BLOCKS} >= {"services", "tasks_from_ros"}


@pytest.mark.parametrize("block", BLOCKS)
def test_an_example_of_the_readme_compiles(block: str) -> None:
    document = parse(block, "README.md", README.parent)
    assert plan.make(document, TypeStore(), "demo").document is document
