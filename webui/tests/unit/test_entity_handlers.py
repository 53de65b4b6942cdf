"""Handlers of Tasks, Devices and Alerts: the views and the events."""

from collections.abc import AsyncIterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest

from handover.broker import BrokerClient
from handover.database import connect
from handover_datamodels.entities import Alert
from handover_datamodels.times import iso
from handover_web.live.event_log import EventLog
from handover_web.live.live_state import LiveState
from handover_web.settings import WebuiSettings
from handover_web.sources import alerts as alerts_module
from handover_web.sources.alerts import Alerts, view_of
from handover_web.sources.broker_abilities import BrokerAbilities
from handover_web.sources.devices import Devices
from handover_web.sources.services import ServiceMonitor
from handover_web.sources.tasklist import Tasklist
from handover_web.sources.tasks import Tasks

GLOVE = "urn:ngsi-ld:Device:demo:glove-1"
TASK = "urn:ngsi-ld:Task:demo:bin-picking-1-confirm-1"
ALERT = "urn:ngsi-ld:Alert:demo:glove-1-silent"


class Cell:
    """The three handlers with their own live state and event log; none of them uses a broker."""

    def __init__(self, folder: Path) -> None:
        settings = WebuiSettings.load(data_dir=folder)
        self.state = LiveState()
        self.published: list[dict[str, Any]] = []
        self.hints: list[str] = []
        self.log = EventLog(
            connect(settings.database("webui")), lambda _, event: self.published.append(dict(event))
        )
        self.broker = BrokerClient(settings)
        self.http = httpx.AsyncClient(timeout=120)
        services = ServiceMonitor(
            settings.service_urls, self.http, BrokerAbilities(settings, self.broker), self.state, self.log
        )
        self.devices = Devices(self.state, self.log, services)
        tasklist = Tasklist(self.state)
        self.tasks = Tasks(self.log, self.devices, services, self.hints.append, tasklist)
        self.alerts = Alerts(self.state, self.log, self.broker)

    async def keys(self) -> list[str]:
        """Close the log and return the keys of all published events."""
        await self.log.__aexit__()
        return [event["key"] for event in self.published]


@pytest.fixture
async def cell(tmp_path: Path) -> AsyncIterator[Cell]:
    made = Cell(tmp_path)
    async with made.broker, made.http, made.log:
        yield made


def prop(value: Any, at: int | None = None) -> dict[str, Any]:
    seen = {} if at is None else {"observedAt": f"2999-01-01T00:00:{at:02d}Z"}
    return {"type": "Property", "value": value, **seen}


def moment(at: int) -> dict[str, Any]:
    return prop({"@type": "DateTime", "@value": f"2999-01-01T00:00:{at:02d}Z"})


def task(status: str, at: int, **more: Any) -> dict[str, Any]:
    return {
        "id": TASK,
        "type": "Task",
        "isDefinedBy": {"type": "Relationship", "object": "urn:ngsi-ld:TaskDefinition:demo:confirm"},
        "status": prop(status, at),
        "involves": prop([{"type": "Relationship", "object": GLOVE}]),
        **more,
    }


def device(state: str, at: int) -> dict[str, Any]:
    return {
        "id": GLOVE,
        "type": "Device",
        "controlledProperty": prop(["gesture"]),
        "category": prop(["glove"]),
        "deviceState": prop(state, at),
        "performer": prop("gesture-controller"),
    }


def alert(at: int, **more: Any) -> dict[str, Any]:
    return {
        "id": ALERT,
        "type": "Alert",
        "category": prop("device"),
        "severity": prop("high"),
        "description": prop("glove-1 is silent"),
        "dateIssued": moment(at),
        "alertSource": {"type": "Relationship", "object": GLOVE},
        **more,
    }


