"""Devices join over TCP, are commanded, and what was acknowledged survives the end of the gateway."""

import json
import socket
import time
from base64 import b64encode
from collections.abc import Callable
from typing import Any

import httpx
import pytest
from pydantic import TypeAdapter

from handover.broker import BrokerClient
from handover.errors import Problem
from handover_devices.camera_images import MAX_IMAGE_BYTES, MIN_INTERVAL_S, CameraImages
from handover_devices.device_client import DeviceClient
from handover_devices.routes.views import DeviceView
from handover_devices.simulation import SimulatedDevice, examples
from services.device_gateway.tests.integration.conftest import Bench, TcpDevice, now_s
from tests.kit.waiting import until, wait_for

pytestmark = pytest.mark.slow

DEVICE = "urn:ngsi-ld:Device:demo:"


def end_of(device: TcpDevice) -> dict[str, Any]:
    """Return the error with which the gateway ends the connection."""
    last: dict[str, Any] = {}
    while (message := device.receive()) is not None:
        last = message
    return last


async def test_a_device_gets_its_entities_and_its_values_arrive_in_the_broker(bench: Bench) -> None:
    token = bench.add("hall-1", placement={"relativePosition": [1, 2, 3]})
    device = bench.connect("hall-1", token)
    assert device.ask(type="telemetry", seq=1, values={"temperature": 21.5, "isOpen": True}) == {
        "type": "ack",
        "seq": 1,
    }
    assert device.ask(type="state", seq=2, state="busy", batteryLevel=0.5) == {"type": "ack", "seq": 2}
    assert device.ask(type="event", name="pressed", data={"times": 2}) == {"type": "ack"}
    async with BrokerClient(bench.cell.settings) as broker:

        async def written() -> dict[str, Any] | None:
            found = await broker.retrieve(f"{DEVICE}hall-1")
            is_new = "deviceState" in found and "lastEvent" in found and "performer" in found
            return found if is_new else None

        entity = await until(written)
        assert entity["value"]["value"] == {"temperature": 21.5, "isOpen": 1.0}
        assert (entity["deviceState"]["value"], entity["batteryLevel"]["value"]) == ("busy", 0.5)
        assert entity["connectionState"]["value"] == "connected"
        assert entity["performer"]["value"] == "device-gateway"
        specification = await broker.retrieve("urn:ngsi-ld:ResourceSpecification:demo:hall-1")
        assert specification["parameters"]["value"]["sensors"][0]["unit"] == "CEL"
        bench.rest.delete("/devices/hall-1").raise_for_status()
        assert end_of(device)["code"] == "deleted"
        await until(lambda: _is_missing(broker, f"{DEVICE}hall-1"))


async def _is_missing(broker: BrokerClient, entity: str) -> bool:
    return not await broker.query(type="Device", id=entity)


def test_bad_input_is_answered_and_changes_nothing(bench: Bench) -> None:
    token = bench.add("hall-2")
    device = bench.connect("hall-2", token)
    lines = (
        (b'{"type":"telemetry","seq":1,"values":{"temperature":NaN}}', "notJson"),
        (b'{"type":"telemetry","seq":2,"values":{"pressure":1}}', "unknownValue"),
        (b'{"type":"telemetry","seq":3,"t":5,"values":{"temperature":1}}', "tooOld"),
        (b'{"type":"telemetry","seq":4,"t":9e9,"values":{"temperature":1}}', "future"),
        (b'{"type":"telemetry","seq":5,"values":{"temperature":1,"pressure":2}}', "unknownValue"),
        (b'{"type":"ack","id":"nobody asked"}', "unknownCommand"),
    )
    for line, code in lines:
        device.socket.sendall(line + b"\n")
        answer = device.receive()
        assert answer is not None
        assert (answer["type"], answer["code"]) == ("error", code)
    assert device.ask(type="telemetry", values={"temperature": 99}) == {
        "type": "ack",
        "outOfRange": ["temperature"],
    }
    log = bench.rest.get("/devices/hall-2/messages").json()
    assert [row["type"] for row in log] == ["telemetry", *["refused"] * len(lines)]
    assert bench.rest.get("/devices/hall-2/messages?direction=out").json() == []
    (series,) = bench.rest.get("/devices/hall-2/values").json()
    assert [point["n"] for point in series["points"]] == [1]
    device.socket.sendall(b"x" * 1_000_000)
    assert end_of(device)["code"] == "tooLong"


