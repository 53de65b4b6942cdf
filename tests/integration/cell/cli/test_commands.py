"""The command line as a person types it, against running services."""

import json
import re
import subprocess
import sys
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import httpx
import pytest

from tests.kit.other_broker.running import context_link
from tests.kit.waiting import wait_for

BAD = """<definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL" targetNamespace="urn:t">
<process id="odd" isExecutable="true"><complexGateway id="which" name="Which one?"/></process>
</definitions>"""

WAITS = """<definitions xmlns="http://www.omg.org/spec/BPMN/20100524/MODEL"
  xmlns:handover="urn:handover:bpmn" targetNamespace="urn:t">
<process id="ask-somebody" isExecutable="true">
<extensionElements><handover:process><handover:parameter name="colour" value="red"/></handover:process>
</extensionElements>
<startEvent id="begin"/>
<userTask id="ask" name="Ask"><extensionElements><handover:task definition="ask">
<handover:involves resource="Person:nobody"/><handover:parameter name="colour" expression="colour"/>
</handover:task></extensionElements></userTask>
<endEvent id="end"/>
<sequenceFlow id="a" sourceRef="begin" targetRef="ask"/><sequenceFlow id="b" sourceRef="ask" targetRef="end"/>
</process></definitions>"""

Handover = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def handover(cell: Any) -> Handover:
    def command(*words: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "handover_cell", *words],
            env=cell.environment,
            cwd=cell.data_dir,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=120,
        )

    return command


@pytest.mark.nightly
@pytest.mark.slow
def test_a_process_is_deployed_started_listed_shown_and_cancelled(
    handover: Handover, cell: Any, tmp_path: Path, eventually: Callable[..., None]
) -> None:
    cell.start("context_broker", "task_orchestrator")
    (tmp_path / "bad.bpmn").write_text(BAD)
    (tmp_path / "ask.bpmn").write_text(WAITS)

    refused = handover("process", "deploy", str(tmp_path / "bad.bpmn"))
    assert refused.returncode == 2
    assert 'line 2, which ("Which one?"): complexGateway' in refused.stderr
    assert "Traceback" not in refused.stderr

    deployed = handover("process", "deploy", str(tmp_path / "ask.bpmn"))
    assert deployed.stdout.splitlines()[0] == "ask-somebody version 1 deployed", deployed.stderr
    started = handover("process", "start", "ask-somebody", "--set", "colour=green")
    process = started.stdout.split()[0]

    listed = handover("process", "list").stdout
    assert "bin-picking" in listed
    assert re.search(rf"{process} +inProgress +.+ 1 \(ask-somebody version 1\), waits at ask", listed), listed
    shown = json.loads(handover("process", "show", process).stdout)
    assert shown["status"] == "inProgress"
    assert shown["variables"]["colour"] == "green"

    early = handover("process", "retry", process, "99", "--by", "Anna")
    assert early.returncode == 2
    assert 'there is no token "99"' in early.stderr
    corrected = handover("process", "set", process, "--by", "Anna", "--set", "colour=red")
    assert corrected.returncode == 0, corrected.stderr
    assert json.loads(handover("process", "show", process).stdout)["variables"]["colour"] == "red"
    assert handover("process", "message", "hello").stdout == "stored\n"
    assert handover("process", "signal", "hello").stdout == "no process waits for it\n"

    assert handover("process", "cancel", process, "--by", "Anna").returncode == 0
    asked = f"{cell.url('task_orchestrator')}/processes/{process}"  # a command a look would take seconds
    eventually(lambda: httpx.get(asked, trust_env=False, timeout=120).json()["status"] == "failed")
    (listed,) = json.loads(handover("process", "list", "--json").stdout)["processes"]
    assert listed["id"] == process
    assert re.search(rf"{process} +cancelled ", handover("process", "list").stdout)
    again = handover("process", "cancel", process)
    assert again.returncode == 2
    assert "failed already" in again.stderr


DESK = WAITS.replace("ask-somebody", "at-a-desk").replace(
    '<handover:involves resource="Person:nobody"/><handover:parameter name="colour" expression="colour"/>', ""
)


@pytest.mark.nightly
@pytest.mark.slow
def test_a_task_of_people_is_claimed_and_completed_and_a_migration_that_is_impossible_fails(
    handover: Handover, cell: Any, tmp_path: Path, eventually: Callable[..., None]
) -> None:
    cell.start("context_broker", "task_orchestrator")
    (tmp_path / "desk.bpmn").write_text(DESK)
    handover("process", "deploy", str(tmp_path / "desk.bpmn"))
    process = handover("process", "start", "at-a-desk").stdout.split()[0]
    tasks = f"{cell.url('task_orchestrator')}/tasks"  # a command a look would take seconds
    eventually(lambda: httpx.get(tasks, trust_env=False, timeout=120).json())
    listed = handover("task", "list", "--process", process)
    task, status = listed.stdout.split()[:2]
    assert status == "pending"
    assert "Ask of at-a-desk 1  (offered to everybody)" in listed.stdout

    (tmp_path / "desk.bpmn").write_text(DESK.replace('"ask"', '"other"'))
    handover("process", "deploy", str(tmp_path / "desk.bpmn"))
    migrated = handover("process", "migrate", process, "--by", "Anna", "--dry")
    assert migrated.returncode == 1, migrated.stdout
    assert f"{process} cannot be migrated to version 2" in migrated.stdout

    early = handover("task", "complete", task, "--by", "Anna")
    assert early.returncode == 2, early.stdout
    claimed = handover("task", "claim", task, "--by", "Anna")
    assert claimed.stdout == f"{task} is claimed by Anna\n", claimed.stderr
    mine = json.loads(handover("task", "list", "--claimed-by", "Anna", "--json").stdout)
    assert [each["id"] for each in mine] == [task]
    completed = handover("task", "complete", task, "--by", "Anna", "--note", "done")
    assert completed.stdout == f"{task} is completed\n", completed.stderr
    assert handover("task", "list").stdout == "no Task of a person is open\n"


