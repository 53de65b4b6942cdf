"""A PostgreSQL server that stops: 503 with Retry-After, one log line at each change, and nothing is lost."""

import asyncio
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from handover.broker import BrokerClient, BrokerUnavailable
from handover.broker.latest_value_writer import LatestValueWriter
from tests.kit.cell import Cell, new_cell
from tests.kit.postgres import PostgresServer, postgres_server
from tests.kit.waiting import until, wait_for

pytestmark = pytest.mark.slow

SERVICES = ("context_broker", "accounts", "task_orchestrator", "gesture_controller", "study", "webui")
ROUNDS = 6
MAX_LINES = 12
"""Of different kinds, in one outage: the database, the broker, the leases, the audit trail."""
OPERATIONS = frozenset({"/healthz", "/readyz", "/metrics", "/context.jsonld"})


@pytest.fixture
def server() -> Iterator[PostgresServer]:
    """Return a server that no other test uses."""
    with postgres_server() as server:
        yield server


@pytest.fixture
def cell(server: PostgresServer, tmp_path: Path) -> Iterator[Cell]:
    """Return a cell whose databases are all on the server."""
    with new_cell(tmp_path) as cell:
        cell.extra["HANDOVER_DATABASE_URL"] = server.new_database()
        cell.extra["HANDOVER_BROKER_DATABASE_URL"] = server.new_database()
        yield cell


def routes(cell: Cell) -> list[str]:
    """Return the URLs of all resources that can be read, with a name that nothing has."""
    urls = []
    for service in SERVICES:
        paths = httpx.get(f"{cell.url(service)}/openapi.json", timeout=60).json()["paths"]
        readable = (path for path, methods in paths.items() if "get" in methods and path not in OPERATIONS)
        urls += [cell.url(service) + path.replace("{", "").replace("}", "") for path in readable]
    return urls


def answers(urls: list[str]) -> dict[str, int]:
    """Read each once; return the statuses, of which 503 says when to try again."""
    statuses = {}
    with httpx.Client(timeout=60, trust_env=False) as http:
        for url in urls:
            with http.stream("GET", url) as answer:
                statuses[url] = answer.status_code
                assert answer.status_code < 500 or answer.status_code == 503, (url, answer.status_code)
                if answer.status_code == 503:
                    assert int(answer.headers["Retry-After"]) > 0, url
    return statuses


@pytest.mark.nightly
def test_requests_get_503_and_the_logs_one_line_at_each_change(cell: Cell, server: PostgresServer) -> None:
    cell.start(*SERVICES)
    urls = routes(cell)
    before = answers(urls)
    assert set(before.values()) <= {200, 303, 400, 401, 403, 404, 409, 422}
    for nth in (1, 2):
        lengths = {service: len(cell.log(service)) for service in SERVICES}
        server.stop()
        away = [answers(urls) for _ in range(ROUNDS)][-1]
        assert sum(status == 503 for status in away.values()) > len(urls) / 4
        task = {"id": "urn:ngsi-ld:Task:demo:1", "type": "Task"}
        refused = httpx.post(f"{cell.url('context_broker')}/ngsi-ld/v1/entities", json=task, timeout=60)
        assert refused.status_code == 503, refused.text
        assert "Retry-After" in refused.headers
        for service in SERVICES:
            logged = cell.log(service)[lengths[service] :]
            assert "Traceback" not in logged, logged
            assert logged.count("database unavailable") == 1, logged
            assert f"nth={nth}" in logged
            assert logged.count("\n") < MAX_LINES, logged
        server.start()
        wait_for(lambda: answers(urls) == before, 60, lambda: str(answers(urls)))
        for service in SERVICES:
            wait_for(lambda: cell.log(service).count("database available again") == nth, 60, service)  # noqa: B023


@pytest.mark.nightly
async def test_what_a_service_writes_while_the_broker_has_no_database_is_written_later(
    cell: Cell, server: PostgresServer
) -> None:
    cell.start("context_broker")
    async with BrokerClient(cell.settings) as broker, LatestValueWriter() as writer:
        await broker.upsert([lamp("on")])
        server.stop()
        with pytest.raises(BrokerUnavailable):
            await broker.upsert([lamp("off"), lamp("off", "2")])
        writer.put("lamp", lambda: broker.upsert([lamp("off")]))
        await asyncio.sleep(1)  # refused some times
        server.start()

        async def is_off() -> bool:
            try:
                found = await broker.retrieve("urn:ngsi-ld:Device:demo:lamp-1")
            except BrokerUnavailable:
                return False
            return bool(found["serialNumber"]["value"] == "off")

        await until(is_off)


def lamp(state: str, name: str = "1") -> dict[str, Any]:
    """Return a device that carries `state`."""
    return {
        "id": f"urn:ngsi-ld:Device:demo:lamp-{name}",
        "type": "Device",
        "serialNumber": {"type": "Property", "value": state},
    }
