"""A database that restarts concerns the moment: a Task that comes meanwhile is performed afterwards, once."""

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from handover.broker import BrokerClient
from services.device_gateway.tests.integration.conftest import Bench
from tests.kit.cell import new_cell
from tests.kit.postgres import PostgresServer, postgres_server
from tests.kit.waiting import until, wait_for

pytestmark = pytest.mark.slow

DEVICE = "urn:ngsi-ld:Device:demo:"


@pytest.fixture
def server() -> Iterator[PostgresServer]:
    """Return a server that no other test uses."""
    with postgres_server() as server:
        yield server


@pytest.fixture
def bench(server: PostgresServer, tmp_path: Path) -> Iterator[Bench]:
    """Return a gateway on the server; the broker has a database of its own."""
    with new_cell(tmp_path) as cell, ExitStack() as stack:
        cell.extra["HANDOVER_DATABASE_URL"] = server.new_database()
        cell.start("context_broker", "device_gateway", within_s=60)
        yield Bench(cell, stack)


def turn(name: str) -> dict[str, Any]:
    """Return a Task of the device."""
    return {
        "id": f"urn:ngsi-ld:Task:demo:{name}",
        "type": "Task",
        "isDefinedBy": {"type": "Relationship", "object": "urn:ngsi-ld:TaskDefinition:demo:turn"},
        "status": {"type": "Property", "value": "pending"},
        "involves": {"type": "Property", "value": [{"type": "Relationship", "object": f"{DEVICE}hall-1"}]},
        "workParameters": {"type": "Property", "value": {"rad": 0.5}},
    }


@pytest.mark.nightly
async def test_a_task_that_comes_while_the_database_is_away_is_performed_once(
    bench: Bench, server: PostgresServer
) -> None:
    token = bench.add("hall-1")
    bench.connect("hall-1", token)
    async with BrokerClient(bench.cell.settings) as broker:

        async def status(name: str) -> Any:
            return (await broker.retrieve(turn(name)["id"]))["status"]["value"]

        server.stop()
        wait_for(lambda: bench.rest.get("/devices").status_code == 503)
        await broker.create(turn("away"))
        server.start()
        wait_for(lambda: bench.rest.get("/devices").status_code == 200, 60)
        device = bench.connect("hall-1", token, "b2")
        sent = device.receive()
        assert sent is not None, "the command is lost"
        device.say(type="ack", id=sent["id"], result={"rad": 0.5})
        await until(lambda: _is(status("away"), "completed"), 60)
        await broker.create(turn("later"))
        following = device.receive()
        assert following is not None
        assert following["id"] != sent["id"], "the command is sent twice"
        device.say(type="ack", id=following["id"], result={"rad": 0.5})
        await until(lambda: _is(status("later"), "completed"), 60)


async def _is(value: Any, wanted: str) -> bool:
    return bool(await value == wanted)
