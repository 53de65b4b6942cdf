"""The Tasks page with real services: people claim, return and complete Tasks without a glove."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import pytest
from playwright.sync_api import Locator, Page, expect

from tests.e2e.conftest import OpenPage, type_slowly
from tests.kit.cell import Cell
from tests.kit.waiting import wait_for

pytestmark = [pytest.mark.nightly, pytest.mark.slow, pytest.mark.timeout(300)]

Keep = Callable[[Page, str], Path]
Accessible = Callable[[Page], None]

CONFLICT = "the server responded with a status of 409"

WEIGHING = """<?xml version="1.0" encoding="UTF-8"?>
<bpmn:definitions xmlns:bpmn="http://www.omg.org/spec/BPMN/20100524/MODEL"
    xmlns:camunda="http://camunda.org/schema/1.0/bpmn" targetNamespace="http://example.org/weighing">
  <bpmn:process id="weighing" name="Weighing" isExecutable="true">
    <bpmn:startEvent id="start"/>
    <bpmn:userTask id="weigh" name="Weigh the part">
      <bpmn:extensionElements>
        <camunda:formData>
          <camunda:formField id="weight" label="Weight in kg" type="long">
            <camunda:validation>
              <camunda:constraint name="required"/>
              <camunda:constraint name="max" config="20"/>
            </camunda:validation>
          </camunda:formField>
          <camunda:formField id="colour" label="Colour" type="enum">
            <camunda:value id="r" name="Red"/>
            <camunda:value id="g" name="Green"/>
          </camunda:formField>
        </camunda:formData>
      </bpmn:extensionElements>
    </bpmn:userTask>
    <bpmn:endEvent id="end"/>
    <bpmn:sequenceFlow id="one" sourceRef="start" targetRef="weigh"/>
    <bpmn:sequenceFlow id="two" sourceRef="weigh" targetRef="end"/>
  </bpmn:process>
