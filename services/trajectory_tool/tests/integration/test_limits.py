"""Limits of a robot through its REST and WebSocket interface, and a Task that they slow down and stop."""

import asyncio
import json
import socket
import threading
import time
from collections.abc import AsyncIterator, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import httpx
import pytest
import uvicorn
from websockets.sync.client import ClientConnection, connect

from handover_datamodels.streams import PeopleReport, SpeedLimitReport
from handover_robots.app import make_app
from handover_robots.limits.contact_force import ContactForce
from handover_robots.limits.robot_limits import RobotLimits
from handover_robots.limits.store import LimitStore, RobotRecord, SafeSpeed
from handover_robots.model.trajectory import Setpoint
from handover_robots.people.simulation import SimulatedSensor
from handover_robots.robots import ROBOTS
from handover_robots.routes.report_stream import MAX_REPORTS_PER_S, Rate
from handover_robots.scene.scene import Scene
from handover_robots.settings import TrajectorySettings

UR10 = ROBOTS.load("ur10")


class Tool:
    """The trajectory tool over HTTP and WebSocket, without a broker: the limits need none."""

    def __init__(self, data_dir: Path) -> None:
        app = make_app(TrajectorySettings.load(data_dir=data_dir))
        self._socket = socket.create_server(("127.0.0.1", 0))
        self._port = self._socket.getsockname()[1]
        self._server = uvicorn.Server(
            uvicorn.Config(app, lifespan="off", log_level="warning", ws="websockets-sansio")
        )
        self._thread = threading.Thread(target=self._server.run, args=([self._socket],))

    def __enter__(self) -> "Tool":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.should_exit = True
        self._thread.join()
        self._socket.close()

    def request(self, method: str, path: str, body: Any = None) -> httpx.Response:
        url = f"http://127.0.0.1:{self._port}{path}"
        return httpx.request(method, url, json=body, timeout=60, trust_env=False)

    def limits(self) -> dict[str, Any]:
        return dict(self.request("GET", "/robots/ur10-1/limits").json())

    def post(self, path: str, body: Any) -> httpx.Response:
        return self.request("POST", f"/robots/ur10-1/limits/{path}", body)

    def stream(self, path: str) -> ClientConnection:
        return connect(f"ws://127.0.0.1:{self._port}/{path}", proxy=None)

    def send(self, path: str, *messages: Any) -> list[dict[str, Any]]:
        """Send messages, and return the answer of each."""
        with self.stream(path) as stream:
            answers = []
            for message in messages:
                stream.send(message if isinstance(message, str) else json.dumps(message))
                answers.append(json.loads(stream.recv(60)))
            return answers


@pytest.fixture
def tool(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Tool]:
    monkeypatch.chdir(tmp_path)
    with Tool(tmp_path) as running:
        yield running


def limit(fraction: float, **more: Any) -> dict[str, Any]:
    return {"source": "heart", "stamp": time.time(), "fraction": fraction, "reason": "heart rate 120", **more}


def test_without_sources_nothing_is_limited(tool: Tool) -> None:
    view = tool.limits()
    assert view["pace"] == 1.0
    assert view["rule"] is None
    assert "not a safety-rated function" in view["notice"]
    assert view["safetyStatus"] is None


def test_a_reported_limit_lowers_the_pace_and_names_its_source(tool: Tool) -> None:
    (answer,) = tool.send("robots/ur10-1/speed_limits", limit(0.6))
    assert answer["accepted"]
    view = tool.limits()
    assert (view["pace"], view["rule"], view["reason"]) == (0.6, "heart", "heart rate 120")
    assert view["limitSources"] == ["heart"]


def test_bad_messages_are_answered_and_change_nothing(tool: Tool) -> None:
    good = limit(0.5)
    answers = tool.send(
        "robots/ur10-1/speed_limits",
        good,
        "{",
        "[]",
        '{"fraction": NaN}',
        limit(1.0, stamp=good["stamp"] - 1),
        limit(1.0, extra=1),
        limit(1.0) | {"fraction": "1"},
        "x" * 20_000,
    )
    assert [answer["accepted"] for answer in answers] == [True, *[False] * 7]
    assert all(answer["reason"] for answer in answers[1:])
    assert tool.limits()["pace"] == 0.5


def test_a_flood_exceeds_the_rate_until_the_next_second() -> None:
    rate = Rate()
    assert [rate.excess(5.5) for _ in range(MAX_REPORTS_PER_S)] == [0] * MAX_REPORTS_PER_S
    assert [rate.excess(5.9) for _ in range(3)] == [1, 2, 3]
    assert rate.excess(6.0) == 0


