"""Allocation: the mapping gives the activities of foreign files to people, robots and devices."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.integration.task_orchestrator.cell import Cell, cell, eventually
from tests.kit.ports import next_free_port

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("allocation")]

FOREIGN = """<?xml version="1.0" encoding="UTF-8"?>
<bpmn:definitions xmlns:bpmn="http://www.omg.org/spec/BPMN/20100524/MODEL"
    xmlns:camunda="http://camunda.org/schema/1.0/bpmn" id="file" targetNamespace="urn:t">
  <bpmn:process id="{name}" isExecutable="true">
    <bpmn:startEvent id="start"/>
    <bpmn:serviceTask id="grip" name="Grip" camunda:type="external" camunda:topic="{name}-grip"/>
    <bpmn:userTask id="check" name="Check" camunda:candidateGroups="quality"/>
    <bpmn:endEvent id="end"/>
    <bpmn:sequenceFlow id="a" sourceRef="start" targetRef="grip"/>
    <bpmn:sequenceFlow id="b" sourceRef="grip" targetRef="check"/>
    <bpmn:sequenceFlow id="c" sourceRef="check" targetRef="end"/>
  </bpmn:process>
</bpmn:definitions>"""


@pytest.fixture(scope="module")
def allocating(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    folder = tmp_path_factory.mktemp("allocation")
    file = folder / "mapping.yaml"
    file.write_text("entries:\n- {kind: topic, name: first-grip, resource: 'Device:ur10-1'}\n")
    with cell(folder, next_free_port, extra={"HANDOVER_MAPPING_FILE": str(file)}) as running:
        yield running


def deploy(running: Cell, name: str, *, dry: bool = False) -> dict[str, Any]:
    answer = running.api.post(
        "/definitions",
        content=FOREIGN.format(name=name),
        headers={"Content-Type": "application/xml"},
        params={"dry": dry},
    )
    assert answer.is_success, answer.text
    return {line["element"]: line for line in answer.json()["allocation"]}


def posted(running: Cell, process: str, element: str) -> dict[str, Any]:
    def look() -> dict[str, Any] | None:
        tasks = running.look(process)["tasks"]
        return next((task for task in tasks if task["element"] == element), None)

    return eventually(look, f"the Task of {element}")


def test_a_file_gives_no_work_to_a_robot_until_an_engineer_confirms_the_mapping(allocating: Cell) -> None:
    running = allocating
    table = running.api.get("/mapping").json()
    assert (table["version"], table["by"]) == (1, None)
    report = deploy(running, "first")
    assert report["grip"]["warningCode"] == "allocation.unconfirmed"
    waiting = posted(running, running.start("first"), "grip")
    assert waiting["involves"] == []
    confirmed = running.api.put(
        "/mapping", json={"by": "Anna", "why": "checked", "version": 1, "entries": table["entries"]}
    )
    assert confirmed.status_code == 200, confirmed.text
    assert confirmed.json()["by"] == "Anna"
    assert deploy(running, "first", dry=True)["grip"]["performer"] == "Device:ur10-1"
    process = running.start("first")
    check = posted(running, process, "check")  # the robot has gripped
    assert check["involves"] == []
    assert check["workParameters"]["candidates"] == {"groups": ["quality"]}
    tasks = {task["element"]: task for task in running.look(process)["tasks"]}
    assert tasks["grip"]["allocatedCode"] == "allocation.by_entry"


def test_a_mapping_survives_a_restart_with_its_versions(allocating: Cell) -> None:
    running = allocating
    before = running.api.get("/mapping").json()["version"]
    entries = [{"kind": "topic", "name": "kept-grip", "resource": "Device:ur10-1"}]
    running.api.put("/mapping", json={"by": "Bo", "entries": entries})
    running.orchestrator.kill()
    running.orchestrator.start()
    table = running.api.get("/mapping").json()
    assert (table["version"], table["by"], table["entries"]) == (before + 1, "Bo", entries)
    stale = running.api.put("/mapping", json={"by": "Anna", "version": before, "entries": []})
    assert stale.status_code == 409
    assert running.api.get("/mapping", params={"version": before + 5}).status_code == 404
    wrong = running.api.put("/mapping", json={"by": "Anna", "entries": [{"kind": "lane", "name": "x"}]})
    assert wrong.status_code == 422
    assert "one of resource, role and skills" in wrong.text


def test_the_command_line_shows_and_sets_the_mapping(
    allocating: Cell, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from handover.cli import process

    monkeypatch.setenv("HANDOVER_ORCHESTRATOR_PORT", str(allocating.api.base_url.port))
    file = tmp_path / "mapping.yaml"
    file.write_text("entries:\n- {kind: lane, name: Robot, role: robot}\n")
    process.set_mapping(file, by="Anna", why="new cell")
    process.show_mapping()
    shown = capsys.readouterr().out
    assert "by: Anna" in shown
    assert "role: robot" in shown
