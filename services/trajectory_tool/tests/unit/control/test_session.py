"""A person moves a simulated robot over the WebSocket of the tool."""

import asyncio
import csv
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import httpx
import orjson
import pytest
from fastapi import FastAPI
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import InvalidStatus

from handover.security import revocations
from handover.security.access_tokens import SigningKey, key_set
from handover.security.caller import Caller, CallerKind
from handover.security.guard import Guard
from handover.security.keys_in_force import PUBLIC_KEYS_FILE
from handover.security.permissions import Grant, Role
from handover_robots.app import make_app
from handover_robots.settings import TrajectorySettings
from tests.kit.asgi_server import served
from tests.kit.ports import next_free_port

UP = {"linear": [0.0, 0.0, 0.1]}


class Person:
    """A client that sends its input 50 times a second, and keeps the last state that it got.

    It presses the control again where a busy machine delayed its messages, unless it `is_stuck`.
    """

    def __init__(self, socket: ClientConnection) -> None:
        self.socket = socket
        self.given: dict[str, Any] = {"held": False}
        self.state: dict[str, Any] = {}
        self.errors: list[str] = []
        self.is_silent = False
        self.is_stuck = False
        self._seq = 0

    async def send(self) -> None:
        while True:
            if not self.is_silent:
                self._seq += 1
                members = {"seq": self._seq, **self.given}
                if self.state.get("needsRelease") and not self.is_stuck:
                    members["held"] = False
                await self.socket.send(orjson.dumps(members).decode())
            await asyncio.sleep(0.02)

    async def receive(self) -> None:
        async for text in self.socket:
            received = orjson.loads(text)
            if received["type"] == "state":
                self.state = received
            elif received["type"] == "error":
                self.errors.append(received["reason"])

    @property
    def height_m(self) -> float:
        return float(self.state["toolPose"]["position"][2])

    @property
    def is_at_rest(self) -> bool:
        return not any(self.state["joints"]["velocity"])

    async def hold(self, **members: Any) -> None:
        """Press the control and move; a release comes before, as the dead-man function requires."""
        self.given = {"held": False}
        await until(lambda: bool(self.state))
        self.given = {"held": True, **members}


async def until(condition: Callable[[], bool], bound_s: float = 60.0) -> None:
    async with asyncio.timeout(bound_s):
        while not condition():
            await asyncio.sleep(0.01)


class Tool:
    """The tool on a port of its own, with a robot and nobody else."""

    def __init__(self, url: str, app: FastAPI) -> None:
        self.url = url
        self.app = app

    def address(self, robot: str = "ur10-1", query: str = "") -> str:
        return f"{self.url.replace('http', 'ws')}/robots/{robot}/control{query}"

    @asynccontextmanager
    async def person(self, robot: str = "ur10-1", query: str = "") -> AsyncIterator[Person]:
        async with connect(self.address(robot, query), proxy=None) as socket:
            person = Person(socket)
            tasks = [asyncio.create_task(person.send()), asyncio.create_task(person.receive())]
            try:
                yield person
            finally:
                for task in tasks:
                    task.cancel()
                await asyncio.gather(*tasks, return_exceptions=True)


@pytest.fixture
async def tool(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Tool]:
    monkeypatch.chdir(tmp_path)
    port = next_free_port()
    settings = TrajectorySettings.load(data_dir=tmp_path, broker_url=f"http://127.0.0.1:{next_free_port()}")
    app = make_app(settings)
    async with served(app, port):
        yield Tool(f"http://127.0.0.1:{port}", app)


