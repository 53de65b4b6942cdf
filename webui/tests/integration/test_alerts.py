"""Alerts: raised, acknowledged, shelved, returned to normal; one and five hundred."""

from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import Any

import httpx
import pytest

from handover.alerts import alert_id, clear_alert, raise_alert
from handover.alerts.catalogue import GLOVE_SILENT, AlertType
from handover.broker import BrokerClient
from handover.settings import Settings
from handover_datamodels.states import Severity
from handover_web.settings import WebuiSettings
from handover_web.sources.cells import Cells
from tests.kit.waiting import until

pytestmark = pytest.mark.slow

GLOVE = "urn:ngsi-ld:Device:demo:glove-1"
MANY = 500
CHATTER = AlertType("x", None, Severity.HIGH)


def foreign(number: int, severity: str = "critical") -> dict[str, Any]:
    """An Alert as another component writes it: without our attributes."""
    return {
        "id": f"urn:ngsi-ld:Alert:plant:{number}",
        "type": "Alert",
        "category": {"type": "Property", "value": "traffic"},
        "severity": {"type": "Property", "value": severity},
        "description": {"type": "Property", "value": f"conveyor {number} is blocked"},
        "dateIssued": {
            "type": "Property",
            "value": {"@type": "DateTime", "@value": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}"},
        },
        "alertSource": {"type": "Relationship", "object": "urn:ngsi-ld:Device:plant:conveyor"},
    }


def topic_of(number: int) -> str:
    """The topic of a foreign Alert."""
    return f"alert/{foreign(number)['id']}"


def other_cell(name: str, **values: Any) -> dict[str, Any]:
    """A Cell as the orchestrator of another cell writes it."""
    seen = {"@type": "DateTime", "@value": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}"}
    given = {"identity": "of-another", "cellState": "running", "lastSeen": seen, **values}
    attributes = {key: {"type": "Property", "value": value} for key, value in given.items()}
    return {"id": f"urn:ngsi-ld:Cell:{name}:{name}", "type": "Cell", **attributes}


@pytest.mark.nightly
async def test_alerts_of_another_cell_are_counted_and_not_shown(
    cell: Any, look: Callable[[], Any], browser: httpx.Client
) -> None:
    cell.start("context_broker", "webui")
    settings = Settings.load(broker_url=cell.url("context_broker"))
    viewer = look()
    async with BrokerClient(settings) as broker:
        theirs = {**foreign(1), "id": "urn:ngsi-ld:Alert:north:1"}
        await broker.upsert([theirs, {**theirs, "id": "urn:ngsi-ld:Alert:north:2"}])
        viewer.read_until(lambda: "alert/urn:ngsi-ld:Alert:north:1" in viewer.topics)
        long_ago = {"@type": "DateTime", "@value": "2026-01-01T00:00:00Z"}
        await broker.upsert(
            [other_cell("north", completedLastHour=7), other_cell("south", lastSeen=long_ago)]
        )
        viewer.read_until(lambda: "alert/urn:ngsi-ld:Alert:north:1" not in viewer.topics)
        await broker.upsert([{**theirs, "id": "urn:ngsi-ld:Alert:north:3"}, foreign(2)])
        viewer.read_until(lambda: topic_of(2) in viewer.topics)
        assert not [topic for topic in viewer.topics if ":Alert:north:" in topic]
        listed = {each["name"]: each for each in browser.get("/api/webui/cells").json()}
        found = {name: (listed[name]["state"], listed[name]["alerts"]) for name in ("north", "south")}
        assert found == {"north": ("running", 3), "south": ("silent", 0)}
        assert listed["north"]["completedLastHour"] == 7
        await broker.delete_batch([f"urn:ngsi-ld:Cell:{name}:{name}" for name in ("north", "south")])


async def test_a_tenant_of_no_cell_yet_hides_no_other_cell(cell: Any) -> None:
    cell.run("context_broker")
    settings = WebuiSettings.load(broker_url=cell.url("context_broker"), cell_tenants=("later",))
    async with BrokerClient(settings) as broker:
        await broker.upsert([other_cell("north")])
        async with Cells(settings, broker) as cells:
            assert "north" in {each["name"] for each in await cells.summaries()}
        await broker.delete("urn:ngsi-ld:Cell:north:north")


