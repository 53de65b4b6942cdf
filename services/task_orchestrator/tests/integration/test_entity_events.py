"""Entities of the broker start, continue and interrupt processes."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from services.task_orchestrator.tests.integration.cell import Cell, cell, eventually
from services.task_orchestrator.tests.unit.drawing import activity, boundary, drawing, end, path, start
from tests.kit.ports import next_free_port

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("entity-events")]


def on(definition: str, type_: str, inner: str = "", **attributes: str) -> str:
    """Return the event definition of an entity."""
    given = "".join(f" {name}='{value}'" for name, value in attributes.items())
    extension = f'<bpmn:extensionElements><handover:on type="{type_}"{given}/></bpmn:extensionElements>'
    return f"<bpmn:{definition}EventDefinition>{extension}{inner}</bpmn:{definition}EventDefinition>"


def starts_with(definition: str) -> str:
    return f'<bpmn:startEvent id="start">{definition}</bpmn:startEvent>'


def catches(definition: str, name: str = "wait") -> str:
    return f'<bpmn:intermediateCatchEvent id="{name}">{definition}</bpmn:intermediateCatchEvent>'


def condition(text: str) -> str:
    return f"<bpmn:condition>{text}</bpmn:condition>"


def deploy(running: Cell, name: str, body: str, beside: str = "") -> None:
    """Deploy a process and wait until its filters are known: what exists then is no event."""
    xml = drawing(body, beside=beside, name=name)
    answer = running.api.post("/definitions", content=xml, headers={"Content-Type": "application/xml"})
    assert answer.status_code == 201, answer.text


def subscriptions(running: Cell) -> list[dict[str, Any]]:
    url = str(running.entities.base_url).replace("/entities", "/subscriptions")
    listed: list[dict[str, Any]] = running.entities.get(url, params={"limit": 500}).json()
    return [each for each in listed if "task-orchestrator-entities-" in each["id"]]


def subscribed(running: Cell, type_: str) -> dict[str, Any]:
    """Wait until the orchestrator knows a filter, and return its subscription."""

    def look() -> dict[str, Any] | None:
        found = [each for each in subscriptions(running) if each["entities"][0]["type"] == type_]
        return found[0] if found and _has_baseline(running, found[0]["id"].rpartition("-")[2]) else None

    return eventually(look, f"the subscription to {type_}")


def _has_baseline(running: Cell, key: str) -> bool:
    lines = running.orchestrator.log().splitlines()
    return any("entities queried" in line and key in line for line in lines)


def create(running: Cell, type_: str, name: str, **values: Any) -> str:
    entity_id = f"urn:ngsi-ld:{type_}:demo:{name}"
    entity = {"id": entity_id, "type": type_} | {
        key: value if isinstance(value, dict) else {"type": "Property", "value": value}
        for key, value in values.items()
    }
    assert running.entities.post("", json=entity).status_code == 201
    return entity_id


def change(running: Cell, entity_id: str, **values: Any) -> None:
    attributes = {key: {"type": "Property", "value": value} for key, value in values.items()}
    assert running.entities.post(f"/{entity_id}/attrs", json=attributes).status_code == 204


def of(running: Cell, definition: str) -> list[dict[str, Any]]:
    listed: list[dict[str, Any]] = running.api.get("/processes", params={"definition": definition}).json()
    return listed


def started(running: Cell, definition: str, count: int = 1) -> list[dict[str, Any]]:
    """Wait until `count` processes of a definition have ended, and return them."""

    def look() -> list[dict[str, Any]] | None:
        found = of(running, definition)
        return found if len([each for each in found if each["endedAt"]]) >= count else None

    return eventually(look, f"{count} processes of {definition}")


def waits_at(running: Cell, process: str, element: str) -> None:
    eventually(lambda: element in running.look(process)["waiting"], f"{process} at {element}")


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    with cell(tmp_path_factory.mktemp("world"), next_free_port) as running:
        yield running


@pytest.mark.nightly
def test_a_new_alert_starts_a_process_which_has_it_as_a_variable(world: Cell) -> None:
    old = create(world, "FireAlert", "old", severity="high")
    alert = on("message", "FireAlert", variable="alert", q='severity=="high"')
    deploy(world, "on-fire", starts_with(alert) + activity("work") + end() + path("start", "work", "end"))
    subscribed(world, "FireAlert")
    create(world, "FireAlert", "low", severity="low")
    new = create(world, "FireAlert", "new", severity="high")
    (process,) = started(world, "on-fire")
    seen = world.look(process["id"])
    assert seen["variables"]["alert"] == {"id": new, "type": "FireAlert", "severity": "high"}
    assert old != new


def test_an_attribute_that_passes_a_limit_interrupts_an_activity(world: Cell) -> None:
    oven = create(world, "Oven", "1", temperature=20)
    hot = on("conditional", "Oven", condition("oven.temperature &gt; limit"), variable="oven")
    body = (
        start()
        + activity("bake")
        + boundary("too_hot", "bake", hot)
        + activity("cool")
        + end()
        + path("start", "bake", "end")
        + path("too_hot", "cool", "end")
    )
    deploy(world, "oven", body)
    subscribed(world, "Oven")
    world.script_file.write_text('{"bake-1": {"after_s": 600}}')
    process = world.start("oven", limit=100)
    waits_at(world, process, "too_hot")
    change(world, oven, temperature=90)
    change(world, oven, temperature=150)
    change(world, oven, temperature=30)  # the crossing counts even if the value has returned
    seen = world.ended(process)
    assert seen["variables"]["oven"]["temperature"] == 150
    assert [task["element"] for task in seen["tasks"]] == ["bake", "cool"]


def test_a_condition_that_is_true_when_its_wait_begins_occurs(world: Cell) -> None:
    create(world, "Gauge", "1", level=7)
    full = on("conditional", "Gauge", condition("entity.level &gt; 5"))
    deploy(world, "fill", start() + catches(full) + end() + path("start", "wait", "end"))
    seen = world.ended(world.start("fill"))
    assert seen["variables"]["entity"]["level"] == 7


def test_a_task_that_somebody_else_creates_continues_a_process(world: Cell) -> None:
    other = on("signal", "Task", variable="task")
    deploy(
        world,
        "follow",
        start() + activity("own") + catches(other) + end() + path("start", "own", "wait", "end"),
    )
    subscribed(world, "Task")
    process = world.start("follow")
    waits_at(world, process, "wait")
    definition = {"type": "Relationship", "object": "urn:ngsi-ld:TaskDefinition:demo:x"}
    foreign = create(world, "Task", "of-somebody-else", status="pending", isDefinedBy=definition)
    assert world.ended(process)["variables"]["task"]["id"] == foreign


def test_the_business_key_selects_the_process(world: Cell) -> None:
    arrived = on("message", "Delivery", correlation="entity.order")
    deploy(world, "order", start() + catches(arrived) + end() + path("start", "wait", "end"))
    subscribed(world, "Delivery")
    processes = {}
    for key in ("A-1", "A-2"):
        answer = world.api.post("/processes", json={"definition": "order", "key": key})
        processes[key] = answer.json()["id"]
        waits_at(world, processes[key], "wait")
    create(world, "Delivery", "1", order="A-2")
    assert world.ended(processes["A-2"])["variables"]["entity"]["order"] == "A-2"
    assert world.look(processes["A-1"])["endedAt"] is None
    create(world, "Delivery", "2", order="A-1")
    world.ended(processes["A-1"])


def test_a_receive_task_and_an_event_subprocess_that_does_not_interrupt_receive_entities(
    world: Cell,
) -> None:
    extension = '<bpmn:extensionElements><handover:on type="Shipment"/></bpmn:extensionElements>'
    receive = f'<bpmn:receiveTask id="receive" messageRef="m">{extension}</bpmn:receiveTask>'
    note = on("signal", "Remark", variable="remark")
    inside = (
        f'<bpmn:startEvent id="noted" isInterrupting="false">{note}</bpmn:startEvent>'
        + activity("look")
        + end("looked")
        + path("noted", "look", "looked")
    )
    body = (
        start()
        + receive
        + end()
        + path("start", "receive", "end")
        + f'<bpmn:subProcess id="notes" triggeredByEvent="true">{inside}</bpmn:subProcess>'
    )
    deploy(world, "receiving", body, '<bpmn:message id="m" name="shipment"/>')
    subscribed(world, "Shipment")
    subscribed(world, "Remark")
    process = world.start("receiving")
    waits_at(world, process, "receive")
    create(world, "Remark", "1", text="a")
    prefix = f"urn:ngsi-ld:Task:demo:{process}-look-"
    eventually(lambda: f"{prefix}1" in world.done(), "the first remark")
    create(world, "Remark", "2", text="b")
    eventually(lambda: f"{prefix}2" in world.done(), "the second remark")
    create(world, "Shipment", "1", weight=1)
    seen = world.ended(process)
    assert (seen["status"], seen["variables"]["entity"]["weight"]) == ("completed", 1)


def test_a_correlated_start_event_starts_one_process_for_a_key(world: Cell) -> None:
    order = on("message", "Order", correlation="entity.number")
    deploy(world, "produce", starts_with(order) + activity("work") + end() + path("start", "work", "end"))
    subscribed(world, "Order")
    first = create(world, "Order", "1", number="N-1", state="new")
    started(world, "produce")
    change(world, first, state="changed")
    create(world, "Order", "2", number="N-2")
    found = started(world, "produce", 2)
    assert sorted(each["key"] for each in found) == ["N-1", "N-2"]


def test_a_forged_notification_has_no_effect(world: Cell) -> None:
    hot = on("conditional", "Kiln", condition("entity.temperature &gt; 100"))
    deploy(world, "watch", start() + catches(hot) + end() + path("start", "wait", "end"))
    endpoint = subscribed(world, "Kiln")["notification"]["endpoint"]
    process = world.start("watch")
    waits_at(world, process, "wait")
    kiln = {
        "id": "urn:ngsi-ld:Kiln:demo:1",
        "type": "Kiln",
        "temperature": {"type": "Property", "value": 200},
    }
    notification = {"type": "Notification", "data": [kiln]}
    forged = httpx.post(endpoint["uri"], json=notification, trust_env=False)
    assert forged.status_code == 403
    create(world, "Kiln", "2", temperature=101)
    assert world.ended(process)["variables"]["entity"]["id"] == "urn:ngsi-ld:Kiln:demo:2"


@pytest.mark.nightly
def test_a_filter_that_the_broker_refuses_does_not_stop_the_others(world: Cell) -> None:
    refused = on("message", "Wrong", q="((")
    deploy(world, "wrong", starts_with(refused) + end() + path("start", "end"))
    good = on("message", "Right", idPattern=".*:cell-1-.*")
    deploy(world, "right", starts_with(good) + end() + path("start", "end"))
    subscribed(world, "Right")
    create(world, "Right", "cell-2-a")
    right = create(world, "Right", "cell-1-a")
    (process,) = started(world, "right")
    assert world.look(process["id"])["variables"]["entity"]["id"] == right
    assert "filter of entities refused" in world.orchestrator.log()

    def alert() -> dict[str, Any] | None:
        listed = [
            one for one in world.of_type("Alert") if one["subCategory"]["value"] == "entityFilterRefused"
        ]
        return listed[0] if listed else None

    raised = eventually(alert, "the Alert about the filter")
    assert raised["alertSource"]["object"] == "urn:ngsi-ld:ProcessDefinition:demo:wrong"
    assert "((" in raised["description"]["value"]
    world.orchestrator.kill()
    world.orchestrator.start()
    deploy(world, "wrong", starts_with(on("message", "Wrong")) + end() + path("start", "end"))
    eventually(lambda: "validTo" in (alert() or {}) or None, "the end of the Alert")


@pytest.mark.nightly
def test_entities_created_while_the_orchestrator_is_down_are_found_exactly_once(
    tmp_path: Path,
) -> None:
    with cell(tmp_path, next_free_port) as running:
        alert = on("message", "Leak", variable="alert")
        deploy(
            running, "on-leak", starts_with(alert) + activity("work") + end() + path("start", "work", "end")
        )
        subscribed(running, "Leak")
        create(running, "Leak", "before", size=1)
        started(running, "on-leak")
        running.orchestrator.kill()
        create(running, "Leak", "meanwhile", size=2)
        running.orchestrator.start()
        started(running, "on-leak", 2)
        running.orchestrator.kill()
        running.orchestrator.start()
        create(running, "Leak", "after", size=3)
        found = started(running, "on-leak", 3)
        sizes = sorted(running.look(each["id"])["variables"]["alert"]["size"] for each in found)
        assert sizes == [1, 2, 3]


@pytest.mark.nightly
def test_a_lost_subscription_is_created_again_and_what_happened_meanwhile_is_found(
    tmp_path: Path,
) -> None:
    with cell(tmp_path, next_free_port) as running:
        spill = on("message", "Spill")
        deploy(running, "on-spill", starts_with(spill) + end() + path("start", "end"))
        lost = subscribed(running, "Spill")["id"]
        url = str(running.entities.base_url).replace("/entities", f"/subscriptions/{lost}")
        assert running.entities.delete(url).status_code == 204
        create(running, "Spill", "1", size=1)
        started(running, "on-spill")
        eventually(lambda: lost in {each["id"] for each in subscriptions(running)}, "the subscription")
        deploy(running, "on-spill", start() + end() + path("start", "end"))
        eventually(lambda: not subscriptions(running), "the removal of the unused subscription")


@pytest.mark.nightly
def test_entities_created_before_and_after_an_outage_of_the_broker_are_found(tmp_path: Path) -> None:
    with cell(tmp_path, next_free_port) as running:
        smoke = on("message", "Smoke")
        deploy(running, "on-smoke", starts_with(smoke) + end() + path("start", "end"))
        subscribed(running, "Smoke")
        create(running, "Smoke", "1", size=1)
        running.broker.kill()
        running.broker.start()
        create(running, "Smoke", "2", size=2)
        found = started(running, "on-smoke", 2)
        running.broker.kill()
        running.broker.start()
        create(running, "Smoke", "3", size=3)
        found = started(running, "on-smoke", 3)
        sizes = sorted(running.look(each["id"])["variables"]["entity"]["size"] for each in found)
        assert sizes == [1, 2, 3]


@pytest.mark.nightly
def test_a_limit_that_was_passed_while_the_orchestrator_was_down_counts(tmp_path: Path) -> None:
    with cell(tmp_path, next_free_port) as running:
        tank = create(running, "Tank", "1", level=1, colour="red")
        full = on("conditional", "Tank", condition('entity.level &gt; limit and entity.colour == "red"'))
        deploy(running, "tank", start() + catches(full) + end() + path("start", "wait", "end"))
        process = running.start("tank", limit=5)
        waits_at(running, process, "wait")
        subscribed(running, "Tank")
        running.orchestrator.kill()
        for level in (3, 8, 2):
            change(running, tank, level=level)
        running.orchestrator.start()
        assert running.ended(process)["variables"]["entity"]["level"] == 8
