"""The Tasks page with real services: people claim, return and complete Tasks without a glove."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import pytest
from playwright.sync_api import Page, expect

from tests.e2e.conftest import OpenPage
from tests.kit.cell import Cell
from tests.kit.waiting import wait_for

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

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


def test_a_task_is_claimed_and_completed_with_its_form_by_keyboard(
    begun: str, open_page: OpenPage, keep: Keep, accessible: Accessible
) -> None:
    page = open_page("/tasks", who="")
    entry = page.get_by_role("button", name="Weigh the part")
    expect(entry).to_contain_text("Unclaimed")
    accessible(page)
    page.keyboard.press("j")
    expect(entry).to_be_focused()
    page.keyboard.press("Enter")
    page.get_by_role("button", name="Claim this task").wait_for()
    page.keyboard.press("c")
    page.get_by_label("Your name").fill("Liisa")
    page.keyboard.press("Enter")
    form = page.get_by_role("form", name="Result")
    expect(entry).to_contain_text("Claimed by Liisa")
    wait_for(lambda: [task["status"] for task in seen(begun)["tasks"]] == ["inProgress"])

    form.get_by_label("Weight in kg").fill("21")
    page.keyboard.press("Enter")
    expect(form).to_contain_text("The number is too large")
    accessible(page)
    keep(page, "tasks-form")
    form.get_by_label("Weight in kg").fill("12")
    form.get_by_label("Colour").select_option("Green")
    form.get_by_label("Weight in kg").press("Enter")
    expect(entry).to_have_count(0)
    wait_for(lambda: seen(begun)["status"] == "completed")
    [task] = seen(begun)["tasks"]
    outputs = task["outputParameters"]
    assert (outputs["weight"], outputs["colour"]) == (12, "g")
    assert (outputs["operator"], outputs["by"], outputs["outcome"]) == ("Liisa", "tasklist", "ok")


def test_a_claimed_task_is_refused_to_others_until_it_is_returned(
    begun: str, cell: Cell, open_page: OpenPage, keep: Keep
) -> None:
    anna = open_page("/tasks", who="Anna", forgives=(CONFLICT,))
    ben = open_page("/tasks", who="Ben", forgives=(CONFLICT,))
    for page in (anna, ben):
        page.get_by_role("button", name="Weigh the part").click()
        page.get_by_role("button", name="Claim this task").wait_for()
    anna.get_by_role("button", name="Claim this task").click()
    anna.get_by_role("form", name="Result").wait_for()
    expect(ben.get_by_role("article")).to_contain_text("Claimed by Anna")
    expect(ben.get_by_role("button", name="Claim this task")).to_have_count(0)
    ben.get_by_role("radio", name="Mine").click()
    expect(ben.get_by_text("No tasks in this view.")).to_be_visible()
    keep(ben, "tasks-claimed")

    task = f"{cell.url('webui')}/api/tasks/{seen(begun)['tasks'][0]['id']}"
    refused = httpx.post(f"{task}/claim", json={"by": "Ben"}, timeout=120)
    assert (refused.status_code, refused.json()["detail"]) == (409, "Anna has claimed this task")
    refused = httpx.post(f"{task}/complete", json={"by": "Ben", "outputs": {"weight": 1}}, timeout=120)
    assert refused.status_code == 409
    bad = httpx.post(f"{task}/complete", json={"by": "Anna", "outputs": {"weight": "heavy"}}, timeout=120)
    assert bad.status_code == 422
    assert bad.json()["detail"].startswith("the result does not match the form: weight: ")

    anna.get_by_role("button", name="Return this task").click()
    ben.get_by_role("button", name="Claim this task").click()
    form = ben.get_by_role("form", name="Result")
    form.get_by_label("Outcome").select_option("Problem")
    form.get_by_label("Note").fill("the scale is broken")
    form.get_by_role("button", name="Report the problem").click()
    wait_for(lambda: seen(begun)["incidents"] != [])
    [incident] = seen(begun)["incidents"]
    assert incident["element"] == "weigh"
    assert "the scale is broken" in incident["reason"]


def test_tasks_of_devices_are_not_in_the_list(quiet_screen: Cell, open_page: OpenPage) -> None:
    url = f"{quiet_screen.url('task_orchestrator')}/processes"
    process = httpx.post(url, json={"definition": "bin-picking"}, timeout=120).raise_for_status().json()
    page = open_page("/tasks")
    page.get_by_text("No open tasks for people.").wait_for()
    wait_for(lambda: seen(f"{url}/{process['id']}")["tasks"][0]["status"] == "inProgress")
    expect(page.get_by_role("button", name="Confirm that the cell is clear")).to_have_count(0)
    task = f"{quiet_screen.url('webui')}/api/tasks/{process['tasks'][0]['id']}/claim"
    assert httpx.post(task, json={"by": "Anna"}, timeout=120).status_code == 409
    assert httpx.post(f"{task[:-8]}-unknown/claim", json={"by": "Anna"}, timeout=120).status_code == 404
