"""The page shows what packages in `examples/` add: a robot in its 3D view, and a service with its health."""

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import Page, expect

from tests.e2e.conftest import OpenPage
from tests.kit.cell import Cell
from tests.kit.ports import next_free_port
from tests.kit.waiting import scaled

pytestmark = [pytest.mark.nightly, pytest.mark.slow, pytest.mark.timeout(300)]

Keep = Callable[[Page, str], Path]


@pytest.fixture
def rail_cell(extended_cell: Cell) -> Cell:
    """A cell whose robot is the arm on a rail of `examples/`."""
    extended_cell.extra["HANDOVER_ROBOT_MODEL"] = "rail"
    extended_cell.run("context_broker")
    extended_cell.run("task_orchestrator", "gesture_controller", "trajectory_tool", "study", "webui")
    return extended_cell


def move(cell: Cell, name: str, joints: list[float]) -> None:
    """Create a Task that moves the arm on the rail."""
    task = {
        "id": f"urn:ngsi-ld:Task:demo:{name}",
        "type": "Task",
        "isDefinedBy": {"type": "Relationship", "object": "urn:ngsi-ld:TaskDefinition:demo:moveTo"},
        "status": {"type": "Property", "value": "pending", "observedAt": "2026-01-01T12:00:00Z"},
        "involves": {
            "type": "Property",
            "value": [{"type": "Relationship", "object": "urn:ngsi-ld:Device:demo:rail-1"}],
        },
        "workParameters": {"type": "Property", "value": {"operation": "moveTo", "joints": joints}},
    }
    httpx.post(f"{cell.url('context_broker')}/ngsi-ld/v1/entities", json=task, timeout=120).raise_for_status()


def test_the_page_shows_the_joints_and_the_3d_view_of_a_robot_of_another_package(
    rail_cell: Cell, open_page: OpenPage, keep: Keep, accessible: Callable[[Page], None]
) -> None:
    page = open_page("/cell/robots/rail-1")
    expect(page.get_by_role("heading", name="rail-1 (Rail arm)")).to_be_visible()
    joints = page.get_by_role("table", name="Joints")
    rows = joints.get_by_role("row")
    expect(rows).to_have_count(8)
    labels = ["Rail", "Base", "Shoulder", "Elbow", "Forearm roll", "Wrist bend", "Flange roll"]
    expect(joints.get_by_role("rowheader")).to_have_text(labels)
    expect(rows.nth(1).get_by_role("cell")).to_have_text(["0.400 m", "0.000 m/s", "0 … 1.6 m"])
    expect(rows.nth(3).get_by_role("cell")).to_have_text(["−34.4 °", "0.0 °/s", "−109 … 109 °"])
    expect(rows.nth(7).get_by_role("cell").last).to_have_text("∞")

    drawing = page.get_by_role("application", name=re.compile("^Live 3D view of rail-1"))
    expect(drawing.locator("canvas")).to_be_visible()
    expect(page.get_by_text("cannot be drawn")).to_have_count(0)
    accessible(page)
    before = drawing.screenshot()
    keep(page, "example-robot-home")
    move(rail_cell, "along-the-rail", [1.5, 0.8, -0.2, 0.9, 0.0, 0.9, 0.0])
    expect(rows.nth(1).get_by_role("cell").first).to_have_text("1.500 m")
    expect(rows.nth(2).get_by_role("cell").first).to_have_text("45.8 °")
    expect(page.get_by_role("heading", name="No task")).to_be_visible()
    keep(page, "example-robot-moved")
    assert drawing.screenshot() != before

    in_german = open_page("/cell/robots/rail-1", language="de")
    expect(in_german.get_by_role("rowheader", name="Linearachse")).to_be_visible()
    facts = in_german.locator(".robot__facts")
    assert facts.evaluate("facts => facts.scrollWidth <= facts.clientWidth")
    expect(in_german.locator("canvas")).to_be_visible()
    keep(in_german, "example-robot-german")


def run_lamp(cell: Cell) -> "subprocess.Popen[bytes]":
    """Start the lamp of `examples/` as `handover up` does."""
    command = [sys.executable, "-m", "handover_cell", "run", "lamp", "--port", str(cell.ports["lamp"])]
    return subprocess.Popen(
        command, env=cell.environment, cwd=cell.data_dir, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL
    )


@pytest.mark.parametrize("wanted", [True, False])
def test_the_page_lists_a_service_of_another_package_with_its_health(
    extended_cell: Cell, open_page: OpenPage, keep: Keep, wanted: bool
) -> None:
    cell = extended_cell
    cell.ports["lamp"] = next_free_port()
    cell.extra["HANDOVER_LAMP_PORT"] = str(cell.ports["lamp"])
    cell.extra["HANDOVER_EXTRA_SERVICES"] = "lamp" if wanted else ""
    cell.run("context_broker")
    cell.run("task_orchestrator", "gesture_controller", "trajectory_tool", "study", "webui")
    page = open_page("/admin/services")
    services = page.get_by_role("grid", name="Services")
    expect(services.get_by_role("row", name=re.compile("^Study"))).to_be_visible()
    row = services.get_by_role("row", name=re.compile("^lamp"))
    expect(row).to_have_count(1 if wanted else 0)
    lamp = run_lamp(cell)
    try:
        expect(row.get_by_text("Running", exact=True)).to_be_visible()
        keep(page, "example-service")
    finally:
        lamp.terminate()
        lamp.wait(timeout=scaled(30))
    if wanted:
        expect(row).to_contain_text("does not respond")
    else:
        expect(row).to_have_count(0)
