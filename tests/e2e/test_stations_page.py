"""A station with Chromium: an engineer signs the screen in, people join it, and a Task demands their PIN."""

from collections.abc import Iterator
from typing import Any

import httpx
import pytest
from playwright.sync_api import Browser, Page, expect

from services.task_orchestrator.tests.unit.drawing import drawing, end, path, start
from tests.e2e.conftest import PANEL, SCREENSHOTS, TIMEOUT_MS, type_slowly
from tests.kit.cell import Cell, new_cell
from tests.kit.waiting import wait_for
from webui.tests.integration.test_signing_in import PASSWORD, set_up

pytestmark = [pytest.mark.nightly, pytest.mark.slow, pytest.mark.timeout(600)]

ANNA = "urn:ngsi-ld:Person:demo:anna"
PIN = "480215"
SIGN = (
    '<bpmn:userTask id="sign" name="Release the batch"><bpmn:extensionElements>'
    '<handover:task definition="sign" requirePin="true"/></bpmn:extensionElements></bpmn:userTask>'
)
SHOW = (
    '<bpmn:userTask id="show" name="Confirm"><bpmn:extensionElements>'
    '<handover:task definition="show" requirePin="true"><handover:involves resource="Device:glove-1"/>'
    '<handover:parameter name="gesture" value="Thumbs up"/></handover:task>'
    "</bpmn:extensionElements></bpmn:userTask>"
)
PACK = SHOW.replace(' requirePin="true"', "").replace("show", "pack").replace("Confirm", "Pack the box")
RELEASE = start() + SIGN + SHOW + PACK + end() + path("start", "sign", "show", "pack", "end")
VIEWS = (
    ("light", {"viewport": PANEL, "locale": "en"}),
    ("dark", {"viewport": PANEL, "locale": "en", "color_scheme": "dark"}),
    ("de", {"viewport": PANEL, "locale": "de"}),
    ("phone", {"viewport": {"width": 390, "height": 844}, "locale": "en"}),
)


@pytest.fixture
def own_cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    with new_cell(tmp_path_factory.mktemp("station")) as made:
        names = ("context_broker", "accounts", "task_orchestrator", "gesture_controller", "webui")
        made.start(*names, within_s=120)
        yield made


def test_a_person_joins_a_station_and_gives_the_pin_that_a_task_demands(
    browser: Browser, own_cell: Cell
) -> None:
    SCREENSHOTS.mkdir(parents=True, exist_ok=True)
    orchestrator = own_cell.url("task_orchestrator")
    content = drawing(RELEASE, name="release").decode()
    files = {"files": [{"name": "release.bpmn", "content": content}]}
    httpx.post(f"{orchestrator}/deployments", json=files, timeout=60).raise_for_status()
    httpx.post(f"{orchestrator}/processes", json={"definition": "release"}, timeout=60).raise_for_status()
    entities = f"{own_cell.url('context_broker')}/ngsi-ld/v1/entities"
    httpx.post(entities, json={"id": ANNA, "type": "Person"}, timeout=60).raise_for_status()
    glove = httpx.put(f"{own_cell.url('gesture_controller')}/gloves/glove-1", json={}, timeout=60)
    assert glove.status_code < 500

    page = browser.new_page(viewport=PANEL, locale="en")
    page.set_default_timeout(TIMEOUT_MS)
    page.goto(f"{own_cell.url('webui')}/join#{set_up(own_cell)}")
    page.get_by_label("Name", exact=True).fill("Anna")
    page.get_by_label("New password").fill(PASSWORD)
    page.get_by_role("button", name="Create the account").click()
    expect(page.get_by_role("button", name="Account of Anna")).to_be_visible()
    give_identifiers(page, own_cell)
    page.goto(f"{own_cell.url('webui')}/people?view=stations")
    page.get_by_role("button", name="Add a station").click()
    page.get_by_role("dialog").get_by_label("Name", exact=True).fill("Station 1")
    page.get_by_role("dialog").get_by_label("Gloves").fill("glove-1")
    page.get_by_role("dialog").get_by_role("button", name="Add a station").click()
    expect(page.get_by_role("row", name="Station 1")).to_contain_text("nobody")
    page.get_by_role("button", name="Use this screen as Station 1").click()
    page.get_by_role("dialog").get_by_role("button", name="Use this screen").click()

    join = page.get_by_role("button", name="Join", exact=True)
    expect(join).to_be_visible()
    join.click()
    page.get_by_label("Badge number or QR code").fill("nobody-1")
    page.keyboard.press("Enter")
    expect(page.get_by_role("alert")).to_contain_text("Nobody has this badge")
    page.screenshot(path=SCREENSHOTS / "station-join.png")
    page.get_by_label("Badge number or QR code").fill("B-anna-1")
    page.keyboard.press("Enter")
    expect(page.get_by_role("button", name="Anna at Station 1")).to_be_visible()

    page.goto(f"{own_cell.url('webui')}/tasks")
    page.get_by_role("row", name="Release the batch").first.click()
    page.get_by_role("button", name="Claim this task").click()
    page.get_by_role("button", name="Complete the task").click()
    dialog = page.get_by_role("dialog")
    press(dialog, "111222")
    page.screenshot(path=SCREENSHOTS / "task-pin.png")
    key = dialog.get_by_role("button", name="5", exact=True).bounding_box()
    assert key is not None
    assert min(key["height"], key["width"]) >= 64, "for gloved hands"
    dialog.get_by_role("button", name="Confirm with the PIN").click()
    expect(dialog.get_by_role("alert")).to_contain_text("This is not your PIN")
    press(dialog, PIN)
    dialog.get_by_role("button", name="Confirm with the PIN").click()
    expect(dialog).to_have_count(0)

    page.goto(f"{own_cell.url('webui')}/work?glove=glove-1")
    page.get_by_role("button", name="Enter the PIN").click()
    type_slowly(page, *PIN, "Enter")
    expect(page.get_by_role("dialog")).to_have_count(0)
    page.get_by_role("button", name="Complete by hand").click()
    expect(page.get_by_role("button", name="Enter the PIN")).to_have_count(0)
    wait_for(lambda: "show" in answered(page, own_cell), 120)
    expect(page.get_by_text("Pack the box").first).to_be_visible()
    page.get_by_role("button", name="Complete by hand").click()
    wait_for(lambda: "pack" in answered(page, own_cell), 120)
    outputs = answered(page, own_cell)
    assert {one["performedBy"] for one in outputs.values()} == {ANNA}
    assert "pinProof" in outputs["show"]
    assert "performerProof" in outputs["pack"], "also without a PIN"
    completed = wait_for(lambda: audited(own_cell, "complete"), 120)
    assert {one["method"] for one in completed if one["action"].startswith("POST /tasks")} == {"pin"}
    assert [one["outcome"] for one in completed if one["action"].startswith("POST /tasks")] == [
        "refused",
        "done",
    ]

    page.get_by_role("button", name="Anna at Station 1").click()
    page.get_by_role("button", name="Leave").click()
    expect(join).to_be_visible()
    cookies = page.context.cookies()
    page.close()
    for name, options in VIEWS:
        context = browser.new_context(**options)  # type: ignore[arg-type]
        context.set_default_timeout(TIMEOUT_MS)
        context.add_cookies(cookies)  # type: ignore[arg-type]
        seen = context.new_page()
        seen.goto(f"{own_cell.url('webui')}/tasks")
        word = "Anmelden" if name == "de" else "Join"
        seen.locator("header").get_by_role("button", name=word, exact=True).click()
        expect(seen.get_by_role("dialog")).to_be_visible()
        seen.screenshot(path=SCREENSHOTS / f"station-{name}.png")
        context.close()


