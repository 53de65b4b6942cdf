"""A person says no: with a gesture or on the screen, to a Task alone and to a process with a robot in it."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import pytest

from services.task_orchestrator.tests.unit.drawing import drawing, end, path, start
from tests.kit.cell import Cell
from tests.kit.waiting import until

pytestmark = pytest.mark.slow

UP, HORNS, RING, OPEN = "02222", "20220", "22202", "00000"
SITE = """
answers:
  notGood: Horns
  problem: Ring straight
"""
ROBOT = "urn:ngsi-ld:Device:demo:ur10-1"
ALLOWS = (
    '<bpmn:userTask id="allow" name="Allow"><bpmn:extensionElements><handover:task definition="allow">'
    '<handover:involves resource="Device:glove-1"/><handover:parameter name="gesture" value="Thumbs up"/>'
    "</handover:task></bpmn:extensionElements></bpmn:userTask>"
)
MOVES = (
    '<bpmn:serviceTask id="move"><bpmn:extensionElements><handover:task definition="move">'
    '<handover:involves resource="Device:ur10-1"/></handover:task></bpmn:extensionElements>'
    "</bpmn:serviceTask>"
)
NOT_HANDLED = start() + ALLOWS + MOVES + end() + path("start", "allow", "move", "end")


@pytest.fixture
def tenant_cell(tenant_cell: Cell, tmp_path: Path) -> Cell:
    """A cell whose gestures file has gestures for the answers."""
    (tmp_path / "gestures.yaml").write_text(SITE)
    tenant_cell.extra["HANDOVER_GESTURES_FILE"] = str(tmp_path / "gestures.yaml")
    return tenant_cell


async def asked_for(bench: Any, task_id: str) -> dict[str, Any]:
    """Wait until the controller asks for what a Task wants; return what the screen shows of it."""

    async def shown() -> Any:
        task = bench.view()["task"]
        return task if task is not None and task["id"] == task_id else None

    return dict(await until(shown, 60, f"{task_id} is asked for"))


async def ended(bench: Any, task_id: str) -> tuple[str, dict[str, Any]]:
    """Wait until a Task has ended; return how, and its outputParameters."""

    async def final() -> bool:
        return await bench.status(task_id) in {"completed", "failed"}

    await until(final, 60, f"{task_id} has ended")
    return await bench.status(task_id), await bench.outputs(task_id)


async def test_a_gesture_that_says_no_ends_the_task_as_failed_with_the_reason(
    bench: Any, put_on: Callable[..., Any]
) -> None:
    glove = put_on()
    task = await bench.put("t1", description="Look at the grip", commandId=3)
    answers = (await asked_for(bench, task))["answers"]
    assert [(one["outcome"], one["gesture"], one["code"]) for one in answers] == [
        ("notGood", "Horns", HORNS),
        ("problem", "Ring straight", RING),
    ]
    glove.show(OPEN, 0.2)
    glove.show(HORNS, 0.8)

    async def held() -> bool:
        return bool(bench.view()["hold"]["outcome"] == "notGood")

    await until(held, 60, "the hold is for notGood")
    assert await bench.status(task) == "inProgress"
    glove.show(HORNS, 0.8)
    status, outputs = await ended(bench, task)
    assert status == "failed"
    assert outputs == {
        "gesture": "Horns",
        "heldMs": 1500,
        "by": "gesture",
        "outcome": "notGood",
        "reason": 'answered "not good"',
        "reasonCode": "task.not_good",
        "reasonParameters": {},
        "errorCode": "notGood",
    }
    assert bench.view()["answered"]["outcome"] == "notGood"
    assert "commandId" not in await bench.device()


async def test_a_problem_on_the_screen_ends_the_task_as_failed_with_its_note(bench: Any) -> None:
    task = await bench.put("t1", commandId=3)
    await asked_for(bench, task)
    refused = bench.press("complete", by="Anna", outcome="problem", note="x" * 501)
    assert refused.status_code == 422
    assert bench.press("complete", by="Anna", outcome="maybe").status_code == 422
    assert await bench.status(task) == "inProgress"
    assert bench.press("complete", by="Anna", outcome="problem", note=" oil\non the belt ").is_success
    status, outputs = await ended(bench, task)
    assert status == "failed"
    assert outputs["note"] == "oil\non the belt"
    assert outputs["reason"] == 'answered "problem": oil\non the belt'


async def test_a_task_whose_definition_handles_outcomes_is_completed_with_them(bench: Any) -> None:
    said = await bench.put("t1", commandId=3, handlesOutcomes=True)
    await asked_for(bench, said)
    bench.press("complete", by="Anna", outcome="notGood", note="scratched").raise_for_status()
    status, outputs = await ended(bench, said)
    assert (status, outputs["outcome"], outputs["note"]) == ("completed", "notGood", "scratched")
    assert "reason" not in outputs

    await bench.broker.create(
        {
            "id": "urn:ngsi-ld:TaskDefinition:demo:confirm",
            "type": "TaskDefinition",
            "name": {"type": "Property", "value": "Confirm"},
            "handlesOutcomes": {"type": "Property", "value": True},
        }
    )
    defined = await bench.put("t2", commandId=3, description="Look")
    await asked_for(bench, defined)
    bench.press("complete", by="Anna", outcome="problem").raise_for_status()
    status, outputs = await ended(bench, defined)
    assert (status, outputs["outcome"]) == ("completed", "problem")


@pytest.fixture
def orchestrator(running_cell: Cell) -> Any:
    """The task orchestrator, beside broker and controller."""
    running_cell.run("task_orchestrator")
    url = running_cell.url("task_orchestrator")
    with httpx.Client(base_url=url, timeout=120, trust_env=False) as client:
        yield client


async def robot_tasks(bench: Any) -> list[str]:
    """Return the ids of all Tasks for the robot."""
    tasks = await bench.broker.query(type="Task")
    return [task["id"] for task in tasks if task["involves"]["value"][0]["object"] == ROBOT]


@pytest.mark.nightly
async def test_after_no_in_a_process_that_does_not_handle_it_no_robot_is_asked(
    bench: Any, put_on: Callable[..., Any], orchestrator: httpx.Client
) -> None:
    as_xml = {"content-type": "application/xml"}
    assert orchestrator.post("/definitions", content=drawing(NOT_HANDLED), headers=as_xml).is_success
    glove = put_on()
    for say_no, reason in (
        (lambda: glove.show(HORNS, 1.8), 'answered "not good"'),
        (None, 'answered "problem": hand in the bin'),
    ):
        process = orchestrator.post("/processes", json={"definition": "p"}).json()["id"]
        await asked_for(bench, f"urn:ngsi-ld:Task:demo:{process}-allow-1")
        if say_no is not None:
            say_no()
        else:
            bench.press("complete", by="Anna", outcome="problem", note="hand in the bin").raise_for_status()

        async def stopped(process: str = process) -> Any:
            seen = orchestrator.get(f"/processes/{process}").json()
            return seen if seen["incidents"] else None

        seen = await until(stopped, 60, "the process has an incident")
        (incident,) = seen["incidents"]
        assert (incident["name"], incident["reason"]) == ("Allow", reason)
        assert incident["reasonCode"].startswith("task.")
        assert [task["element"] for task in seen["tasks"]] == ["allow"]
        glove.show(OPEN, 0.2)
    assert await robot_tasks(bench) == []


@pytest.mark.nightly
async def test_the_shipped_process_asks_again_after_not_good_goes_on_after_ok_and_stops_at_a_problem(
    bench: Any, put_on: Callable[..., Any], orchestrator: httpx.Client
) -> None:
    glove = put_on()
    process = orchestrator.post("/processes", json={"definition": "bin-picking"}).json()["id"]
    first, second = (f"urn:ngsi-ld:Task:demo:{process}-confirm_clear-{visit}" for visit in (1, 2))
    await asked_for(bench, first)
    glove.show(OPEN, 0.2)
    glove.show(HORNS, 1.8)
    await asked_for(bench, second)
    assert (await ended(bench, first))[0] == "completed"
    assert await robot_tasks(bench) == []
    glove.show(OPEN, 0.2)
    glove.show(UP, 1.8)
    home = f"urn:ngsi-ld:Task:demo:{process}-home_before-1"

    async def robot_is_asked() -> bool:
        return home in await robot_tasks(bench)

    await until(robot_is_asked, 60, "the robot is asked")
    orchestrator.post(f"/processes/{process}/cancel").raise_for_status()

    stopped = orchestrator.post("/processes", json={"definition": "bin-picking"}).json()["id"]
    await asked_for(bench, f"urn:ngsi-ld:Task:demo:{stopped}-confirm_clear-1")
    bench.press("complete", by="Anna", outcome="problem", note="oil").raise_for_status()

    async def over() -> Any:
        seen = orchestrator.get(f"/processes/{stopped}").json()
        return seen if seen["status"] != "inProgress" else None

    seen = await until(over, 60, "the process has ended")
    assert (seen["status"], seen["reason"]) == ("failed", 'the error end event "Cell not clear" was reached')
    assert seen["tasks"][0]["outputParameters"]["note"] == "oil"
    assert await robot_tasks(bench) == [home]
