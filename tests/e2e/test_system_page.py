"""Services, robots, gloves, Alerts and events with real services, while the robot moves."""

import json
import re
import time
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import Page, expect
from websockets.sync.client import connect

from handover_datamodels.times import iso
from tests.e2e.conftest import OpenPage, answer
from tests.kit.cell import Cell
from tests.kit.waiting import Bound, wait_for

pytestmark = [pytest.mark.nightly, pytest.mark.slow, pytest.mark.timeout(300)]

FORGIVEN = ("WebSocket connection", "Failed to load resource")
"""What a browser logs of a service that the test has killed."""

Keep = Callable[[Page, str], Path]
Accessible = Callable[[Page], None]


def start_process(cell: Cell) -> str:
    """Start the bin-picking process; return its id."""
    answer = httpx.post(
        f"{cell.url('task_orchestrator')}/processes", json={"definition": "bin-picking"}, timeout=120
    )
    return str(answer.raise_for_status().json()["id"])


def complete(cell: Cell, words: str) -> None:
    """Complete by hand what glove-1 is asked for, once it is asked for what has these words."""
    glove = f"{cell.url('gesture_controller')}/gloves/glove-1"
    wait_for(lambda: words in (httpx.get(glove, timeout=120).json()["task"] or {}).get("description", ""))
    httpx.post(f"{glove}/complete", json={"by": "Anna"}, timeout=120).raise_for_status()


@pytest.fixture(scope="module")
def cell(shared_cell: Cell) -> Cell:
    """One cell for all of this page's tests: none needs it as new."""
    shared_cell.run("accounts")
    shared_cell.run("context_broker")
    shared_cell.run("device_gateway")
    shared_cell.run("alert_router")
    return shared_cell


@pytest.mark.usefixtures("screen")
def test_a_failed_service_is_shown_with_the_reason_and_recovers(
    cell: Cell, open_page: OpenPage, keep: Keep, accessible: Accessible
) -> None:
    page = open_page("/admin/services", forgives=FORGIVEN)
    services = page.get_by_role("grid", name="Services")
    expect(services.get_by_role("row", name=re.compile("^Trajectory tool"))).to_contain_text("ur10-1: ")
    cell.kill("trajectory_tool")
    row = services.get_by_role("row", name=re.compile("^Trajectory tool"))
    expect(row).to_contain_text("does not respond")
    expect(row).to_contain_text(cell.url("trajectory_tool"))
    accessible(page)
    keep(page, "system-service-down")
    cell.start("trajectory_tool")
    expect(row).not_to_contain_text("does not respond")
    page.get_by_role("link", name="Cell", exact=True).click()
    page.get_by_role("link", name="Events").click()
    expect(page.get_by_role("grid", name="Events")).to_contain_text("Trajectory tool is running")


@pytest.mark.usefixtures("quiet_screen")
def test_an_acknowledgement_with_a_name_survives_a_restart(
    cell: Cell, open_page: OpenPage, keep: Keep, accessible: Accessible
) -> None:
    process = start_process(cell)
    views = f"{cell.url('task_orchestrator')}/processes/{process}"
    answer(cell, httpx.get(views, timeout=120).json()["tasks"][0]["id"], "failed", reason="nobody was there")

    page = open_page("/alerts", who="", forgives=FORGIVEN)
    row = page.get_by_role("row", name="Incident in a process").first
    row.click()
    alert = page.get_by_role("complementary", name="Incident in a process")
    expect(alert).to_contain_text("Confirm that the cell is clear")
    accessible(page)
    alert.get_by_role("button", name="Acknowledge").click()
    dialog = page.get_by_role("dialog")
    dialog.get_by_role("textbox").fill("Aino")
    page.keyboard.press("Enter")
    expect(alert).to_contain_text("Acknowledged by Aino")
    accessible(page)
    keep(page, "system-alert")

    cell.restart("webui")
    page.goto("/alerts")
    page.get_by_role("row", name="Incident in a process").first.click()
    expect(alert).to_contain_text("Acknowledged by Aino")
    context = f"{cell.url('task_orchestrator')}/context.jsonld"
    page.get_by_role("link", name="Open the process").click()
    expect(page.locator(".incident__reason")).to_contain_text("Nobody was there")
    [stored] = httpx.get(
        f"{cell.url('context_broker')}/ngsi-ld/v1/entities",
        params={"type": "Alert"},
        headers={"Link": f'<{context}>; rel="http://www.w3.org/ns/json-ld#context"'},
        timeout=120,
    ).json()
    assert stored["humanVerified"]["by"]["value"] == "Aino", stored


