"""Tasks, Devices and Alerts: what the page is shown of them, and what of it is an event."""

from collections.abc import AsyncIterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest

from datamodels.entities import Alert
from datamodels.times import iso
from handover.broker import BrokerClient
from handover.database import connect
from webui.events import EventLog
from webui.settings import WebuiSettings
from webui.sources import alerts as alerts_module
from webui.sources.alerts import Alerts, view_of
from webui.sources.devices import Devices
from webui.sources.services import Services
from webui.sources.tasks import Tasks
from webui.world import World

GLOVE = "urn:ngsi-ld:Device:demo:glove-1"
TASK = "urn:ngsi-ld:Task:demo:bin-picking-1-confirm-1"
ALERT = "urn:ngsi-ld:Alert:demo:glove-1-silent"


class Floor:
    """The three kinds with a world and a log of their own; nothing of it asks a broker."""

    def __init__(self, folder: Path) -> None:
        settings = WebuiSettings.load(data_dir=folder)
        self.world = World()
        self.told: list[dict[str, Any]] = []
        self.hints: list[str] = []
        self.log = EventLog(
            connect(settings.database("webui")), lambda _, event: self.told.append(dict(event))
        )
        self.broker = BrokerClient(settings)
        self.http = httpx.AsyncClient()
        services = Services(settings.service_urls, self.http, self.broker, self.world, self.log)
        self.devices = Devices(self.world, self.log, services)
        self.tasks = Tasks(self.log, self.devices, services, self.hints.append)
        self.alerts = Alerts(self.world, self.log, self.broker)

    async def keys(self) -> list[str]:
        """What has happened, once the log is closed and all of it is told."""
        await self.log.__aexit__()
        return [event["key"] for event in self.told]


@pytest.fixture
async def floor(tmp_path: Path) -> AsyncIterator[Floor]:
    made = Floor(tmp_path)
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


async def test_each_move_of_a_task_is_one_event_and_none_goes_back(floor: Floor) -> None:
    for status, at in [("pending", 1), ("pending", 1), ("inProgress", 3), ("assigned", 2), ("completed", 4)]:
        floor.tasks.take(task(status, at))
    floor.tasks.take(task("inProgress", 3))  # long after its end: the log has it
    assert await floor.keys() == ["task.pending", "task.inProgress", "task.completed"]
    assert TASK in floor.hints


async def test_a_finished_task_is_no_longer_asked_for(floor: Floor) -> None:
    floor.tasks.take(task("pending", 1))
    assert list(floor.tasks.still_open()) == [TASK]
    floor.tasks.take(task("failed", 2, outputParameters=prop({"reason": "cancelled"})))
    assert list(floor.tasks.still_open()) == []
    await floor.keys()
    assert floor.told[-1]["level"] == "attention"
    assert floor.told[-1]["values"]["reason"] == "cancelled"


async def test_a_device_at_work_and_at_rest_is_shown_but_is_no_event(floor: Floor) -> None:
    for at, state in enumerate(["idle", "ok", "busy", "ok", "busy", "ok", "error", "ok"]):
        floor.devices.take(device(state, at))
        assert floor.world.value(f"device/{GLOVE}")["deviceState"] == state
    await floor.keys()
    assert [event["values"]["state"] for event in floor.told] == ["idle", "ok", "error", "ok"]
    assert floor.devices.performer_of(GLOVE) == "gesture-controller"


async def test_a_device_of_which_only_the_performer_is_known_is_not_shown(floor: Floor) -> None:
    floor.devices.take({"id": GLOVE, "type": "Device", "performer": prop("gesture-controller")})
    assert floor.world.names("device") == []
    assert floor.devices.performer_of(GLOVE) == "gesture-controller"


async def test_a_brief_device_without_what_the_model_asks_is_still_shown(floor: Floor) -> None:
    floor.devices.take({"id": GLOVE, "type": "Device", "deviceState": prop("ok", 1)})
    assert floor.world.value(f"device/{GLOVE}")["category"] == []


async def test_an_alert_is_raised_known_over_and_raised_anew(floor: Floor) -> None:
    known = {**prop(True, 2), "by": prop("Aino")}
    for entity in (
        alert(1),
        alert(1, humanVerified=known),
        alert(1, humanVerified=known, validTo=prop({"@type": "DateTime", "@value": iso(datetime.now(UTC))})),
        alert(4),
    ):
        floor.alerts.take(entity)
        floor.alerts.take(entity)
    assert await floor.keys() == ["alert.raised", "alert.acknowledged", "alert.over", "alert.raised"]
    assert [event["level"] for event in floor.told] == ["stop", "info", "info", "stop"]
    shown = floor.world.value(f"alert/{ALERT}")
    assert shown["acknowledged"] is None
    assert shown["validTo"] is None


async def test_only_so_many_alerts_that_are_over_are_shown(
    floor: Floor, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(alerts_module, "KEPT_PAST", 3)
    floor.alerts.take(alert(1))
    for number in (9, 2, 8, 3, 7, 2):
        over = prop({"@type": "DateTime", "@value": f"2020-01-01T00:00:{number:02d}Z"})
        floor.alerts.take({**alert(1, validTo=over), "id": f"urn:ngsi-ld:Alert:demo:past-{number}"})
    shown = {topic.rsplit(":", 1)[-1] for topic in floor.world.names("alert")}
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
def test_the_state_of_an_alert_is_derived_where_it_is_not_stated(
    attributes: dict[str, Any], state: str, priority: str
) -> None:
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
async def test_an_alert_that_uses_our_names_for_something_else_is_shown(
    floor: Floor, attributes: dict[str, Any]
) -> None:
    floor.alerts.take(alert(1, severity=prop("low"), humanVerified=prop(True), **attributes))
    shown = floor.world.value(f"alert/{ALERT}")
    assert (shown["severity"], shown["priority"], shown["state"]) == ("low", "low", "acknowledged")


async def test_only_the_attributes_that_do_not_fit_are_left_out(floor: Floor) -> None:
    floor.alerts.take(alert(1, priority=prop(1), alertState=prop("acknowledged")))
    assert floor.world.value(f"alert/{ALERT}")["state"] == "acknowledged"


async def test_an_alert_that_has_not_changed_is_not_validated_again(
    floor: Floor, monkeypatch: pytest.MonkeyPatch
) -> None:
    floor.alerts.take(alert(1))
    validated: list[str] = []
    monkeypatch.setattr(alerts_module, "view_of", lambda read: validated.append(read.id) or view_of(read))
    floor.alerts.take(alert(1))
    assert validated == []
    floor.alerts.take(alert(2))
    assert validated
