"""Allocation: the mapping gives the activities of foreign files to people, robots and devices."""

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import orjson
import pytest

from services.task_orchestrator.tests.integration.cell import Cell, cell, eventually
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


@pytest.mark.nightly
def test_a_file_gives_no_work_to_a_robot_until_an_engineer_confirms_the_mapping(allocating: Cell) -> None:
    running = allocating
    table = running.api.get("/mapping").json()
    assert (table["version"], table["by"]) == (1, None)
    report = deploy(running, "first")
    assert report["grip"]["warningCode"] == "allocation.unconfirmed"
    unmapped = deploy(running, "unmapped", dry=True)
    assert unmapped["grip"]["warningCode"] == "allocation.no_performer"
    assert unmapped["check"]["warning"] is None, "people perform it"
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
    running.script_file.write_text("{}")
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
    from handover_processes.command_line import mapping

    monkeypatch.setenv("HANDOVER_ORCHESTRATOR_PORT", str(allocating.api.base_url.port))
    file = tmp_path / "mapping.yaml"
    file.write_text("entries:\n- {kind: lane, name: Robot, role: robot}\n")
    mapping.set_mapping(file, by="Anna", why="new cell")
    mapping.show_mapping()
    shown = capsys.readouterr().out
    assert "by: Anna" in shown
    assert "role: robot" in shown


CHOICE = """<?xml version="1.0" encoding="UTF-8"?>
<bpmn:definitions xmlns:bpmn="http://www.omg.org/spec/BPMN/20100524/MODEL"
    xmlns:handover="urn:handover:bpmn" id="file" targetNamespace="urn:t">
  <bpmn:process id="{name}" isExecutable="true">
    <bpmn:startEvent id="start"/>
    <bpmn:serviceTask id="work" name="Work"><bpmn:extensionElements>
      <handover:task definition="work" {needs}/>
    </bpmn:extensionElements></bpmn:serviceTask>
    <bpmn:endEvent id="end"/>
    <bpmn:sequenceFlow id="a" sourceRef="start" targetRef="work"/>
    <bpmn:sequenceFlow id="b" sourceRef="work" targetRef="end"/>
  </bpmn:process>
</bpmn:definitions>"""
GLOVE, ROBOT = (f"urn:ngsi-ld:Device:demo:{name}" for name in ("glove-1", "ur10-1"))


def deploy_choice(running: Cell, name: str, needs: str) -> dict[str, Any]:
    answer = running.api.post(
        "/definitions",
        content=CHOICE.format(name=name, needs=needs),
        headers={"Content-Type": "application/xml"},
    )
    assert answer.is_success, answer.text
    line: dict[str, Any] = answer.json()["allocation"][0]
    return line


def have(running: Cell, skills: dict[str, Any], roles: dict[str, list[str]] | None = None) -> None:
    """Give the devices skills and roles, by URN, in their ResourceSpecifications."""
    for urn, given in skills.items():
        name = urn.rpartition(":")[2]
        specification = f"urn:ngsi-ld:ResourceSpecification:demo:{name}"
        for entity in (
            {
                "id": specification,
                "type": "ResourceSpecification",
                "name": {"type": "Property", "value": name},
                "resourceType": {"type": "Property", "value": "robot"},
                "skills": {"type": "Property", "value": given},
                "roles": {"type": "Property", "value": (roles or {}).get(urn, [])},
            },
            {
                "id": urn,
                "type": "Device",
                "controlledProperty": {"type": "Property", "value": ["motion"]},
                "isSpecifiedBy": {"type": "Relationship", "object": specification},
            },
        ):
            answer = running.entities.post("", json=entity, headers={"Content-Type": "application/json"})
            if answer.status_code == 409:
                attributes = {name: value for name, value in entity.items() if name not in {"id", "type"}}
                answer = running.entities.post(f"/{entity['id']}/attrs", json=attributes)
            assert answer.is_success, answer.text

    def are_known() -> bool:
        known = {each["id"]: each for each in running.api.get("/agents").json()}
        return all(
            urn in known
            and set(known[urn]["skills"]) == {one if isinstance(one, str) else one["name"] for one in given}
            and known[urn]["roles"] == (roles or {}).get(urn, [])
            for urn, given in skills.items()
        )

    eventually(are_known, "the change of the agents")


def test_the_most_skilled_agent_gets_the_task_and_the_next_one_if_it_declines(allocating: Cell) -> None:
    running = allocating
    have(running, {GLOVE: ["weld"], ROBOT: [{"name": "weld", "level": 3}]})
    running.script_file.write_text('{"work-1": {"fails": "the gripper is hot", "declined": true}}')
    assert deploy_choice(running, "skilled", 'skills="weld"')["warning"] is None
    ended = running.ended(running.start("skilled"))
    assert ended["status"] == "completed"
    first, second = ended["tasks"]
    assert (first["involves"], first["status"]) == ([ROBOT], "failed")
    assert first["allocated"] == "ur10-1: idle, skill 3; glove-1 free as well"
    assert (second["involves"], second["status"]) == ([GLOVE], "completed")
    assert second["allocated"] == "glove-1: idle, skill 1"


def test_it_is_an_incident_when_all_have_declined_and_a_retry_asks_all_again(allocating: Cell) -> None:
    running = allocating
    have(running, {GLOVE: ["paint"], ROBOT: ["paint"]})
    no = {"fails": "no", "declined": True}
    running.script_file.write_bytes(orjson.dumps({"work-1": no, "work-2": no}))
    assert deploy_choice(running, "refused", 'skills="paint"')["warning"] is None
    process = running.start("refused")
    (incident,) = running.stuck(process)["incidents"]
    assert incident["reasonCode"] == "allocation.all_declined"
    answer = running.api.post(f"/processes/{process}/tokens/{incident['token']}/retry", json={"by": "Anna"})
    assert answer.is_success, answer.text
    assert running.ended(process)["status"] == "completed"


def test_an_activity_waits_for_an_agent_also_across_a_kill(allocating: Cell) -> None:
    running = allocating
    running.script_file.write_text("{}")
    have(running, {GLOVE: [], ROBOT: []})
    role = 'role="inspector"'
    assert deploy_choice(running, "inspection", role)["warning"] == "nobody has role:inspector"
    process = running.start("inspection")
    (waiting,) = running.look(process)["unallocated"]
    assert (waiting["element"], waiting["reason"]) == ("work", "nobody has role:inspector")
    running.orchestrator.kill()
    running.orchestrator.start()
    assert running.look(process)["unallocated"][0]["since"] == waiting["since"]
    have(running, {ROBOT: []}, {ROBOT: ["inspector"]})
    ended = running.ended(process)
    assert ended["status"] == "completed"
    assert [task["involves"] for task in ended["tasks"]] == [[ROBOT]]
    assert ended["unallocated"] == []


def test_one_agent_works_on_one_task_at_a_time(allocating: Cell) -> None:
    running = allocating
    have(running, {GLOVE: [], ROBOT: ["drill"]})
    running.script_file.write_text('{"work-1": {"after_s": 0.3}}')
    eventually(
        lambda: deploy_choice(running, "drilling", 'skills="drill"')["warning"] is None,
        "the agents are known",
    )
    ended = [running.ended(each) for each in [running.start("drilling") for _ in range(4)]]
    times = sorted((each["tasks"][0]["createdAt"], each["tasks"][0]["endedAt"]) for each in ended)
    assert all(before[1] <= after[0] for before, after in itertools.pairwise(times))
