"""Definitions of other systems in the broker are offered to an engineer, who accepts or rejects them."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

from services.task_orchestrator.tests.integration.cell import Cell, cell, eventually
from services.task_orchestrator.tests.unit.drawing import activity, drawing, end, gateway, path, start
from tests.kit.ports import next_free_port

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("offers")]

DECISION = {"by": "Eva Engineer", "why": "checked with the line"}


def process_file(name: str, *activities: str, title: str = "") -> str:
    """Return a BPMN file with activities in a row."""
    body = "".join([start(), *(activity(each) for each in activities), end()])
    xml = drawing(body + path("start", *activities, "end"), name=name).decode()
    return xml.replace(f'id="{name}"', f'id="{name}" name="{title}"', 1) if title else xml


def prop(value: Any) -> dict[str, Any]:
    return {"type": "Property", "value": value}


def definition(name: str, bpmn: str, version: str = "1", factory: str = "demo") -> dict[str, Any]:
    """Return a ProcessDefinition as a MES posts it."""
    return {
        "id": f"urn:ngsi-ld:ProcessDefinition:{factory}:{name}",
        "type": "ProcessDefinition",
        "name": prop(name),
        "version": prop(version),
        "bpmn": prop(bpmn),
    }


def post(world: Cell, entity: dict[str, Any]) -> str:
    """Create an entity, or replace it."""
    url = str(world.entities.base_url).replace("/entities", "/entityOperations/upsert")
    answer = world.entities.post(url, json=[entity])
    assert answer.is_success, answer.text
    return str(entity["id"])


def offers(world: Cell, **selection: str) -> list[dict[str, Any]]:
    answer = world.api.get("/offers", params=selection)
    assert answer.status_code == 200, answer.text
    listed: list[dict[str, Any]] = answer.json()
    return listed


def offered(world: Cell, entity: str, **attributes: Any) -> dict[str, Any]:
    """Wait until an entity is offered with these attributes, and return the open offer."""

    def look() -> dict[str, Any] | None:
        found = offers(world, entity=entity, status="open")
        return found[0] if found and attributes.items() <= found[0]["attributes"].items() else None

    return eventually(look, f"an offer of {entity}")


def decide(world: Cell, offer: str, act: str) -> dict[str, Any]:
    answer = world.api.post(f"/offers/{offer}/{act}", json=DECISION)
    assert answer.status_code == 200, answer.text
    decided: dict[str, Any] = answer.json()
    return decided


def refused(world: Cell, offer: str, status: int) -> dict[str, Any]:
    answer = world.api.post(f"/offers/{offer}/accept", json=DECISION)
    assert answer.status_code == status, answer.text
    problem: dict[str, Any] = answer.json()
    return problem


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    with cell(tmp_path_factory.mktemp("offers"), next_free_port) as running:
        yield running


class Files(BaseHTTPRequestHandler):
    """A web server with BPMN files, good and bad ones."""

    served: dict[str, bytes]
    released: threading.Event

    def do_GET(self) -> None:
        name = self.path.strip("/")
        if name == "hangs":
            self.released.wait(120)
            return
        if name == "moved":
            self.send_response(302)
            self.send_header("Location", "/good")
        elif name == "local":
            self.send_response(302)
            self.send_header("Location", "file:///etc/passwd")
        elif name in self.served or name == "huge":
            self.send_response(200)
        else:
            self.send_response(404)
        self.end_headers()
        if name == "huge":
            try:
                for _ in range(50):
                    self.wfile.write(b"<" * 1024 * 1024)
            except OSError:
                return
        self.wfile.write(self.served.get(name, b""))

    def log_message(self, *_: object) -> None:
        pass


@contextmanager
def web_server(**served: bytes) -> Iterator[str]:
    released = threading.Event()
    handler = type("Handler", (Files,), {"served": served, "released": released})
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}"
    finally:
        released.set()
        server.shutdown()
        server.server_close()
        thread.join()


@pytest.mark.nightly
def test_a_definition_of_a_mes_runs_after_an_engineer_has_accepted_it(world: Cell) -> None:
    entity = definition("bottle", process_file("bottle", "fill", "cap", title="Fill a bottle"))
    urn = post(world, entity)
    offer = offered(world, urn)
    assert (offer["faults"], offer["decisions"], offer["times"]) == ([], [], 1)
    assert offer["definitions"] == [
        {"name": "bottle", "version": 1, "title": "Fill a bottle", "created": True}
    ]
    assert [line["element"] for line in offer["allocation"]] == ["fill", "cap"]
    assert world.api.post("/processes", json={"definition": "bottle"}).status_code == 404
    assert world.api.get(f"/offers/{offer['id']}/bpmn").text == entity["bpmn"]["value"]
    decided = decide(world, offer["id"], "accept")
    (decision,) = decided["decisions"]
    assert (decision["by"], decision["why"], decision["verified"]) == (*DECISION.values(), False)
    assert decision["deployed"] == [{"name": "bottle", "version": 1}]
    seen = world.ended(world.start("bottle"))
    assert [task["element"] for task in seen["tasks"]] == ["fill", "cap"]
    process = eventually(lambda: world.entity(seen["entity"]), "the Process")
    assert process["isDefinedBy"]["object"] == urn
    stored = world.entity(urn)
    assert stored is not None
    assert stored["bpmn"] == entity["bpmn"]  # the entity of the MES stays as it is
    assert refused(world, offer["id"], 409)["detail"].startswith("the offer is accepted")
    assert offers(world, entity=urn, status="open") == []


def test_a_change_is_a_new_offer_that_says_what_would_change(world: Cell) -> None:
    urn = post(world, definition("jar", process_file("jar", "fill", "cap"), factory="mes"))
    decide(world, offered(world, urn)["id"], "accept")
    post(world, definition("jar", process_file("jar", "fill", "label"), "2", factory="mes"))
    offer = offered(world, urn, version="2")
    assert {(each["element"], each["change"]) for each in offer["changes"]} == {
        ("cap", "removed"),
        ("label", "added"),
    }
    assert offer["definitions"][0]["version"] == 2
    running = world.start("jar")
    decide(world, offer["id"], "accept")
    assert [task["element"] for task in world.ended(running)["tasks"]] == ["fill", "cap"]
    assert [task["element"] for task in world.ended(world.start("jar"))["tasks"]] == ["fill", "label"]


def test_a_newer_change_supersedes_an_open_offer(world: Cell) -> None:
    urn = post(world, definition("crate", process_file("crate", "a")))
    first = offered(world, urn, version="1")
    post(world, definition("crate", process_file("crate", "b"), "2"))
    second = offered(world, urn, version="2")
    assert world.api.get(f"/offers/{first['id']}").json()["status"] == "superseded"
    assert "superseded" in refused(world, first["id"], 409)["detail"]
    decide(world, second["id"], "reject")
    post(world, definition("crate", process_file("crate", "b"), "2"))
    assert offers(world, entity=urn, status="open") == []
    decide(world, second["id"], "accept")  # an engineer may change a decision while the content is present
    assert [each["status"] for each in world.api.get(f"/offers/{second['id']}").json()["decisions"]] == [
        "rejected",
        "accepted",
    ]


def test_all_faults_of_a_file_are_listed_in_its_words_and_it_cannot_be_accepted(world: Cell) -> None:
    wrong = activity("x", '<handover:parameter name="y" expression="1 +"/>')
    body = start() + wrong + gateway("lonely") + end()
    urn = post(world, definition("broken", drawing(body, name="broken").decode()))
    offer = offered(world, urn)
    assert {each["element"] for each in offer["faults"]} >= {"x", "lonely"}
    assert refused(world, offer["id"], 422)["faults"] == offer["faults"]
    post(world, definition("broken", "<not xml", "2"))
    assert "not well-formed XML" in offered(world, urn, version="2")["faults"][0]["message"]
    entity = definition("broken", "<x/>", "3")
    del entity["name"]
    post(world, {**entity, "name": prop(7)})
    assert '"name"' in offered(world, urn, version="3")["faults"][0]["message"]


@pytest.mark.nightly
def test_a_file_is_loaded_from_its_address_within_bounds(world: Cell) -> None:
    with web_server(good=process_file("by-address", "a").encode()) as address:
        urns = {
            name: post(world, definition(f"by-{name}", f"{address}/{name}"))
            for name in ("hangs", "moved", "local", "huge", "missing")
        }
        urns["ftp"] = post(world, definition("by-ftp", "ftp://mes.example/file.bpmn"))
        urns["closed"] = post(world, definition("by-closed", "http://127.0.0.1:1/file.bpmn"))
        good = offered(world, urns["moved"])
        assert good["faults"] == []  # the address that hangs delays no other offer
        reasons = {name: offered(world, urn)["faults"] for name, urn in urns.items() if name != "moved"}
        assert "did not send the file within 10 s" in reasons["hangs"][0]["message"]
        assert "neither a BPMN file nor an http or https address" in reasons["local"][0]["message"]
        assert "more than 4194304 bytes" in reasons["huge"][0]["message"]
        assert "status 404" in reasons["missing"][0]["message"]
        assert "neither a BPMN file nor an http or https address" in reasons["ftp"][0]["message"]
        assert "cannot be loaded" in reasons["closed"][0]["message"]
    decide(world, good["id"], "accept")  # what the engineer saw is deployed, though the address is gone
    assert world.ended(world.start("by-address"))["status"] == "completed"


def test_an_offer_of_a_deleted_entity_is_withdrawn(world: Cell) -> None:
    urn = post(world, definition("short-lived", process_file("short-lived", "a")))
    offer = offered(world, urn)
    assert world.entities.delete(f"/{urn}").status_code == 204
    assert "was deleted" in refused(world, offer["id"], 409)["detail"]
    assert world.api.get(f"/offers/{offer['id']}").json()["status"] == "withdrawn"
    other = post(world, definition("gone", process_file("gone", "a")))
    offered(world, other)
    assert world.entities.delete(f"/{other}").status_code == 204
    eventually(lambda: not offers(world, entity=other, status="open"), "the offer being withdrawn")


def test_an_entity_that_changed_unseen_is_not_accepted(world: Cell) -> None:
    urn = post(world, definition("moving", process_file("moving", "a")))
    offer = offered(world, urn)
    world.orchestrator.kill()
    post(world, definition("moving", process_file("moving", "b"), "2"))
    world.orchestrator.start()
    assert refused(world, offer["id"], 409)
    newer = offered(world, urn, version="2")  # found again by a query: nobody has notified anything
    assert newer["changes"] == []


def test_two_systems_that_change_an_entity_in_turn_make_two_offers(world: Cell) -> None:
    one, other = (definition("contested", process_file("contested", name), name) for name in ("a", "b"))
    for _ in range(4):
        for entity in (one, other):
            urn = post(world, entity)
            offered(world, urn, version=entity["version"]["value"])
    found = offers(world, entity=urn)
    assert sorted(each["status"] for each in found) == ["open", "superseded"]
    assert "several systems change it in turn" in found[0]["warnings"][0]["message"]


@pytest.mark.nightly
def test_our_own_definitions_are_never_offered_and_those_of_others_never_overwritten(world: Cell) -> None:
    xml = process_file("ours", "a", "b").encode()
    answer = world.api.post("/definitions", content=xml, headers={"Content-Type": "application/xml"})
    assert answer.status_code == 201
    ours = "urn:ngsi-ld:ProcessDefinition:demo:ours"
    eventually(lambda: world.entity(ours), "our definition")
    world.orchestrator.kill()
    changed = process_file("ours", "a", "c")
    assert world.entities.post(f"/{ours}/attrs", json={"bpmn": prop(changed)}).status_code == 204
    world.orchestrator.start()
    offer = offered(world, ours)
    assert {(each["element"], each["change"]) for each in offer["changes"]} == {
        ("b", "removed"),
        ("c", "added"),
    }
    stored = world.entity(ours)
    assert stored is not None
    assert stored["bpmn"]["value"] == changed
    named = {each["entity"] for each in offers(world)}
    assert "urn:ngsi-ld:ProcessDefinition:demo:bin-picking" not in named
    assert not any(each.startswith("urn:ngsi-ld:TaskDefinition:") for each in named)


def kind(name: str, **attributes: Any) -> dict[str, Any]:
    """Return a TaskDefinition as a MES posts it."""
    urn = f"urn:ngsi-ld:TaskDefinition:mes:{name}"
    given = {key: prop(value) for key, value in attributes.items()}
    return {"id": urn, "type": "TaskDefinition", "name": prop(name), **given}


def naming(name: str, inner: str = "", attributes: str = "") -> bytes:
    """Return a file whose activity names the TaskDefinition of a MES."""
    urn = f"urn:ngsi-ld:TaskDefinition:mes:{name}"
    task = f'<handover:task definition="{urn}" {attributes}>{inner}</handover:task>'
    extended = f"<bpmn:extensionElements>{task}</bpmn:extensionElements>"
    body = start() + f'<bpmn:userTask id="work">{extended}</bpmn:userTask>' + end()
    return drawing(body + path("start", "work", "end"), name=name)


def deploy(world: Cell, xml: bytes) -> dict[str, Any]:
    answer = world.api.post("/definitions", content=xml, headers={"Content-Type": "application/xml"})
    assert answer.status_code == 201, answer.text
    deployed: dict[str, Any] = answer.json()
    return deployed


def posted(world: Cell, process: str) -> dict[str, Any]:
    """Return the workParameters of the first Task of a process."""
    (task,) = eventually(lambda: world.tasks(process), "the Task")
    parameters: dict[str, Any] = task["workParameters"]["value"]
    return {"definition": task["isDefinedBy"]["object"], **parameters}


@pytest.mark.nightly
def test_an_accepted_task_definition_completes_tasks_and_a_later_change_waits(world: Cell) -> None:
    involves = '<handover:involves resource="Device:glove-1"/>'
    deploy(world, naming("weigh", involves))
    urn = post(world, kind("weigh", gesture="Thumbs up", description="Weigh it"))
    assert posted(world, world.start("weigh")) == {"definition": urn}
    decide(world, offered(world, urn)["id"], "accept")
    known = {"definition": urn, "gesture": "Thumbs up", "description": "Weigh it"}
    assert posted(world, world.start("weigh")) == known
    post(world, kind("weigh", gesture="Horns", description="Weigh it twice"))
    offer = offered(world, urn)
    assert {each["element"]: (each["before"], each["after"]) for each in offer["changes"]} == {
        "gesture": ("Thumbs up", "Horns"),
        "description": ("Weigh it", "Weigh it twice"),
    }
    assert posted(world, world.start("weigh")) == known
    world.orchestrator.kill()
    world.orchestrator.start()
    assert posted(world, world.start("weigh")) == known
    decide(world, offer["id"], "accept")
    assert posted(world, world.start("weigh"))["gesture"] == "Horns"


@pytest.mark.nightly
def test_an_accepted_schema_checks_work_parameters(world: Cell) -> None:
    schema = {"properties": {"grams": {"type": "number", "maximum": 500}}, "required": ["grams"]}
    urn = post(world, kind("dose", workParametersSchema=schema, description="Dose it"))
    decide(world, offered(world, urn)["id"], "accept")
    inner = (
        '<handover:involves resource="Device:glove-1"/><handover:parameter name="grams" expression="grams"/>'
    )
    deploy(world, naming("dose", inner))
    seen = world.stuck(world.start("dose", grams=700))
    assert "the work parameters do not match" in seen["incidents"][0]["reason"]
    assert "grams: " in seen["incidents"][0]["reason"]
    assert world.ended(world.start("dose", grams=300))["status"] == "completed"
    post(world, kind("dose", workParametersSchema={"type": "nothing"}))
    offer = offered(world, urn)
    assert "is no JSON Schema" in offer["faults"][0]["message"]
    refused(world, offer["id"], 422)


def test_required_skills_of_an_accepted_definition_choose_the_performer(world: Cell) -> None:
    deploy(world, naming("weld"))
    urn = post(world, kind("weld", requiredSkills=["weld"]))
    decide(world, offered(world, urn)["id"], "accept")
    specification = {
        "id": "urn:ngsi-ld:ResourceSpecification:mes:welder",
        "type": "ResourceSpecification",
        "name": prop("Welder"),
        "resourceType": prop("robot"),
        "skills": prop(["weld"]),
    }
    post(world, specification)
    link = {"type": "Relationship", "object": specification["id"]}
    robot = "urn:ngsi-ld:Device:demo:ur10-1"
    assert world.entities.post(f"/{robot}/attrs", json={"isSpecifiedBy": prop([link])}).status_code == 204
    seen = world.ended(world.start("weld"))
    assert seen["tasks"][0]["involves"] == [robot]
    offer = offered(world, str(specification["id"]))
    assert {each["element"] for each in offer["changes"]} == {"name", "resourceType", "skills"}
    decide(world, offer["id"], "reject")

    def has_skill() -> bool:
        agents = {each["id"]: each["skills"] for each in world.api.get("/agents").json()}
        return "weld" in agents[robot]

    eventually(lambda: not has_skill(), "the rejected specification being ignored")
    decide(world, offer["id"], "accept")
    eventually(has_skill, "the accepted specification being used")


def test_an_odd_resource_is_reported_by_name_and_stops_nothing(world: Cell) -> None:
    odd = {"id": "urn:ngsi-ld:ResourceSpecification:mes:odd", "type": "ResourceSpecification"}
    post(world, {**odd, "name": prop("Odd"), "resourceType": prop("robot"), "capacity": prop("many")})
    faulty = offered(world, odd["id"])
    assert '"capacity"' in faulty["faults"][0]["message"]
    shifts = [{"weekday": 9, "from": "06:00", "to": "14:00"}]
    other = {**odd, "id": "urn:ngsi-ld:ResourceSpecification:mes:shifts", "name": prop("Shifts")}
    post(world, {**other, "resourceType": prop("person"), "shifts": prop(shifts)})
    assert "shift 1 cannot be read" in offered(world, other["id"])["warnings"][0]["message"]
    place = {"id": "urn:ngsi-ld:Location:mes:hall", "type": "Location", "name": prop("Hall")}
    post(world, place)
    assert "has no position" in offered(world, place["id"])["warnings"][0]["message"]
    deploy(world, process_file("undisturbed", "a").encode())
    assert world.ended(world.start("undisturbed"))["status"] == "completed"


def test_closed_and_unknown_offers_are_refused(world: Cell) -> None:
    assert world.api.get("/offers/none").status_code == 404
    assert refused(world, "none", 404)["detail"] == 'there is no offer "none"'
    assert world.api.post("/offers/none/reject", json={}).status_code == 422
    assert world.api.get("/offers", params={"status": "strange"}).status_code == 422


@pytest.mark.nightly
def test_offers_survive_on_postgresql(tmp_path: Path, request: pytest.FixtureRequest) -> None:
    url = str(request.getfixturevalue("new_database")())
    with cell(tmp_path, next_free_port, url) as running:
        urn = post(running, definition("pg", process_file("pg", "a"), "null \0 byte"))
        offer = offered(running, urn)
        running.orchestrator.kill()
        running.orchestrator.start()
        assert offered(running, urn)["id"] == offer["id"]
        decide(running, offer["id"], "accept")
        assert running.ended(running.start("pg"))["status"] == "completed"
        assert offers(running, status="accepted")[0]["id"] == offer["id"]