@pytest.mark.nightly
@pytest.mark.slow
def test_a_failed_task_is_retried(
    handover: Handover, cell: Any, tmp_path: Path, eventually: Callable[..., None]
) -> None:
    cell.start("context_broker", "task_orchestrator")
    (tmp_path / "ask.bpmn").write_text(WAITS)
    handover("process", "deploy", str(tmp_path / "ask.bpmn"))
    process = handover("process", "start", "ask-somebody").stdout.split()[0]

    def shown() -> dict[str, Any]:
        seen: dict[str, Any] = json.loads(handover("process", "show", process).stdout)
        return seen

    task = shown()["tasks"][0]["id"]
    entity = f"{cell.url('context_broker')}/ngsi-ld/v1/entities/{task}"
    failed = {
        "status": {"type": "Property", "value": "failed", "observedAt": datetime.now(UTC).isoformat()},
        "outputParameters": {"type": "Property", "value": {"reason": "nobody is there"}},
    }
    link = {"Link": context_link()}
    eventually(lambda: httpx.get(entity, headers=link, trust_env=False, timeout=120).status_code == 200)
    assert httpx.post(f"{entity}/attrs", json=failed, headers=link, trust_env=False, timeout=120).is_success
    asked = f"{cell.url('task_orchestrator')}/processes/{process}"  # a command a look would take seconds
    eventually(lambda: httpx.get(asked, trust_env=False, timeout=120).json()["incidents"])
    assert "nobody is there" in handover("process", "list").stdout
    (incident,) = shown()["incidents"]

    retried = handover("process", "retry", process, incident["token"], "--by", "Anna")
    assert retried.stdout == f"{process} continues: {shown()['waiting'][0]}\n", retried.stderr
    assert shown()["acts"][0]["by"] == "Anna"


@pytest.mark.nightly
@pytest.mark.slow
def test_an_offer_of_another_system_is_listed_shown_and_accepted_or_rejected(
    handover: Handover, cell: Any
) -> None:
    cell.start("context_broker", "task_orchestrator")
    url = f"{cell.url('context_broker')}/ngsi-ld/v1/entityOperations/upsert"
    definitions = [
        {
            "id": f"urn:ngsi-ld:TaskDefinition:mes:{name}",
            "type": "TaskDefinition",
            "name": {"type": "Property", "value": name},
            "gesture": {"type": "Property", "value": "Thumbs up"},
        }
        for name in ("allow-scan", "allow-pick")
    ]
    httpx.post(url, json=definitions, headers={"Link": context_link()}, timeout=120).raise_for_status()
    offers = f"{cell.url('task_orchestrator')}/offers"  # a command a look would take seconds
    wait_for(lambda: len(httpx.get(offers, timeout=120).json()) == 2)
    listed = handover("process", "offers", "list").stdout
    ids = {line.split()[2]: line.split()[0] for line in listed.splitlines()}
    assert set(ids) == {"allow-scan", "allow-pick"}
    shown = handover("process", "offers", "show", ids["allow-scan"]).stdout
    assert "urn:ngsi-ld:TaskDefinition:mes:allow-scan" in shown
    assert "added    gesture" in shown
    accepted = handover("process", "offers", "accept", ids["allow-scan"], "--by", "Eva")
    assert accepted.stdout == "allow-scan is accepted\n", accepted.stderr
    rejected = handover("process", "offers", "reject", ids["allow-pick"], "--by", "Eva", "--why", "not ours")
    assert rejected.stdout == "allow-pick is rejected\n", rejected.stderr
    assert handover("process", "offers", "list").stdout == "no offer is open\n"
    assert "allow-pick" in handover("process", "offers", "list", "--status", "rejected").stdout
    again = handover("process", "offers", "accept", "unknown", "--by", "Eva")
    assert again.returncode != 0
    assert "Traceback" not in again.stderr


@pytest.mark.nightly
def test_what_cannot_be_done_is_one_line_with_the_way_out(handover: Handover, tmp_path: Path) -> None:
    for words, expected in (
        (("process", "start", "bin-picking"), "handover up"),
        (("process", "start", "bin-picking", "--set", "colour"), "name=value"),
        (("process", "deploy", str(tmp_path / "none.bpmn")), "cannot be read"),
        (("run", "coffee-machine"), "context-broker"),
        (("glove", "replay", str(tmp_path / "none.csv")), "cannot be read"),
        (("glove", "dance"), "dance"),
    ):
        said = handover(*words)
        assert said.returncode == 2, words
        assert expected in said.stderr, said.stderr
        assert len(said.stderr.strip().splitlines()) == 1, said.stderr


@pytest.mark.nightly
def test_settings_are_listed_with_where_they_come_from(handover: Handover, cell: Any) -> None:
    said = handover("settings").stdout
    port = next(line for line in said.splitlines() if line.startswith("HANDOVER_BROKER_PORT"))
    assert str(cell.ports["context_broker"]) in port
    assert "environment" in port
    for setting in ("HANDOVER_GLOVE_PORT", "HANDOVER_SCAN_SEED", "HANDOVER_PROCESS_DIR"):
        assert setting in said


@pytest.mark.nightly
def test_the_doctor_says_what_is_there_and_what_is_missing(handover: Handover) -> None:
    examined = handover("doctor")
    assert examined.returncode == 0, examined.stdout
    assert "Python" in examined.stdout
    assert "is free" in examined.stdout