def test_only_the_token_of_a_device_opens_a_connection(bench: Bench) -> None:
    token = bench.add("hall-3")
    for name, given in (("hall-3", "wrong"), ("nobody", token), ("hall-3", token[:-1])):
        with TcpDevice(bench.cell.ports["devices"], name, given) as refused:
            assert refused.greeting is not None
            assert (refused.greeting["code"], refused.greeting["retry"]) == ("wrongToken", False)
    device = bench.connect("hall-3", token)
    new = bench.rest.post("/devices/hall-3/token").json()["token"]
    assert end_of(device)["code"] == "tokenChanged"
    with TcpDevice(bench.cell.ports["devices"], "hall-3", token) as refused:
        assert refused.greeting is not None
        assert refused.greeting["code"] == "wrongToken"
    device = bench.connect("hall-3", new)
    bench.rest.delete("/devices/hall-3/token").raise_for_status()
    assert end_of(device)["code"] == "tokenRevoked"
    assert not bench.rest.get("/devices/hall-3").json()["hasToken"]
    stored = (bench.cell.data_dir / "devices.db").read_bytes() if _has_file(bench) else b""
    assert new.encode() not in stored


def _has_file(bench: Bench) -> bool:
    return (bench.cell.data_dir / "devices.db").exists()


def test_a_new_connection_replaces_the_old_one_of_the_same_device(bench: Bench) -> None:
    token = bench.add("hall-4")
    first = bench.connect("hall-4", token)
    second = bench.connect("hall-4", token)
    ended = end_of(first)
    assert (ended["code"], ended["retry"]) == ("replaced", False)
    assert second.ask(type="telemetry", values={"temperature": 1}) == {"type": "ack"}
    assert bench.rest.get("/devices/hall-4").json()["connected"]


def test_a_device_sends_by_http_with_its_token(bench: Bench) -> None:
    token = bench.add("hall-5")
    message = {"type": "telemetry", "values": {"temperature": 4.5}}
    refused = bench.rest.post("/ingest/hall-5", json=message, headers={"Authorization": "Bearer no"})
    assert refused.status_code == 401
    header = {"Authorization": f"Bearer {token}"}
    assert bench.rest.post("/ingest/hall-5", json=message, headers=header).json() == {"type": "ack"}
    bad = bench.rest.post("/ingest/hall-5", json={"type": "telemetry", "values": {}}, headers=header)
    assert (bad.status_code, bad.json()["code"]) == (422, "badValues")
    assert bench.rest.get("/devices/hall-5").json()["values"]["temperature"]["value"] == 4.5


def test_the_newest_image_of_a_camera_is_shown_and_never_stored(bench: Bench) -> None:
    token = bench.add("camera-9")
    header = {"Authorization": f"Bearer {token}", "Content-Type": "image/jpeg"}
    jpeg = b"\xff\xd8\xff" + b"1" * 1000
    assert bench.rest.get("/devices/camera-9/image").status_code == 404
    assert "camera-9" not in bench.rest.get("/cameras").text
    url = "/ingest/camera-9/image"
    wrong = bench.rest.post(url, content=jpeg, headers={**header, "Authorization": "Bearer no"})
    none = bench.rest.post(url, content=b"<svg/>", headers=header)
    large = bench.rest.post(url, content=jpeg + bytes(MAX_IMAGE_BYTES), headers=header)
    assert (wrong.status_code, none.status_code, large.status_code) == (401, 422, 413)
    assert bench.rest.post(url, content=jpeg, headers=header).status_code == 204
    shown = bench.rest.get("/devices/camera-9/image")
    assert (shown.content, shown.headers["content-type"]) == (jpeg, "image/jpeg")
    (listed,) = bench.rest.get("/cameras").json()
    assert listed["device"] == "camera-9"
    assert listed["ageS"] >= 0
    assert bench.rest.get("/devices/camera-9/messages").json() == []
    bench.rest.delete("/devices/camera-9")
    assert bench.rest.get("/cameras").json() == []


