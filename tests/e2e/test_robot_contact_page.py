"""A contact stop on the page of robots: an arm touches something, and a person resets the stop."""

from collections.abc import Iterator
from datetime import UTC, datetime

import httpx
import pytest
import yaml
from playwright.sync_api import expect

from handover_datamodels.times import iso
from handover_ur.simulator.controller import SimulatedController
from tests.e2e.conftest import OpenPage
from tests.kit.cell import Cell
from tests.kit.ur_controllers import RunningController, running_controller
from tests.kit.waiting import wait_for

pytestmark = [pytest.mark.nightly, pytest.mark.slow, pytest.mark.timeout(600)]

HOME = (0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0)
TASK = "urn:ngsi-ld:Task:demo:away-1"
WEIGHT_N, CONTACT_N = 20.0, 62.0


@pytest.fixture
def controller() -> Iterator[RunningController]:
    with running_controller(SimulatedController(HOME, frequency_hz=125.0)) as running:
        yield running


@pytest.fixture
def screen(cell: Cell, controller: RunningController) -> Cell:
    """A cell whose robot has a contact limit and is moved by a simulated controller."""
    robot = {"model": "ur10", "driver": "ur", "contact_force_n": 30, "settings": controller.options()}
    file = cell.data_dir / "cell.yaml"
    file.write_text(yaml.safe_dump({"name": "cell with a contact limit", "robots": {"ur10-1": robot}}))
    cell.extra["HANDOVER_CELL_FILE"] = str(file)
    feel(controller, WEIGHT_N)
    cell.run("context_broker")
    cell.run("task_orchestrator", "trajectory_tool", "webui")
    return cell


def feel(controller: RunningController, force_n: float) -> None:
    """Let the controller measure a force at the tool."""
    controller.do(lambda each: setattr(each, "tcp_force_n", (0.0, 0.0, force_n)))


def move_away(cell: Cell) -> None:
    """Start a Task that turns the first joint slowly."""
    task = {
        "id": TASK,
        "type": "Task",
        "isDefinedBy": {"type": "Relationship", "object": "urn:ngsi-ld:TaskDefinition:demo:moveTo"},
        "status": {"type": "Property", "value": "pending", "observedAt": iso(datetime.now(UTC))},
        "involves": {
            "type": "Property",
            "value": [{"type": "Relationship", "object": "urn:ngsi-ld:Device:demo:ur10-1"}],
        },
        "workParameters": {"type": "Property", "value": {"joints": [1.2, *HOME[1:]], "speed": 0.1}},
    }
    context = f"<{cell.url('task_orchestrator')}/context.jsonld>"
    httpx.post(
        f"{cell.url('context_broker')}/ngsi-ld/v1/entities",
        json=task,
        headers={"Link": f'{context}; rel="http://www.w3.org/ns/json-ld#context"'},
        timeout=120,
    ).raise_for_status()


def test_a_contact_stops_the_arm_until_a_person_resets_it_on_the_page(
    screen: Cell, open_page: OpenPage, controller: RunningController
) -> None:
    page = open_page("/cell/robots/ur10-1")
    limits = page.locator(".limits")
    expect(limits).to_contain_text("20 N")

    def turned_rad() -> float:
        return controller.do(lambda each: each.positions[0])

    def is_at_rest() -> bool:
        robot = httpx.get(f"{screen.url('trajectory_tool')}/robots/ur10-1", timeout=120).json()
        return max(map(abs, robot["joints"]["velocity"])) < 1e-3

    move_away(screen)
    wait_for(lambda: turned_rad() > 0.02)
    feel(controller, CONTACT_N)
    expect(limits.locator("[data-stopped]")).to_contain_text("contact with 42 N; a person must reset it")
    wait_for(is_at_rest)
    stopped_rad = turned_rad()
    assert stopped_rad < 1.1, "the arm was on its way"
    feel(controller, WEIGHT_N)
    expect(limits).to_contain_text("20 N")
    expect(limits.locator("[data-stopped]")).to_contain_text("a person must reset it")
    assert turned_rad() == pytest.approx(stopped_rad, abs=1e-3), "only a person ends the stop"

    page.get_by_role("button", name="Reset the stop").click()
    dialog = page.get_by_role("dialog")
    dialog.get_by_role("textbox").fill("Aino")
    dialog.get_by_role("button", name="Reset the stop").click()
    expect(limits.locator("[data-stopped]")).to_have_count(0)
    entity = f"{screen.url('context_broker')}/ngsi-ld/v1/entities/{TASK}"
    wait_for(lambda: '"completed"' in httpx.get(entity, timeout=120).text)
    assert turned_rad() == pytest.approx(1.2, abs=0.01)
