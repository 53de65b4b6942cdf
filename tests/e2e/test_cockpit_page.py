"""The Cockpit: heat map, throughput, incidents, filters and exports; agents; the mapping is confirmed."""

import re
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import httpx
import pytest
from playwright.sync_api import Page, expect

from handover_datamodels.times import iso
from tests.e2e.conftest import OpenPage
from tests.kit.cell import Cell
from tests.kit.other_broker.running import context_link
from tests.kit.waiting import wait_for

pytestmark = [pytest.mark.nightly, pytest.mark.slow, pytest.mark.timeout(600)]

AWAY = ("WebSocket connection", "Failed to load resource")
"""What a browser logs of services that are not started here."""
STOPPED = 500
WORKED = 6
SIZES = {
    "laptop": {"width": 1440, "height": 900},
    "phone": {"width": 390, "height": 844},
    "4k": {"width": 3840, "height": 2160},
}
FILE = """<?xml version="1.0" encoding="UTF-8"?>
<bpmn:definitions xmlns:bpmn="http://www.omg.org/spec/BPMN/20100524/MODEL"
    xmlns:camunda="http://camunda.org/schema/1.0/bpmn" targetNamespace="urn:t">
  <bpmn:process id="assembly" name="Assembly" isExecutable="true">
    <bpmn:startEvent id="start"/>
    <bpmn:exclusiveGateway id="kind" name="Kind of order?"/>
    <bpmn:userTask id="prepare" name="Prepare the parts" camunda:candidateGroups="logistics"/>
    <bpmn:serviceTask id="assemble" name="Assemble" camunda:type="external" camunda:topic="assemble"/>
    <bpmn:userTask id="check" name="Check the result" camunda:candidateGroups="quality"/>
    <bpmn:endEvent id="end"/>
    <bpmn:sequenceFlow id="a" sourceRef="start" targetRef="kind"/>
    <bpmn:sequenceFlow id="b" sourceRef="kind" targetRef="prepare">
      <bpmn:conditionExpression>${total &gt; 0}</bpmn:conditionExpression>
    </bpmn:sequenceFlow>
    <bpmn:sequenceFlow id="c" sourceRef="prepare" targetRef="assemble"/>
    <bpmn:sequenceFlow id="d" sourceRef="assemble" targetRef="check"/>
    <bpmn:sequenceFlow id="e" sourceRef="check" targetRef="end"/>
  </bpmn:process>
</bpmn:definitions>"""

Keep = Callable[[Page, str], Path]
Accessible = Callable[[Page], None]


def prop(value: Any) -> dict[str, Any]:
    return {"type": "Property", "value": value}


def put_agents(cell: Cell) -> None:
    """Put two agents with skills and shifts into the broker."""
    shifts = [{"weekday": day, "from": "00:00", "to": "00:00", "zone": "UTC"} for day in range(1, 8)]
    agents = [
        {
            "id": "urn:ngsi-ld:Device:demo:ur10-7",
            "type": "Device",
            "controlledProperty": prop(["motion"]),
            "deviceState": prop("idle"),
            "skills": prop([{"name": "assemble", "level": 3}, "place"]),
            "shifts": prop(shifts),
            "relativePosition": prop([1.5, 2, 0]),
        },
        {
            "id": "urn:ngsi-ld:Person:demo:aino",
            "type": "Person",
            "firstName": prop("Aino"),
            "lastName": prop("Virtanen"),
            "roles": prop(["inspector"]),
            "state": prop("absent"),
        },
    ]
    url = f"{cell.url('context_broker')}/ngsi-ld/v1/entityOperations/upsert"
    httpx.post(url, json=agents, headers={"Link": context_link()}, timeout=120).raise_for_status()


def perform(cell: Cell, process: str) -> None:
    """Perform all Tasks of a process, as components without a page do."""
    broker = f"{cell.url('context_broker')}/ngsi-ld/v1/entities"
    view = f"{cell.url('task_orchestrator')}/processes/{process}"
    with httpx.Client(timeout=120) as client:

        def has_ended() -> bool:
            found = client.get(view).json()
            for task in found["tasks"]:
                following = {"pending": "inProgress", "inProgress": "completed"}.get(task["status"])
                if following is not None and client.get(f"{broker}/{task['id']}").status_code == 200:
                    attributes = {"status": {**prop(following), "observedAt": iso(datetime.now(UTC))}}
                    client.post(f"{broker}/{task['id']}/attrs", json=attributes).raise_for_status()
            return bool(found["endedAt"])

        wait_for(has_ended, 120)


