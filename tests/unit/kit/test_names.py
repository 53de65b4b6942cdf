"""Names say what a thing is: no class name twice in a package, no variable that could be anything."""

import ast
import functools
from collections import defaultdict
from pathlib import Path

import pytest

from requirements.subset import members
from tests.kit.paths import REPOSITORY
from tests.kit.wheels import packages_of

PACKAGES = [package for name in members() for package in packages_of(name)]
MEANINGLESS = {"one", "each", "found", "given", "known"}


@functools.cache
def nodes_in(package: Path) -> list[tuple[str, ast.AST]]:
    """Return each node of the code of a package, with its file."""
    nodes: list[tuple[str, ast.AST]] = []
    for file in sorted(package.rglob("*.py")):
        place = str(file.relative_to(REPOSITORY))
        nodes += ((place, node) for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))))
    return nodes


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.name)
def test_no_class_name_stands_twice_in_a_package(package: Path) -> None:
    places = defaultdict(list)
    for place, node in nodes_in(package):
        if isinstance(node, ast.ClassDef):
            places[node.name].append(f"{place}:{node.lineno}")
    assert {name: lines for name, lines in places.items() if len(lines) > 1} == {}


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.name)
def test_a_variable_says_what_it_holds(package: Path) -> None:
    bound = []
    fields = {  # of documents that others read
        id(statement.target)
        for _, node in nodes_in(package)
        if isinstance(node, ast.ClassDef)
        for statement in node.body
        if isinstance(statement, ast.AnnAssign)
    }
    for place, node in nodes_in(package):
        if id(node) in fields:
            continue
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store) and node.id in MEANINGLESS:
            bound.append(f"{place}:{node.lineno} {node.id}")
        if isinstance(node, ast.arg) and node.arg in MEANINGLESS:
            bound.append(f"{place}:{node.lineno} {node.arg}")
    assert bound == []
