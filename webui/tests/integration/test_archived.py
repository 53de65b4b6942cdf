"""Archived processes are shown with their Tasks after their entities have left the broker."""

from typing import Any

import httpx
import pytest

from services.task_orchestrator.tests.unit.drawing import ONE_STEP, drawing
from tests.kit.cell import Cell
from tests.kit.waiting import wait_for

pytestmark = pytest.mark.slow


@pytest.mark.nightly
def test_archived_processes_are_shown(cell: Cell, look: Any) -> None:
    cell.extra["HANDOVER_RETENTION_H"] = "0.0001"
    cell.start("context_broker", "task_orchestrator", "webui")
    entities = f"{cell.url('context_broker')}/ngsi-ld/v1/entities"
    with (
        httpx.Client(base_url=cell.url("task_orchestrator"), trust_env=False, timeout=120) as orchestrator,
        httpx.Client(base_url=entities, trust_env=False, timeout=120) as broker,
    ):
        xml = {"Content-Type": "application/xml"}
        orchestrator.post("/definitions", content=drawing(ONE_STEP), headers=xml).raise_for_status()
        process = orchestrator.post("/processes", json={"definition": "p"}).json()["id"]
        task = f"urn:ngsi-ld:Task:demo:{process}-work-1"
        wait_for(lambda: broker.get(f"/{task}").is_success)
        first = look()
        first.read_until(lambda: first.process().get("status") == "inProgress")
        change = {"status": {"type": "Property", "value": "completed", "observedAt": "2040-01-01T00:00:00Z"}}
        broker.post(f"/{task}/attrs", json=change).raise_for_status()
        first.read_until(lambda: first.process().get("status") == "completed")
        wait_for(lambda: orchestrator.get(f"/processes/{process}").json()["archivedAt"])
        wait_for(lambda: broker.get(f"/{task}").status_code == 404)
    cell.restart("webui")
    second = look()
    second.read_until(lambda: second.process().get("archivedAt"))
    assert second.process()["id"] == process
    assert second.process()["status"] == "completed"
    assert [each["status"] for each in second.process()["tasks"]] == ["completed"]
    assert second.process()["tasks"][0]["history"]
