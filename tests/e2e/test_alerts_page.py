"""Alerts on the page: one and five hundred, acknowledged, shelved, announced on *Work* and *Start*."""

import re
import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest
from playwright.sync_api import Page, expect

from tests.e2e.conftest import OpenPage
from tests.kit.cell import Cell
from tests.kit.waiting import wait_for

pytestmark = [pytest.mark.nightly, pytest.mark.slow, pytest.mark.timeout(300)]

AWAY = ("WebSocket connection", "Failed to load resource")
"""What a browser logs of services that are not started here."""
MANY, CRITICAL = 500, 100
CATEGORIES = ("device", "traffic", "process")
COUNT_TONES = """
    const made = window.tones = [];
    const create = AudioContext.prototype.createOscillator;
    AudioContext.prototype.createOscillator = function () { made.push(1); return create.call(this); };
"""

Keep = Callable[[Page, str], Path]
Accessible = Callable[[Page], None]


def alert(number: int, severity: str = "medium") -> dict[str, Any]:
    """An Alert as another component writes it, without our attributes; a greater number is older."""
    issued = datetime.now(UTC) - timedelta(minutes=number)
    return {
        "id": f"urn:ngsi-ld:Alert:plant:{number}",
        "type": "Alert",
        "category": {"type": "Property", "value": CATEGORIES[number % len(CATEGORIES)]},
        "severity": {"type": "Property", "value": severity},
        "description": {"type": "Property", "value": f"Conveyor {number} is blocked"},
        "dateIssued": {
            "type": "Property",
            "value": {"@type": "DateTime", "@value": f"{issued:%Y-%m-%dT%H:%M:%SZ}"},
        },
        "alertSource": {"type": "Relationship", "object": f"urn:ngsi-ld:Device:plant:conveyor-{number % 7}"},
    }


def write(cell: Cell, *alerts: dict[str, Any]) -> None:
    """Have the broker keep Alerts."""
    context = f'<{cell.url("webui")}/context.jsonld>; rel="http://www.w3.org/ns/json-ld#context"'
    url = f"{cell.url('context_broker')}/ngsi-ld/v1/entityOperations/upsert"
    answer = httpx.post(
        url, json=list(alerts), params={"options": "update"}, headers={"Link": context}, timeout=60
    )
    answer.raise_for_status()


def states(cell: Cell) -> dict[str, Any]:
    """What the broker keeps of each Alert: its state and who acknowledged it."""
    context = f'<{cell.url("webui")}/context.jsonld>; rel="http://www.w3.org/ns/json-ld#context"'
    entities = httpx.get(
        f"{cell.url('context_broker')}/ngsi-ld/v1/entities",
        params={"type": "Alert", "limit": 1000, "options": "keyValues"},
        headers={"Link": context},
        timeout=120,
    ).json()
    return {entity["id"]: entity for entity in entities}


@pytest.fixture
def alert_screen(cell: Cell) -> Cell:
    """A broker and the screen; nothing else raises Alerts."""
    cell.run("context_broker")
    cell.run("webui")
    return cell


def test_five_hundred_alerts_are_counted_filtered_and_acknowledged_at_once(
    alert_screen: Cell, open_page: OpenPage, keep: Keep, accessible: Accessible
) -> None:
    cell = alert_screen
    write(cell, *(alert(number, "critical" if number < CRITICAL else "high") for number in range(MANY)))
    page = open_page("/", forgives=AWAY)
    banner = page.locator(".attention")
    expect(banner).to_contain_text("100 critical alerts, 400 high alerts")
    expect(banner).to_contain_text("Conveyor 0 is blocked")
    assert banner.bounding_box()["height"] < 60  # type: ignore[index]
    expect(page.get_by_role("link", name="Alerts 500 new alerts")).to_be_visible()
    keep(page, "alerts-start-500")
    page.goto("/work")
    expect(page.locator(".attention[data-large]")).to_contain_text("100 critical alerts")
    page.locator(".work").wait_for()
    root = "document.documentElement"
    assert page.evaluate(f"{root}.scrollHeight - {root}.clientHeight") <= 0, "the page fits the screen"
    keep(page, "alerts-work-500")

    page.locator(".attention").get_by_role("link", name="Show alerts").click()
    table = page.get_by_role("grid", name="Alerts")
    expect(table).to_have_attribute("aria-rowcount", "501")
    rows = table.locator(".vgrid__line")
    expect(rows.first).to_contain_text("Conveyor 0 is blocked")
    assert rows.count() < 60, "only visible rows are in the document"
    accessible(page)
    keep(page, "alerts-500")

    began = time.monotonic()
    rows.first.focus()
    page.keyboard.press("End")
    expect(table.locator("[role=row]:focus")).to_contain_text("Conveyor 499 is blocked")
    page.keyboard.press("Home")
    expect(table.locator("[role=row]:focus")).to_contain_text("Conveyor 0 is blocked")
    print(f"to the end of {MANY} rows and back in {time.monotonic() - began:.2f} s")

    page.get_by_label("Severity").select_option("critical")
    page.get_by_label("Group by").select_option("source")
    expect(table.locator(".vgrid__group").first).to_contain_text("conveyor-0 (15)")
    page.get_by_role("searchbox", name="Search").fill("conveyor blocked")
    expect(page.locator(".alert-actions__count")).to_have_text("100 alerts")
    expect(page).to_have_url(re.compile("severity=critical.*group=source"))
    page.get_by_role("checkbox", name="Select all").check()
    keep(page, "alerts-selected")
    page.get_by_role("button", name="Acknowledge 100").click()
    expect(page.locator(".alert-actions__count")).to_have_text("100 alerts")
    expect(rows.first).to_contain_text("Acknowledged")
    kept = states(cell)
    done = [one for one in kept.values() if one.get("alertState") == "acknowledged"]
    assert len(done) == CRITICAL
    assert {one["acknowledgedBy"] for one in done} == {"Anna"}
    page.goto("/")
    expect(page.locator(".attention")).to_contain_text("400 high alerts")
    expect(page.locator(".attention")).not_to_contain_text("critical")


