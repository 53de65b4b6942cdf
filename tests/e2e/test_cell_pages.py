"""The place Cell: from the overview to a robot, its tabs and back; what is found is adopted."""

import re
from collections.abc import Callable
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import Page, expect

from tests.e2e.conftest import OpenPage
from tests.e2e.test_every_page import nothing_is_cut_off
from tests.kit.cell import Cell

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

AWAY = ("WebSocket connection", "Failed to load resource")
"""Messages of the browser about services that this test does not start."""
VIEWPORTS = {"laptop": {"width": 1366, "height": 768}, "phone": {"width": 390, "height": 844}}

Keep = Callable[[Page, str], Path]
Accessible = Callable[[Page], None]


def announce(cell: Cell, name: str) -> None:
    """Write a Device entity that no service has registered."""
    device = {
        "id": f"urn:ngsi-ld:Device:demo:{name}",
        "type": "Device",
        "category": {"type": "Property", "value": ["sensor"]},
        "deviceState": {"type": "Property", "value": "ok", "observedAt": "2026-01-01T08:00:00Z"},
        "value": {"type": "Property", "value": {"force": 12.5}},
    }
    context = f'<{cell.url("webui")}/context.jsonld>; rel="http://www.w3.org/ns/json-ld#context"'
    url = f"{cell.url('context_broker')}/ngsi-ld/v1/entities"
    httpx.post(url, json=device, headers={"Link": context}, timeout=120).raise_for_status()


@pytest.mark.parametrize("size", VIEWPORTS)
def test_from_the_overview_to_the_control_of_a_robot_and_back(
    cell: Cell, open_page: OpenPage, keep: Keep, accessible: Accessible, size: str
) -> None:
    cell.run("context_broker")
    cell.run("device_gateway", "gesture_controller", "trajectory_tool", "webui")
    announce(cell, "press-7")
    page = open_page("/cell", viewport=VIEWPORTS[size], forgives=AWAY)
    table = page.get_by_role("grid", name="Objects of the cell")
    expect(table.get_by_role("row", name="ur10-1")).to_contain_text("No task")
    expect(table).not_to_contain_text("urn:")
    expect(table).not_to_contain_text("{")
    nothing_is_cut_off(page)
    accessible(page)
    keep(page, f"cell-overview-{size}")

    table.get_by_role("link", name="ur10-1").click()
    expect(page).to_have_url(re.compile("/cell/robots/ur10-1$"))
    tabs = page.get_by_role("navigation", name="ur10-1")
    for tab, address in (
        ("Limits", "limits"),
        ("History", "history"),
        ("Settings", "settings"),
        ("Control", "control"),
    ):
        tabs.get_by_role("link", name=tab).click()
        expect(page).to_have_url(re.compile(f"/cell/robots/ur10-1/{address}$"))
        expect(tabs.get_by_role("link", name=tab)).to_have_attribute("aria-current", "page")
    expect(page.get_by_role("button", name="Take control")).to_be_visible()
    for _ in range(5):
        page.go_back()
    expect(page).to_have_url(re.compile("/cell$"))

    page.get_by_role("searchbox", name="Search").fill("gateway")
    expect(page).to_have_url(re.compile("find=gateway"))
    table.get_by_role("link", name="Device gateway").click()
    expect(page).to_have_url(re.compile("/admin/services/device-gateway$"))
    expect(page.get_by_role("link", name="REST interface")).to_have_attribute(
        "href", "/api/device-gateway/docs"
    )
    accessible(page)


def test_a_device_that_was_found_is_adopted_under_its_name(cell: Cell, open_page: OpenPage) -> None:
    cell.run("context_broker")
    cell.run("device_gateway", "webui")
    announce(cell, "press-7")
    page = open_page("/cell", forgives=AWAY)
    page.get_by_role("button", name="Adopt press-7").click()
    dialog = page.get_by_role("dialog")
    dialog.get_by_role("textbox").fill("Press of hall 7")
    dialog.get_by_role("button", name="Adopt").click()
    expect(page.get_by_role("dialog", name="Token of press-7")).to_be_visible()
    registered = httpx.get(f"{cell.url('device_gateway')}/devices/press-7", timeout=120).json()
    assert registered["kind"] == "sensor"
    assert registered["title"] == "Press of hall 7"
    page.get_by_role("button", name="I have stored the token").click()
    page.goto("/cell/sensors")
    expect(page).to_have_url(re.compile(r"/cell/devices\?view=board$"))
    expect(page.get_by_role("article", name="Press of hall 7")).to_be_visible()
