"""Five hundred processes on the page: identified by key, filtered, sorted, scrolled, counted."""

import re
from collections.abc import Callable
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import Page, expect

from tests.e2e.conftest import OpenPage
from tests.kit.cell import Cell

pytestmark = [pytest.mark.nightly, pytest.mark.slow, pytest.mark.timeout(600)]

AWAY = ("WebSocket connection", "Failed to load resource")
"""What a browser logs of services that are not started here."""
MANY = 500
PATIENCE_MS = 120_000

Keep = Callable[[Page, str], Path]
Accessible = Callable[[Page], None]


@pytest.fixture
def process_screen(cell: Cell) -> Cell:
    """A broker, the orchestrator and the screen; nobody performs Tasks."""
    cell.run("context_broker")
    cell.run("task_orchestrator", "webui")
    return cell


def test_five_hundred_processes_are_distinguished_filtered_and_scrolled(
    process_screen: Cell, open_page: OpenPage, keep: Keep, accessible: Accessible
) -> None:
    cell = process_screen
    url = f"{cell.url('task_orchestrator')}/processes"
    with httpx.Client(timeout=120) as client:
        for number in range(MANY):
            robot = {"robot": f"Device:ur10-{number}"}
            order = {"definition": "bin-picking", "key": f"order {number}", "parameters": robot}
            client.post(url, json=order).raise_for_status()
    page = open_page("/processes", forgives=AWAY)
    table = page.get_by_role("grid", name="Definitions and processes")
    page.get_by_text("Running (500)", exact=True).wait_for(timeout=PATIENCE_MS)
    first = table.locator(".process-list__link[href*='/processes/bin-picking-']").first
    expect(first).to_contain_text(f"order {MANY - 1}")
    expect(first).to_contain_text("Confirm that the cell is clear")
    assert not re.search(r"[0-9a-f]{8}", first.inner_text()), "no hash where there is a key"
    assert table.locator(".vgrid__line").count() < 60, "only visible rows are in the document"
    accessible(page)
    keep(page, "processes-500")
    table.locator("[role=row][tabindex='0']").focus()
    page.keyboard.press("End")
    expect(table.locator("[role=row]:focus")).to_be_visible()
    page.keyboard.press("Home")

    page.get_by_role("searchbox", name="Search").fill("order 77")
    page.get_by_text("Running (5)", exact=True).wait_for()
    page.get_by_role("searchbox", name="Search").fill("")
    page.get_by_role("button", name="Filter and sort").click()
    page.get_by_label("Sort by").select_option("key")
    expect(first).to_contain_text("order 0")
    page.get_by_label("State").select_option("failed")
    page.get_by_text("Running (0)", exact=True).wait_for()
    page.get_by_label("State").select_option("")
    page.get_by_label("Person or device").select_option(label="glove-1")
    page.get_by_text("Running (500)", exact=True).wait_for(timeout=PATIENCE_MS)
    first.click()
    expect(page).to_have_url(re.compile("sort=key.*involves=|involves=.*sort=key"))
    expect(page.locator(".process__mark")).to_have_text("Bin picking · order 0")
    keep(page, "processes-500-filtered")

    page.goto("/")
    expect(page.get_by_role("region", name="Running")).to_contain_text(str(MANY))
    expect(page.get_by_role("region", name="Open tasks")).to_contain_text(f"glove-1 {MANY}")
    expect(page.get_by_role("region", name="Open tasks").get_by_role("listitem")).to_have_count(6)
    accessible(page)
    keep(page, "start-500")
