"""Gestures of both hands and two in turn complete Tasks in a real broker, with a real glove on each hand."""

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from services.gesture_controller.tests.integration.people.test_people import asked, ends
from tests.kit.waiting import until

pytestmark = pytest.mark.slow

OPEN, UP, POINT, HORNS = "00000", "02222", "20222", "20220"
SITE = """
gestures:
  Thumbs up: 02222
  Point with index: 20222
  Horns: 20220
  Both thumbs up: {left: 02222, right: 02222}
  Wave off: {sequence: [Point with index, Horns]}
commands: {1: Thumbs up, 2: Both thumbs up, 3: Wave off}
gloves:
  glove-1: {hand: right, person: anna}
"""


@pytest.fixture
def cell(cell: Any, tmp_path: Path) -> Any:
    """A cell whose gestures file has composed gestures."""
    (tmp_path / "gestures.yaml").write_text(SITE)
    cell.extra["HANDOVER_GESTURES_FILE"] = str(tmp_path / "gestures.yaml")
    return cell


async def show_both(left: Any, right: Any, codes: tuple[str, str], seconds: float) -> None:
    """Show with both hands, in pieces, so that neither glove is long unheard of."""
    for _ in range(round(seconds / 0.1)):
        left.show(codes[0], 0.1)
        right.show(codes[1], 0.1)
        await asyncio.sleep(0.02)


async def test_both_hands_complete_a_task_also_when_the_second_glove_comes_later(
    bench: Any, put_on: Callable[..., Any]
) -> None:
    right = put_on()
    task = await bench.put("t1", "urn:ngsi-ld:Person:demo:anna", commandId=2)
    assert (await asked(bench, task))["gesture"] == "Both thumbs up"
    assert bench.view()["message"]["key"] == "wearBothLeft"
    right.show(UP, 2)
    left = put_on("left-1", "left")
    bench.screen.put("/gloves/left-1/person", json={"person": "anna"}).raise_for_status()
    await asked(bench, task, "left-1")
    assert await bench.status(task) == "inProgress"

    async def asks_for_the_right_hand() -> bool:
        """Hold briefly: what lasts longer, as on a slow machine, is answered with the fingers that differ."""
        right.show(POINT, 0.1)  # so that the open hand is a new one
        await show_both(left, right, (OPEN, OPEN), 0.1)
        is_asked = bench.view()["message"]["key"] == "showBoth"
        await show_both(left, right, (UP, OPEN), 0.1)
        view = bench.view()
        wanted = {
            "key": "showWithRight",
            "values": {"gesture": "Thumbs up", "hand": "right"},
            "text": "Show with your right hand: Thumbs up.",
        }
        return (
            is_asked
            and view["message"] == wanted
            and [part["state"] for part in view["task"]["parts"]] == ["held", "now"]
        )

    await until(asks_for_the_right_hand)
    await show_both(left, right, (OPEN, OPEN), 0.3)
    await show_both(left, right, (UP, UP), 1.8)
    await ends(bench, task, "completed")
    assert await bench.outputs(task) == {
        "gesture": "Both thumbs up",
        "commandId": 2,
        "heldMs": 1500,
        "by": "gesture",
        "outcome": "ok",
    }

    async def both_devices_say_so() -> bool:
        devices = [await bench.device(f"urn:ngsi-ld:Device:demo:{glove}") for glove in ("glove-1", "left-1")]
        return all(device.get("commandId") == 2 and device["deviceState"] == "ok" for device in devices)

    await until(both_devices_say_so)
    for name in ("t2", "t3"):  # one for each hand: both are free again
        glove = {"t2": "glove-1", "t3": "left-1"}[name]
        await asked(bench, await bench.put(name, f"urn:ngsi-ld:Device:demo:{glove}", commandId=1), glove)


async def test_two_in_turn_complete_a_task_and_without_filtering_are_commands(
    bench: Any, put_on: Callable[..., Any]
) -> None:
    glove = put_on()
    refused = bench.screen.post("/tests", json={"glove": "glove-1", "gestures": ["wave off"]})
    assert refused.status_code == 422
    assert '"Wave off" is composed of "Point with index" and "Horns"' in refused.json()["detail"]
    task = await bench.put("t1", commandId=3)
    await asked(bench, task)
    glove.show(HORNS, 3)
    glove.show(OPEN, 0.2)
    glove.show(POINT, 0.6)

    async def second_is_due() -> bool:
        return [part["state"] for part in bench.view()["task"]["parts"]] == ["done", "now"]

    await until(second_is_due)
    glove.show(OPEN, 0.5)
    glove.show(HORNS, 1.2)
    await ends(bench, task, "completed")
    outputs = await bench.outputs(task)
    assert (outputs["gesture"], outputs["commandId"], outputs["by"]) == ("Wave off", 3, "gesture")
    glove.show(OPEN, 0.3)
    bench.screen.put("/gloves/glove-1/modes", json={"filtering": False}).raise_for_status()
    assert bench.view()["warning"]["key"] == "unfiltered"
    glove.show(UP, 1.6)

    async def commanded(command: int) -> bool:
        return bool((await bench.device()).get("commandId") == command)

    await until(lambda: commanded(1))
    glove.show(OPEN, 0.3)
    glove.show(POINT, 0.6)
    glove.show(HORNS, 1.2)
    await until(lambda: commanded(3))
