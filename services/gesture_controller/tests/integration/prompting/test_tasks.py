"""Real Tasks in a real broker, answered by a glove on TCP or on the screen."""

import asyncio
from collections.abc import Callable
from typing import Any

import httpx
import orjson
import pytest
import websockets

from tests.kit.waiting import until

pytestmark = pytest.mark.slow

UP, HORNS, OPEN = "02222", "20220", "00000"
PutOn = Callable[..., Any]


async def asked(bench: Any, task_id: str) -> None:
    """Wait until the controller asks for what a Task wants."""

    async def so() -> bool:
        task = bench.view()["task"]
        return task is not None and task["id"] == task_id

    await until(so)


async def ends(bench: Any, task_id: str, status: str) -> None:
    """Wait until a Task is in `status`."""

    async def so() -> bool:
        return bool(await bench.status(task_id) == status)

    await until(so)


async def test_a_held_gesture_completes_its_task_and_keeps_the_device_current(
    bench: Any, put_on: PutOn
) -> None:
    glove = put_on()
    assert glove.answer == {"type": "ack", "version": 1, "glove": "glove-1"}
    glove.show(OPEN, 0.2)
    task = await bench.put("t1", description="Confirm that the part lies free", commandId=3)
    await asked(bench, task)
    view = bench.view()
    assert view["task"] == {
        "id": task,
        "description": "Confirm that the part lies free",
        "gesture": "Thumbs up",
        "code": UP,
        "commandId": 3,
        "parts": [],
        "status": "inProgress",
        "needsPin": False,
        "answers": [
            {"outcome": outcome, "gesture": None, "code": None, "parts": []}
            for outcome in ("notGood", "problem")
        ],
    }
    assert view["deviceState"] == "busy"
    glove.show(HORNS, 3)  # a wrong one, twice as long as confirms
    glove.show(UP, 1.4)  # a right one, too short
    glove.show(OPEN, 0.2)

    async def all_seen() -> bool:
        return bool(bench.view()["frames"] == 240)

    await until(all_seen)
    assert await bench.status(task) == "inProgress"
    glove.show(UP, 1.6)
    await ends(bench, task, "completed")
    outputs = await bench.outputs(task)
    assert outputs == {
        "gesture": "Thumbs up",
        "commandId": 3,
        "heldMs": 1500,
        "by": "gesture",
        "outcome": "ok",
    }

    async def device_is_current() -> bool:
        device = await bench.device()
        return device.get("commandId") == 3 and device["deviceState"] == "ok"

    await until(device_is_current)
    device = await bench.broker.retrieve("urn:ngsi-ld:Device:demo:glove-1")
    assert "observedAt" in device["commandId"]
    assert (await bench.device())["controlledProperty"] in ("gesture", ["gesture"])


async def test_one_hold_completes_one_task_and_tasks_come_in_order(bench: Any, put_on: PutOn) -> None:
    glove = put_on()
    first = await bench.put("t1", commandId=3)
    await asked(bench, first)
    second = await bench.put("t2", gesture="Thumbs up")
    glove.show(UP, 1.6)
    await ends(bench, first, "completed")
    await asked(bench, second)
    glove.show(UP, 5)

    async def is_raised() -> bool:
        return "Let go" in bench.view()["message"]["text"]

    await until(is_raised)
    assert await bench.status(second) == "inProgress"
    glove.show(OPEN, 0.3)
    glove.show(UP, 1.6)
    await ends(bench, second, "completed")


async def test_a_task_for_the_person_is_answered_with_the_glove_they_wear(bench: Any, put_on: PutOn) -> None:
    glove = put_on()
    for_glove = await bench.put("t1", commandId=3)
    await asked(bench, for_glove)
    for_person = await bench.put("t2", "urn:ngsi-ld:Person:demo:operator-1", gesture="Horns")
    glove.show(UP, 1.6)
    await ends(bench, for_glove, "completed")
    await asked(bench, for_person)
    glove.show(HORNS, 1.6)
    await ends(bench, for_person, "completed")


async def test_what_the_task_leaves_out_stands_in_its_definition(bench: Any, put_on: PutOn) -> None:
    await bench.broker.create(
        {
            "id": "urn:ngsi-ld:TaskDefinition:demo:confirm",
            "type": "TaskDefinition",
            "name": {"type": "Property", "value": "Confirm"},
            "description": {"type": "Property", "value": "Look into the bin"},
            "gesture": {"type": "Property", "value": "Horns"},
        }
    )
    task = await bench.put("t1")
    await asked(bench, task)
    assert bench.view()["task"]["description"] == "Look into the bin"
    put_on().show(HORNS, 1.6)
    await ends(bench, task, "completed")
    assert (await bench.outputs(task))["commandId"] == 8


