"""An edge of a gateway with replicas goes to another one when its replica is killed."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from handover_devices.device_client import DeviceClient, Run
from services.device_gateway.tests.integration.test_replicas import Pair, certificates, mosquitto, pair
from tests.kit.cell import Cell, new_cell
from tests.kit.waiting import wait_for

__all__ = ["certificates", "mosquitto", "pair"]

pytestmark = pytest.mark.slow

EDGE = "site-1"


@pytest.fixture
def edge(pair: Pair, tmp_path: Path) -> Iterator[Cell]:
    """An edge that knows the address of the balancer only."""
    answer = pair.ask("POST", "/devices", json={"name": EDGE, "template": "edge"})
    (tmp_path / "edge").mkdir()
    with new_cell(tmp_path / "edge") as cell:
        cell.extra.update(
            HANDOVER_EDGE_UPSTREAM=f"127.0.0.1:{pair.devices}",
            HANDOVER_EDGE_NAME=EDGE,
            HANDOVER_EDGE_TOKEN=answer["token"],
            HANDOVER_TLS_AUTHORITY=pair.authority,
        )
        cell.start("device_gateway", within_s=60)
        yield cell


@pytest.mark.nightly
def test_an_edge_whose_replica_is_killed_loses_and_doubles_nothing(pair: Pair, edge: Cell) -> None:
    token = pair.add("hall-1", edge=EDGE)
    site = httpx.Client(base_url=edge.url("device_gateway"), timeout=120, trust_env=False)
    wait_for(lambda: site.get("/devices/hall-1").is_success, 60)
    client = DeviceClient("127.0.0.1", edge.ports["devices"], "hall-1", token)
    turned: list[float] = []
    ordered: list[float] = []
    sent = 0

    @client.command("turn")
    def turn(parameters: dict[str, Any], _: Run) -> None:
        turned.append(parameters["rad"])

    def order(rad: float) -> int:
        """Order a motion once; one that is accepted has to be executed."""
        try:
            answer = pair.rest.post(
                "/devices/hall-1/commands", json={"name": "turn", "parameters": {"rad": rad}}
            )
        except httpx.HTTPError:
            return 502
        if answer.is_success:
            ordered.append(rad)
        return answer.status_code

    def send(count: int) -> None:
        nonlocal sent
        for _ in range(count):
            client.send({"temperature": sent % 50}, time.time())
            sent += 1
        wait_for(lambda: client.waiting() == 0, 60)  # the edge has acknowledged all

    client.start()
    try:
        wait_for(lambda: pair.ask("GET", "/devices/hall-1")["connected"], 60)
        wait_for(lambda: order(1.0) == 202, 60)
        since = site.get("/edge").json()["since"]
        for victim in pair.cells:  # one of them is the one that the edge is connected to
            send(20)
            pair.kill(victim)
            send(20)
            wait_for(lambda: site.get("/edge").json()["connected"], 60)
            send(20)
            pair.start(victim)
            wait_for(lambda: pair.ask("GET", "/devices/hall-1")["connected"], 60)
            wait_for(lambda: order(1.0 + len(ordered)) == 202, 60)
        assert site.get("/edge").json()["since"] > since, "the edge has connected again"
        wait_for(lambda: site.get("/edge").json()["waiting"] == 0, 60)
        wait_for(lambda: pair.values("hall-1") >= sent, 60)
        assert pair.values("hall-1") == sent, "each acknowledged value is stored once"
        wait_for(lambda: len(turned) >= len(ordered), 60)
        assert turned == ordered == [1.0, 2.0, 3.0], "each motion that was accepted, once and in order"
    finally:
        client.stop()
        site.close()
