"""A person drives a robot with an input device over the TCP protocol of the gateway."""

import asyncio
import time
from collections.abc import AsyncIterator
from dataclasses import dataclass
from typing import Any

import httpx
import orjson
import pytest

from handover_devices.input_mapping import AxisInput, AxisMapping, InputMapping, MappedAxes
from services.device_gateway.tests.integration.conftest import Bench

pytestmark = pytest.mark.slow

STYLUS = {"name": "stylus-1", "description": {"kind": "wearable"}}


@dataclass
class Cell:
    gateway: httpx.AsyncClient
    tool: httpx.AsyncClient
    device_port: int

    async def is_at_rest(self) -> bool:
        return not any((await self.tool.get("/robots/ur10-1")).json()["joints"]["velocity"])

    async def control(self, device: str = "stylus-1") -> dict[str, Any]:
        found: dict[str, Any] = (await self.gateway.get(f"/devices/{device}/control")).json()
        return found


@pytest.fixture
async def cell(bench: Bench) -> AsyncIterator[Cell]:
    running = bench.cell
    running.run("trajectory_tool")
    async with (
        httpx.AsyncClient(base_url=running.url("device_gateway"), trust_env=False, timeout=120) as gateway,
        httpx.AsyncClient(base_url=running.url("trajectory_tool"), trust_env=False, timeout=120) as tool,
    ):
        yield Cell(gateway, tool, running.ports["devices"])


class Stylus:
    """A haptic device: it sends its state 50 times a second."""

    def __init__(self, writer: asyncio.StreamWriter) -> None:
        self.given: dict[str, Any] = {"held": False, "axes": {"lift": 0.0}}
        self.writer = writer
        self._seq = 0

    async def run(self) -> None:
        while True:
            self._seq += 1
            message = {"type": "human_input", "seq": self._seq, **self.given}
            self.writer.write(orjson.dumps(message) + b"\n")
            await self.writer.drain()
            await asyncio.sleep(0.02)


async def test_a_haptic_device_moves_the_robot_until_it_is_released_or_lost(cell: Cell) -> None:
    added = await cell.gateway.post("/devices", json=STYLUS)
    assert added.status_code == 201, added.text
    mapping = {"z": {"axis": "lift", "scale": 0.1, "deadZone": 0.05}}
    drive = {"robot": "ur10-1", "mapping": mapping, "gamma": 0.5}
    away = await cell.gateway.post("/devices/stylus-1/control", json=drive)
    assert (away.status_code, away.json()["title"]) == (409, "Not connected")
    reader, writer = await asyncio.open_connection("127.0.0.1", cell.device_port)
    hello = {"type": "hello", "version": 1, "device": "stylus-1", "token": added.json()["token"]}
    writer.write(orjson.dumps(hello) + b"\n")
    assert orjson.loads(await reader.readline())["type"] == "ack"
    stylus = Stylus(writer)
    sending = asyncio.create_task(stylus.run())
    async with asyncio.timeout(90):
        while not (listed := (await cell.gateway.get("/input-devices")).json()):
            await asyncio.sleep(0.05)
    assert listed == [{"device": "stylus-1", "title": "", "axes": ["lift"], "control": None}]
    begun = await cell.gateway.post("/devices/stylus-1/control", json=drive)
    assert begun.status_code == 201, begun.text
    again = await cell.gateway.post("/devices/stylus-1/control", json=drive)
    assert again.status_code == 409

    async def presses_until_it_moves() -> None:
        """A busy machine may delay messages, after which the control has to be pressed again."""
        while await cell.is_at_rest():
            state = (await cell.control())["state"]
            is_held = state is not None and not state.get("needsRelease", False)
            stylus.given = {"held": is_held, "axes": {"lift": 1.0}}
            await asyncio.sleep(0.05)

    async with asyncio.timeout(90):
        await presses_until_it_moves()
        assert (await cell.tool.get("/robots/ur10-1")).json()["controlledBy"] == "local owner"
        stylus.given = {"held": False, "axes": {"lift": 1.0}}
        while not await cell.is_at_rest():
            await asyncio.sleep(0.02)
        stylus.given = {"held": True, "axes": {"lift": "up"}}
        while (await cell.control())["error"] is None:
            await asyncio.sleep(0.02)
        await presses_until_it_moves()
        sending.cancel()
        writer.transport.abort()  # the device is gone without a word
        while not await cell.is_at_rest():
            await asyncio.sleep(0.02)
        while (await cell.tool.get("/robots/ur10-1")).json()["controlledBy"] is not None:
            await asyncio.sleep(0.02)
    assert (await cell.gateway.get("/input-devices")).json() == [], "it is not connected"
    ended = await cell.control()
    assert ended["ended"] == "the device has disconnected"
    assert ended["inputs"] > 0
    history = (await cell.gateway.get("/devices/stylus-1/messages")).text
    assert "human_input" not in history, "inputs are no telemetry"


async def test_a_control_with_a_device_is_ended_by_a_person(cell: Cell) -> None:
    added = await cell.gateway.post("/devices", json={**STYLUS, "name": "stylus-2"})
    reader, writer = await asyncio.open_connection("127.0.0.1", cell.device_port)
    hello = {"type": "hello", "version": 1, "device": "stylus-2", "token": added.json()["token"]}
    writer.write(orjson.dumps(hello) + b"\n")
    await reader.readline()
    event = {"type": "event", "seq": 1, "t": time.time(), "name": "noted", "data": {"about": "human_input"}}
    writer.write(orjson.dumps(event) + b"\n")
    assert orjson.loads(await reader.readline())["type"] == "ack", "the word alone makes no input"
    assert "noted" in (await cell.gateway.get("/devices/stylus-2/messages")).text
    nothing = await cell.gateway.delete("/devices/stylus-2/control")
    assert nothing.status_code == 404
    unknown = await cell.gateway.post("/devices/stylus-2/control", json={"robot": "ur10-9"})
    assert unknown.status_code == 201
    async with asyncio.timeout(60):
        while (ended := (await cell.control("stylus-2"))["ended"]) is None:
            await asyncio.sleep(0.02)
    assert "ur10-9" in ended
    await cell.gateway.post("/devices/stylus-2/control", json={"robot": "ur10-1"})
    async with asyncio.timeout(60):
        while (await cell.control("stylus-2"))["state"] is None:
            await asyncio.sleep(0.02)
    assert (await cell.gateway.delete("/devices/stylus-2/control")).json()["ended"] == "ended by a person"
    async with asyncio.timeout(60):
        while (await cell.tool.get("/robots/ur10-1")).json()["controlledBy"] is not None:
            await asyncio.sleep(0.02)
    writer.close()


def test_positions_of_a_hand_become_velocities_while_the_control_is_held() -> None:
    axes = MappedAxes(InputMapping(x=AxisMapping(axis="hand", kind="position", scale=2.0)))

    def velocity(value: float, now_s: float, *, held: bool = True) -> float:
        given = AxisInput(seq=1, held=held, axes={"hand": value})
        return axes.input_of(given, now_s).linear[0]

    assert velocity(0.0, 1.0) == 0, "the first position is where the hand begins"
    assert velocity(0.01, 1.02) == pytest.approx(1.0)
    assert velocity(5.0, 1.5) == 0, "a gap is no motion"
    assert velocity(5.0, 1.52, held=False) == 0
    assert velocity(1.0, 1.54) == 0, "the hand may return while the control is released"
    assert velocity(1.01, 1.56) == pytest.approx(1.0)