@pytest.mark.nightly
async def test_an_alert_is_acknowledged_once_with_the_name_of_the_person(
    cell: Any, look: Callable[[], Any], browser: httpx.Client
) -> None:
    cell.start("context_broker", "webui")
    viewer = look()
    settings = Settings.load(broker_url=cell.url("context_broker"))
    about = {
        "key": "glove-1 silent",
        "source": GLOVE,
        "description": "glove-1 is silent",
    }
    urn = alert_id(settings, "glove-1 silent")
    topic = f"alert/{urn}"
    async with BrokerClient(settings) as broker:
        await raise_alert(broker, settings, GLOVE_SILENT, **about)
        viewer.read_until(lambda: topic in viewer.topics)
        assert viewer.topics[topic]["acknowledged"] is None
        assert viewer.topics[topic]["severity"] == "high"
        assert viewer.topics[topic]["source"] == GLOVE

        done = browser.post(f"/api/alerts/{urn}/acknowledge", json={"by": " Aino "})
        assert done.status_code == 200
        viewer.read_until(lambda: viewer.topics[topic]["acknowledged"])
        assert viewer.topics[topic]["acknowledged"]["by"] == "Aino"
        written = (await broker.retrieve(urn))["humanVerified"]
        assert written["value"] is True
        assert written["by"]["value"] == "Aino"
        assert written["observedAt"]
        stored = await broker.retrieve(urn)
        assert (stored["alertState"]["value"], stored["acknowledgedBy"]["value"]) == ("acknowledged", "Aino")

        records = browser.get("/api/webui/audit").json()
        assert [(one["action"], one["outcome"], one["text"]) for one in records] == [
            ("POST /api/alerts/{alert}/acknowledge", "done", f"/api/alerts/{urn}/acknowledge")
        ]

        twice = browser.post(f"/api/alerts/{urn}/acknowledge", json={"by": "Ville"})
        assert twice.status_code == 409
        assert "Aino" in twice.json()["detail"]
        unknown = browser.post(f"/api/alerts/{urn}-none/acknowledge", json={"by": "Ville"})
        assert unknown.status_code == 404
        assert browser.post(f"/api/alerts/{urn}/acknowledge", json={"by": " "}).status_code == 422

        await clear_alert(broker, settings, key="glove-1 silent")
        viewer.read_until(lambda: viewer.topics[topic]["validTo"])
        await raise_alert(broker, settings, GLOVE_SILENT, **about)
        viewer.read_until(lambda: viewer.topics[topic]["validTo"] is None)
        assert viewer.topics[topic]["acknowledged"] is None
        assert viewer.topics[topic]["state"] == "new"
        stored = await broker.retrieve(urn)
        assert stored["alertState"]["value"] == "new"
        assert not {"acknowledgedBy", "humanVerified", "validTo"} & stored.keys()
        moves = ["alert.raised", "alert.acknowledged", "alert.over", "alert.raised"]
        viewer.read_until(lambda: len(viewer.event_keys("alert.")) == len(moves))
        assert viewer.event_keys("alert.") == moves

        await broker.delete(urn)
        viewer.read_until(lambda: topic not in viewer.topics)

    cell.kill("context_broker")
    away = browser.post(f"/api/alerts/{urn}/acknowledge", json={"by": "Ville"})
    assert away.status_code == 503


@pytest.mark.nightly
async def test_bulk_acknowledgement_reports_each_failure(
    cell: Any, look: Callable[[], Any], browser: httpx.Client
) -> None:
    cell.start("context_broker", "webui")
    viewer = look()
    settings = Settings.load(broker_url=cell.url("context_broker"))
    async with BrokerClient(settings) as broker:
        await broker.upsert([foreign(number) for number in range(MANY)])
        batches = len(viewer.kinds)
        viewer.read_until(lambda: all(topic_of(number) in viewer.topics for number in range(MANY)))
        assert len(viewer.kinds) - batches < MANY / 2, "pages get batches, not a message for each Alert"
        assert viewer.topics[topic_of(7)]["state"] == "new"
        assert viewer.topics[topic_of(7)]["priority"] == "critical"

        ids = [foreign(number)["id"] for number in range(MANY)]
        assert browser.post(f"/api/alerts/{ids[3]}/acknowledge", json={"by": "Ville"}).status_code == 200
        await broker.delete(ids[4])
        answer = browser.post("/api/alerts/acknowledge", json={"alerts": ids, "by": "Aino"}, timeout=60)
        assert answer.status_code == 200
        assert set(answer.json()["done"]) == set(ids) - {ids[3], ids[4]}
        failed = {one["alert"]: one for one in answer.json()["failed"]}
        assert (failed[ids[3]]["status"], failed[ids[4]]["status"]) == (409, 404)
        assert "Ville" in failed[ids[3]]["detail"]
        viewer.read_until(lambda: viewer.topics[topic_of(MANY - 1)]["state"] == "acknowledged")
        assert (await broker.retrieve(ids[9]))["acknowledgedBy"]["value"] == "Aino"

    long_ids = [f"urn:ngsi-ld:Alert:plant:{number}-{'x' * 150}" for number in range(1001)]
    too_many = {"alerts": long_ids, "by": "Aino"}  # their number is refused, not how long they are
    assert browser.post("/api/alerts/acknowledge", json=too_many).status_code == 422
    assert browser.post("/api/alerts/acknowledge", json={"alerts": [], "by": "Aino"}).status_code == 422


