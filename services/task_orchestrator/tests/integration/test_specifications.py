"""The orchestrator writes the specification database before it posts the Task that needs the row."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from handover.database import connect
from handover.tasks.specification import Specification
from handover.tasks.specification_table import every
from services.task_orchestrator.tests.integration.cell import Cell, eventually
from services.task_orchestrator.tests.unit.drawing import activity, drawing, end, path, start
from tests.kit.ports import next_free_port
from tests.kit.refusing_proxy import RefusingProxy, refusing_proxy

pytestmark = pytest.mark.slow

CONFIRM = '<handover:specification name="Confirm" description="Look at the bin" gesture="Thumbs up"/>'
OF_PART = '<handover:specification description="Look at ${part}" commandId="4"/>'
WEIGH = "urn:ngsi-ld:TaskDefinition:demo:weigh"
MES = "urn:ngsi-ld:TaskDefinition:mes:inspect"


def specified(name: str, specification: str) -> str:
    """Return an activity that has a specification."""
    return activity(name).replace("<bpmn:extensionElements>", f"<bpmn:extensionElements>{specification}")


def one_step(element: str, name: str) -> str:
    return start() + element + end() + path("start", name, "end")


def deploy(running: Cell, body: str, name: str) -> None:
    headers = {"Content-Type": "application/xml"}
    answer = running.api.post("/definitions", content=drawing(body, name=name), headers=headers)
    assert answer.status_code == 201, answer.text


class Site:
    """A cell without a performer, whose orchestrator reaches the broker by a proxy."""

    def __init__(self, folder: Path, proxy: RefusingProxy, running: Cell) -> None:
        self.file = folder / "specifications.db"
        self.proxy = proxy
        self.running = running

    def rows(self) -> dict[str, Specification]:
        if not self.file.exists():
            return {}
        engine = connect(f"sqlite:///{self.file}", is_own=False)
        try:
            return every(engine)
        finally:
            engine.dispose()

    def task(self, process: str) -> dict[str, Any]:
        (task,) = eventually(lambda: self.running.tasks(process), "the Task")
        return dict(task)

    def alert(self) -> dict[str, Any] | None:
        """Return the Alert that the database is not written."""
        found = [
            each
            for each in self.running.of_type("Alert")
            if each["subCategory"]["value"] == "specificationDatabaseNotWritten"
        ]
        return found[0] if found else None

    def refusals(self, number: int = 1) -> None:
        """Wait until the proxy has refused more writes."""
        before = self.proxy.refusals
        eventually(lambda: self.proxy.refusals >= before + number, "more refusals")


@contextmanager
def site_in(folder: Path) -> Iterator[Site]:
    running = Cell(folder, next_free_port)
    with refusing_proxy(running.broker.environment["HANDOVER_BROKER_URL"]) as proxy:
        running.orchestrator.environment = {
            **running.orchestrator.environment,
            "HANDOVER_BROKER_URL": proxy.url,
            "HANDOVER_SPECIFICATION_URL": f"sqlite:///{folder / 'specifications.db'}",
        }
        try:
            running.broker.start()
            running.orchestrator.start()
            yield Site(folder, proxy, running)
        finally:
            running.api.close()
            running.entities.close()
            for member in reversed(running.members):
                member.stop()


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Site]:
    with site_in(tmp_path) as made:
        yield made


@pytest.mark.nightly
def test_the_row_is_written_before_the_task_also_when_the_orchestrator_is_killed_in_between(
    site: Site,
) -> None:
    running = site.running
    deploy(running, one_step(specified("confirm", CONFIRM), "confirm"), "constant")
    site.proxy.refused = frozenset({b'"pending"'})
    process = running.start("constant")
    site.refusals()
    assert site.rows() == {"confirm": Specification("Confirm", "Look at the bin", "Thumbs up")}
    assert running.tasks(process) == []
    running.orchestrator.kill()
    running.orchestrator.start()
    site.refusals()
    site.proxy.refused = frozenset()
    task = site.task(process)
    assert task["workParameters"]["value"] == {"specification": "confirm"}
    assert site.rows() == {"confirm": Specification("Confirm", "Look at the bin", "Thumbs up")}


@pytest.mark.nightly
def test_a_row_with_expressions_is_that_of_its_task_and_ends_with_it(site: Site) -> None:
    running = site.running
    deploy(running, one_step(specified("confirm", OF_PART), "confirm"), "by-part")
    first, second = running.start("by-part", part="A"), running.start("by-part", part="B")
    ids = {part: site.task(process)["id"] for part, process in (("A", first), ("B", second))}
    assert site.rows() == {
        task: Specification(None, f"Look at {part}", None, 4) for part, task in ids.items()
    }
    running.api.post(f"/processes/{first}/cancel", json={"by": "Eva"}).raise_for_status()
    eventually(lambda: set(site.rows()) == {ids["B"]}, "the row of the cancelled Task is deleted")
    stuck = running.stuck(running.start("by-part"))
    assert "part" in stuck["incidents"][0]["reason"]


@pytest.mark.nightly
def test_a_database_that_is_unavailable_delays_no_other_task_and_raises_an_alert(site: Site) -> None:
    running = site.running
    site.file.mkdir()
    body = (
        start()
        + '<bpmn:parallelGateway id="fork"/>'
        + specified("confirm", CONFIRM)
        + activity("weigh")
        + end()
        + path("start", "fork", "confirm", "end")
        + path("fork", "weigh", "end")
    )
    deploy(running, body, "both")
    process = running.start("both")
    assert site.task(process)["isDefinedBy"]["object"] == WEIGH
    alert = eventually(site.alert, "the Alert")
    assert "HANDOVER_SPECIFICATION_URL" in alert["description"]["value"]
    assert "validTo" not in alert
    running.orchestrator.kill()
    site.file.rmdir()
    running.orchestrator.start()
    eventually(lambda: len(running.tasks(process)) == 2, "both Tasks")
    assert set(site.rows()) == {"confirm"}
    eventually(lambda: "validTo" in (site.alert() or {}), "the end of the Alert")


@pytest.mark.nightly
def test_a_database_that_refuses_the_row_is_an_incident_that_can_be_retried(site: Site) -> None:
    running = site.running
    engine = connect(f"sqlite:///{site.file}", is_own=False)
    with engine.begin() as connection:
        connection.exec_driver_sql(
            "CREATE TABLE task_definitions (id TEXT PRIMARY KEY, name TEXT, description TEXT, gesture TEXT, "
            "command_id INTEGER, CHECK (gesture <> 'Thumbs up'))"
        )
    deploy(running, one_step(specified("confirm", CONFIRM), "confirm"), "refused")
    stuck = running.stuck(running.start("refused"))
    (incident,) = stuck["incidents"]
    assert "the specification database does not accept the row confirm: " in incident["reason"]
    assert running.tasks(stuck["id"]) == []
    with engine.begin() as connection:
        connection.exec_driver_sql("DROP TABLE task_definitions")
    engine.dispose()
    url = f"/processes/{stuck['id']}/tokens/{incident['token']}/retry"
    running.api.post(url, json={"by": "Eva"}).raise_for_status()
    assert site.task(stuck["id"])["workParameters"]["value"] == {"specification": "confirm"}


@pytest.mark.nightly
def test_an_accepted_task_definition_of_a_mes_names_what_is_written(site: Site) -> None:
    running = site.running
    entity = {
        "id": MES,
        "type": "TaskDefinition",
        "name": {"type": "Property", "value": "Inspect"},
        "specification": {"type": "Property", "value": {"description": "Look closely", "commandId": 7}},
    }
    url = str(running.entities.base_url).replace("/entities", "/entityOperations/upsert")
    bad = {**entity, "specification": {"type": "Property", "value": {"command": 7}}}
    for written in (bad, entity):
        running.entities.post(url, json=[written]).raise_for_status()

        def offered(written: dict[str, Any] = written) -> dict[str, Any] | None:
            found = running.api.get("/offers", params={"entity": MES, "status": "open"}).json()
            given = written["specification"]["value"]
            return found[0] if found and found[0]["attributes"]["specification"] == given else None

        offer = eventually(offered, "the offer")
        if written is bad:
            assert "the specification cannot be written: " in offer["faults"][0]["message"]
    decision = {"by": "Eva", "why": "fits"}
    running.api.post(f"/offers/{offer['id']}/accept", json=decision).raise_for_status()
    deploy(
        running,
        one_step(activity("inspect").replace('definition="inspect"', f'definition="{MES}"'), "inspect"),
        "of-mes",
    )
    process = running.start("of-mes")
    assert site.task(process)["workParameters"]["value"] == {"specification": MES}
    assert site.rows() == {MES: Specification(None, "Look closely", None, 7)}


@pytest.mark.nightly
def test_a_task_whose_definition_the_broker_refuses_is_not_posted_but_an_incident(site: Site) -> None:
    running, proxy = site.running, site.proxy
    proxy.status, proxy.refused = 400, frozenset({WEIGH.encode() + b'","type":"TaskDefinition"'})
    body = one_step(activity("weigh"), "weigh")
    deploy(running, body, "weighing")
    stuck = running.stuck(running.start("weighing"))
    (incident,) = stuck["incidents"]
    assert f"the broker does not accept {WEIGH}: " in incident["reason"]
    assert "as the test wants" in incident["reason"]
    running.orchestrator.kill()
    running.orchestrator.start()
    again = running.stuck(running.start("weighing"))
    assert running.tasks(stuck["id"]) + running.tasks(again["id"]) == []
    proxy.refused = frozenset()
    url = f"/processes/{stuck['id']}/tokens/{incident['token']}/retry"
    running.api.post(url, json={"by": "Eva"}).raise_for_status()
    site.task(stuck["id"])
    assert running.entity(WEIGH) is not None