async def test_the_tool_moves_while_the_control_is_held_and_rests_after_its_release(tool: Tool) -> None:
    async with tool.person() as anna:
        await until(lambda: bool(anna.state))
        start_m = anna.height_m
        await anna.hold(**UP)
        await until(lambda: anna.height_m > start_m + 0.03)
        x, y = anna.state["toolPose"]["position"][:2]
        anna.given = {"held": False, **UP}
        await until(lambda: anna.is_at_rest)
        rest_m = anna.height_m
        await asyncio.sleep(0.3)
        assert anna.height_m == pytest.approx(rest_m, abs=1e-6)
        assert anna.state["toolPose"]["position"][:2] == pytest.approx([x, y], abs=0.005)
        assert anna.state["latencyMs"] is not None
        await until(lambda: anna.state["stop"] is not None)
        stop = anna.state["stop"]
        assert 0 <= stop["beginMs"] <= stop["restMs"]


async def test_two_people_move_two_robots_of_a_cell_at_once_and_no_task_performs_meanwhile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "cell.yaml"
    file.write_text(
        "robots:\n  left: {model: ur10}\n  right: {model: ur10, base: {position: [1.6, 0, 0]}}\n"
        "scene: {name: hall}\n"
    )
    port, broker = next_free_port(), f"http://127.0.0.1:{next_free_port()}"
    app = make_app(TrajectorySettings.load(data_dir=tmp_path, broker_url=broker, cell_file=file))
    async with served(app, port):
        tool = Tool(f"http://127.0.0.1:{port}", app)
        units = app.state.controllers.cell.units
        async with tool.person("left") as anna:
            await anna.hold(**UP)
            await until(lambda: not anna.is_at_rest)
            async with tool.person("right") as ben:
                await until(lambda: bool(ben.state))
                start_m, before_m = ben.height_m, anna.height_m
                await ben.hold(linear=[0.0, 0.0, -0.1])
                await until(lambda: ben.height_m < start_m - 0.02 and anna.height_m > before_m + 0.01)
                assert all(unit.in_hand.locked() for unit in units.values())
            await until(lambda: not units["right"].robot.is_moving)
            assert all(unit.in_hand.locked() for unit in units.values()), "Anna still moves a robot"
        await until(lambda: not any(unit.in_hand.locked() for unit in units.values()))
        async with units["left"].in_hand:  # as a Task does
            async with connect(tool.address("right"), proxy=None) as socket:
                await socket.wait_closed()
            assert socket.close_code == 4409


@pytest.mark.parametrize("lost", ["silent", "gone"])
async def test_the_robot_stops_when_messages_no_longer_arrive(tool: Tool, lost: str) -> None:
    async with tool.person() as anna:
        await anna.hold(**UP)
        await until(lambda: not anna.is_at_rest)
        if lost == "silent":
            anna.is_silent = anna.is_stuck = True
            await until(lambda: anna.is_at_rest)
            anna.is_silent = False  # the button is still held
            await until(lambda: anna.state["needsRelease"])
            await asyncio.sleep(0.3)
            assert anna.is_at_rest, "a held control must not begin a motion after a gap"
            return
    async with httpx.AsyncClient(base_url=tool.url) as http:

        async def is_at_rest() -> bool:
            joints = (await http.get("/robots/ur10-1")).json()["joints"]
            return not any(joints["velocity"])

        async with asyncio.timeout(60):
            while not await is_at_rest():
                await asyncio.sleep(0.02)


async def test_one_person_controls_and_an_admin_takes_the_control_away(tool: Tool) -> None:
    async with tool.person() as anna, httpx.AsyncClient(base_url=tool.url) as http:
        await anna.hold(**UP)
        await until(lambda: not anna.is_at_rest)
        assert (await http.get("/robots/ur10-1/control")).json()["holder"] == "local owner"
        async with connect(tool.address(), proxy=None) as ben:
            await ben.wait_closed()
            assert ben.close_code == 4409
            assert "local owner controls ur10-1" in (ben.close_reason or "")
        assert (await http.delete("/robots/ur10-1/control")).status_code == 200
        await anna.socket.wait_closed()
        assert anna.socket.close_code == 4403
        assert (await http.get("/robots/ur10-1/control")).json()["holder"] is None
        joints = (await http.get("/robots/ur10-1")).json()["joints"]
        assert not any(joints["velocity"])