def test_a_camera_sends_images_over_its_connection_in_parts_if_they_are_large(bench: Bench) -> None:
    token = bench.add("camera-8")
    client = DeviceClient("127.0.0.1", bench.cell.ports["devices"], "camera-8", token)
    client.start()
    wait_for(lambda: bench.rest.get("/devices/camera-8").json()["connected"])
    for size in (1_000, 400_000):
        jpeg = b"\xff\xd8\xff" + bytes(size)

        def is_shown(jpeg: bytes = jpeg) -> bool:
            client.image(jpeg)  # one that comes too soon after the last one is dropped
            return bench.rest.get("/devices/camera-8/image").content == jpeg

        wait_for(is_shown)
    client.stop()
    with bench.connect("camera-8", token) as camera:
        refused = camera.ask(type="image", data=b64encode(b"<svg/>").decode())
        assert refused is not None
        assert (refused["code"], "PNG" in refused["reason"]) == ("imageRefused", True)
        camera.say(type="image", frame=1, part=0, parts=3, data="AAAA")
        gap = camera.ask(type="image", frame=1, part=2, parts=3, data="AAAA")
        assert gap is not None
        assert gap["code"] == "imagePartMissing"
        for bad in ({"data": "?"}, {"data": "AAAA", "part": 1}, {"data": "AAAA", "parts": 1e9}):
            answer = camera.ask(type="image", **bad)
            assert answer is not None
            assert answer["code"] == "badImage"
    assert bench.rest.get("/devices/camera-8/messages").json() == []
    bench.rest.delete("/devices/camera-8")


def test_images_that_come_too_fast_are_refused() -> None:
    now = [100.0]
    images = CameraImages(lambda: now[0])
    first = images.put("camera-1", b"\xff\xd8\xff1")
    with pytest.raises(Problem) as refused:
        images.put("camera-1", b"\xff\xd8\xff2")
    assert refused.value.status == 429
    assert images.of("camera-1") == first
    now[0] += 2 * MIN_INTERVAL_S
    assert images.put("camera-1", b"\xff\xd8\xff3").number > first.number


def test_a_command_is_acknowledged_and_the_same_id_is_not_sent_twice(bench: Bench) -> None:
    token = bench.add("hall-6")
    device = bench.connect("hall-6", token)
    ordered = bench.order("hall-6", "turn", parameters={"rad": 1.0}, id="t-1")
    assert (ordered.status_code, ordered.json()["state"]) == (202, "sent")
    again = bench.order("hall-6", "turn", parameters={"rad": 1.0}, id="t-1")
    assert again.json()["id"] == "t-1"
    assert bench.order("hall-6", "turn", parameters={"rad": 2.0}, id="t-1").status_code == 409
    sent = device.receive()
    assert sent is not None
    assert (sent["type"], sent["id"], sent["parameters"]) == ("command", "t-1", {"rad": 1.0})
    device.say(type="ack", id="t-1", state="running", progress=0.5)
    wait_for(lambda: bench.command("hall-6", "t-1")["progress"] == 0.5)
    device.say(type="ack", id="t-1", result={"rad": 1.0})
    done = bench.command("hall-6", "t-1", wait_s=30)
    assert (done["state"], done["result"]) == ("done", {"rad": 1.0})
    assert device.ask(type="telemetry", values={"temperature": 1}) == {"type": "ack"}  # nothing else was sent
    assert bench.order("hall-6", "turn", parameters={"rad": "far"}).status_code == 422
    assert bench.order("hall-6", "fly").status_code == 404


def test_a_motion_is_refused_while_the_device_is_away_and_an_action_waits(bench: Bench) -> None:
    token = bench.add("hall-7")
    refused = bench.order("hall-7", "turn", parameters={"rad": 1.0})
    assert (refused.status_code, refused.json()["title"]) == (409, "Device away")
    queued = bench.order("hall-7", "beep", id="q-1").json()
    assert queued["state"] == "queued"
    cancelled = bench.order("hall-7", "beep").json()["id"]
    assert bench.rest.delete(f"/devices/hall-7/commands/{cancelled}").json()["state"] == "cancelled"
    device = bench.connect("hall-7", token)
    sent = device.receive()
    assert sent is not None
    assert sent["id"] == "q-1"
    device.say(type="error", id="q-1", reason="no battery")
    failed = bench.command("hall-7", "q-1", wait_s=30)
    assert (failed["state"], failed["reason"]) == ("failed", "no battery")


def test_a_device_is_asked_to_cancel(bench: Bench) -> None:
    device = bench.connect("hall-8", bench.add("hall-8"))
    bench.order("hall-8", "turn", parameters={"rad": 1.0}, id="t-1")
    assert device.receive() is not None
    assert bench.rest.delete("/devices/hall-8/commands/t-1").status_code == 202
    cancel = device.receive()
    assert cancel is not None
    assert (cancel["name"], cancel["parameters"]) == ("cancel", {"id": "t-1"})
    device.say(type="error", id="t-1", reason="stopped")
    assert bench.command("hall-8", "t-1", wait_s=30)["state"] == "cancelled"


