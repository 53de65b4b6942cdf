"""Five hundred devices and people on the page, on a laptop and at 4K: searched, sorted, scrolled."""

import re
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx
import pytest
from playwright.sync_api import Page, expect

from tests.e2e.conftest import PANEL, OpenPage
from tests.e2e.test_every_page import COLLIDING, nothing_is_cut_off
from tests.kit.cell import Cell

pytestmark = [pytest.mark.nightly, pytest.mark.slow, pytest.mark.timeout(600)]

AWAY = ("WebSocket connection", "Failed to load resource")
"""Messages of the browser about services that this test does not start."""
MANY = 500
MAX_ELEMENTS = 4000
"""Of a page; without virtual rows 500 devices have more than 10,000."""
UHD = {"width": 3840, "height": 2160}
KINDS = ("sensor", "actuator", "robot", "conveyor")
STATES = ("ok", "idle", "busy", "paused", "error")

Keep = Callable[[Page, str], Path]
Accessible = Callable[[Page], None]


def device(number: int) -> dict[str, Any]:
    """A Device with all values that the table shows."""
    kind = KINDS[number % len(KINDS)]
    at = "2026-01-01T08:00:00Z"
    return {
        "id": f"urn:ngsi-ld:Device:plant:{kind}-{number}",
        "type": "Device",
        "category": {"type": "Property", "value": [kind]},
        "deviceState": {"type": "Property", "value": STATES[number % len(STATES)], "observedAt": at},
        "batteryLevel": {"type": "Property", "value": (number % 100) / 100},
        "value": {"type": "Property", "value": number * 1.25, "observedAt": at},
    }


def elements(page: Page) -> int:
    """The number of elements in the document."""
    return int(page.evaluate("document.querySelectorAll('*').length"))


def test_five_hundred_devices_are_searched_sorted_and_scrolled(
    cell: Cell, open_page: OpenPage, keep: Keep, accessible: Accessible
) -> None:
    cell.run("context_broker")
    cell.run("webui")
    context = f'<{cell.url("webui")}/context.jsonld>; rel="http://www.w3.org/ns/json-ld#context"'
    url = f"{cell.url('context_broker')}/ngsi-ld/v1/entityOperations/upsert"
    devices = [device(number) for number in range(MANY)]
    httpx.post(url, json=devices, headers={"Link": context}, timeout=60).raise_for_status()
    for size, viewport in (("laptop", PANEL), ("4k", UHD)):
        page = open_page("/cell", viewport=viewport, forgives=AWAY)
        table = page.get_by_role("grid", name="Objects of the cell")
        expect(table).to_have_attribute(
            "aria-rowcount", re.compile(r"5\d\d")
        )  # with the services and headings
        rows = table.locator(".vgrid__line")
        expect(rows.first).to_contain_text("actuator-1")
        assert elements(page) < MAX_ELEMENTS
        assert page.evaluate(COLLIDING) == []
        nothing_is_cut_off(page)
        accessible(page)
        keep(page, f"devices-500-{size}")

        rows.first.focus()
        page.keyboard.press("End")
        expect(table.locator("[role=row]:focus")).to_contain_text("Service")
        page.keyboard.press("Home")
        expect(table.locator("[role=row]:focus")).to_contain_text("actuator-1")
        table.get_by_role("button", name="Battery").click()
        expect(rows.first).to_contain_text("0%")
        table.get_by_role("button", name="Battery").click()
        expect(rows.first).to_contain_text("99%")
        expect(page).to_have_url(re.compile("sort=-battery"))
        page.get_by_role("searchbox", name="Search").fill("conveyor-49")
        expect(rows).to_have_count(3)
        page.context.close()


def test_five_hundred_people_are_listed_and_found(
    cell: Cell, open_page: OpenPage, keep: Keep, accessible: Accessible
) -> None:
    cell.run("context_broker")
    cell.run("gesture_controller", "webui")
    with httpx.Client(base_url=cell.url("gesture_controller"), timeout=120) as controller:

        def add(number: int) -> None:
            title = {"title": f"Person of the night shift {number}"}
            controller.put(f"/people/person-{number}", json=title).raise_for_status()

        with ThreadPoolExecutor(4) as threads:
            list(threads.map(add, range(MANY)))
    for size, viewport in (("laptop", PANEL), ("4k", UHD)):
        page = open_page("/admin/people?person=person-321", viewport=viewport, forgives=AWAY)
        table = page.get_by_role("grid", name="People and gestures")
        expect(page.get_by_role("heading", name="Person of the night shift 321")).to_be_visible()
        expect(table.locator("[aria-selected=true]")).to_contain_text("night shift 321")
        assert elements(page) < MAX_ELEMENTS
        assert page.evaluate(COLLIDING) == []
        nothing_is_cut_off(page)
        accessible(page)
        keep(page, f"people-500-{size}")
        page.get_by_role("searchbox", name="Search").first.fill("shift 49")
        expect(table.locator(".vgrid__line")).to_have_count(15)
        table.get_by_role("row", name=re.compile("shift 490")).click()
        expect(page.get_by_role("heading", name="Person of the night shift 490")).to_be_visible()
        page.context.close()