@pytest.fixture(scope="module")
def cell(shared_cell: Cell) -> Cell:
    """One cell for all of these tests: starting its processes takes a minute. The last test adds to them."""
    return shared_cell


@pytest.fixture(scope="module")
def cockpit(cell: Cell) -> Cell:
    """A cell with a definition whose processes have completed, and 500 that cannot continue."""
    cell.run("context_broker")
    put_agents(cell)
    cell.run("task_orchestrator", "webui")
    url = cell.url("task_orchestrator")
    with httpx.Client(timeout=120) as client:
        xml = {"Content-Type": "application/xml"}
        client.post(f"{url}/definitions", content=FILE, headers=xml).raise_for_status()

        def start(number: int) -> str:
            key = f"order {number}" if number > 0 else f"stopped {-number}"
            body = {"definition": "assembly", "key": key, "parameters": {"total": number}}
            return str(client.post(f"{url}/processes", json=body).raise_for_status().json()["id"])

        for number in range(1, WORKED + 1):
            process = start(number)
            if number > 1:
                perform(cell, process)
        with ThreadPoolExecutor(16) as together:
            list(together.map(start, range(-STOPPED + 1, 1)))
        wait_for(lambda: len(client.get(f"{url}/agents").json()) >= 2)
    return cell


def test_an_engineer_finds_where_processes_are_slow_or_stuck(
    cockpit: Cell, open_page: OpenPage, keep: Keep, accessible: Accessible
) -> None:
    page = open_page("/processes/statistics", viewport=SIZES["laptop"], forgives=AWAY)
    definitions = page.get_by_role("grid", name="Definitions")
    expect(definitions.get_by_role("row").filter(has_text="Assembly")).to_contain_text(str(STOPPED))
    accessible(page)
    keep(page, "cockpit-all")

    definitions.get_by_role("row").filter(has_text="Assembly").click()
    expect(page).to_have_url(re.compile("of=assembly"))
    expect(page.locator(".diagram-heat5").first).to_be_visible()  # those that take the longest
    expect(page.locator(".diagram__badge--incident")).to_contain_text(str(STOPPED))
    assert page.locator(".bjs-powered-by").is_visible(), "the mark of bpmn.io stays visible"
    totals = page.locator(".cockpit__totals")
    expect(totals).to_contain_text(re.compile(rf"Completed\s*{WORKED - 1}"))
    expect(page.get_by_role("img", name=re.compile(r"Processes by day\. .*Completed: 5"))).to_be_visible()
    expect(page.get_by_role("grid", name="Activities").get_by_role("row")).to_have_count(4)
    processes = page.get_by_role("grid", name="Processes")
    expect(processes.get_by_role("row").nth(1)).to_contain_text("stopped")
    assert processes.locator(".vgrid__line").count() < 60, "only visible rows are in the document"
    accessible(page)
    keep(page, "cockpit-assembly")
    page.get_by_label("Heat map", exact=True).select_option("completed")
    expect(page.locator(".diagram__badge--duration")).to_have_text(["5", "5", "5"])

    page.get_by_role("textbox", name="Variables").fill("total>=4; total<5")
    expect(processes.locator(".vgrid__line")).to_have_count(1)
    expect(processes).to_contain_text("order 4")
    page.get_by_role("textbox", name="Variables").fill("total is 3")
    expect(page.get_by_text("is no condition")).to_be_visible()
    page.get_by_role("textbox", name="Variables").fill("")
    page.get_by_label("State").select_option("completed")
    expect(processes.locator(".vgrid__line")).to_have_count(WORKED - 1)
    with page.expect_download() as exported:
        page.get_by_role("button", name="Export the tasks of these processes as XES").click()
    log = Path(exported.value.path()).read_text()
    assert log.count("<trace>") == WORKED - 1
    with page.expect_download() as exported:
        page.get_by_role("button", name="Export activities as CSV").click()
    assert "assemble" in Path(exported.value.path()).read_text("utf-8-sig")

    page.keyboard.press("Escape")
    row = processes.locator("[role=row][tabindex='0']")
    row.focus()
    page.keyboard.press("Enter")
    expect(page).to_have_url(re.compile("/processes/assembly-"))