async def test_each_status_of_a_task_is_recorded_once_and_in_order(cell: Cell) -> None:
    for status, at in [("pending", 1), ("pending", 1), ("inProgress", 3), ("assigned", 2), ("completed", 4)]:
        cell.tasks.update(task(status, at))
    cell.tasks.update(task("inProgress", 3))  # after its end: it is recorded already
    assert await cell.keys() == ["task.pending", "task.inProgress", "task.completed"]
    assert TASK in cell.hints


async def test_finished_tasks_are_not_queried_again(cell: Cell) -> None:
    cell.tasks.update(task("pending", 1))
    assert list(cell.tasks.active_ids()) == [TASK]
    cell.tasks.update(task("failed", 2, outputParameters=prop({"reason": "cancelled"})))
    assert list(cell.tasks.active_ids()) == []
    await cell.keys()
    assert cell.published[-1]["level"] == "attention"
    assert cell.published[-1]["values"]["reason"] == "cancelled"


async def test_busy_devices_are_shown_without_an_event(cell: Cell) -> None:
    for at, state in enumerate(["idle", "ok", "busy", "ok", "busy", "ok", "error", "ok"]):
        cell.devices.update(device(state, at))
        assert cell.state.value(f"device/{GLOVE}")["deviceState"] == state
    await cell.keys()
    assert [event["values"]["state"] for event in cell.published] == ["idle", "ok", "error", "ok"]
    assert cell.devices.performer_of(GLOVE) == "gesture-controller"


async def test_devices_with_only_a_performer_are_not_shown(cell: Cell) -> None:
    cell.devices.update({"id": GLOVE, "type": "Device", "performer": prop("gesture-controller")})
    assert cell.state.topics_of("device") == []
    assert cell.devices.performer_of(GLOVE) == "gesture-controller"


async def test_incomplete_devices_are_shown(cell: Cell) -> None:
    cell.devices.update({"id": GLOVE, "type": "Device", "deviceState": prop("ok", 1)})
    assert cell.state.value(f"device/{GLOVE}")["category"] == []


async def test_an_alert_is_raised_acknowledged_returned_to_normal_and_raised_again(cell: Cell) -> None:
    known = {**prop(True, 2), "by": prop("Aino")}
    for entity in (
        alert(1),
        alert(1, humanVerified=known),
        alert(1, humanVerified=known, validTo=prop({"@type": "DateTime", "@value": iso(datetime.now(UTC))})),
        alert(4),
    ):
        cell.alerts.update(entity)
        cell.alerts.update(entity)
    assert await cell.keys() == ["alert.raised", "alert.acknowledged", "alert.over", "alert.raised"]
    assert [event["level"] for event in cell.published] == ["stop", "info", "info", "stop"]
    shown = cell.state.value(f"alert/{ALERT}")
    assert shown["acknowledged"] is None
    assert shown["validTo"] is None