def test_an_alert_is_explained_shelved_and_unshelved(
    alert_screen: Cell, open_page: OpenPage, keep: Keep, accessible: Accessible
) -> None:
    cell = alert_screen
    write(cell, alert(1, "critical"))
    page = open_page("/alerts", who="", forgives=AWAY)
    detail = page.get_by_role("complementary", name="Conveyor 1 is blocked")
    expect(detail).to_contain_text("conveyor-1")
    accessible(page)
    keep(page, "alerts-one")
    detail.get_by_role("button", name="Shelve").click()
    page.get_by_role("dialog").get_by_role("radio", name="15 min").click()
    page.get_by_role("dialog").get_by_role("button", name="Shelve").click()
    page.get_by_role("textbox", name="Your name").fill("Aino")
    page.keyboard.press("Enter")
    expect(detail).to_contain_text("Shelved by Aino")
    accessible(page)
    expect(page.get_by_role("link", name="Alerts", exact=True)).to_be_visible()
    expect(page.locator(".alert-actions__count")).to_have_text("0 alerts")
    page.get_by_label("State").select_option("shelved")
    expect(page.locator(".alert-actions__count")).to_have_text("1 alert")
    detail.get_by_role("button", name="Unshelve").click()
    expect(detail.locator(".alert__states")).to_contain_text("New")


def test_new_alerts_do_not_move_the_list(alert_screen: Cell, open_page: OpenPage) -> None:
    cell = alert_screen
    write(cell, *(alert(number) for number in range(10, 13)))
    page = open_page("/alerts", forgives=AWAY)
    rows = page.get_by_role("grid", name="Alerts").locator(".vgrid__line")
    expect(rows).to_have_count(3)
    rows.nth(1).focus()
    write(cell, *(alert(number, "critical") for number in range(3)))
    page.get_by_role("button", name="3 new").wait_for()
    expect(rows).to_have_count(3)
    expect(rows.first).to_contain_text("Conveyor 10")
    page.get_by_role("button", name="3 new").click()
    expect(rows).to_have_count(6)
    expect(rows.first).to_contain_text("Conveyor 0")


def test_alert_sounds_are_optional_and_played_once_for_many(alert_screen: Cell, open_page: OpenPage) -> None:
    cell = alert_screen
    page = open_page("/alerts", forgives=AWAY)
    page.add_init_script(COUNT_TONES)
    page.reload()
    page.get_by_text("No alerts", exact=True).wait_for()
    write(cell, alert(1, "critical"))
    page.get_by_role("grid", name="Alerts").wait_for()
    assert page.evaluate("window.tones.length") == 0, "the sound is off unless somebody wants it"
    page.get_by_role("checkbox", name=re.compile("^Play a sound")).check(force=True)
    wait_for(lambda: page.evaluate("window.tones.length") == 2)
    write(cell, *(alert(number, "critical") for number in range(2, 60)))
    wait_for(lambda: page.evaluate("window.tones.length") >= 4)
    expect(page.locator(".alert-actions__count")).to_have_text("59 alerts")
    write(cell, *(alert(number, "low") for number in range(60, 70)))
    expect(page.locator(".alert-actions__count")).to_have_text("69 alerts")
    assert page.evaluate("window.tones.length") == 4