async def test_a_person_who_waits_gets_the_control_when_it_is_handed_over(tool: Tool) -> None:
    async with tool.person() as anna, httpx.AsyncClient(base_url=tool.url) as http:
        await anna.hold(**UP)
        await until(lambda: not anna.is_at_rest)
        async with tool.person(query="?mode=wait") as ben:
            robot = {"waitingForControl": []}
            async with asyncio.timeout(60):
                while not robot["waitingForControl"]:
                    robot = (await http.get("/robots/ur10-1")).json()
            assert robot["controlledBy"] == "local owner"
            waiting = robot["waitingForControl"][0]["id"]
            assert not ben.state
            gone = await http.post("/robots/ur10-1/control/hand-over", json={"to": "somebody"})
            assert gone.status_code == 404
            handed = await http.post("/robots/ur10-1/control/hand-over", json={"to": waiting})
            assert handed.status_code == 200
            await anna.socket.wait_closed()
            assert (anna.socket.close_code, anna.socket.close_reason) == (4410, "handed over to local owner")
            await ben.hold(**UP)
            await until(lambda: not ben.is_at_rest)
            async with tool.person(query="?mode=takeOver") as admin:
                await ben.socket.wait_closed()
                assert ben.socket.close_code == 4403
                await admin.hold(**UP)
                await until(lambda: not admin.is_at_rest)
    async with httpx.AsyncClient(base_url=tool.url) as http:
        async with asyncio.timeout(60):
            while (await http.get("/robots/ur10-1")).json()["controlledBy"] is not None:
                await asyncio.sleep(0.05)
        refused = await http.post("/robots/ur10-1/control/hand-over", json={"to": waiting})
        assert refused.status_code == 409


async def test_joints_are_moved_one_by_one_and_invalid_input_is_answered(tool: Tool) -> None:
    async with tool.person() as anna:
        await until(lambda: bool(anna.state))
        before = anna.state["joints"]["position"]
        await anna.hold(joints=[0, 0, 0, 0, 0, 0.5])
        await until(lambda: abs(anna.state["joints"]["position"][5] - before[5]) > 0.05)
        assert anna.state["joints"]["position"][:5] == pytest.approx(before[:5], abs=1e-6)
        anna.given = {"held": True, "joints": [0.1]}
        await until(lambda: bool(anna.errors))
        assert "ur10-1 has 6 joints" in anna.errors[-1]
        await until(lambda: anna.is_at_rest)
        anna.given = {"held": False}
        seen = len(anna.errors)
        invalid = (
            '{"seq": 1',
            '{"seq": -1, "held": true}',
            '{"seq": 1, "held": true, "linear": [NaN, 0, 0]}',
            '{"seq": 1, "held": "true"}',
            '{"seq": 1, "held": 1}',
            '{"seq": 1, "held": true, "linear": ["0.1", 0, 0]}',
            '{"seq": 1, "held": true, "mode": "takeOver"}',
            "x" * 5000,
        )
        for text in invalid:
            await anna.socket.send(text)
        await until(lambda: len(anna.errors) >= seen + len(invalid))
    for query in ("mode=nonsense", "mode=", "record=yes", "gamma=3", "Mode=wait", "speed=2"):
        async with connect(tool.address(query=f"?{query}"), proxy=None) as socket:
            await socket.wait_closed()
            assert socket.close_code == 4400, query
            assert query.partition("=")[0] in (socket.close_reason or "")


