"""What an engineer changes while processes run: offers, versions, pauses; comments and forms of people."""

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from playwright.sync_api import Locator, Page, expect

from services.task_orchestrator.tests.integration.test_offers import definition, process_file, prop
from services.task_orchestrator.tests.integration.test_tasklist import FORM, bpmn
from tests.e2e.conftest import OpenPage
from tests.kit.cell import Cell
from tests.kit.other_broker.running import context_link
from tests.kit.waiting import wait_for

pytestmark = [pytest.mark.nightly, pytest.mark.slow, pytest.mark.timeout(300)]

AWAY = ("WebSocket connection", "Failed to load resource")
"""What a browser logs of services that are not started here."""
PHONE = {"width": 390, "height": 844}

Keep = Callable[[Page, str], Path]
Accessible = Callable[[Page], None]


@pytest.fixture(scope="module")
def cell(shared_cell: Cell) -> Cell:
    """One cell for all of these tests: each has definitions of its own, and none needs a robot."""
    return shared_cell


@pytest.fixture
def url(cell: Cell) -> str:
    """The orchestrator, beside a broker and the page."""
    cell.run("context_broker")
    cell.run("task_orchestrator", "webui")
    return cell.url("task_orchestrator")


def ask(method: str, url: str, **options: Any) -> Any:
    return httpx.request(method, url, timeout=120, **options).raise_for_status().json()


def deploy(url: str, file: str) -> None:
    ask("POST", f"{url}/definitions", content=file, headers={"Content-Type": "application/xml"})


def start(url: str, name: str, key: str) -> str:
    return str(ask("POST", f"{url}/processes", json={"definition": name, "key": key})["id"])


@pytest.fixture
def begun(url: str) -> Iterator[Callable[[str, str], str]]:
    """Start processes, which are cancelled after the test."""
    ids: list[str] = []

    def begin(name: str, key: str) -> str:
        ids.append(start(url, name, key))
        return ids[-1]

    yield begin
    for process in ids:
        httpx.post(f"{url}/processes/{process}/cancel", json={}, timeout=120)


def offer_entities(cell: Cell, *entities: dict[str, Any]) -> None:
    """Write entities as another system does."""
    upsert = f"{cell.url('context_broker')}/ngsi-ld/v1/entityOperations/upsert"
    httpx.post(upsert, json=entities, headers={"Link": context_link()}, timeout=120).raise_for_status()


def decide(page: Page, act: str, why: str) -> None:
    """Fill the dialog that asks for a reason, and press its button."""
    dialog = page.get_by_role("dialog")
    dialog.get_by_label("Reason").fill(why)
    dialog.get_by_role("button", name=act, exact=True).click()
    expect(dialog).to_have_count(0)


def test_an_engineer_accepts_and_rejects_what_other_systems_offer(
    cell: Cell, url: str, open_page: OpenPage, keep: Keep, accessible: Accessible
) -> None:
    page = open_page("/processes/offers", forgives=AWAY)
    expect(page.get_by_text("No open offers")).to_be_visible()
    gesture = {
        "id": "urn:ngsi-ld:TaskDefinition:mes:allow-scan",
        "type": "TaskDefinition",
        "name": prop("Allow the scan"),
        "gesture": prop("Thumbs up"),
    }
    pick = definition("offered-pick", process_file("offered-pick", "work", title="Offered pick"))
    broken = definition("broken", "<definitions")
    offer_entities(cell, pick, gesture, broken)
    offered = page.get_by_role("article", name="offered-pick")
    expect(offered).to_contain_text("Becomes version 1 of Offered pick")
    expect(page.get_by_role("button", name=re.compile(r"Offered by other systems \(3\)"))).to_be_visible()
    refused = page.get_by_role("article", name="broken")
    expect(refused).to_contain_text("Faults (1)")
    expect(refused.get_by_role("button", name="Accept")).to_be_disabled()
    accessible(page)
    keep(page, "offers")

    offered.get_by_role("button", name="Accept").click()
    decide(page, "Accept", "checked with the line")
    expect(offered).to_have_count(0)
    expect(page.get_by_role("grid", name="Definitions and processes")).to_contain_text("Offered pick")
    scan = page.get_by_role("article", name="Allow the scan")
    expect(scan).to_contain_text("gesture: Thumbs up")
    for each in (scan, refused):
        each.get_by_role("button", name="Reject").click()
        decide(page, "Reject", "not ours")
    expect(page.get_by_text("No open offers")).to_be_visible()
    (rejected,) = ask("GET", f"{url}/offers", params={"entity": gesture["id"]})
    assert [(one["by"], one["why"]) for one in rejected["decisions"]] == [("Anna", "not ours")]
    (accepted,) = ask("GET", f"{url}/offers", params={"entity": pick["id"]})
    assert (accepted["status"], accepted["inForce"]) == ("accepted", True)


