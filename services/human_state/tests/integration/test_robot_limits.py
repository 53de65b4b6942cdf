"""A heart rate slows a real robot service; without a signal the robot stops, and a person resets it."""

from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import httpx
import orjson
import pytest
from websockets.asyncio.client import connect

from services.human_state.tests.integration.conftest import add_person
from tests.kit.cell import Cell, new_cell
from tests.kit.waiting import until

pytestmark = pytest.mark.slow

ROBOT = "ur10-1"


class Bench:
    """The services, and what the robot says."""

    def __init__(self, cell: Cell, body: httpx.AsyncClient, tool: httpx.AsyncClient) -> None:
        self.cell = cell
        self.body = body
        self.tool = tool
        self.source = ""

    async def rule(self) -> dict[str, Any] | None:
        """Return what the robot knows of the limit of the person."""
        view = (await self.tool.get(f"/robots/{ROBOT}/limits")).raise_for_status().json()
        found: list[dict[str, Any]] = [each for each in view["rules"] if each["rule"] == self.source]
        return found[0] if found else None

    async def when(self, condition: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """Wait for a state of the limit at the robot."""

        async def met() -> dict[str, Any] | None:
            rule = await self.rule()
            return rule if rule is not None and condition(rule) else None

        found: dict[str, Any] = await until(met, why=lambda: self.cell.log("human_state")[-2000:])
        return found

    async def sense(self, bpm: float) -> None:
        """Give the person a simulated strap with a heart rate near `bpm` at rest."""
        settings = {"signals": ["heartRate"], "packet_s": 0.1, "rest_bpm": bpm}
        body = {"person": "aino", "driver": "simulated", "settings": settings}
        (await self.body.put("/sensors/strap-aino", json=body)).raise_for_status()


@pytest.fixture
async def bench(tmp_path: Path) -> AsyncIterator[Bench]:
    with new_cell(tmp_path) as cell:
        cell.start("context_broker", "trajectory_tool", "human_state", within_s=120)
        async with (
            httpx.AsyncClient(base_url=cell.url("human_state"), timeout=60, trust_env=False) as body,
            httpx.AsyncClient(base_url=cell.url("trajectory_tool"), timeout=60, trust_env=False) as tool,
        ):
            yield Bench(cell, body, tool)


@pytest.mark.nightly
async def test_heart_rate_slows_the_robot_silence_stops_it_and_a_person_resets(bench: Bench) -> None:
    made = await add_person(bench.body)
    bench.source = f"body-{made['pseudonym']}"
    await bench.sense(65)
    (await bench.body.put(f"/people/aino/robots/{ROBOT}", json={})).raise_for_status()
    calm = await bench.when(lambda rule: rule["fraction"] > 0.3)

    await bench.sense(150)
    slow = await bench.when(lambda rule: rule["reason"] == "the heart rate is high")
    assert slow["fraction"] == pytest.approx(0.2, abs=0.01)
    assert slow["fraction"] < calm["fraction"]
    async with connect(f"{bench.cell.url('human_state').replace('http', 'ws')}/limits", proxy=None) as stream:
        first, second = orjson.loads(await stream.recv()), orjson.loads(await stream.recv())
        assert second["sequence"] > first["sequence"]
        assert second["limits"][0]["source"] == bench.source
        assert second["limits"][0]["ageS"] < 5

    (await bench.body.delete("/sensors/strap-aino")).raise_for_status()
    stopped = await bench.when(lambda rule: rule["fraction"] == 0.0)
    assert stopped["needsReset"]
    refused = await bench.body.post("/people/aino/limit/reset", json={"name": "Aino"})
    assert (refused.status_code, "put the sensor on" in refused.text) == (409, True)

    await bench.sense(65)

    async def reset() -> bool:
        return (await bench.body.post("/people/aino/limit/reset", json={"name": "Aino"})).is_success

    await until(reset)
    assert (await bench.rule() or {})["fraction"] == 0.0, "the robot has a reset of its own"

    async def reset_robot() -> bool:
        body = {"name": "Aino"}
        await bench.tool.post(f"/robots/{ROBOT}/limits/reset", json=body)
        rule = await bench.rule()
        return rule is not None and not rule["needsReset"]

    await until(reset_robot)
    await bench.when(lambda rule: rule["fraction"] > 0.0)

    bench.cell.kill("human_state")
    aged = await bench.when(lambda rule: rule["fraction"] == 0.0)
    assert aged["needsReset"]
    assert "silent" in aged["reason"]