async def test_an_autonomous_share_leads_to_the_part_that_is_steered_to(tool: Tool) -> None:
    """With m = 1 the tool moves by itself; a person who steers away prevents it; all is recorded."""
    async with tool.person(query="?record=true&gamma=0.5") as anna:
        await anna.hold(mix=1.0)
        await until(lambda: anna.state["goal"] is not None and anna.state["mix"] > 0.9)
        start = anna.state["toolPose"]["position"]
        await until(lambda: anna.state["toolPose"]["position"] != start)
        assert sum(anna.state["goals"].values()) == pytest.approx(1, abs=0.01)
        here = anna.state["toolPose"]["position"]
        await anna.hold(mix=1.0, linear=[0.0, 0.0, 0.2])  # the parts lie below
        await until(lambda: anna.height_m > here[2] + 0.02)
        assert anna.state["mix"] == 0
        assert anna.state["isRecorded"]
    async with httpx.AsyncClient(base_url=tool.url) as http:
        control = "/robots/ur10-1/control"
        async with asyncio.timeout(60):
            while (await http.get(control)).json()["holder"] is not None:
                await asyncio.sleep(0.02)
        (recording,) = (await http.get(f"{control}/recordings")).json()["recordings"]
        text = (await http.get(f"{control}/recordings/{recording['name']}")).text
        assert (await http.delete(f"{control}/recordings/{recording['name']}")).status_code == 204
        assert (await http.get(f"{control}/recordings/{recording['name']}")).status_code == 404
    rows = list(csv.DictReader(text.splitlines()))
    for axis in ("x", "y", "z", "rx", "ry", "rz"):
        for row in rows:
            mix, gamma = float(row["mix"]), float(row["gamma"])
            human, robot = float(row[f"human_{axis}"]), float(row[f"robot_{axis}"])
            expected = (1 - mix) * gamma * human + mix * robot
            assert float(row[f"blended_{axis}"]) == pytest.approx(expected, abs=1e-3), "equation 1"
    assert max(float(row["mix"]) for row in rows) > 0.9
    assert any(float(row["human_z"]) > 0 for row in rows)
    times = [float(row["t"]) for row in rows]
    assert times == sorted(times)
    assert all(float(row["inputT"]) < float(row["t"]) + 0.1 for row in rows)


async def test_a_grant_that_is_removed_stops_the_robot(
    tool: Tool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(revocations, "MAX_SILENCE_S", 1e9)  # no accounts service answers here
    key = SigningKey.generate()
    (tmp_path / "security").mkdir()
    (tmp_path / "security" / PUBLIC_KEYS_FILE).write_bytes(key_set(key))
    guard: Guard = tool.app.state.guard
    assert guard._followed is not None
    guard._followed.apply({"position": 4, "revoked": []})

    def token(*grants: Grant) -> dict[str, str]:
        anna = Caller(CallerKind.USER, "anna", "Anna", grants, revision=4)
        return {"Authorization": f"Bearer {key.issue(anna, valid_s=600)}"}

    async with asyncio.timeout(60):
        while not guard.has_accounts():
            await asyncio.sleep(0.05)
    for grants in ((), (Grant(Role.OPERATOR),), (Grant(Role.ENGINEER, "urn:ngsi-ld:Device:demo:ur10-2"),)):
        with pytest.raises(InvalidStatus):
            async with connect(tool.address(), proxy=None, additional_headers=token(*grants)):
                pass
    mine = token(Grant(Role.ENGINEER, "urn:ngsi-ld:Device:demo:ur10-1"))
    async with connect(tool.address(), proxy=None, additional_headers=mine) as socket:
        person = Person(socket)
        tasks = [asyncio.create_task(person.send()), asyncio.create_task(person.receive())]
        await person.hold(**UP)
        await until(lambda: not person.is_at_rest)
        guard._followed.apply({"position": 5, "revoked": [[5, "anna"]]})
        await socket.wait_closed()
        await asyncio.gather(*tasks, return_exceptions=True)
        assert socket.close_code in {4401, 4403}
    async with httpx.AsyncClient(base_url=tool.url) as http:
        anna = Caller(CallerKind.USER, "ben", "Ben", (Grant(Role.VIEWER),), revision=5)
        headers = {"Authorization": f"Bearer {key.issue(anna, valid_s=600)}"}
        async with asyncio.timeout(60):  # the connection may end before the robot rests
            while any((await http.get("/robots/ur10-1", headers=headers)).json()["joints"]["velocity"]):
                await asyncio.sleep(0.02)
