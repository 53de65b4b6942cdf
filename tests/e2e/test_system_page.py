"""The System page with real services: health, alerts, the moving robot, events."""

import json
import re
import time
from collections.abc import Callable
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import Page, expect
from websockets.sync.client import connect

from tests.e2e.conftest import OpenPage, answer
from tests.kit.cell import Cell
from tests.kit.waiting import wait_for

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

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
    return shared_cell


@pytest.mark.usefixtures("screen")
def test_a_failed_service_is_shown_with_the_reason_and_recovers(
    cell: Cell, open_page: OpenPage, keep: Keep, accessible: Accessible
) -> None:
    page = open_page("/system", forgives=FORGIVEN)
    services = page.get_by_role("grid", name="Services")
    expect(services.get_by_role("row", name=re.compile("^Trajectory tool"))).to_contain_text("ur10-1: ")
    cell.kill("trajectory_tool")
    row = services.get_by_role("row", name=re.compile("^Trajectory tool"))
    expect(row).to_contain_text("does not respond")
    expect(row).to_contain_text(cell.url("trajectory_tool"))
    expect(page.get_by_role("tab", name="1 service has a problem")).to_be_visible()
    accessible(page)
    keep(page, "system-service-down")
    cell.start("trajectory_tool")
    expect(row).not_to_contain_text("does not respond")
    page.get_by_role("tab", name="Events").click()
    expect(page.get_by_role("grid", name="Events")).to_contain_text("Trajectory tool is running")


@pytest.mark.usefixtures("quiet_screen")
def test_an_acknowledgement_with_a_name_survives_a_restart(
    cell: Cell, open_page: OpenPage, keep: Keep, accessible: Accessible
) -> None:
    process = start_process(cell)
    views = f"{cell.url('task_orchestrator')}/processes/{process}"
    answer(cell, httpx.get(views, timeout=120).json()["tasks"][0]["id"], "failed", reason="nobody was there")

    page = open_page("/system?tab=alerts", who="", forgives=FORGIVEN)
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
    page.goto("/system?tab=alerts")
    page.get_by_role("row", name="Incident in a process").first.click()
    expect(alert).to_contain_text("Acknowledged by Aino")
    context = f"{cell.url('task_orchestrator')}/context.jsonld"
    page.get_by_role("link", name="Open the process").click()
    expect(page.locator(".incident__reason")).to_contain_text("nobody was there")
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
    page = open_page("/system?tab=robots")
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
def test_the_stop_of_a_robot_for_a_body_signal_is_reset_by_a_person(
    cell: Cell, open_page: OpenPage, keep: Keep, accessible: Accessible
) -> None:
    page = open_page("/system?tab=robots")
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
    page.get_by_role("button", name="Start the simulated operator").click()
    page.goto("/system?tab=gloves")
    expect(page.get_by_role("main")).to_contain_text(" frames")
    expect(page.get_by_text("Connected", exact=True)).to_be_visible()
    accessible(page)
    keep(page, "system-glove")
    page.keyboard.press("e")
    page.wait_for_url("**tab=events*")
    events = page.get_by_role("grid", name="Events")
    expect(events).to_contain_text("Simulated operator started with glove-1")
    accessible(page)
    keep(page, "system-events")
    with page.expect_download() as saved:
        page.get_by_role("button", name="Save as JSON").click()
    happened = json.loads(saved.value.path().read_text())
    assert "operator.started" in {event["key"] for event in happened}