def test_a_process_and_all_of_a_version_continue_in_another_version(
    url: str, begun: Callable[[str, str], str], open_page: OpenPage, keep: Keep, accessible: Accessible
) -> None:
    deploy(url, process_file("moving", "work", title="Moving"))
    processes = [begun("moving", f"order m{number}") for number in range(3)]
    deploy(url, process_file("moving", "weld", "check", title="Moving"))
    page = open_page(f"/processes/{processes[0]}", forgives=AWAY)
    page.get_by_role("button", name="Other version …").click()
    dialog = page.get_by_role("dialog")
    expect(dialog).to_contain_text("It cannot continue in this version:")
    act = dialog.get_by_role("button", name="Continue in version 2")
    expect(act).to_be_disabled()
    accessible(page)
    keep(page, "migration")
    dialog.get_by_label("“work” continues as").select_option("weld")
    expect(dialog).to_contain_text("It can continue in this version.")
    decide(page, "Continue in version 2", "the station was renamed")
    expect(page.locator(".process__head")).to_contain_text("Version 2")
    wait_for(lambda: ask("GET", f"{url}/processes/{processes[0]}")["waiting"] == ["weld"])

    deploy(url, process_file("moving", "work", "check", title="Moving"))
    page.goto("/processes/definition/moving?version=1")
    page.get_by_role("button", name="Migrate to version 3 …").click()
    decide(page, "Migrate 2 processes to version 3", "the check was missing")
    wait_for(lambda: [ask("GET", f"{url}/processes/{each}")["version"] for each in processes] == [2, 3, 3])


def test_a_process_is_paused_and_resumed_with_a_reason(
    url: str, begun: Callable[[str, str], str], open_page: OpenPage
) -> None:
    deploy(url, process_file("pausing", "work", title="Pausing"))
    process = begun("pausing", "order q1")
    page = open_page(f"/processes/{process}", forgives=AWAY)
    page.get_by_role("button", name="Pause Pausing").click()
    expect(page.get_by_role("dialog")).to_contain_text("This is no emergency stop.")
    decide(page, "Pause Pausing · order q1", "tool change")
    expect(page.locator(".process__head")).to_contain_text("Paused")
    expect(page.locator(".process__act")).to_contain_text("Anna")
    page.get_by_role("button", name="Resume Pausing").click()
    decide(page, "Resume Pausing · order q1", "tool changed")
    wait_for(lambda: ask("GET", f"{url}/processes/{process}")["status"] == "inProgress")
    acts = [(act["act"], act["why"]) for act in ask("GET", f"{url}/processes/{process}")["acts"]]
    assert acts == [("pause", "tool change"), ("resume", "tool changed")]


def row(page: Page, key: str) -> Locator:
    return page.get_by_role("row").filter(has_text=key)


def test_a_comment_appears_on_other_pages_at_once(
    url: str, begun: Callable[[str, str], str], open_page: OpenPage
) -> None:
    deploy(url, bpmn("commented", ">"))
    process = begun("commented", "order c1")
    anna = open_page("/work/tasks", who="Anna", forgives=AWAY)
    ben = open_page(f"/processes/{process}", who="Ben", forgives=AWAY)
    row(anna, "order c1").click()
    ben.get_by_role("radio", name="Comments").click()
    comments = ben.get_by_role("region", name="Comments")
    expect(comments).to_contain_text("No comments yet.")
    anna.get_by_label("Comment", exact=True).fill("the scale drifts")
    anna.get_by_role("button", name="Add comment").click()
    expect(comments.get_by_role("listitem")).to_contain_text("the scale drifts")
    comments.get_by_label("Comment", exact=True).fill("use the other one")
    comments.get_by_role("button", name="Add comment").click()
    expect(comments.get_by_role("listitem")).to_have_count(2)


def test_fields_of_a_form_appear_as_they_are_needed(
    url: str, begun: Callable[[str, str], str], open_page: OpenPage, keep: Keep, accessible: Accessible
) -> None:
    ask("POST", f"{url}/forms", json={**FORM, "id": "seen-form"})
    deploy(url, bpmn("formed", 'camunda:formRef="seen-form" camunda:formRefBinding="latest">'))
    process = begun("formed", "order f1")
    page = open_page("/work/tasks", forgives=AWAY)
    row(page, "order f1").click()
    page.get_by_role("button", name="Claim this task").click()
    form = page.get_by_role("form", name="Result")
    form.get_by_label("Weight").fill("12")
    expect(form.get_by_label("Why")).to_have_count(0)
    form.get_by_label("Broken").focus()
    page.keyboard.press("Space")
    expect(form.get_by_label("Why")).to_be_visible()
    accessible(page)
    keep(page, "tasks-form-js")
    form.get_by_label("Why").fill("cracked")
    page.keyboard.press("Control+Enter")
    wait_for(lambda: ask("GET", f"{url}/processes/{process}")["status"] == "completed")
    outputs = ask("GET", f"{url}/processes/{process}")["tasks"][0]["outputParameters"]
    assert (outputs["weight"], outputs["broken"], outputs["why"]) == (12, True, "cracked")


def test_a_phone_shows_the_list_or_a_process(
    url: str, begun: Callable[[str, str], str], open_page: OpenPage, keep: Keep, accessible: Accessible
) -> None:
    title = "Final assembly with torque check and traceability, late shift"
    deploy(url, process_file("phoned", "work", title=title))
    begun("phoned", "order p1")
    page = open_page("/processes", forgives=AWAY, viewport=PHONE, has_touch=True, is_mobile=True)
    table = page.get_by_role("grid", name="Definitions and processes")
    table.get_by_text("order p1").click()
    expect(page.locator(".process__head")).to_contain_text(title)
    expect(table).to_be_hidden()
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
    for button in page.locator(".process__actions .button").all():
        box = button.bounding_box()
        assert box is not None
        assert min(box["width"], box["height"]) >= 44
    accessible(page)
    keep(page, "processes-phone")
    page.get_by_role("button", name="All processes").click()
    expect(table).to_be_visible()
    expect(page.locator(".process__head")).to_have_count(0)