def press(dialog: Any, digits: str) -> None:
    for digit in digits:
        dialog.get_by_role("button", name=digit, exact=True).click()


def give_identifiers(page: Page, cell: Cell) -> None:
    """Assign a Person, a badge number, a PIN and a QR code to the only user."""
    page.goto(f"{cell.url('webui')}/people?view=users")
    page.get_by_role("row", name="Anna").click()
    page.get_by_role("combobox", name="Person in the cell").select_option(ANNA)
    page.get_by_role("button", name="Assign badge").click()
    page.get_by_role("dialog").get_by_label("badge", exact=True).fill("B-anna-1")
    page.get_by_role("dialog").get_by_role("button", name="Assign", exact=True).click()
    expect(page.get_by_role("dialog")).to_have_count(0)
    page.get_by_role("button", name="Assign PIN").click()
    page.keyboard.type(PIN)
    page.get_by_role("dialog").get_by_role("button", name="Assign", exact=True).click()
    expect(page.get_by_role("dialog")).to_have_count(0)
    page.get_by_role("button", name="Assign QR code").click()
    expect(page.get_by_role("img", name="QR code of Anna")).to_be_visible()
    page.screenshot(path=SCREENSHOTS / "station-qr.png")
    page.get_by_role("button", name="Close").click()
    expect(page.get_by_role("button", name="Remove badge")).to_be_visible()


def answered(page: Page, cell: Cell) -> dict[str, dict[str, Any]]:
    """Return the outputs of the completed Tasks by their activity, as the broker has them."""
    path = "/api/context-broker/ngsi-ld/v1/entities?type=Task&options=keyValues"
    tasks = page.request.get(f"{cell.url('webui')}{path}").json()
    return {
        one["id"].split("-")[-2]: one["outputParameters"] for one in tasks if one["status"] == "completed"
    }


def audited(cell: Cell, action: str) -> list[dict[str, Any]]:
    """Return the records of the orchestrator and the gesture controller, read from their databases."""
    from handover.security.audit_reading.audit_chains import chains_of, records_of
    from handover.settings import Settings

    records = records_of(chains_of(Settings(data_dir=cell.data_dir, _env_file=None)))
    found: list[dict[str, Any]] = [dict(one) for one in records if action in one["action"]]
    return found if any("gloves" in one["action"] for one in found) else []