async def test_a_task_becomes_a_command_and_its_result_that_of_the_task(bench: Bench) -> None:
    device = bench.connect("hall-9", bench.add("hall-9"))
    async with BrokerClient(bench.cell.settings) as broker:
        for name, operation, members in (
            ("turned", "turn", {"rad": 0.5}),
            ("wrong", "turn", {"rad": "far"}),
        ):
            await broker.create(
                {
                    "id": f"urn:ngsi-ld:Task:demo:{name}",
                    "type": "Task",
                    "isDefinedBy": {
                        "type": "Relationship",
                        "object": f"urn:ngsi-ld:TaskDefinition:demo:{operation}",
                    },
                    "status": {"type": "Property", "value": "pending"},
                    "involves": {
                        "type": "Property",
                        "value": [{"type": "Relationship", "object": f"{DEVICE}hall-9"}],
                    },
                    "workParameters": {"type": "Property", "value": members},
                }
            )
            if name == "turned":
                sent = device.receive()
                assert sent is not None
                assert (sent["name"], sent["parameters"]) == ("turn", {"rad": 0.5})
                device.say(type="ack", id=sent["id"], result={"rad": 0.5})

        async def ended(name: str) -> dict[str, Any] | None:
            task = await broker.retrieve(f"urn:ngsi-ld:Task:demo:{name}")
            return task if task["status"]["value"] in {"completed", "failed"} else None

        turned = await until(lambda: ended("turned"))
        assert turned["status"]["value"] == "completed"
        assert turned["outputParameters"]["value"]["rad"] == 0.5
        wrong = await until(lambda: ended("wrong"))
        assert wrong["status"]["value"] == "failed"
        assert "number" in wrong["outputParameters"]["value"]["reason"]


INSPECTION = """<?xml version="1.0"?>
<bpmn:definitions xmlns:bpmn="http://www.omg.org/spec/BPMN/20100524/MODEL" targetNamespace="t">
  <bpmn:process id="inspection" isExecutable="true">
    <bpmn:startEvent id="s"/><bpmn:sequenceFlow id="f" sourceRef="s" targetRef="look"/>
    <bpmn:userTask id="look" name="Look"/><bpmn:sequenceFlow id="g" sourceRef="look" targetRef="e"/>
    <bpmn:endEvent id="e"/>
  </bpmn:process>
</bpmn:definitions>"""
HOT = {
    "device": "oven-*",
    "value": "temperature",
    "check": {"type": "limits", "maximum": 40, "hysteresis": 5},
    "severity": "high",
    "description": "Switch it off.",
    "startProcess": {"definition": "inspection", "parameters": {"robot": "ur10-1"}},
}


@pytest.mark.nightly
async def test_an_anomaly_raises_an_alert_and_starts_a_process_once(
    new_bench: Callable[[], Bench],
) -> None:
    bench = new_bench()
    bench.cell.run("task_orchestrator")
    orchestrator = bench.cell.url("task_orchestrator")
    xml = {"Content-Type": "application/xml"}
    httpx.post(f"{orchestrator}/definitions", content=INSPECTION, headers=xml).raise_for_status()
    token = bench.add("oven-1")
    assert bench.rest.put("/rules/hot", json={**HOT, "check": {"type": "limits"}}).status_code == 422
    assert bench.rest.put("/rules/a b", json=HOT).json()["detailCode"] == "device.rule_bad_name"
    bench.rest.put("/rules/hot", json=HOT).raise_for_status()
    device = bench.connect("oven-1", token)
    for value in (20, 41, 39, 42):
        assert device.ask(type="telemetry", values={"temperature": value}) == {"type": "ack"}
    async with BrokerClient(bench.cell.settings) as broker:

        async def alert(state: str) -> dict[str, Any] | None:
            (anomaly,) = bench.rest.get("/anomalies", params={"all": True, "device": "oven-1"}).json()
            found = await broker.query(type="Alert", id=anomaly["alert"])
            return found[0] if found and found[0]["alertState"]["value"] == state else None

        raised = await until(lambda: alert("new"))
        assert (raised["severity"]["value"], raised["alertSource"]["object"]) == ("high", f"{DEVICE}oven-1")
        assert raised["descriptionCode"]["value"] == "device.anomaly_limits"
        assert "41" in raised["description"]["value"]

        def processes() -> list[dict[str, Any]]:
            found: list[dict[str, Any]] = httpx.get(
                f"{orchestrator}/processes", params={"definition": "inspection"}
            ).json()
            return found

        await until(processes)
        bench.cell.restart("device_gateway")
        bench = new_bench()
        device = bench.connect("oven-1", token)
        assert bench.rest.get("/anomalies").json()[0]["active"]  # it is known after the end of the gateway
        device.ask(type="telemetry", values={"temperature": 34})
        await until(lambda: alert("returnedToNormal"))
        device.ask(type="telemetry", values={"temperature": 50})
        await until(lambda: alert("new"))
        assert len(processes()) == 1  # within the cooldown
        tested = {"rule": HOT, "device": "oven-1", "value": "temperature"}
        found = bench.rest.post("/rules/test", json=tested).json()
        assert (found["values"], len(found["findings"])) == (6, 2)
        bench.rest.delete("/rules/hot").raise_for_status()
        assert bench.rest.get("/rules").json() == []
        ended = raised["id"]

        async def is_normal() -> bool:
            return (await broker.retrieve(ended))["alertState"]["value"] == "returnedToNormal"

        await until(is_normal)