async def test_a_task_for_an_unknown_gesture_fails_with_the_reason_and_an_alert(bench: Any) -> None:
    task = await bench.put("t1", gesture="Vulcan salute")
    await ends(bench, task, "failed")
    assert 'unknown gesture "Vulcan salute"' in (await bench.outputs(task))["reason"]

    async def alerted() -> bool:
        return any("Vulcan salute" in one["description"]["value"] for one in await bench.alerts())

    await until(alerted)
    neither = await bench.put("t2", description="What now?")
    await ends(bench, neither, "failed")
    assert "neither a gesture nor a commandId" in (await bench.outputs(neither))["reason"]


async def test_without_a_glove_the_screen_says_so_and_completes_the_task(bench: Any) -> None:
    task = await bench.put("t1", commandId=3)
    await asked(bench, task)
    assert bench.view()["message"]["text"].startswith("Put on glove-1")
    assert bench.press("complete", by="Anna").is_success
    await ends(bench, task, "completed")
    assert await bench.outputs(task) == {
        "gesture": "Thumbs up",
        "commandId": 3,
        "heldMs": 0,
        "by": "screen",
        "operator": "Anna",
        "outcome": "ok",
    }
    assert bench.press("complete", by="Anna").status_code == 409


@pytest.mark.nightly
@pytest.mark.parametrize("silence_s", [2.0])
async def test_a_silent_glove_pauses_its_task_raises_an_alert_and_goes_on_when_it_is_back(
    bench: Any, put_on: PutOn
) -> None:
    glove = put_on()
    glove.show(OPEN, 0.2)
    task = await bench.put("t1", commandId=3)
    await asked(bench, task)
    glove.show(OPEN, 0.2)
    await ends(bench, task, "paused")

    async def alerted() -> bool:
        return any(
            one["severity"]["value"] == "high" and "validTo" not in one for one in await bench.alerts()
        )

    await until(alerted)

    async def in_error() -> bool:
        return (await bench.device())["deviceState"] == "error"

    await until(in_error)
    glove.show(OPEN, 0.2)

    async def over() -> bool:
        return all("validTo" in one for one in await bench.alerts())

    await until(over)
    glove.show(UP, 1.6)
    await ends(bench, task, "completed")


@pytest.mark.nightly
@pytest.mark.parametrize("silence_s", [2.0])
async def test_a_task_whose_glove_went_silent_is_completed_on_the_screen(bench: Any, put_on: PutOn) -> None:
    glove = put_on()
    glove.show(OPEN, 0.2)
    task = await bench.put("t1", commandId=3)
    await asked(bench, task)
    glove.close()
    await ends(bench, task, "paused")
    assert bench.press("complete", by="Anna").is_success
    await ends(bench, task, "completed")


async def test_a_requested_pause_is_kept_and_a_requested_end_ends(bench: Any, put_on: PutOn) -> None:
    glove = put_on()
    task = await bench.put("t1", commandId=3)
    await asked(bench, task)

    async def request(wish: str) -> None:
        await bench.broker.append(task, {"requestedStatus": {"type": "Property", "value": wish}})

    await request("paused")
    await ends(bench, task, "paused")
    before = bench.view()["frames"]
    glove.show(UP, 2)

    async def seen() -> bool:
        return bool(bench.view()["frames"] == before + 100)

    await until(seen)
    assert bench.view()["paused"] is True
    assert await bench.status(task) == "paused"
    assert bench.press("complete", by="Anna").status_code == 409
    await request("inProgress")
    await ends(bench, task, "inProgress")
    await request("cancelled")
    await ends(bench, task, "failed")
    assert (await bench.outputs(task))["reason"] == "cancelled"

    async def free() -> bool:
        return bench.view()["task"] is None

    await until(free)


async def test_a_pause_on_the_screen_pauses_the_task(bench: Any, put_on: PutOn) -> None:
    glove = put_on()
    task = await bench.put("t1", commandId=3)
    await asked(bench, task)
    assert bench.press("pause").json()["paused"] is True
    await ends(bench, task, "paused")
    assert bench.press("resume").json()["paused"] is False
    await ends(bench, task, "inProgress")
    glove.show(UP, 1.6)
    await ends(bench, task, "completed")


