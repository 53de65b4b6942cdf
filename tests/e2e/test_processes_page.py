"""The Processes page with real services: monitor, cancel and retry; check and deploy files."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import pytest
from playwright.sync_api import Page, expect

from services.task_orchestrator.tests.unit.drawing import drawing, end, path, start
from tests.e2e.conftest import OpenPage, answer, type_slowly
from tests.kit.cell import Cell
from tests.kit.paths import REPOSITORY
from tests.kit.waiting import wait_for

pytestmark = [pytest.mark.nightly, pytest.mark.slow, pytest.mark.timeout(300)]

SHIPPED = REPOSITORY / "services/task_orchestrator/handover_processes/processes" / "bin_picking.bpmn"
REFUSED = "the server responded with a status of 422"
"""What the browser logs of a file that is refused, as it must be."""

Keep = Callable[[Page, str], Path]
Accessible = Callable[[Page], None]


@pytest.fixture(scope="module")
def cell(shared_cell: Cell) -> Cell:
    """One cell for all of these tests; a new version is deployed in the last of them."""
    return shared_cell


def ask(cell: Cell, method: str, path: str, **options: Any) -> Any:
    """What the orchestrator answers."""
    answer = httpx.request(method, f"{cell.url('task_orchestrator')}/{path}", **options)
    answer.raise_for_status()
    return answer.json()


def bin_picking(cell: Cell, **given: Any) -> Any:
    """Start a process and return it with its first Task: the robot may still be reserved by a test before."""
    process = ask(cell, "POST", "processes", json={"definition": "bin-picking", **given})["id"]
    wait_for(lambda: ask(cell, "GET", f"processes/{process}")["tasks"])
    return ask(cell, "GET", f"processes/{process}")


def element(page: Page, name: str) -> Any:
    """An element of the drawing."""
    return page.locator(f".djs-element[data-element-id={name}]")


def has_look(page: Page, name: str, look: str) -> None:
    """Wait until an element of the drawing looks so."""
    expect(element(page, name)).to_have_class(re.compile(rf"\bdiagram-{look}\b"))


def upload(page: Page, file: Path) -> None:
    """Choose a file on the page."""
    with page.expect_file_chooser() as chooser:
        page.get_by_role("button", name=re.compile("^Choose (a|another) file")).click()
    chooser.value.set_files(file)


@pytest.mark.usefixtures("quiet_screen")
def test_a_process_is_started_monitored_and_cancelled(
    cell: Cell, open_page: OpenPage, keep: Keep, accessible: Accessible
) -> None:
    page = open_page("/processes")
    files = []
    page.on("request", lambda request: files.append(request.url) if "/bpmn?" in request.url else None)
    page.get_by_role("button", name="Start Bin picking").click()
    dialog = page.get_by_role("dialog")
    expect(dialog.get_by_label("robot")).to_have_value("Device:ur10-1")
    accessible(page)
    dialog.get_by_role("button", name="Start Bin picking").click()
    has_look(page, "confirm_clear", "token")
    expect(page.get_by_role("button", name=re.compile("^Confirm that the cell is clear, "))).to_be_visible()

    # The token moves without a new layout of the diagram.
    page.locator(".djs-container svg").first.evaluate("drawing => { drawing.dataset.first = 'yes' }")
    process = ask(cell, "GET", "processes")[0]
    [task] = ask(cell, "GET", f"processes/{process['id']}")["tasks"]
    answer(cell, task["id"], "completed", by="screen")
    has_look(page, "confirm_clear", "done")
    expect(page.locator(".djs-container svg[data-first=yes]")).to_have_count(1)
    assert len(files) == 1
    expect(page.locator(".bjs-powered-by")).to_be_visible()
    accessible(page)
    keep(page, "processes-running")

    element(page, "confirm_clear").click()
    expect(page).to_have_url(re.compile(r"task=confirm_clear-1"))
    page.get_by_role("radio", name="Table").click()
    page.get_by_role("searchbox", name="Find tasks").fill("cell is clear")
    expect(page.locator(".tasks .vgrid__line")).to_have_count(1)
    page.reload()
    expect(page.locator(".tasks .vgrid__line")).to_have_count(1)
    expect(page.get_by_role("complementary", name="Task Confirm that the cell is clear")).to_be_visible()
    accessible(page)
    with page.expect_download() as csv:
        page.get_by_role("button", name="Save 1 task as CSV").click()
    assert "confirm_clear" in Path(csv.value.path()).read_text("utf-8")

    page.get_by_role("button", name="Cancel Bin picking").click()
    dialog.get_by_role("button", name="Cancel Bin picking").click()
    expect(page.locator(".process__act")).to_contain_text("Cancelled by Anna")
    expect(page.get_by_role("button", name="Cancel Bin picking")).to_have_count(0)


@pytest.mark.usefixtures("quiet_screen")
def test_an_incident_is_marked_at_its_element_and_retried(
    cell: Cell, open_page: OpenPage, keep: Keep, accessible: Accessible
) -> None:
    process = bin_picking(cell)
    page = open_page(f"/processes/{process['id']}", who="")
    has_look(page, "confirm_clear", "token")
    answer(cell, process["tasks"][0]["id"], "failed", reason="nobody was there")
    has_look(page, "confirm_clear", "incident")
    expect(page.locator(".incident")).to_contain_text("Nobody was there")
    expect(page.locator(".process__name")).to_contain_text("Incident")
    page.get_by_role("button", name="Filter and sort").click()
    page.get_by_label("State").first.select_option("incident")
    expect(page.locator(".process-list__link[href*='/processes/bin-picking-']")).to_have_count(1)
    accessible(page)
    keep(page, "processes-incident")
    page.get_by_role("button", name="Retry “Confirm that the cell is clear”").click()
    page.get_by_label("Your name").fill("Liisa")
    page.get_by_role("button", name="Use this name").click()
    has_look(page, "confirm_clear", "token")
    expect(page.locator(".process__act")).to_contain_text("Retried by Liisa")
    expect(page.locator(".timeline__bar")).to_have_count(2)
    expect(page.locator(".incident")).to_have_count(0)


@pytest.mark.usefixtures("quiet_screen")
def test_an_engineer_resolves_incidents_with_a_name_and_a_reason(
    cell: Cell, open_page: OpenPage, keep: Keep, accessible: Accessible
) -> None:
    process = bin_picking(cell)
    answer(cell, process["tasks"][0]["id"], "failed", reason="nobody was there")
    page = open_page(f"/processes/{process['id']}", who="")
    has_look(page, "confirm_clear", "incident")
    dialog = page.get_by_role("dialog")

    # Variables are validated before they are set, then the Task is posted again.
    page.get_by_role("button", name="Edit and retry").click()
    confirm = dialog.get_by_role("button", name="Set variables and retry")
    variables = dialog.get_by_label("Variables (JSON)")
    dialog.get_by_label("Reason").fill("another person is there now")
    dialog.get_by_label("Your name").fill("Liisa")
    expect(confirm).to_be_enabled()
    given = variables.input_value()
    variables.fill(given.replace('"robot"', "robot"))
    expect(dialog).to_contain_text("Not valid JSON in line")
    expect(confirm).to_be_disabled()
    variables.fill(given.rstrip().removesuffix("}").rstrip() + ',\n  "shift": 2\n}')
    expect(dialog).to_contain_text("Will be set: shift")
    accessible(page)
    keep(page, "processes-incident-variables")
    confirm.click()
    expect(dialog).to_have_count(0)
    has_look(page, "confirm_clear", "token")
    process = ask(cell, "GET", f"processes/{process['id']}")
    assert process["variables"]["shift"] == 2

    # Another incident: the token is moved to an element that is chosen on the diagram.
    answer(cell, process["tasks"][1]["id"], "failed", reason="still nobody")
    has_look(page, "confirm_clear", "incident")
    page.get_by_role("button", name="Move …").click()
    has_look(page, "confirm_grip", "target")
    element(page, "confirm_grip").click()
    has_look(page, "confirm_grip", "picked")
    expect(page.get_by_label("Continue at")).to_have_value("confirm_grip")
    keep(page, "processes-incident-move")
    page.get_by_role("button", name="Move …").click()
    dialog.get_by_label("Reason").fill("the part is gripped already")
    expect(dialog.get_by_label("Your name")).to_have_value("Liisa")
    keep(page, "processes-incident-move-dialog")
    page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    has_look(page, "confirm_grip", "token")
    expect(page.locator(".incident")).to_have_count(0)

    # The history has what was done, by whom and why; nobody has verified the name.
    page.get_by_role("radio", name="History").click()
    rows = page.get_by_role("table", name="History").get_by_role("row")
    expect(rows).to_have_count(3)
    expect(rows.nth(1)).to_contain_text("Liisa (not verified)")
    expect(rows.nth(1)).to_contain_text('{"shift":2}')
    expect(rows.nth(2)).to_contain_text("Moved from “Confirm that the cell is clear” to “Confirm")
    expect(rows.nth(2)).to_contain_text("the part is gripped already")
    accessible(page)
    keep(page, "processes-history")


@pytest.mark.usefixtures("quiet_screen")
def test_a_process_shows_who_holds_the_robot_and_an_engineer_releases_it(
    cell: Cell, open_page: OpenPage, keep: Keep, accessible: Accessible
) -> None:
    started = [ask(cell, "POST", "processes", json={"definition": "bin-picking"}) for _ in range(2)]
    holder, waiting = (each["id"] for each in started)
    page = open_page(f"/processes/{waiting}", who="")
    reservations = page.get_by_role("list", name="Reservations")
    name = started[0]["name"]
    assert re.fullmatch("Bin picking [0-9]+", name)
    expect(page.get_by_role("heading", level=1)).to_have_text(started[1]["name"])
    expect(reservations).to_contain_text(re.compile(f"waits: ur10-1 is held by {name} since .*[0-9]:[0-9]"))
    has_look(page, "confirm_clear", "token")
    accessible(page)
    keep(page, "processes-reservation-waits")
    page.goto(f"/processes/{holder}")
    expect(reservations).to_contain_text("Bin picking has reserved ur10-1")
    keep(page, "processes-reservation-held")
    page.get_by_role("button", name="Release …").click()
    dialog = page.get_by_role("dialog")
    dialog.get_by_label("Reason").fill("the gripper is empty")
    dialog.get_by_label("Your name").fill("Liisa")
    dialog.get_by_role("button", name="Release", exact=True).click()
    expect(dialog).to_have_count(0)
    expect(reservations).to_contain_text("released by Liisa")
    page.get_by_role("radio", name="History").click()
    expect(page.get_by_role("table", name="History")).to_contain_text("the gripper is empty")
    wait_for(lambda: ask(cell, "GET", f"processes/{waiting}")["reservations"][0]["state"] == "held")


@pytest.mark.usefixtures("quiet_screen")
def test_a_step_is_skipped_with_results_and_a_branch_is_ended(cell: Cell, open_page: OpenPage) -> None:
    process = bin_picking(cell)
    answer(cell, process["tasks"][0]["id"], "failed", reason="nobody was there")
    page = open_page(f"/processes/{process['id']}")
    dialog = page.get_by_role("dialog")
    page.locator(".incident").wait_for()
    type_slowly(page, "g", "i")
    expect(page.get_by_role("button", name="Retry “Confirm that the cell is clear”")).to_be_focused()
    page.get_by_role("button", name="Skip …").click()
    dialog.get_by_label("Results of the step (JSON)").fill('{"seen": true}')
    dialog.get_by_label("Reason").fill("seen on the camera")
    dialog.get_by_role("button", name="Skip “Confirm that the cell is clear”").click()
    expect(dialog).to_have_count(0)
    process = ask(cell, "GET", f"processes/{process['id']}")
    assert process["variables"]["seen"] is True
    assert (process["acts"][-1]["act"], process["acts"][-1]["by"]) == ("skip", "Anna")

    ask(cell, "POST", f"processes/{process['id']}/cancel")
    process = bin_picking(cell, parameters={"robot": "Device:ur10-2"})
    answer(cell, process["tasks"][0]["id"], "failed", reason="nobody was there")
    page.goto(f"/processes/{process['id']}")
    page.get_by_role("button", name="End branch …").click()
    dialog.get_by_label("Reason").fill("the shift is over")
    dialog.get_by_role("button", name="End the branch").click()
    expect(page.locator(".process__act")).to_contain_text("Branch ended by Anna")
    wait_for(lambda: ask(cell, "GET", f"processes/{process['id']}")["endedAt"] is not None)


@pytest.mark.usefixtures("quiet_screen")
def test_errors_of_a_file_are_marked_at_its_elements(
    open_page: OpenPage, tmp_path: Path, keep: Keep, accessible: Accessible
) -> None:
    bad = tmp_path / "bad.bpmn"
    bad.write_text(SHIPPED.read_text("utf-8").replace('deadline="PT1M"', 'deadline="soon"', 1), "utf-8")
    page = open_page("/processes/upload", forgives=(REFUSED,))
    upload(page, bad)
    fault = page.locator(".upload__faults button")
    expect(fault).to_have_count(1)
    where = fault.locator(".upload__where").inner_text()
    found = re.fullmatch(r"(.+) \((\w+)\) · line \d+", where)
    assert found is not None, where
    name = found[2]
    has_look(page, name, "fault")
    page.get_by_role("button", name="Zoom in").click(click_count=4)
    fault.click()
    has_look(page, name, "picked")
    place, shown = page.locator(".diagram").bounding_box(), element(page, name).bounding_box()
    assert place is not None
    assert shown is not None
    assert abs((shown["x"] + shown["width"] / 2) - (place["x"] + place["width"] / 2)) < 5
    accessible(page)
    keep(page, "processes-faults")


@pytest.mark.usefixtures("quiet_screen")
def test_warnings_of_a_file_are_listed_and_do_not_prevent_its_deployment(
    open_page: OpenPage, tmp_path: Path, keep: Keep, accessible: Accessible
) -> None:
    stock = '<bpmn:dataStoreReference id="stock" name="Stock of parts"/><bpmn:userTask id="confirm_clear"'
    file = tmp_path / "stock.bpmn"
    xml = SHIPPED.read_text("utf-8").replace('<bpmn:userTask id="confirm_clear"', stock, 1)
    file.write_text(xml, "utf-8")
    page = open_page("/processes/upload")
    upload(page, file)
    warnings = page.get_by_role("region", name="Warnings")
    expect(warnings.get_by_role("listitem")).to_have_count(1)
    expect(warnings).to_contain_text("Stock of parts (stock) · line")
    expect(page.get_by_text("1 warning", exact=True)).to_be_visible()
    expect(page.get_by_role("button", name="Deploy Bin picking, version 2")).to_be_enabled()
    accessible(page)
    keep(page, "processes-warnings")


@pytest.mark.usefixtures("quiet_screen")
def test_a_token_in_a_called_process_is_moved_to_an_element_of_that_process(
    cell: Cell, open_page: OpenPage, keep: Keep
) -> None:
    pack = (
        '<bpmn:userTask id="wrap" name="Wrap it"><bpmn:extensionElements><handover:task definition="wrap">'
        '<handover:involves resource="Device:glove-1"/><handover:parameter name="gesture" value="Thumbs up"/>'
        "</handover:task></bpmn:extensionElements></bpmn:userTask>"
        '<bpmn:manualTask id="label" name="Label it"/>'
    )
    called = drawing(start() + pack + end() + path("start", "wrap", "label", "end"), name="packing")
    call = '<bpmn:callActivity id="pack" name="Pack" calledElement="packing"/>'
    caller = drawing(start() + call + end() + path("start", "pack", "end"), name="shipping")
    for xml in (called, caller):
        ask(cell, "POST", "definitions", content=xml, headers={"Content-Type": "application/xml"})
    process = ask(cell, "POST", "processes", json={"definition": "shipping"})
    answer(cell, process["tasks"][0]["id"], "failed", reason="no paper")
    page = open_page(f"/processes/{process['id']}")
    has_look(page, "pack", "incident")
    expect(page.locator(".incident")).to_contain_text("Wrap it")
    page.get_by_role("button", name="Move …").click()
    page.get_by_label("Continue at", exact=True).select_option("Label it (label)")
    expect(page.locator(".diagram-target")).to_have_count(0)
    keep(page, "processes-incident-called")
    page.get_by_role("button", name="Move …").click()
    dialog = page.get_by_role("dialog")
    dialog.get_by_label("Reason").fill("wrapped by hand")
    dialog.get_by_role("button", name="Move to “Label it”").click()
    expect(page.locator(".incident")).to_have_count(0)
    [act] = ask(cell, "GET", f"processes/{process['id']}")["acts"]
    assert (act["act"], act["element"], act["to"]) == ("move", "pack.wrap", "label")


@pytest.mark.usefixtures("quiet_screen")
def test_the_diagram_is_moved_with_the_keyboard_and_leaks_nothing(cell: Cell, open_page: OpenPage) -> None:
    ids = [ask(cell, "POST", "processes", json={"definition": "bin-picking"})["id"] for _ in range(2)]
    page = open_page(f"/processes/{ids[0]}")
    has_look(page, "confirm_clear", "token")
    before = element(page, "confirm_clear").bounding_box()
    page.get_by_role("application").focus()
    page.keyboard.press("ArrowRight")
    after = element(page, "confirm_clear").bounding_box()
    assert before is not None
    assert after is not None
    assert after["x"] < before["x"]
    page.keyboard.press("0")
    for turn in range(6):
        page.locator(f"a[href='/processes/{ids[(turn + 1) % 2]}']").click()
        page.wait_for_url(f"**/{ids[(turn + 1) % 2]}")
        has_look(page, "confirm_clear", "token")
    expect(page.locator(".djs-container")).to_have_count(1)


@pytest.mark.usefixtures("quiet_screen")
def test_a_file_without_a_layout_is_laid_out_and_deployed_as_a_new_version(
    cell: Cell, open_page: OpenPage, tmp_path: Path, keep: Keep, accessible: Accessible
) -> None:
    bare = tmp_path / "bare.bpmn"
    drawing = re.compile(r"<bpmndi:BPMNDiagram.*</bpmndi:BPMNDiagram>", re.DOTALL)
    bare.write_text(drawing.sub("", SHIPPED.read_text("utf-8")), "utf-8")
    page = open_page("/processes/upload")
    upload(page, bare)
    element(page, "confirm_clear").wait_for()
    expect(page.get_by_text("contains no diagram")).to_be_visible()
    assert ask(cell, "GET", "definitions/bin-picking")["version"] == 1, "it is only looked at by now"
    page.get_by_role("button", name="Deploy Bin picking, version 2").click()
    expect(page.get_by_label("Version")).to_have_value("2")
    accessible(page)
    page.get_by_label("Version").select_option("1")
    expect(page).to_have_url(re.compile(r"/processes/definition/bin-picking\?version=1"))
    expect(page.get_by_text("contains no diagram")).to_have_count(0)
    keep(page, "processes-definition")