@pytest.mark.nightly
def test_a_flood_changes_nothing_and_others_are_answered(tool: Tool) -> None:
    with tool.stream("robots/ur10-1/speed_limits") as flood:
        for _ in range(2000):
            flood.send("{")
        assert tool.send("robots/ur10-1/speed_limits", limit(0.5))[0]["accepted"]
        assert tool.limits()["pace"] == 0.5


def test_a_stop_for_a_body_signal_is_reset_by_a_person(tool: Tool) -> None:
    tool.send("robots/ur10-1/speed_limits", limit(0.0))
    assert tool.limits()["needsReset"]
    refused = tool.post("reset", {"name": "Aino"})
    assert refused.status_code == 409
    assert "heart" in refused.json()["detail"]
    tool.send("robots/ur10-1/speed_limits", limit(0.9))
    assert tool.limits()["pace"] == 0.0
    assert tool.post("reset", {}).status_code == 422
    assert not tool.post("reset", {"name": "Aino"}).json()["needsReset"]


def test_a_source_is_required_after_a_restart_until_it_is_removed_with_a_reason(
    tool: Tool, tmp_path: Path
) -> None:
    tool.send("robots/ur10-1/speed_limits", limit(1.0))
    path = "sources/heart/remove"
    with Tool(tmp_path) as again:
        assert again.limits()["pace"] == 0.25
        assert again.post(path, {"name": "Aino"}).status_code == 422
        removed = again.post(path, {"name": "Aino", "reason": "strap is broken"}).json()
        assert removed["pace"] == 1.0
        assert removed["decisions"][-1]["reason"] == "strap is broken"
        assert again.post(path, {"name": "Aino", "reason": "again"}).status_code == 404
    with Tool(tmp_path) as third:
        assert third.limits()["pace"] == 1.0


def test_people_near_the_robot_stop_it(tool: Tool) -> None:
    report = {"source": "lidar", "stamp": time.time(), "people": [{"id": "p1", "x": 0.3, "y": 0.0}]}
    tool.send("robots/ur10-1/people", report)
    view = tool.limits()
    assert view["pace"] == 0.0
    assert view["rule"] == "separation"
    assert view["separation"]["distance"] < 0.5


def test_scans_and_depth_images_of_people_stop_the_robot(tool: Tool) -> None:
    sensors = {
        "lidar-1": {"kind": "lidar", "position": [2.0, 0.0, 0.3], "yaw_deg": 180},
        "camera-1": {"kind": "depthCamera", "position": [0.5, 0.0, 3.5]},
    }
    written = {"name": "cell with sensors", "people_sensors": sensors}
    assert tool.request("PUT", "/cell/scene", written).status_code == 200
    scene = Scene.model_validate(written)
    for name, stream in (("lidar-1", "scans"), ("camera-1", "depth_images")):
        measured = SimulatedSensor(scene, name).measure([(0.5, 0.0)], time.time())
        (answer,) = tool.send(f"cell/{stream}", measured.model_dump(mode="json", by_alias=True))
        assert answer["accepted"], answer
        assert tool.limits()["separation"]["distance"] < 0.5
    view = tool.limits()
    assert view["peopleSensors"] == ["lidar-1", "camera-1"]
    assert (view["pace"], view["rule"]) == (0.0, "separation")
    (answer,) = tool.send("cell/scans", {"source": "lidar-1", "stamp": time.time()})
    assert not answer["accepted"]


def test_reduced_mode_and_the_validated_speed_limit_the_tool(tool: Tool) -> None:
    mode = tool.request("PUT", "/robots/ur10-1/limits/mode", {"name": "Aino", "mode": "reduced"}).json()
    assert mode["mode"] == "reduced"
    assert {"rule": "mode", "maxSpeed": 0.25} in [
        {"rule": rule["rule"], "maxSpeed": rule["maxSpeed"]} for rule in mode["rules"]
    ]
    safe = {
        "name": "Aino",
        "endEffector": "gripper",
        "speedMps": 0.2,
        "validatedAt": "2026-03-02T00:00:00Z",
    }
    view = tool.request("PUT", "/robots/ur10-1/limits/safe-speed", safe).json()
    assert view["reason"] == "gripper, validated on 2026-03-02"
    assert view["safeSpeeds"] == [
        {"endEffector": "gripper", "speedMps": 0.2, "validatedAt": "2026-03-02T00:00:00Z"}
    ]
    for fault in ({"speedMps": -1}, {"validatedAt": "2999-01-01T00:00:00Z"}):
        answer = tool.request("PUT", "/robots/ur10-1/limits/safe-speed", {**safe, **fault})
        assert answer.status_code == 422


