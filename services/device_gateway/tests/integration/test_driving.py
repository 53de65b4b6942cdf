"""People drive registered robots: gateway, broker and the simulated robots are processes."""

import asyncio
import subprocess
import sys
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager
from typing import Any

import pytest
from websockets.asyncio.client import connect

from services.device_gateway.tests.integration.conftest import Bench
from services.trajectory_tool.tests.unit.control.test_session import Person, until
from tests.kit.waiting import scaled

pytestmark = pytest.mark.slow


@pytest.fixture
def robots(bench: Bench) -> Iterator[Bench]:
    """A NAO and a myCobot, played by the command line."""
    for name, template in (("nao-1", "nao"), ("cobot-1", "mycobot280")):
        bench.rest.post("/devices", json={"name": name, "template": template}).raise_for_status()
    command = [sys.executable, "-m", "handover_cell", "device", "simulate", "nao-1", "cobot-1"]
    with (bench.cell.data_dir / "simulate.log").open("wb") as log:
        playing = subprocess.Popen(command, env=bench.cell.environment, stdout=log, stderr=log)
    try:
        yield bench
    finally:
        playing.kill()
        playing.wait()


def address(bench: Any, robot: str) -> str:
    return f"{bench.cell.url('device_gateway').replace('http', 'ws')}/robots/{robot}/control"


@asynccontextmanager
async def driver(bench: Any, robot: str) -> AsyncIterator[Person]:
    async with connect(address(bench, robot), proxy=None) as socket:
        person = Person(socket)
        tasks = [asyncio.create_task(person.send()), asyncio.create_task(person.receive())]
        try:
            yield person
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)


async def shown(bench: Bench, robot: str) -> dict[str, Any]:
    answer = await asyncio.to_thread(bench.rest.get, f"/devices/{robot}")
    found: dict[str, Any] = answer.raise_for_status().json()
    return found


async def until_shown(bench: Bench, robot: str, condition: Callable[[dict[str, Any]], bool]) -> None:
    async with asyncio.timeout(scaled(60)):
        while not condition(await shown(bench, robot)):
            await asyncio.sleep(0.05)


@pytest.mark.nightly
async def test_any_registered_robot_is_driven_by_its_id(robots: Bench) -> None:
    for robot in ("nao-1", "cobot-1"):
        await until_shown(robots, robot, lambda view: view["connected"] and view["state"] == "idle")
    async with driver(robots, "nao-1") as anna:
        await anna.hold(linear=[0.05, 0.0, 0.0])
        await until(lambda: anna.state["moves"])
        await until_shown(robots, "nao-1", lambda view: view["state"] == "busy")
        lease = (await asyncio.to_thread(robots.rest.get, "/robots/nao-1/control")).json()
        assert lease["holder"] == "local owner"
        async with connect(address(robots, "nao-1"), proxy=None) as ben:
            await ben.wait_closed()
            assert ben.close_code == 4409
        anna.given = {"held": False}
        await until(lambda: (anna.state["stop"] or {}).get("restMs") is not None)
        assert anna.state["stop"]["restMs"] >= anna.state["stop"]["beginMs"] >= 0
        assert anna.state["posture"] == "Stand"
        await anna.hold(linear=[0.05, 0.0, 0.0])
        await until(lambda: anna.state["moves"])
        anna.is_silent = True
        await until(lambda: not anna.state["moves"])
    async with driver(robots, "cobot-1") as anna:
        await until(lambda: bool(anna.state) and bool(anna.state["joints"]["position"]))
        await anna.hold(joints=[0.2, 0.0, 0.0, 0.0, 0.0, 0.0])
        await until(lambda: anna.state["joints"]["position"][0] > 0.02)
        assert anna.state["joints"]["position"][1:] == [0.0] * 5
        anna.given = {"held": True, "linear": [0.1, 0.0, 0.0]}
        await until(lambda: anna.state["limit"] == "this robot takes velocities of its joints only")
        revoked = await asyncio.to_thread(robots.rest.delete, "/robots/cobot-1/control")
        assert revoked.json()["holder"] is None
        await anna.socket.wait_closed()
        assert anna.socket.close_code == 4403
    at_rest = await shown(robots, "cobot-1")
    assert at_rest["connected"]


async def test_a_program_that_follows_no_velocities_is_refused(bench: Bench) -> None:
    body = {"name": "cobot-2", "template": "mycobot280"}
    token = bench.rest.post("/devices", json=body).raise_for_status().json()["token"]
    async with connect(f"{address(bench, 'cobot-2')}?mode=nonsense", proxy=None) as socket:
        await socket.wait_closed()
        assert (socket.close_code, "mode" in (socket.close_reason or "")) == (4400, True)
    for reason in ("is not connected", "follows no velocities"):
        async with connect(address(bench, "cobot-2"), proxy=None) as socket:
            await socket.wait_closed()
            assert socket.close_code == 4409
            assert reason in (socket.close_reason or "")
        if "connected" in reason:
            bench.connect("cobot-2", token)
