"""`operations.md` lists every operation and parameter of the broker, with tests that exist."""

import re

import pytest

from handover_broker.app import operations_of
from handover_broker.request.routing import Operation
from handover_broker.settings import BrokerSettings
from tests.kit.paths import REPOSITORY

PAGE = (REPOSITORY / "services/context_broker/handover_broker/operations.md").read_text(encoding="utf-8")
CLAUSE = re.compile(r"[4-7](\.\d+)+|RFC \d+")
WRITTEN = re.compile(r"`([^`]+)`")


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> tuple[Operation, ...]:
    return operations_of(BrokerSettings(data_dir=tmp_path_factory.mktemp("none")))


def rows(heading: str) -> dict[str, list[str]]:
    """Return the rows of the table under a heading by their first cell; a row may stand there once."""
    section = PAGE.partition(f"\n## {heading}\n")[2].partition("\n## ")[0]
    cells = [line.strip("|").split("|") for line in section.splitlines() if line.startswith("|")][2:]
    found = {row[0].strip().strip("`"): [cell.strip() for cell in row[1:]] for row in cells}
    assert len(found) == len(cells) > 0, heading
    return found


def test_every_operation_is_documented(table: tuple[Operation, ...]) -> None:
    result = rows("By path")
    for one in table:
        parameters = ", ".join(f"`{name}`" for name in sorted(one.parameters)) or "–"
        expected = [one.name, one.clause, parameters]
        path = f"{one.method} {one.path}"
        row = f"| `{path}` | {' | '.join(expected)} | `test_file.py::test_that_shows_it` |"
        assert result.get(path, [])[:3] == expected, f"operations.md needs the row {row}"
    assert result.keys() == {f"{one.method} {one.path}" for one in table}, "and no others"


def test_every_parameter_is_documented(table: tuple[Operation, ...]) -> None:
    there = {name for one in table for name in one.parameters}
    result = rows("Parameters")
    assert result.keys() == there, (
        f"operations.md differs in {sorted(result.keys() ^ there)} under Parameters"
    )


@pytest.mark.parametrize(
    "heading", ["By path", "Parameters", "Headers and methods", "Context sources", "Stored documents"]
)
def test_every_row_names_a_clause_and_tests_that_are_there(heading: str) -> None:
    for what, cells in rows(heading).items():
        assert any(CLAUSE.fullmatch(cell) for cell in cells[:2]), what
        tests = WRITTEN.findall(cells[-1])
        assert tests, f"{what} has no test"
        for test in tests:
            file, _, name = test.partition("::")
            found = list((REPOSITORY / "services" / "context_broker" / "tests").glob(f"*/{file}"))
            assert found, f"{what}: there is no {file}"
            assert f"def {name}(" in found[0].read_text(encoding="utf-8"), f"{what}: there is no {test}"
