"""The control of a robot through the page server, with the trajectory tool behind it."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import httpx
import pytest
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus

from handover.http.origin_guard import OriginGuard, OriginPolicy
from handover_robots.app import make_app as make_tool
from handover_robots.settings import TrajectorySettings
from handover_web.app import make_app
from handover_web.settings import WebuiSettings
from services.trajectory_tool.tests.unit.control.test_session import UP, Person, until
from tests.kit.asgi_server import served
from tests.kit.ports import next_free_port


@pytest.fixture
async def page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[str]:
    """The address of the control of the robot at the page server."""
    monkeypatch.chdir(tmp_path)
    webui_port, tool_port = next_free_port(), next_free_port()
    given = {
        "data_dir": tmp_path,
        "broker_url": f"http://127.0.0.1:{next_free_port()}",
        "webui_port": webui_port,
        "trajectory_port": tool_port,
    }
    tool = make_tool(TrajectorySettings.load(**given))
    settings = WebuiSettings.load(**given)
    async with (
        served(tool, tool_port),
        served(OriginGuard(make_app(settings), OriginPolicy.of(settings)), webui_port),
    ):
        yield f"ws://127.0.0.1:{webui_port}/api/trajectory-tool/robots/ur10-1/control"


@asynccontextmanager
async def person(address: str) -> AsyncIterator[Person]:
    async with connect(address, proxy=None) as socket:
        anna = Person(socket)
        tasks = [asyncio.create_task(anna.send()), asyncio.create_task(anna.receive())]
        try:
            yield anna
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)


async def test_a_page_moves_the_robot_and_its_loss_stops_it(page: str) -> None:
    robot = page.replace("ws:", "http:").removesuffix("/control")
    async with httpx.AsyncClient(trust_env=False) as http:

        async def velocities() -> list[float]:
            found: list[float] = (await http.get(robot)).json()["joints"]["velocity"]
            return found

        async with person(f"{page}?gamma=0.5") as anna:
            await anna.hold(**UP)
            await until(lambda: not anna.is_at_rest)
            assert anna.state["seq"] > 0
            assert (await http.get(robot)).json()["controlledBy"] == "local owner"
            anna.socket.transport.abort()  # the browser is gone without a word
        async with asyncio.timeout(60):
            while any(await velocities()):
                await asyncio.sleep(0.02)
            while (await http.get(robot)).json()["controlledBy"] is not None:
                await asyncio.sleep(0.02)


async def test_a_user_keeps_settings_on_the_server(page: str) -> None:
    origin = page.replace("ws:", "http:").partition("/api/")[0]
    async with httpx.AsyncClient(base_url=f"{origin}/api/user-settings", trust_env=False) as http:
        asked = (http.get(f"/control.{name}") for name in ("panels", "keyboard", "gamepad", "screen"))
        assert [answer.json() for answer in await asyncio.gather(*asked)] == [{}] * 4
        for value in ({"order": ["view", "jog"]}, {"order": ["jog"]}):
            assert (await http.put("/control.panels", json=value)).status_code == 204
            assert (await http.get("/control.panels")).json() == value
        assert (await http.put("/control.panels", json=[1])).status_code == 422
        assert (await http.put("/control.panels", json={"x": "y" * 40_000})).status_code == 413
        assert (await http.put("/Bad name", json={})).status_code == 422


async def test_a_release_arrives_and_refusals_name_their_reason(page: str) -> None:
    async with person(page) as anna:
        await anna.hold(**UP)
        await until(lambda: not anna.is_at_rest)
        anna.given = {"held": False}
        await until(lambda: anna.is_at_rest)
        async with connect(page, proxy=None) as ben:
            await ben.wait_closed()
            assert ben.close_code == 4409
            assert "local owner controls ur10-1" in (ben.close_reason or "")
        await anna.socket.send('{"seq": 1')
        await until(lambda: bool(anna.errors))
    async with connect(page.replace("ur10-1", "ur10-9"), proxy=None) as unknown:
        await unknown.wait_closed()
        assert unknown.close_code == 4404
    with pytest.raises(InvalidStatus):
        async with connect(page, proxy=None, origin="http://evil.example"):  # type: ignore[arg-type]
            pass