def test_what_was_acknowledged_survives_the_end_of_the_gateway(new_bench: Callable[[], Bench]) -> None:
    bench = new_bench()
    token = bench.add("hall-10")
    device = bench.connect("hall-10", token)
    t = now_s() - 60
    acknowledged = 0
    for seq in range(50):
        if device.ask(type="telemetry", seq=seq, t=t + seq, values={"temperature": seq}) is not None:
            acknowledged += 1
    bench.order("hall-10", "turn", parameters={"rad": 1.0}, id="t-1")
    bench.order("hall-10", "setInterval", id="s-1")
    bench.cell.restart("device_gateway")
    bench = new_bench()
    (series,) = bench.rest.get("/devices/hall-10/values").json()
    assert sum(point["n"] for point in series["points"]) == acknowledged == 50
    assert bench.rest.get("/devices/hall-10").json()["values"]["temperature"]["value"] == 49
    device = bench.connect("hall-10", token, boot="b2")
    sent = device.receive()
    assert sent is not None
    assert sent["id"] == "s-1"  # a setting is sent again, the motion is not
    device.say(type="ack", id="s-1")
    assert bench.command("hall-10", "s-1", wait_s=30)["state"] == "done"
    assert bench.command("hall-10", "t-1", wait_s=30)["state"] == "unknown"


def test_a_flood_and_silent_connections_leave_others_alone(bench: Bench) -> None:
    token, flooding = bench.add("hall-11"), bench.connect("hall-12", bench.add("hall-12"))
    silent = [socket.create_connection(("127.0.0.1", bench.cell.ports["devices"])) for _ in range(140)]
    flooding.socket.setblocking(False)
    line = json.dumps({"type": "telemetry", "values": {"temperature": 1}}).encode() + b"\n"
    try:
        for _ in range(100_000):
            flooding.socket.sendall(line * 10)
    except BlockingIOError:
        pass  # the gateway reads no more
    else:
        pytest.fail("the gateway read a million messages of one device at once")
    device = bench.connect("hall-11", token)
    for seq in range(20):
        assert device.ask(type="telemetry", seq=seq, values={"temperature": 1}) == {"type": "ack", "seq": seq}
    for one in silent:
        one.close()


