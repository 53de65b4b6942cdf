"""The Processes page with real services: monitor, cancel and retry; check and deploy files."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import pytest
from playwright.sync_api import Page, expect

from tests.e2e.conftest import OpenPage, answer
from tests.kit.cell import Cell
from tests.kit.paths import REPOSITORY

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

SHIPPED = REPOSITORY / "services" / "task_orchestrator" / "processes" / "bin_picking.bpmn"
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
def test_a_failed_task_is_marked_at_its_element_and_retried(
    cell: Cell, open_page: OpenPage, keep: Keep
) -> None:
    process = ask(cell, "POST", "processes", json={"definition": "bin-picking"})
    page = open_page(f"/processes/{process['id']}", who="")
    has_look(page, "confirm_clear", "token")
    answer(cell, process["tasks"][0]["id"], "failed", reason="nobody was there")
    has_look(page, "confirm_clear", "failed")
    expect(page.locator(".process__reason")).to_contain_text("nobody was there")
    keep(page, "processes-failed")
    page.get_by_role("button", name="Retry “Confirm that the cell is clear”").click()
    page.get_by_label("Your name").fill("Liisa")
    page.get_by_role("button", name="Use this name").click()
    has_look(page, "confirm_clear", "token")
    expect(page.locator(".process__act")).to_contain_text("Retried by Liisa")
    expect(page.locator(".timeline__bar")).to_have_count(2)


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
    name = (fault.locator(".upload__where").inner_text()).split(" · ")[0]
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
