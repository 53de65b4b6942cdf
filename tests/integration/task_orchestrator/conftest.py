"""Cells of the orchestrator, and the databases that it is tested on."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.integration.task_orchestrator.cell import Cell, cell
from tests.kit.ports import next_free_port


@pytest.fixture(params=["sqlite", "postgresql"])
def database_url(request: pytest.FixtureRequest) -> str | None:
    return None if request.param == "sqlite" else str(request.getfixturevalue("new_database")())


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    """A cell for all tests of a module: each looks at its own processes only, and sees them end."""
    with cell(tmp_path_factory.mktemp("cell"), next_free_port) as running:
        yield running


@pytest.fixture
def running(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Cell]:
    """The shared cell with everybody up and an empty script; for a database of its own, a cell of its own."""
    database = request.getfixturevalue("database_url") if "database_url" in request.fixturenames else None
    if database:
        with cell(tmp_path, next_free_port, database) as made:
            yield made
    else:
        shared: Cell = request.getfixturevalue("shared")
        shared.script_file.write_text("{}")
        for member in shared.members:
            member.run()
        yield shared