async def test_alerts_older_than_the_event_log_are_in_it(cell: Any, browser: httpx.Client) -> None:
    cell.start("context_broker")
    hour_ago = (datetime.now(UTC) - timedelta(hours=1)).strftime("%Y-%m-%dT%H:%M:%SZ")
    issued = {"type": "Property", "value": {"@type": "DateTime", "@value": hour_ago}}
    over = {"alertState": {"type": "Property", "value": "returnedToNormal"}}
    async with BrokerClient(Settings.load(broker_url=cell.url("context_broker"))) as broker:
        await broker.upsert([{**foreign(number), "dateIssued": issued} for number in range(MANY)])
        await broker.upsert([{**foreign(MANY), "dateIssued": issued, **over}])
    cell.start("webui")
    params: dict[str, int] = {"before": 2**53 - 1, "limit": 1000}

    def raised() -> list[str]:
        events = browser.get("/api/events", params=params).raise_for_status().json()
        return sorted(event["values"]["alert"] for event in events if event["key"] == "alert.raised")

    await until(lambda: len(raised()) >= MANY)
    expected = sorted(foreign(number)["id"] for number in range(MANY))
    assert raised() == expected
    cell.restart("webui")
    await until(lambda: browser.get("/readyz").is_success)
    assert raised() == expected, "a restart adds nothing"


@pytest.mark.nightly
async def test_shelving_ends_by_itself_also_after_a_restart(
    cell: Any, look: Callable[[], Any], browser: httpx.Client
) -> None:
    cell.start("context_broker", "webui")
    viewer = look()
    settings = Settings.load(broker_url=cell.url("context_broker"))
    first, second, third = (foreign(number)["id"] for number in (1, 2, 3))
    async with BrokerClient(settings) as broker:
        await broker.upsert([foreign(number) for number in (1, 2, 3)])
        viewer.read_until(lambda: all(topic_of(number) in viewer.topics for number in (1, 2, 3)))

        def shelve(alerts: list[str], minutes: float) -> httpx.Response:
            return browser.post(
                "/api/alerts/shelve", json={"alerts": alerts, "by": "Aino", "minutes": minutes}
            )

        for minutes in (0, -1, 60 * 24 * 365):
            assert shelve([first], minutes).status_code == 422
        assert shelve([first], 600).json()["done"] == [first]
        viewer.read_until(lambda: viewer.topics[topic_of(1)]["state"] == "shelved")
        assert viewer.topics[topic_of(1)]["shelvedBy"] == "Aino"
        assert viewer.topics[topic_of(1)]["shelvedUntil"] > f"{datetime.now(UTC):%Y-%m-%dT%H:%M}"
        undone = browser.post("/api/alerts/unshelve", json={"alerts": [first, second], "by": "Ville"})
        assert undone.json()["done"] == [first]
        assert [one["status"] for one in undone.json()["failed"]] == [409]
        viewer.read_until(lambda: viewer.topics[topic_of(1)]["state"] == "new")

        assert browser.post(f"/api/alerts/{second}/acknowledge", json={"by": "Ville"}).status_code == 200
        shelve([first, second], 0.05)
        shelve([third], 600)
        viewer.read_until(lambda: viewer.topics[topic_of(3)]["state"] == "shelved")
        cell.restart("webui")
        viewer = look()
        viewer.read_until(
            lambda: (
                [viewer.topics.get(topic_of(number), {}).get("state") for number in (1, 2, 3)]
                == ["new", "acknowledged", "shelved"]
            )
        )
        viewer.read_until(lambda: viewer.event_keys("alert.unshelved"))

        async def are_unshelved() -> bool:
            states = [(await broker.retrieve(one))["alertState"]["value"] for one in (first, second)]
            return states == ["new", "acknowledged"]

        await until(are_unshelved)


async def test_a_shelved_alert_stays_shelved_when_raised_again(cell: Any, browser: httpx.Client) -> None:
    cell.start("context_broker", "webui")
    settings = Settings.load(broker_url=cell.url("context_broker"))
    async with BrokerClient(settings) as broker:

        async def again() -> dict[str, Any]:
            await clear_alert(broker, settings, key="chatter")
            await raise_alert(broker, settings, CHATTER, key="chatter", source=GLOVE, description="x")
            return await broker.retrieve(urn)

        critical = replace(CHATTER, severity=Severity.CRITICAL)
        urn = await raise_alert(broker, settings, critical, key="chatter", source=GLOVE, description="x")
        assert (await broker.retrieve(urn))["priority"]["value"] == "critical"
        browser.post("/api/alerts/shelve", json={"alerts": [urn], "by": "Aino", "minutes": 600})
        assert (await again())["alertState"]["value"] == "shelved"
        browser.post("/api/alerts/unshelve", json={"alerts": [urn], "by": "Aino"})
        assert (await again())["alertState"]["value"] == "new"


@pytest.mark.parametrize("mark", ["after", "before"])
def test_sequence_numbers_out_of_range_are_rejected(cell: Any, browser: httpx.Client, mark: str) -> None:
    cell.start("context_broker", "webui")
    for digits in ("9" * 20, "9" * 400):
        refused = browser.get(f"/api/events?{mark}={digits}")
        assert refused.status_code == 422
        assert mark in refused.json()["detail"]
    assert browser.get(f"/api/events?{mark}={2**53 - 1}").status_code == 200