def test_a_robot_is_registered_by_template_and_urdf(bench: Bench) -> None:
    made = bench.rest.post("/devices", json={"name": "panda-1", "template": "panda"})
    assert made.status_code == 201
    assert bench.rest.post("/devices", json={"name": "panda-1", "template": "panda"}).status_code == 409
    assert bench.rest.post("/devices", json={"name": "x", "template": "r2d2"}).status_code == 404
    details = bench.rest.get("/devices/panda-1").json()["description"]
    assert (details["degreesOfFreedom"], len(details["joints"])) == (7, 7)
    urdf = b"""<robot name="two">
        <joint name="lift" type="prismatic"><limit lower="0" upper="0.5" velocity="1"/></joint>
        <joint name="spin" type="continuous"/><joint name="bolt" type="fixed"/></robot>"""
    headers = {"Content-Type": "application/xml"}
    changed = bench.rest.put("/devices/panda-1/urdf?joints=true", content=urdf, headers=headers).json()
    assert [joint["name"] for joint in changed["description"]["joints"]] == ["lift", "spin"]
    assert bench.rest.get("/devices/panda-1/urdf").content == urdf
    evil = b'<!DOCTYPE robot [<!ENTITY e SYSTEM "file:///etc/passwd">]><robot name="&e;"/>'
    for bad in (b"no xml", b"<other/>", evil, b'<robot><joint name="a" type="revolute"/></robot>'):
        assert bench.rest.put("/devices/panda-1/urdf", content=bad, headers=headers).status_code == 422
    svg = bench.rest.put("/devices/panda-1/picture", content=b"<svg/>", headers={"Content-Type": "image/png"})
    assert svg.status_code == 422
    png = b"\x89PNG\r\n\x1a\n" + b"0" * 20
    bench.rest.put("/devices/panda-1/picture", content=png, headers={"Content-Type": "image/png"})
    assert bench.rest.get("/devices/panda-1/picture").headers["content-type"] == "image/png"
    assert bench.rest.get("/devices/panda-1").json()["files"] == ["picture", "urdf"]
    devices = bench.rest.get("/devices").json()
    TypeAdapter(list[DeviceView]).validate_python(devices, extra="forbid")  # as it is documented
    listed = next(one for one in devices if one["name"] == "panda-1")
    assert [one["name"] for one in listed["sensors"]] == ["externalForce", "gripperWidth"]
    assert bench.rest.get("/units").json()["CEL"] == "°C"
    csv = bench.rest.get("/devices/panda-1/values.csv")
    assert csv.text.startswith("time,name,value")


@pytest.mark.nightly
def test_simulated_devices_of_every_kind_send_and_move(bench: Bench) -> None:
    played: dict[str, SimulatedDevice] = {}
    for name, description in examples().items():
        body = {"name": name, "description": description.model_dump(mode="json", by_alias=True)}
        token = bench.rest.post("/devices", json=body).raise_for_status().json()["token"]
        client = DeviceClient("127.0.0.1", bench.cell.ports["devices"], name, token)
        played[name] = SimulatedDevice(client, description, period_s=0.2)
        played[name].start()
    try:
        wait_for(
            lambda: all(
                one["connected"] and (one["values"] or one["kind"] == "inputDevice")
                for one in _simulated(bench)
            )
        )
        moved = bench.order("sim-panda", "moveTo", parameters={"joints": [0, 0.5, 0, -1, 0, 1, 0]}, id="m-1")
        assert moved.status_code == 202
        done = bench.command("sim-panda", "m-1", wait_s=30)
        assert (done["state"], done["result"]["joints"]["panda_joint2"]) == ("done", 0.5)
        bench.order("sim-panda", "moveTo", parameters={"joints": [9, 0, 0, 0, 0, 0, 0]}, id="m-2")
        refused = bench.command("sim-panda", "m-2", wait_s=30)
        assert (refused["state"], "panda_joint1" in refused["reason"]) == ("failed", True)
    finally:
        for one in played.values():
            one.stop()


def _simulated(bench: Bench) -> list[dict[str, Any]]:
    return [one for one in bench.rest.get("/devices").json() if one["name"].startswith("sim-")]


def test_a_value_is_forecast_with_its_error_once_the_history_is_long_enough(bench: Bench) -> None:
    token = bench.add("forecast-1")
    device = bench.connect("forecast-1", token)
    asked = {"name": "temperature", "horizon": 600, "steps": 10}
    now = time.time()
    for minute in range(60, 0, -1):
        if minute == 50:
            short = bench.rest.get("/devices/forecast-1/forecast", params=asked)
            assert (short.status_code, short.json()["detailCode"]) == (409, "device.forecast_too_short")
        answer = device.ask(type="telemetry", t=now - 60 * minute, values={"temperature": 20 - minute / 10})
        assert answer is not None
        assert answer["type"] == "ack"
    found = bench.rest.get("/devices/forecast-1/forecast", params=asked).raise_for_status().json()
    assert (found["method"], found["unit"], len(found["points"])) == ("dampedTrend", "CEL", 10)
    assert found["error"] < found["naiveError"]
    assert found["points"][0]["t"] > now - 60
    assert all(point["low"] <= point["mean"] <= point["high"] for point in found["points"])