@pytest.mark.usefixtures("quiet_screen")
def test_the_robot_moves_and_its_gripper_is_released_only_when_idle(
    cell: Cell, open_page: OpenPage, keep: Keep, accessible: Accessible
) -> None:
    start_process(cell)
    page = open_page("/cell/robots/ur10-1")
    drawing = page.get_by_role("application", name=re.compile("^Live 3D view of ur10-1"))
    expect(drawing.locator("canvas")).to_be_visible()
    before = drawing.screenshot()
    complete(cell, "nobody and nothing stands")
    expect(page.get_by_role("heading", name="Scanning the bin")).to_be_visible()
    expect(page.get_by_role("progressbar", name="Task progress")).to_be_visible()
    expect(page.get_by_role("button", name="Open the gripper")).to_be_disabled()
    accessible(page)
    keep(page, "system-robot")
    expect(page.get_by_role("heading", name="No task")).to_be_visible()
    assert drawing.screenshot() != before

    complete(cell, "Stir the bin")
    complete(cell, "pick")
    expect(page.get_by_role("heading", name="Picking a part")).to_be_visible()
    page.get_by_text(re.compile("^Holding ")).wait_for()
    page.get_by_role("heading", name="No task").wait_for()
    page.get_by_role("button", name="Open the gripper").click()
    dialog = page.get_by_role("dialog")
    expect(dialog).to_contain_text("falls unless someone holds it")
    accessible(page)
    dialog.get_by_role("button", name="Open the gripper").click()
    page.get_by_text("Open", exact=True).wait_for()


@pytest.mark.usefixtures("quiet_screen")
def test_a_hand_over_is_confirmed_with_a_button_that_is_large_enough_for_gloves(
    cell: Cell, open_page: OpenPage, keep: Keep, accessible: Accessible
) -> None:
    page = open_page("/cell/robots/ur10-1")
    expect(page.get_by_role("heading", name="No task")).to_be_visible()
    entities = f"{cell.url('context_broker')}/ngsi-ld/v1/entities"
    task = "urn:ngsi-ld:Task:demo:hand-over-1"
    wanted = {
        "id": task,
        "type": "Task",
        "isDefinedBy": {"type": "Relationship", "object": "urn:ngsi-ld:TaskDefinition:demo:handOver"},
        "status": {"type": "Property", "value": "pending", "observedAt": iso(datetime.now(UTC))},
        "involves": {
            "type": "Property",
            "value": [{"type": "Relationship", "object": "urn:ngsi-ld:Device:demo:ur10-1"}],
        },
        "workParameters": {
            "type": "Property",
            "value": {"direction": "take", "part": "housing-1", "pose": {"position": [-0.6, 0.0, 0.4]}},
        },
    }
    context = f"<{cell.url('task_orchestrator')}/context.jsonld>"
    link = {"Link": f'{context}; rel="http://www.w3.org/ns/json-ld#context"'}
    httpx.post(entities, json=wanted, headers=link, timeout=120).raise_for_status()
    button = page.get_by_role("button", name="The part is in place")
    expect(button).to_be_visible()
    box = button.bounding_box()
    assert box is not None
    assert box["height"] >= 64
    stale = f"{cell.url('trajectory_tool')}/robots/ur10-1/confirm"
    assert httpx.post(stale, json={"task": "urn:ngsi-ld:Task:demo:other"}, timeout=120).status_code == 409
    accessible(page)
    keep(page, "system-hand-over")
    button.click()
    expect(page.get_by_text("Holding housing-1")).to_be_visible()
    wait_for(lambda: '"completed"' in httpx.get(f"{entities}/{task}", timeout=120).text)
    free = f"{cell.url('trajectory_tool')}/robots/ur10-1/gripper/free"
    httpx.post(free, timeout=120).raise_for_status()