</bpmn:definitions>"""


@pytest.fixture(scope="module")
def cell(shared_cell: Cell) -> Cell:
    """One cell for all of these tests."""
    return shared_cell


@pytest.fixture
def begun(quiet_screen: Cell) -> str:
    """Start a process with a Task that involves nobody; return its URL."""
    url = quiet_screen.url("task_orchestrator")
    xml = {"Content-Type": "application/xml"}
    httpx.post(f"{url}/definitions", content=WEIGHING, headers=xml, timeout=120).raise_for_status()
    started = httpx.post(f"{url}/processes", json={"definition": "weighing"}, timeout=120)
    return f"{url}/processes/{started.raise_for_status().json()['id']}"


def seen(process: str) -> Any:
    """Return a process as the orchestrator has it."""
    return httpx.get(process, timeout=120).raise_for_status().json()


def row(page: Page, name: str = "Weigh the part") -> Locator:
    """The row of a Task in the list."""
    return page.get_by_role("row", name=name)


def tick(page: Page, name: str) -> None:
    """Tick a checkbox as the keyboard does."""
    page.get_by_role("checkbox", name=name).focus()
    page.keyboard.press("Space")


def post(cell: Cell, process: str, act: str, **body: Any) -> httpx.Response:
    """Do something with the only Task of a process, without a page."""
    task = seen(process)["tasks"][0]["id"]
    return httpx.post(f"{cell.url('task_orchestrator')}/tasks/{task}/{act}", json=body, timeout=120)


def test_a_task_is_claimed_and_completed_with_its_form_by_keyboard(
    begun: str, open_page: OpenPage, keep: Keep, accessible: Accessible
) -> None:
    page = open_page("/work/tasks", who="")
    expect(row(page)).to_contain_text("Unclaimed")
    accessible(page)
    type_slowly(page, "g", "j")
    expect(row(page)).to_be_focused()
    type_slowly(page, "Enter")
    claim = page.get_by_role("button", name="Claim this task")
    claim.wait_for()
    type_slowly(page, "c", "g", "c")  # no key claims, and the focused row keeps its place
    page.wait_for_url("**/cell")
    page.go_back()
    claim.focus()
    type_slowly(page, "Enter")
    page.get_by_label("Your name").fill("Liisa")
    page.keyboard.press("Enter")
    form = page.get_by_role("form", name="Result")
    form.wait_for()
    expect(row(page)).to_contain_text("Claimed by Liisa")
    wait_for(lambda: [task["status"] for task in seen(begun)["tasks"]] == ["inProgress"])

    type_slowly(page, "g", "i")
    expect(form.get_by_label("Weight in kg")).to_be_focused()
    page.keyboard.type("21")
    page.keyboard.press("Control+Enter")
    expect(form).to_contain_text("Enter 20 or less.")
    accessible(page)
    keep(page, "tasks-form")
    form.get_by_label("Weight in kg").fill("12")
    form.get_by_label("Colour").select_option("Green")
    page.keyboard.press("Control+Enter")
    expect(row(page)).to_have_count(0)
    wait_for(lambda: seen(begun)["status"] == "completed")
    [task] = seen(begun)["tasks"]
    outputs = task["outputParameters"]
    assert (outputs["weight"], outputs["colour"]) == (12, "g")
    assert (outputs["operator"], outputs["by"], outputs["outcome"]) == ("Liisa", "tasklist", "ok")


def test_of_two_browsers_that_claim_at_once_one_reads_who_has_the_task(
    begun: str, open_page: OpenPage, keep: Keep
) -> None:
    anna = open_page("/work/tasks", who="Anna", forgives=(CONFLICT,))
    ben = open_page("/work/tasks", who="Ben", forgives=(CONFLICT,))
    for page in (anna, ben):
        row(page).click()
        page.get_by_role("button", name="Claim this task").wait_for()
    for page in (anna, ben):  # both clicks are on their way before either answer is there
        page.evaluate("document.querySelector('.tasklist__acts button').click()")
    wait_for(lambda: seen(begun)["tasks"][0]["status"] == "inProgress")
    task = seen(begun)["tasks"][0]["id"]
    url = f"{begun.rpartition('/processes/')[0]}/tasks/{task}"
    winner = httpx.get(url, timeout=120).raise_for_status().json()["claimedBy"]
    won, lost = (anna, ben) if winner == "Anna" else (ben, anna)
    won.get_by_role("form", name="Result").wait_for()
    expect(lost.get_by_role("article")).to_contain_text(f"Claimed by {winner}")
    expect(lost.get_by_role("article")).to_contain_text(f"{winner} has claimed this task")
    expect(lost.get_by_role("button", name="Claim this task")).to_have_count(0)
    lost.get_by_role("radio", name="Mine").click()
    expect(lost.get_by_text("No tasks in this view.")).to_be_visible()
    keep(lost, "tasks-claimed")

    won.get_by_role("button", name="Return this task").click()
    lost.get_by_role("button", name="Claim this task").click()
    form = lost.get_by_role("form", name="Result")
    form.get_by_label("Outcome").select_option("Problem")
    form.get_by_label("Note").fill("the scale is broken")
    form.get_by_role("button", name="Report the problem").click()
    wait_for(lambda: seen(begun)["incidents"] != [])
    [incident] = seen(begun)["incidents"]
    assert incident["element"] == "weigh"
    assert "the scale is broken" in incident["reason"]


def test_typed_text_survives_a_reload_and_a_kill_of_the_orchestrator(
    begun: str, quiet_screen: Cell, open_page: OpenPage
) -> None:
    page = open_page("/work/tasks", who="Anna", forgives=("502", "503", "Failed to load"))
    row(page).click()
    page.get_by_role("button", name="Claim this task").click()
    form = page.get_by_role("form", name="Result")
    form.get_by_label("Weight in kg").fill("7")
    form.get_by_label("Note").fill("half way")
    page.reload()
    expect(form.get_by_label("Weight in kg")).to_have_value("7")
    expect(form.get_by_label("Note")).to_have_value("half way")

    quiet_screen.kill("task_orchestrator")
    form.get_by_role("button", name="Complete the task").click()
    expect(form).to_contain_text("Your entries are kept on this device.")
    quiet_screen.start("task_orchestrator")
    form.get_by_role("button", name="Complete the task").click()
    wait_for(lambda: seen(begun)["status"] == "completed")
    outputs = seen(begun)["tasks"][0]["outputParameters"]
    assert (outputs["weight"], outputs["note"]) == (7, "half way")


def test_comments_and_history_are_on_the_page(
    begun: str, quiet_screen: Cell, open_page: OpenPage, accessible: Accessible, keep: Keep
) -> None:
    post(quiet_screen, begun, "claim", by="Ben").raise_for_status()
    post(quiet_screen, begun, "return", by="Ben", why="end of shift").raise_for_status()
    page = open_page("/work/tasks", who="Anna")
    row(page).click()
    history = page.get_by_role("region", name="History")
    expect(history).to_contain_text("Claimed by Ben")
    expect(history).to_contain_text("end of shift")
    page.get_by_label("Comment", exact=True).fill("the scale drifts")
    page.get_by_role("button", name="Add comment").click()
    comments = page.get_by_role("region", name="Comments")
    expect(comments.get_by_role("listitem")).to_contain_text("the scale drifts")
    accessible(page)
    keep(page, "tasks-history")
    page.get_by_role("button", name="Decline").click()
    page.get_by_label("Reason").fill("no scale here")
    page.get_by_role("dialog").get_by_role("button", name="Decline").click()
    expect(history).to_contain_text("Declined by Anna: no scale here")
    page.get_by_role("link", name="show in the diagram").click()
    page.wait_for_url("**/processes/**")


def test_a_task_of_a_group_is_found_by_its_members_and_put_off(
    quiet_screen: Cell, open_page: OpenPage, accessible: Accessible, keep: Keep
) -> None:
    url = quiet_screen.url("task_orchestrator")
    for name, follow_up in (("packing-now", "PT0S"), ("packing-later", "P2D")):
        hints = f'camunda:candidateGroups="packing" camunda:dueDate="P1D" camunda:followUpDate="{follow_up}"'
        file = WEIGHING.replace('id="weighing"', f'id="{name}"').replace("Weigh the part", f"Pack {name}")
        file = file.replace('<bpmn:userTask id="weigh"', f'<bpmn:userTask id="weigh" {hints}')
        xml = {"Content-Type": "application/xml"}
        httpx.post(f"{url}/definitions", content=file, headers=xml, timeout=120).raise_for_status()
        httpx.post(f"{url}/processes", json={"definition": name}, timeout=120).raise_for_status()
    page = open_page("/work/tasks", who="Anna", forgives=(CONFLICT,))
    expect(row(page, "Pack packing-now")).to_contain_text("Due in 23 h")
    page.get_by_role("radio", name="My groups’ 0").click()
    expect(page.get_by_text("You have no groups yet.")).to_be_visible()
    page.get_by_role("button", name="Anna").click()
    tick(page, "packing")
    accessible(page)
    page.get_by_role("button", name="Use this").click()
    expect(row(page, "Pack packing-now")).to_be_visible()
    expect(row(page, "Pack packing-later")).to_have_count(0)
    tick(page, "Show 1 later task")
    expect(row(page, "Pack packing-later")).to_be_visible()
    keep(page, "tasks-groups")

    other = open_page("/work/tasks", who="Ben", forgives=(CONFLICT,))
    row(other, "Pack packing-now").click()
    other.get_by_role("button", name="Claim this task").click()
    other.get_by_role("dialog").get_by_role("button", name="Claim it anyway").click()
    other.get_by_role("form", name="Result").wait_for()


def test_a_phone_shows_one_pane_with_large_targets(
    begun: str, open_page: OpenPage, accessible: Accessible, keep: Keep
) -> None:
    page = open_page("/work/tasks", who="Anna")
    page.set_viewport_size({"width": 390, "height": 844})
    keep(page, "tasks-phone")
    row(page).click()
    claim = page.get_by_role("button", name="Claim this task")
    expect(page.get_by_role("grid")).to_have_count(0)
    box = claim.bounding_box()
    assert box is not None
    assert box["height"] >= 44
    accessible(page)
    claim.click()
    page.get_by_role("form", name="Result").wait_for()
    keep(page, "tasks-phone-form")
    page.get_by_role("button", name="Back to the list").click()
    expect(row(page)).to_contain_text("Claimed by Anna")
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    assert seen(begun)["status"] == "inProgress"


def test_tasks_of_devices_are_not_in_the_list(quiet_screen: Cell, open_page: OpenPage) -> None:
    url = f"{quiet_screen.url('task_orchestrator')}/processes"
    process = httpx.post(url, json={"definition": "bin-picking"}, timeout=120).raise_for_status().json()
    page = open_page("/work/tasks")
    page.get_by_text("No open tasks for people.").wait_for()
    wait_for(lambda: seen(f"{url}/{process['id']}")["tasks"][0]["status"] == "inProgress")
    expect(row(page, "Confirm that the cell is clear")).to_have_count(0)
    task = f"{quiet_screen.url('webui')}/api/task-orchestrator/tasks/{process['tasks'][0]['id']}/claim"
    assert httpx.post(task, json={"by": "Anna"}, timeout=120).status_code == 409
    assert httpx.post(f"{task[:-8]}-unknown/claim", json={"by": "Anna"}, timeout=120).status_code == 404
