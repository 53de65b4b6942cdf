"""Imports of the trajectory tool are statements, which import-linter sees."""

import ast
from collections.abc import Iterator
from pathlib import Path

import handover_robots

PACKAGE = Path(handover_robots.__file__).parent
REGISTRIES = {"drivers/__init__.py"}
"""They name modules for `ExtensionPoint`, which loads them as those of other packages."""


def imports_by_string(file: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call):
            function = ast.unparse(node.func)
            if function.rpartition(".")[2] in {"import_module", "__import__"}:
                yield ast.unparse(node)


def test_no_module_is_imported_by_a_string() -> None:
    calls_by_file = {
        str(file.relative_to(PACKAGE)): calls
        for file in PACKAGE.rglob("*.py")
        if (calls := list(imports_by_string(file)))
    }
    assert calls_by_file == {}


def test_modules_named_by_strings_are_in_the_registries() -> None:
    """A registry is above what it names: `pyproject.toml` has the layers."""
    naming = set()
    for file in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                module, colon, _ = node.value.partition(":")
                if colon and module.startswith("handover_robots."):
                    naming.add(file.relative_to(PACKAGE).as_posix())
    assert naming == REGISTRIES