@pytest.mark.usefixtures("quiet_screen")
def test_the_stop_of_a_robot_for_a_body_signal_is_reset_by_a_person(
    cell: Cell, open_page: OpenPage, keep: Keep, accessible: Accessible
) -> None:
    page = open_page("/cell/robots/ur10-1")
    limits = page.locator(".limits")
    expect(limits).to_contain_text("Nothing limits the speed")
    expect(limits).to_contain_text("not a safety-rated function")
    url = f"{cell.url('trajectory_tool').replace('http', 'ws')}/robots/ur10-1/speed_limits"
    with connect(url, proxy=None) as source:

        def send(fraction: float) -> None:
            report = {
                "source": "strap-1",
                "stamp": time.time(),
                "fraction": fraction,
                "reason": "heart rate 171 bpm",
                "period": 3.0,
                "timeout": 20.0,
            }
            source.send(json.dumps(report))
            received = json.loads(source.recv(timeout=120))
            assert received["accepted"], received

        send(0.0)
        expect(limits).to_contain_text("heart rate 171 bpm")
        expect(limits.locator("[data-stopped]")).to_be_visible()
        accessible(page)
        keep(page, "system-robot-limits")
        send(1.0)
        page.get_by_role("button", name="Reset the stop").click()
        dialog = page.get_by_role("dialog")
        expect(dialog.get_by_role("button", name="Reset the stop")).to_be_disabled()
        dialog.get_by_role("textbox").fill("Aino")
        send(1.0)  # a silent source would stop the robot again
        dialog.get_by_role("button", name="Reset the stop").click()
        expect(limits.locator("[data-stopped]")).to_have_count(0)
    removed = httpx.post(
        f"{cell.url('trajectory_tool')}/robots/ur10-1/limits/sources/strap-1/remove",
        json={"name": "Aino", "reason": "the test is over"},
        timeout=120,
    )
    assert removed.is_success, removed.text


@pytest.mark.usefixtures("screen")
def test_the_simulated_operator_is_started_and_the_event_log_is_exported(
    open_page: OpenPage, keep: Keep, accessible: Accessible
) -> None:
    page = open_page("/")
    page.get_by_role("button", name="Try with a simulated hand").click()
    page.goto("/cell/gloves/glove-1")
    expect(page.get_by_role("main")).to_contain_text(" frames")
    expect(page.get_by_text("Connected", exact=True)).to_be_visible()
    accessible(page)
    keep(page, "system-glove")
    page.get_by_role("link", name="Events").click()
    page.wait_for_url("**/cell/events*")
    events = page.get_by_role("grid", name="Events")
    expect(events).to_contain_text("Simulated operator started with glove-1")
    accessible(page)
    keep(page, "system-events")
    with page.expect_download() as saved:
        page.get_by_role("button", name="Save as JSON").click()
    happened = json.loads(saved.value.path().read_text())
    assert "operator.started" in {event["key"] for event in happened}


@pytest.mark.usefixtures("quiet_screen")
def test_a_person_moves_the_robot_while_the_control_is_held(
    cell: Cell, open_page: OpenPage, keep: Keep, accessible: Accessible
) -> None:
    robot = f"{cell.url('trajectory_tool')}/robots/ur10-1"

    def is_at_rest() -> bool:
        return not any(httpx.get(robot, timeout=120).json()["joints"]["velocity"])

    # Without the 3D view, which a machine without a graphics card draws too slowly for inputs every 20 ms.
    panels = {"side": "joints", "isViewFolded": True}
    httpx.put(f"{cell.url('webui')}/api/user-settings/control.layout", json=panels, timeout=120)
    page = open_page("/cell/robots/ur10-1/control")
    expect(page.get_by_text("No safety function and no emergency stop.")).to_be_visible()
    page.get_by_role("button", name="Take control").click()
    expect(page.get_by_role("heading", name="You control ur10-1")).to_be_visible()
    assert httpx.get(robot, timeout=120).json()["controlledBy"] == "local owner"
    accessible(page)

    def hold_until_it_moves() -> None:
        """Hold and jog; where a busy machine delayed the inputs, the control has to be pressed again."""
        bound = Bound(90)
        while is_at_rest():
            bound.check(lambda: page.inner_text(".hold-bar"))
            page.keyboard.up("Space")
            page.keyboard.down("r")
            page.keyboard.down("Space")
            with suppress(AssertionError):
                expect(page.get_by_text("The robot moves. Release to stop.")).to_be_visible(timeout=1000)

    hidden = "Object.defineProperty(document, 'hidden', {value: true, configurable: true});"
    for end in (
        lambda: page.keyboard.up("Space"),
        lambda: page.evaluate("dispatchEvent(new Event('blur'))"),
        lambda: page.evaluate(f"{hidden} document.dispatchEvent(new Event('visibilitychange'))"),
    ):
        hold_until_it_moves()
        end()
        wait_for(is_at_rest)
        expect(page.get_by_text("Hold this button or Space, and jog.")).to_be_visible()
        page.keyboard.up("Space")
        page.keyboard.up("r")
        page.evaluate("delete document.hidden")
    expect(page.locator(".control__panel--state")).to_contain_text(re.compile(r"rest\s*\d+"))
    keep(page, "control")
    page.get_by_role("button", name="End control").click()
    expect(page.get_by_role("heading", name="Nobody controls ur10-1")).to_be_visible()