def test_an_unknown_robot_is_answered(tool: Tool) -> None:
    assert tool.request("GET", "/robots/r2d2/limits").status_code == 404


@pytest.fixture
async def limits(tmp_path: Path) -> AsyncIterator[RobotLimits]:
    made = RobotLimits("ur10-1", UR10, lambda: UR10.home, LimitStore(tmp_path / "limits.json"))
    running = asyncio.create_task(made.run())
    yield made
    running.cancel()


async def test_the_lowest_rule_holds(limits: RobotLimits) -> None:
    limits.peak_mps = 2.0
    await limits.receive_limit(SpeedLimitReport.model_validate(limit(0.8, maxSpeed=1.0)))
    assert limits.pace() == pytest.approx(0.5)
    person = {"id": "p1", "x": 3.0, "y": 0.0}
    await limits.receive_people(
        PeopleReport.model_validate({"source": "lidar", "stamp": time.time(), "people": [person]})
    )
    allowed_mps = limits.separation.rule.speed_mps(limits.state.distance_m or 0.0)
    assert limits.pace() == pytest.approx(min(0.5, allowed_mps / 2.0))


async def test_distances_that_are_not_evaluated_in_time_stop_the_robot(tmp_path: Path) -> None:
    now = [0.0]
    store = LimitStore(tmp_path / "limits.json")
    limits = RobotLimits("ur10-1", UR10, lambda: UR10.home, store, now=lambda: now[0])
    await limits.receive_people(
        PeopleReport.model_validate({"source": "lidar", "stamp": time.time(), "people": []})
    )
    assert limits.pace() == 1.0
    now[0] = 0.51
    assert limits.pace() == 0.0


SPEEDS = {
    name: SafeSpeed(end_effector=name, speed_mps=speed, validated_at=datetime(2026, 3, 2, tzinfo=UTC))
    for name, speed in (("gripper", 0.4), ("screwdriver", 0.15))
}


@pytest.mark.parametrize(
    ("mounted", "max_mps", "reason"),
    [
        ("gripper", 0.4, "gripper, validated on 2026-03-02"),
        ("screwdriver", 0.15, "screwdriver, validated on 2026-03-02"),
        ("camera", 0.25, "camera has no validated speed"),
        (None, 0.15, "screwdriver, validated on 2026-03-02"),
    ],
)
def test_the_validated_speed_of_the_mounted_end_effector_holds(
    tmp_path: Path, mounted: str | None, max_mps: float, reason: str
) -> None:
    store = LimitStore(tmp_path / "limits.json")
    store.put("ur10-1", RobotRecord(safe_speeds=SPEEDS))
    stored = LimitStore(store.path)
    limits = RobotLimits("ur10-1", UR10, lambda: UR10.home, stored, end_effector=mounted)
    (allowed,) = limits.allowed()
    assert (allowed.rule, allowed.max_speed_mps, allowed.reason) == ("endEffector", max_mps, reason)


def test_a_validated_speed_of_an_earlier_release_holds(tmp_path: Path) -> None:
    path = tmp_path / "limits.json"
    record = {"safe_speed": SPEEDS["gripper"].model_dump(mode="json")}
    path.write_text(json.dumps({"robots": {"ur10-1": record, "ur10-2": {"safe_speed": None}}}))
    assert LimitStore(path).of("ur10-1").safe_speeds == {"gripper": SPEEDS["gripper"]}
    assert LimitStore(path).of("ur10-2").safe_speeds == {}


async def test_a_contact_stops_the_motion_until_a_person_resets_it(tmp_path: Path) -> None:
    force_n: list[float | None] = [20.0]
    store = LimitStore(tmp_path / "limits.json")
    contact = ContactForce(30.0, lambda: force_n[0])
    limits = RobotLimits("ur10-1", UR10, lambda: UR10.home, store, contact=contact)
    force_n[0] = 80.0
    assert limits.pace() == 1.0, "at rest the weight of a part may change the force"
    limits.begin_motion(lambda _: Setpoint.at_rest(UR10.home), 1.0)
    force_n[0] = 105.0
    assert limits.pace() == 1.0
    force_n[0] = 115.0
    assert limits.pace() == 0.0
    force_n[0] = 80.0
    limits.end_motion()
    lowest = limits.lowest()
    assert lowest is not None
    assert (lowest.rule, lowest.needs_reset) == ("contactForce", True)
    assert lowest.reason == "contact with 35 N; a person must reset it"
    assert await limits.reset("Aino") == []
    assert limits.pace() == 1.0
    force_n[0] = None
    assert limits.pace() == 0.0, "a required measurement is missing"