def test_the_cockpit_fits_every_screen(
    cockpit: Cell, open_page: OpenPage, keep: Keep, accessible: Accessible
) -> None:
    looks = [("phone", "light", "de"), ("4k", "light", "en"), ("laptop", "dark", "fi")]
    for size, theme, language in looks:
        page = open_page(viewport=SIZES[size], theme=theme, language=language, forgives=AWAY)
        for view in ("statistics&of=assembly", "statistics", "agents", "mapping"):
            page.goto(f"/processes/statistics?view={view}")
            page.locator(".vgrid__line").first.wait_for()
            if "of=" in view:
                page.locator(".diagram__badge--incident").wait_for()
            wider_by = page.evaluate(
                "document.documentElement.scrollWidth - document.documentElement.clientWidth"
            )
            assert wider_by <= 0, f"{view} is {wider_by} px wider than the screen {size}"
            accessible(page)
            keep(page, f"cockpit-{view.replace('&of=', '-')}-{size}-{theme}")
        page.context.close()


def test_an_engineer_confirms_who_gets_the_work(cockpit: Cell, open_page: OpenPage, keep: Keep) -> None:
    url = cockpit.url("task_orchestrator")
    page = open_page("/processes/statistics", viewport=SIZES["laptop"], forgives=(*AWAY, "409"))
    page.get_by_role("grid", name="Definitions").wait_for()
    page.get_by_role("radio", name="Agents").click()
    agents = page.get_by_role("grid", name="Agents")
    expect(agents.get_by_role("row").filter(has_text="ur10-7")).to_contain_text("assemble (level 3)")
    expect(agents.get_by_role("row").filter(has_text="aino")).to_contain_text("absent")

    page.get_by_role("radio", name="Mapping").click()
    names = page.get_by_role("grid", name="Names without an entry")
    names.get_by_role("row").filter(has_text="Topic").filter(has_text="assemble").get_by_role(
        "button"
    ).click()
    dialog = page.get_by_role("dialog")
    dialog.get_by_label("Goes to").select_option("skills")
    dialog.get_by_role("textbox", name="Skills").fill("assemble, fly")
    dialog.get_by_role("button", name="Add entry").click()
    expect(page.get_by_text("Unconfirmed changes")).to_be_visible()
    other = {"by": "Ben", "version": 0, "entries": [{"kind": "lane", "name": "Store", "role": "store"}]}
    httpx.put(f"{url}/mapping", json=other, timeout=120).raise_for_status()
    page.get_by_role("button", name="Confirm mapping").click()
    dialog.get_by_role("textbox", name="Reason").fill("new cell")
    dialog.get_by_role("button", name="Confirm mapping").click()
    expect(dialog.get_by_role("alert")).to_contain_text("The mapping has the version 1, not 0")
    dialog.get_by_role("button", name="Cancel").click()
    page.get_by_role("button", name="Apply my changes to the current version").click()
    page.get_by_role("button", name="Confirm mapping").click()
    dialog.get_by_role("button", name="Confirm mapping").click()
    expect(page.get_by_text("Version 2, confirmed by Anna")).to_be_visible()
    stored = httpx.get(f"{url}/mapping", timeout=120).json()
    assert {(entry["kind"], entry["name"]) for entry in stored["entries"]} == {
        ("lane", "Store"),
        ("topic", "assemble"),
    }
    expect(page.get_by_text("nobody has skill:assemble skill:fly")).to_be_visible()
    keep(page, "cockpit-mapping-confirmed")

    page.goto("/processes/definition/assembly")
    activities = page.get_by_role("grid", name="Activities")
    expect(activities.get_by_role("row").filter(has_text="Assemble")).to_contain_text("nobody has")
    perform_first = httpx.post(
        f"{url}/processes",
        json={"definition": "assembly", "key": "new", "parameters": {"total": 1}},
        timeout=120,
    ).json()["id"]
    broker = f"{cockpit.url('context_broker')}/ngsi-ld/v1/entities"
    (task,) = httpx.get(f"{url}/processes/{perform_first}", timeout=120).json()["tasks"]
    wait_for(lambda: httpx.get(f"{broker}/{task['id']}", timeout=120).status_code == 200)
    for status in ("inProgress", "completed"):
        attributes = {"status": {**prop(status), "observedAt": iso(datetime.now(UTC))}}
        httpx.post(f"{broker}/{task['id']}/attrs", json=attributes, timeout=120).raise_for_status()
    page.goto("/processes/statistics?of=assembly&state=unallocated")
    waiting = page.get_by_role("grid", name="Processes")
    expect(waiting.locator(".vgrid__line")).to_contain_text("Assemble: nobody has skill:assemble skill:fly")