async def test_the_number_of_past_alerts_is_limited(cell: Cell, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(alerts_module, "MAX_PAST_ALERTS", 3)
    cell.alerts.update(alert(1))
    for number in (9, 2, 8, 3, 7, 2):
        over = prop({"@type": "DateTime", "@value": f"2020-01-01T00:00:{number:02d}Z"})
        cell.alerts.update({**alert(1, validTo=over), "id": f"urn:ngsi-ld:Alert:demo:past-{number}"})
    shown = {topic.rsplit(":", 1)[-1] for topic in cell.state.topics_of("alert")}
    assert shown == {"glove-1-silent", "past-9", "past-8", "past-7"}


NOW = datetime(2026, 3, 2, 12, 0, tzinfo=UTC)


def time_of(minutes: float) -> dict[str, Any]:
    return prop({"@type": "DateTime", "@value": iso(NOW + timedelta(minutes=minutes))})


@pytest.mark.parametrize(
    ("attributes", "state", "priority"),
    [
        ({}, "new", "high"),
        ({"severity": prop("informational")}, "new", "low"),
        ({"severity": prop("low"), "priority": prop("critical")}, "new", "critical"),
        ({"humanVerified": prop(True)}, "acknowledged", "high"),
        ({"humanVerified": prop(False)}, "new", "high"),
        ({"acknowledgedBy": prop("Aino")}, "acknowledged", "high"),
        ({"validTo": time_of(-1)}, "returnedToNormal", "high"),
        ({"validTo": time_of(1)}, "new", "high"),
        ({"alertState": prop("returnedToNormal")}, "returnedToNormal", "high"),
        ({"alertState": prop("shelved"), "shelvedUntil": time_of(1)}, "shelved", "high"),
        ({"alertState": prop("shelved"), "shelvedUntil": time_of(-1)}, "new", "high"),
        (
            {"alertState": prop("shelved"), "shelvedUntil": time_of(-1), "humanVerified": prop(True)},
            "acknowledged",
            "high",
        ),
        (
            {"alertState": prop("shelved"), "shelvedUntil": time_of(1), "validTo": time_of(-1)},
            "returnedToNormal",
            "high",
        ),
    ],
)
def test_missing_alert_states_are_derived(attributes: dict[str, Any], state: str, priority: str) -> None:
    view = view_of(Alert.from_ngsild(alert(1, **attributes)), NOW)
    assert (view["state"], view["priority"]) == (state, priority)


@pytest.mark.parametrize(
    "attributes",
    [
        {"priority": prop(1)},
        {"alertState": prop("open"), "acknowledgedBy": prop({"name": "Aino"})},
        {"shelvedUntil": prop("tomorrow"), "descriptionCode": prop(7), "descriptionParameters": prop([])},
    ],
)
async def test_alerts_with_other_meanings_of_our_attributes_are_shown(
    cell: Cell, attributes: dict[str, Any]
) -> None:
    cell.alerts.update(alert(1, severity=prop("low"), humanVerified=prop(True), **attributes))
    shown = cell.state.value(f"alert/{ALERT}")
    assert (shown["severity"], shown["priority"], shown["state"]) == ("low", "low", "acknowledged")


async def test_only_invalid_attributes_are_ignored(cell: Cell) -> None:
    cell.alerts.update(alert(1, priority=prop(1), alertState=prop("acknowledged")))
    assert cell.state.value(f"alert/{ALERT}")["state"] == "acknowledged"


async def test_unchanged_alerts_are_not_validated_again(cell: Cell, monkeypatch: pytest.MonkeyPatch) -> None:
    cell.alerts.update(alert(1))
    validated: list[str] = []
    monkeypatch.setattr(alerts_module, "view_of", lambda read: validated.append(read.id) or view_of(read))
    cell.alerts.update(alert(1))
    assert validated == []
    cell.alerts.update(alert(2))
    assert validated


async def test_an_open_task_of_people_is_in_the_tasklist_until_it_ends(cell: Cell) -> None:
    entity = {
        **task("pending", 1),
        "involves": prop([]),
        "name": prop("Weigh"),
        "element": prop("weigh"),
        "isPartOf": {"type": "Relationship", "object": "urn:ngsi-ld:Process:demo:weighing-1"},
        "priority": prop(70),
        "dueDate": moment(30),
        "workParameters": prop({"candidates": {"groups": ["packing"], "lane": "Hall", "users": ["ben"]}}),
    }
    cell.tasks.update(entity)
    topic = f"tasklist/{TASK}"
    shown = cell.state.value(topic)
    assert (shown["name"], shown["process"], shown["priority"]) == ("Weigh", "weighing-1", 70)
    assert (shown["groups"], shown["persons"]) == (["packing", "Hall"], ["ben"])
    assert (shown["claimedBy"], shown["isClaimable"]) == (None, True)
    claimed = {"outputParameters": prop({"by": "tasklist", "operator": "Anna", "declinedBy": ["Ben"]})}
    cell.tasks.update({**entity, **claimed, "status": prop("inProgress", 2)})
    shown = cell.state.value(topic)
    assert (shown["claimedBy"], shown["declinedBy"], shown["isClaimable"]) == ("Anna", ["Ben"], True)
    cell.tasks.update({**entity, "status": prop("completed", 3)})
    assert cell.state.value(topic) is None
