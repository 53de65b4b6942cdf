"""The tasklist over REST: people claim, return, decline and complete Tasks, and comment on them."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import httpx
import orjson
import pytest

from services.task_orchestrator.tests.integration.cell import Cell, cell, eventually
from tests.kit.ports import next_free_port

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("tasklist")]

NAMESPACES = (
    'xmlns:bpmn="http://www.omg.org/spec/BPMN/20100524/MODEL" xmlns:handover="urn:handover:bpmn" '
    'xmlns:camunda="http://camunda.org/schema/1.0/bpmn" targetNamespace="urn:t"'
)
FORM = {
    "type": "default",
    "id": "weighing-form",
    "components": [
        {"type": "number", "key": "weight", "label": "Weight", "validate": {"required": True, "max": 20}},
        {"type": "checkbox", "key": "broken", "label": "Broken"},
        {
            "type": "textfield",
            "key": "why",
            "label": "Why",
            "validate": {"required": True},
            "conditional": {"hide": "=broken != true"},
        },
    ],
}


def bpmn(name: str, task: str) -> str:
    """A process with one user task; `task` are its attributes and content."""
    return f"""<bpmn:definitions {NAMESPACES}><bpmn:process id="{name}" name="Weighing" isExecutable="true">
      <bpmn:startEvent id="start"/><bpmn:userTask id="weigh" name="Weigh" {task}</bpmn:userTask>
      <bpmn:endEvent id="end"/>
      <bpmn:sequenceFlow id="a" sourceRef="start" targetRef="weigh"/>
      <bpmn:sequenceFlow id="b" sourceRef="weigh" targetRef="end"/></bpmn:process></bpmn:definitions>"""


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    with cell(tmp_path_factory.mktemp("tasklist"), next_free_port) as all_members:
        yield all_members


def deploy(running: Cell, name: str, task: str, *forms: dict[str, Any]) -> None:
    files = [{"name": f"{name}.bpmn", "content": bpmn(name, task)}]
    files += [{"name": f"{form['id']}.form", "content": orjson.dumps(form).decode()} for form in forms]
    running.api.post("/deployments", json={"files": files}).raise_for_status()


def begin(running: Cell, name: str) -> tuple[str, str]:
    """Start a process; return its id and the id of its Task."""
    process = running.start(name)
    return process, str(running.look(process)["tasks"][0]["id"])


def post(running: Cell, task: str, act: str, **body: Any) -> httpx.Response:
    return running.api.post(f"/tasks/{task}/{act}", json=body)


def details(running: Cell, task: str) -> dict[str, Any]:
    seen: dict[str, Any] = running.api.get(f"/tasks/{task}").raise_for_status().json()
    return seen


def status_in_broker(running: Cell, task: str) -> str | None:
    entity = running.entity(task)
    return None if entity is None else entity["status"]["value"]


@pytest.mark.nightly
def test_of_two_persons_who_claim_at_once_one_gets_a_clear_answer(running: Cell) -> None:
    deploy(running, "race", ">")
    for _ in range(5):
        race(running)


def race(running: Cell) -> None:
    _, task = begin(running, "race")
    with ThreadPoolExecutor(2) as pool:
        answers = list(pool.map(lambda who: post(running, task, "claim", by=who), ("Anna", "Ben")))
    won, lost = sorted(answers, key=lambda answer: answer.status_code)
    assert (won.status_code, lost.status_code) == (200, 409)
    who = won.json()["claimedBy"]
    assert lost.json()["detail"] == f"{who} has claimed this task"
    assert lost.json()["detailCode"] == "tasklist.taken"
    eventually(lambda: status_in_broker(running, task) == "inProgress", "the claim in the broker")


def test_a_claimed_task_is_returned_and_completed_by_another_person(running: Cell) -> None:
    deploy(running, "relay", ">")
    process, task = begin(running, "relay")
    assert post(running, task, "complete", by="Anna").status_code == 409
    post(running, task, "claim", by="Anna").raise_for_status()
    assert post(running, task, "return", by="Ben").status_code == 409
    post(running, task, "return", by="Anna", why="end of shift").raise_for_status()
    assert [entry["id"] for entry in running.api.get("/tasks", params={"process": process}).json()] == [task]
    post(running, task, "claim", by="Ben").raise_for_status()
    forged = {"weight": 3, "performedBy": "urn:ngsi-ld:Person:demo:anna"}
    done = post(running, task, "complete", by="Ben", outputs=forged)
    assert done.status_code == 200, done.text
    assert "performedBy" not in done.text
    assert running.ended(process)["status"] == "completed"
    again = post(running, task, "complete", by="Ben", outputs={"weight": 3})
    assert again.status_code == 200  # the answer to the first request was lost
    assert post(running, task, "complete", by="Ben", outputs={"weight": 4}).status_code == 409
    kinds = [(entry["kind"], entry["by"], entry.get("status")) for entry in details(running, task)["history"]]
    assert kinds == [
        ("created", None, None),
        ("offered", None, None),
        ("claim", "Anna", None),
        ("status", None, "assigned"),
        ("status", None, "inProgress"),
        ("return", "Anna", None),
        ("claim", "Ben", None),
        ("complete", "Ben", None),
        ("status", None, "completed"),
    ]
    eventually(lambda: status_in_broker(running, task) == "completed", "the result in the broker")


def test_a_form_that_was_deployed_with_the_process_refuses_a_result_by_field(running: Cell) -> None:
    attributes = 'camunda:formKey="camunda-forms:deployment:weighing-form.form">'
    deploy(running, "weighing", attributes, FORM)
    process, task = begin(running, "weighing")
    form = post(running, task, "claim", by="Anna").json()["form"]
    assert (form["id"], form["version"], form["isDynamic"]) == ("weighing-form", 1, True)
    assert [field["path"] for field in form["fields"]] == ["weight", "broken"]
    shown = post(running, task, "form", values={"broken": True}).json()
    assert [field["path"] for field in shown["fields"]] == ["weight", "broken", "why"]

    newer = {**FORM, "components": FORM["components"][:1]}
    answer = running.api.post("/forms", params={"file": "weighing-form.form"}, json=newer)
    assert (answer.status_code, answer.json()["version"]) == (201, 2)
    assert details(running, task)["form"]["version"] == 1  # an open Task keeps its form

    refused = post(running, task, "complete", by="Anna", outputs={"weight": 21, "broken": True})
    assert refused.status_code == 422
    faults = {fault["field"]: fault["reasonCode"] for fault in refused.json()["faults"]}
    assert faults == {"weight": "form.too_large", "why": "form.required"}
    assert running.look(process)["status"] == "inProgress"
    outputs = {"weight": 12, "broken": False, "why": "typed and hidden", "other": 1}
    post(running, task, "complete", by="Anna", outputs=outputs).raise_for_status()
    variables = running.ended(process)["variables"]
    assert (variables["weight"], variables["broken"]) == (12, False)
    assert "why" not in variables
    assert "other" not in variables


def test_a_form_that_is_posted_later_belongs_to_an_open_task(running: Cell) -> None:
    xml = {"Content-Type": "application/xml"}
    file = bpmn("late", 'camunda:formRef="late-form">')
    (line,) = running.api.post("/definitions", content=file, headers=xml).json()["allocation"]
    assert line["warningCode"] == "form.not_deployed"
    _, task = begin(running, "late")
    assert details(running, task)["form"] == {
        "id": "late-form",
        "version": None,
        "isDynamic": False,
        "fields": [],
    }
    late = {**FORM, "id": "late-form"}
    assert running.api.post("/forms", json=late).status_code == 201
    assert running.api.post("/forms", json=late).status_code == 200
    assert len(details(running, task)["form"]["fields"]) == 2
    assert running.api.get("/forms/late-form").json() == late
    assert running.api.get("/forms/late-form", params={"version": 9}).status_code == 404
    bad = running.api.post("/forms", json={"components": [{"type": "number"}]})
    assert (bad.status_code, bad.json()["type"]) == (422, "urn:handover:bad-form")


def test_nothing_of_a_deployment_with_a_bad_form_is_deployed(running: Cell) -> None:
    files = [
        {"name": "all-or-none.bpmn", "content": bpmn("all-or-none", ">")},
        {"name": "bad.form", "content": "{}"},
    ]
    assert running.api.post("/deployments", json={"files": files}).status_code == 422
    assert running.api.get("/definitions/all-or-none").status_code == 404


def test_a_task_that_is_offered_to_a_group_is_claimed_by_others_on_purpose_only(running: Cell) -> None:
    deploy(
        running,
        "offered",
        'camunda:candidateGroups="packing" camunda:dueDate="2026-01-02T03:00:00Z" camunda:priority="70">',
    )
    _, task = begin(running, "offered")
    (entry,) = running.api.get("/tasks", params={"group": "packing"}).json()
    assert (entry["groups"], entry["priority"]) == (["packing"], 70)
    assert entry["dueDate"].startswith("2026-01-02T03:00:00")
    refused = post(running, task, "claim", by="Anna", groups=["sales"])
    assert (refused.status_code, refused.json()["type"]) == (409, "urn:handover:offered-to-others")
    assert "packing" in refused.json()["detail"]
    assert post(running, task, "claim", by="Ben", groups=["Packing"]).status_code == 200
    post(running, task, "return", by="Ben").raise_for_status()
    assert post(running, task, "claim", by="Anna", groups=["sales"], override=True).status_code == 200
    entity = eventually(lambda: running.entity(task), "the Task")
    assert (entity["priority"]["value"], entity["element"]["value"]) == (70, "weigh")


def test_a_declined_task_stays_open_for_others_until_all_have_declined(running: Cell) -> None:
    deploy(running, "declined", 'camunda:candidateUsers="anna, ben">')
    process, task = begin(running, "declined")
    assert post(running, task, "decline", by="Anna", why=" ").status_code == 422
    post(running, task, "claim", by="Anna").raise_for_status()
    shown = post(running, task, "decline", by="Anna", why="no scale here").json()
    assert (shown["claimedBy"], shown["declinedBy"]) == (None, ["Anna"])
    assert shown["history"][-1]["text"] == "no scale here"
    post(running, task, "decline", by="Ben", why="no time").raise_for_status()
    (incident,) = running.stuck(process)["incidents"]
    assert incident["reason"] == "Ben declined: no time"


def test_the_list_has_pages_conditions_and_no_unknown_parameter(running: Cell) -> None:
    deploy(running, "listed", 'camunda:assignee="dora" camunda:dueDate="2026-01-02T03:00:00Z">')
    keys = [f"list {n}" for n in range(5)]
    for key in keys:
        running.api.post("/processes", json={"definition": "listed", "key": key}).raise_for_status()
    query: dict[str, Any] = {"definition": "listed", "limit": 2}
    pages, following = [], "/tasks"
    while following:
        page = running.api.get(following, params=query if following == "/tasks" else None).raise_for_status()
        pages.append([entry["id"] for entry in page.json()])
        following = page.links.get("next", {}).get("url", "")
    assert [len(page) for page in pages] == [2, 2, 1]
    assert len({task for page in pages for task in page}) == 5
    first = pages[0][1]
    post(running, first, "claim", by="Dora").raise_for_status()
    post(running, first, "complete", by="Dora").raise_for_status()  # the mark of a page may end
    after = running.api.get("/tasks", params={**query, "before": first}).json()
    assert [entry["id"] for entry in after] == pages[1]

    def listed(**conditions: str) -> int:
        return len(
            running.api.get("/tasks", params={"definition": "listed", **conditions}).raise_for_status().json()
        )

    assert (listed(assignee="Dora"), listed(assignee="Ben")) == (4, 0)
    assert (listed(search="LIST 4"), listed(search="weigh"), listed(search="nothing")) == (1, 4, 0)
    unknown = running.api.get("/tasks", params={"owner": "dora"})
    assert (unknown.status_code, "owner" in unknown.text) == (422, True)
    assert running.api.get("/tasks", params={"before": "none"}).status_code == 404
    seen = details(running, pages[1][0])
    assert (seen["deadline"], seen["dueDate"][:10]) == (None, "2026-01-02")  # a person accepts it at any time
    assert running.look(seen["process"])["tasks"][0]["deadline"] is None


def test_what_the_assignee_declines_is_offered_to_the_users_and_groups_beside(running: Cell) -> None:
    deploy(running, "beside", 'camunda:assignee="anna" camunda:candidateGroups="packing">')
    _, task = begin(running, "beside")
    assert details(running, task)["persons"] == ["anna"]
    assert post(running, task, "claim", by="Ben", groups=["packing"]).status_code == 409
    post(running, task, "decline", by="Anna", why="on holiday").raise_for_status()
    post(running, task, "claim", by="Ben", groups=["packing"]).raise_for_status()
    assert post(running, task, "complete", by="Ben").json()["status"] == "completed"
    # likewise if the assignee is a Person of the mapping, whose Task names her
    entry = {"kind": "assignee", "name": "clara", "resource": "Person:clara"}
    running.api.put("/mapping", json={"entries": [entry], "by": "Eve"}).raise_for_status()
    deploy(running, "mapped", 'camunda:assignee="clara" camunda:candidateUsers="ben">')
    process, task = begin(running, "mapped")
    assert details(running, task)["person"] == "urn:ngsi-ld:Person:demo:clara"
    post(running, task, "decline", by="clara", why="on holiday").raise_for_status()
    seen = running.look(process)
    assert (seen["incidents"], seen["tasks"][-1]["id"]) == ([], f"{task[:-1]}2")
    assert details(running, seen["tasks"][-1]["id"])["persons"] == ["ben"]
    post(running, seen["tasks"][-1]["id"], "decline", by="ben", why="no time").raise_for_status()
    (incident,) = running.stuck(process)["incidents"]
    assert incident["reason"] == "ben declined: no time"


def test_a_claimed_task_ends_when_its_process_is_cancelled(running: Cell) -> None:
    deploy(running, "cancelled", ">")
    process, task = begin(running, "cancelled")
    post(running, task, "claim", by="Anna").raise_for_status()
    running.api.post(f"/processes/{process}/cancel", json={"by": "Ben"}).raise_for_status()
    eventually(lambda: status_in_broker(running, task) == "failed", "the end of the Task")
    assert post(running, task, "complete", by="Anna").status_code == 409


@pytest.mark.nightly
def test_claims_and_comments_survive_a_kill_of_the_orchestrator(running: Cell) -> None:
    deploy(running, "killed", ">")
    process, task = begin(running, "killed")
    post(running, task, "claim", by="Anna").raise_for_status()
    key = "0123456789abcdef" * 2
    post(running, task, "comments", by="Anna", text="the scale drifts", id=key).raise_for_status()
    running.api.post(f"/processes/{process}/comments", json={"by": "Ben", "text": "new scale comes"})
    running.orchestrator.kill()
    running.orchestrator.start()
    seen = details(running, task)
    assert seen["claimedBy"] == "Anna"
    assert [(each["by"], each["text"], each["verified"]) for each in seen["comments"]] == [
        ("Anna", "the scale drifts", False)
    ]
    assert post(running, task, "claim", by="Ben").status_code == 409
    post(running, task, "comments", by="Anna", text="the scale drifts", id=key).raise_for_status()
    comments = running.api.get(f"/processes/{process}/comments").json()
    assert [(each["by"], each["task"]) for each in comments] == [("Anna", task), ("Ben", None)]
    post(running, task, "complete", by="Anna").raise_for_status()
    assert running.ended(process)["status"] == "completed"
    eventually(lambda: status_in_broker(running, task) == "completed", "the result in the broker")


def test_what_is_wrong_is_named(running: Cell) -> None:
    assert running.api.get("/tasks/none").status_code == 404
    assert running.api.post("/tasks/none/claim", json={"by": "Anna"}).status_code == 404
    assert running.api.post("/processes/none/comments", json={"by": "A", "text": "b"}).status_code == 404
    deploy(running, "wrong", ">")
    _, task = begin(running, "wrong")
    assert post(running, task, "claim", by="").status_code == 422
    assert post(running, task, "comments", by="Anna", text="x" * 2001).status_code == 422
    assert post(running, task, "comments", by="Anna", text="x", id="short").status_code == 422
