"""People choose gloves and gestures over REST; Tasks show what is theirs, and all of it survives."""

import asyncio
from collections.abc import Callable
from typing import Any

import pytest

from tests.kit.waiting import until

pytestmark = pytest.mark.slow

UP, HORNS, MINE = "02222", "20220", "20000"
ANNA = "urn:ngsi-ld:Person:demo:anna"
PutOn = Callable[..., Any]


async def asked(bench: Any, task_id: str, glove: str = "glove-1") -> dict[str, Any]:
    """Wait until the wearer of a glove is asked for what a Task wants; return the Task in the view."""

    async def so() -> bool:
        task = bench.view(glove)["task"]
        return task is not None and task["id"] == task_id

    await until(so)
    task: dict[str, Any] = bench.view(glove)["task"]
    return task


async def ends(bench: Any, task_id: str, status: str) -> None:
    """Wait until a Task is in `status`."""

    async def so() -> bool:
        return bool(await bench.status(task_id) == status)

    await until(so)


@pytest.mark.nightly
async def test_a_task_shows_the_gesture_of_who_does_it_and_it_survives_a_power_cut(
    bench: Any, put_on: PutOn
) -> None:
    put = bench.screen.put
    assert put("/gloves/glove-1/person", json={"person": "anna"}).status_code == 404
    assert put("/people/anna", json={"title": "Anna Virtanen"}).status_code == 201
    defined = put("/people/anna/gestures/Mine", json={"code": MINE})
    assert (defined.status_code, defined.json()["nearest"]["distance"]) == (201, 1)
    assert put("/people/anna/commands/3", json={"gesture": "Mine"}).is_success
    first = await bench.put("t1", commandId=3)
    assert (await asked(bench, first))["gesture"] == "Thumbs up"
    assert put("/gloves/glove-1/person", json={"person": "anna"}).json()["person"] == "anna"
    assert (await asked(bench, first))["gesture"] == "Thumbs up"  # what was asked stays asked
    glove = put_on()
    glove.show(UP, 1.6)
    await ends(bench, first, "completed")
    bench.cell.restart("gesture_controller")
    assert bench.view()["person"] == "anna"
    second = await bench.put("t2", commandId=3)
    task = await asked(bench, second)
    assert (task["gesture"], task["code"]) == ("Mine", MINE)
    put_on().show(MINE, 1.6)
    await ends(bench, second, "completed")
    assert (await bench.outputs(second))["gesture"] == "Mine"
    third = await bench.put("t3", gesture="Horns", commandId=3)
    assert (await asked(bench, third))["gesture"] == "Horns"


async def test_a_task_names_the_person_and_a_person_without_a_glove_is_waited_for(
    bench: Any, put_on: PutOn
) -> None:
    bench.screen.put("/people/anna").raise_for_status()
    bench.screen.put("/people/anna/commands", json={"3": "Horns", "8": None}).raise_for_status()
    both = await bench.put("t1", involves=["urn:ngsi-ld:Device:demo:glove-1", ANNA], commandId=3)
    assert (await asked(bench, both))["gesture"] == "Horns"
    assert bench.view()["person"] == "anna"
    put_on().show(HORNS, 1.6)
    await ends(bench, both, "completed")
    bench.screen.put("/gloves/glove-1/person", json={"person": None}).raise_for_status()
    alone = await bench.put("t2", ANNA, commandId=3)
    await ends(bench, alone, "paused")
    assert bench.view()["task"] is None
    bench.screen.put("/gloves/glove-1/person", json={"person": "anna"}).raise_for_status()
    assert (await asked(bench, alone))["gesture"] == "Horns"
    bench.press("complete", by="Anna").raise_for_status()
    await ends(bench, alone, "completed")


async def test_a_gesture_is_recorded_by_making_it_or_refused_with_the_reason(
    bench: Any, put_on: PutOn
) -> None:
    bench.screen.put("/people/anna").raise_for_status()
    glove = put_on()
    straight, bent = 2000, 100
    frames = [[straight if state == "0" else bent for state in MINE]] * 40

    def record(name: str, **given: Any) -> Any:
        return bench.screen.put(f"/people/anna/gestures/{name}", json={"glove": "glove-1", **given})

    made = record("Mine", frames=frames)
    assert made.status_code == 201
    assert (made.json()["code"], made.json()["sample"]["glove"]) == (MINE, "glove-1")
    again = record("Again", frames=frames)
    assert again.status_code == 409
    assert 'it is "Mine" (code 20000, no finger differs)' in again.json()["detail"]
    moved = record("Moved", frames=frames[:20] + [[bent] * 5] * 20)
    assert moved.status_code == 422
    assert "the hand moved" in moved.json()["detail"]
    silent = record("Silent", recordMs=200)
    assert silent.status_code == 409, silent.text
    assert "glove-1 has sent nothing" in silent.json()["detail"]

    async def wave() -> Any:
        recording = asyncio.create_task(asyncio.to_thread(record, "Live", recordMs=1000))
        while not recording.done():
            glove.show("02200", 0.04)
            await asyncio.sleep(0.02)
        return recording.result()

    live = await wave()
    assert (live.status_code, live.json()["code"]) == (201, "02200")
    assert record("Wrong", code=MINE, frames=frames).status_code == 422
    assert sorted(bench.screen.get("/people/anna").json()["ownGestures"]) == ["Live", "Mine"]
    gone = bench.screen.delete("/people/anna/gestures/Live")
    assert gone.json()["givenAsBefore"] == []


@pytest.mark.nightly
async def test_a_profile_goes_out_and_comes_in_under_another_name(bench: Any) -> None:
    put, get = bench.screen.put, bench.screen.get
    put("/people/anna", json={"title": "Anna"}).raise_for_status()
    put("/people/anna/gestures/Mine", json={"code": MINE}).raise_for_status()
    put("/people/anna/gestures/Wave off", json={"sequence": ["Mine", "Horns"]}).raise_for_status()
    put("/people/anna/commands", json={"3": "Wave off"}).raise_for_status()
    put("/gloves/glove-1/person", json={"person": "anna"}).raise_for_status()
    put("/gloves/glove-1/thresholds", json={"ring": {"upper": 950.5}}).raise_for_status()
    text = get("/people/anna/profile.yaml").text
    assert get("/people/anna/profile.yaml").headers["content-type"].startswith("application/yaml")
    took = put(
        "/people/ben/profile.yaml", content=text.encode(), headers={"Content-Type": "application/yaml"}
    )
    assert took.is_success
    assert took.json()["commands"]["3"] == "Wave off"
    assert get("/people/ben/profile.yaml").text == text.replace("person: anna", "person: ben")
    wrong = put(
        "/people/ben/profile.yaml",
        content=b"person: ben\ncommands:\n  3: Wave",
        headers={"Content-Type": "application/yaml"},
    )
    assert wrong.status_code == 422
    assert wrong.json()["detail"].startswith("profile.yaml:3: command 3 has the unknown gesture")
    assert (
        put(
            "/people/ben/profile.yaml", content=b"\xff", headers={"Content-Type": "application/yaml"}
        ).status_code
        == 422
    )
    assert get("/people/ben/profile.yaml").text == text.replace("person: anna", "person: ben")
    assert bench.screen.delete("/people/anna").status_code == 204
    assert bench.view()["person"] is None
    assert get("/people/anna").status_code == 404
    bench.cell.restart("gesture_controller")
    assert [one["name"] for one in get("/people").json()] == ["ben", "operator-1"]