async def test_in_testing_mode_nothing_completes_and_without_filtering_commands_are_written(
    bench: Any, put_on: PutOn
) -> None:
    glove = put_on()
    task = await bench.put("t1", commandId=3)
    await asked(bench, task)
    bench.screen.put("/gloves/glove-1/modes", json={"testing": True}).raise_for_status()
    glove.show(UP, 3)

    async def seen() -> bool:
        return bench.view()["gesture"] == "Thumbs up"

    await until(seen)
    assert await bench.status(task) == "inProgress"
    bench.screen.put("/gloves/glove-1/modes", json={"testing": False, "filtering": False}).raise_for_status()
    glove.show(HORNS, 1.6)

    async def commanded() -> bool:
        return (await bench.device()).get("commandId") == 8

    await until(commanded)
    assert await bench.status(task) == "inProgress"
    glove.show(UP, 1.6)
    await ends(bench, task, "completed")


async def test_a_killed_controller_takes_its_task_up_again(bench: Any, put_on: PutOn) -> None:
    task = await bench.put("t1", commandId=3)
    await asked(bench, task)
    thresholds = {"thumb": {"upper": 900, "lower": 700}}
    bench.screen.put("/gloves/glove-1/thresholds", json=thresholds).raise_for_status()
    bench.cell.restart("gesture_controller")
    await asked(bench, task)
    assert bench.view()["thresholds"]["thumb"] == {"upper": 900, "lower": 700}
    put_on().show(UP, 1.6)
    await ends(bench, task, "completed")


async def test_a_broker_that_was_away_learns_of_the_answer(bench: Any, put_on: PutOn) -> None:
    glove = put_on()
    task = await bench.put("t1", commandId=3)
    await asked(bench, task)
    bench.cell.kill("context_broker")
    glove.show(UP, 1.6)

    async def answered() -> bool:
        return bench.view()["task"] is None

    await until(answered)
    bench.cell.start("context_broker")
    await ends(bench, task, "completed")


async def test_the_screen_follows_the_hand_and_the_recorder_takes_its_frames(
    bench: Any, put_on: PutOn
) -> None:
    glove = put_on()
    address = f"ws://127.0.0.1:{bench.cell.ports['gesture_controller']}/gloves/glove-1/live"
    url = f"{bench.cell.url('gesture_controller')}/gloves/glove-1/frames"
    async with (
        websockets.connect(address) as live,
        httpx.AsyncClient(timeout=120, trust_env=False) as http,
        http.stream("GET", url) as stream,
        asyncio.timeout(120),
    ):
        lines = stream.aiter_lines()
        hello = orjson.loads(await anext(lines))
        assert (hello["type"], hello["glove"]) == ("hello", "glove-1")
        assert orjson.loads(await live.recv())["glove"] == "glove-1"
        glove.show(UP, 1.0)
        while True:
            view = orjson.loads(await live.recv())
            if view["hold"]["heldMs"] == 980:
                break
        assert (view["states"], view["gesture"], view["frames"]) == (UP, "Thumbs up", 50)
        frames = [orjson.loads(await anext(lines)) for _ in range(50)]
        assert frames[0]["t"] == 0.02
        assert frames[-1]["t"] == 1.0


async def test_a_screen_for_an_unknown_glove_is_closed_with_the_reason(bench: Any) -> None:
    base = bench.cell.ports["gesture_controller"]
    async with websockets.connect(f"ws://127.0.0.1:{base}/gloves/nowhere/live") as live:
        with pytest.raises(websockets.ConnectionClosedError) as closed:
            await live.recv()
    assert closed.value.rcvd is not None
    assert closed.value.rcvd.code == 4404
    answer = bench.screen.get("/gloves/nowhere")
    assert answer.status_code == 404
    assert answer.headers["content-type"] == "application/problem+json"


async def test_invalid_requests_get_the_reason(bench: Any) -> None:
    put = bench.screen.put
    assert put("/gloves/glove-1/modes", json={"testing": True, "colour": 1}).status_code == 422
    assert put("/gloves/glove-1/thresholds", json={"pinky": {"upper": 1}}).status_code == 422
    assert (
        put(
            "/gloves/glove-1/thresholds",
            content=b'{"ring": {"upper": NaN}}',
            headers={"Content-Type": "application/json"},
        ).status_code
        == 422
    )
    assert put("/gloves/a%20b", json={}).status_code == 422
    assert put("/gloves/glove-2", json={"hand": "left"}).status_code == 201
    assert put("/gloves/glove-2", json={}).status_code == 200
    flat = {"fist": [[300] * 5] * 20, "open": [[300] * 5] * 20}
    refused = bench.screen.post("/gloves/glove-1/calibration", json=flat)
    assert refused.status_code == 422
    assert "thumb: the sensor does not rise" in refused.json()["detail"]
    metrics = bench.screen.get("/metrics").text
    assert "handover_gesture_controller_frames_received_total" in metrics
