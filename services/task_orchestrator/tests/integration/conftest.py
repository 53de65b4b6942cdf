"""Cells of the orchestrator, and the databases that it is tested on."""

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path

import httpx
import pytest
import uvicorn

from handover.broker import BrokerClient
from handover_broker.app import create_broker
from handover_broker.settings import BrokerSettings
from handover_processes.settings import OrchestratorSettings
from services.task_orchestrator.tests.integration.cell import Cell, cell
from services.task_orchestrator.tests.integration.rest import service, settings_in
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


@pytest.fixture
async def api(tmp_path: Path) -> AsyncIterator[httpx.AsyncClient]:
    async with service(settings_in(tmp_path)) as client:
        yield client


@pytest.fixture
async def broker(tmp_path: Path, free_port: Callable[[], int]) -> AsyncIterator[BrokerClient]:
    """A real broker, in this process."""
    port = free_port()
    settings = BrokerSettings(_env_file=None, data_dir=tmp_path, broker_url=f"http://127.0.0.1:{port}")
    app = create_broker(settings)
    server = uvicorn.Server(uvicorn.Config(app, port=port, log_config=None, timeout_graceful_shutdown=1))
    serving = asyncio.create_task(server.serve())
    while not server.started:
        await asyncio.sleep(0.01)
    try:
        async with BrokerClient(settings) as client:
            yield client
    finally:
        server.should_exit = True
        await serving


@pytest.fixture
def at_broker(tmp_path: Path, broker: BrokerClient, free_port: Callable[[], int]) -> OrchestratorSettings:
    """The settings of an orchestrator that works with the real broker; no notification reaches it."""
    return settings_in(tmp_path, broker_url=broker.url, orchestrator_port=free_port())


@pytest.fixture
async def joined(at_broker: OrchestratorSettings) -> AsyncIterator[httpx.AsyncClient]:
    async with service(at_broker) as client:
        yield client
