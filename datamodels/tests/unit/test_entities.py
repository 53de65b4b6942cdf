"""The entities: made of plain values, frozen, and strict about what they are made of."""

import copy
from datetime import UTC, datetime
from typing import Any

import pytest
from pydantic import ValidationError

from handover_datamodels import (
    Alert,
    DataModelError,
    Device,
    Entity,
    HumanState,
    Links,
    MeasurementStatus,
    Person,
    Property,
    Relationship,
    Severity,
    Task,
    TaskLocation,
    TaskStatus,
    read,
)

DEFINED = "urn:ngsi-ld:TaskDefinition:demo:pick"
ROBOT = "urn:ngsi-ld:Device:demo:ur10-1"
PART = "urn:ngsi-ld:Material:demo:bracket-118"


def a_task(**attributes: Any) -> Task:
    return Task(id="urn:ngsi-ld:Task:demo:t1", is_defined_by=DEFINED, status="pending", **attributes)


def a_wire_task(**attributes: Any) -> dict[str, Any]:
    return {
        "id": "urn:ngsi-ld:Task:demo:t1",
        "type": "Task",
        "isDefinedBy": {"type": "Relationship", "object": DEFINED},
        "status": {"type": "Property", "value": "pending"},
        **attributes,
    }


def test_plain_values_make_an_entity() -> None:
    task = a_task(involves=[ROBOT, PART], work_parameters={"operation": "pick"})
    assert task.type == "Task"
    assert task.status.value is TaskStatus.PENDING
    assert task.is_defined_by.object == DEFINED
    assert [link.object for link in task.involves or ()] == [ROBOT, PART]
    assert task.work_parameters is not None
    assert task.work_parameters.value == {"operation": "pick"}
    assert task.happens_at is None


def test_attributes_bring_when_they_were_observed() -> None:
    at = datetime(2026, 3, 2, 7, 15, tzinfo=UTC)
    task = Task.model_validate(
        {
            "id": "urn:ngsi-ld:Task:demo:t1",
            "is_defined_by": Relationship(object=DEFINED),
            "status": Property[TaskStatus](value=TaskStatus.ASSIGNED, observed_at=at),
            "deadline": at,
        }
    )
    assert task.status.observed_at == at
    written = task.to_normalized()
    assert written["status"] == {
        "type": "Property",
        "value": "assigned",
        "observedAt": "2026-03-02T07:15:00.000000Z",
    }
    assert written["deadline"]["value"] == {"@type": "DateTime", "@value": "2026-03-02T07:15:00.000000Z"}


def test_what_is_not_said_is_not_written() -> None:
    assert set(a_task().to_normalized()) == {"id", "type", "isDefinedBy", "status"}


def test_an_entity_is_frozen() -> None:
    with pytest.raises(ValidationError, match="frozen"):
        a_task().status = Property[TaskStatus](value=TaskStatus.FAILED)  # type: ignore[misc]


def test_a_changed_copy_is_written_as_changed() -> None:
    task = Task.from_ngsild(
        a_wire_task(status={"type": "Property", "value": "pending", "observedAt": "2020-12-01T11:23:19Z"})
    )
    moved = task.status.model_copy(
        update={"value": TaskStatus.ASSIGNED, "observed_at": datetime(2026, 1, 1, tzinfo=UTC)}
    )
    written = task.model_copy(update={"status": moved}).to_normalized()
    assert written["status"]["value"] == "assigned"
    assert written["status"]["observedAt"] == "2026-01-01T00:00:00.000000Z"


@pytest.mark.parametrize(
    "involves",
    [
        {"type": "Property", "value": [{"type": "Relationship", "object": ROBOT}]},
        {"type": "Property", "value": {"type": "Relationship", "object": ROBOT}},
        {"type": "Property", "value": [ROBOT]},
        {"type": "Relationship", "object": ROBOT},
        {"type": "Relationship", "object": [ROBOT]},
        {"type": "ListRelationship", "objectList": [{"object": ROBOT}]},
        {"object": ROBOT},
        {"value": [{"type": "Relationship", "object": ROBOT}]},
        [{"type": "Relationship", "object": ROBOT}],
        [{"object": ROBOT}],
        [ROBOT],
        ROBOT,
    ],
)
def test_involves_is_understood_in_every_form_and_written_as_a_property_of_a_list(involves: Any) -> None:
    task = Task.from_ngsild(a_wire_task(involves=involves))
    assert task.to_normalized()["involves"] == {
        "type": "Property",
        "value": [{"type": "Relationship", "object": ROBOT}],
    }


@pytest.mark.parametrize(
    "involves",
    [
        {"type": "Relationship", "object": [ROBOT, PART]},
        [
            {"type": "Relationship", "object": ROBOT},
            {"type": "Relationship", "object": PART, "datasetId": "urn:ngsi-ld:Dataset:2"},
        ],
        {"type": "ListRelationship", "objectList": [ROBOT, PART]},
        [ROBOT, PART],
    ],
)
def test_the_order_of_those_involved_is_kept(involves: Any) -> None:
    task = Task.from_ngsild(a_wire_task(involves=involves))
    assert [link.object for link in task.involves or ()] == [ROBOT, PART]


def test_an_empty_list_of_those_involved_stays_a_list() -> None:
    task = Task.from_ngsild(a_wire_task(involves={"type": "Property", "value": []}))
    assert task.involves == ()
    assert task.to_normalized()["involves"] == {"type": "Property", "value": []}


def test_what_is_said_of_the_list_itself_is_kept() -> None:
    involves = {
        "type": "Property",
        "value": [{"type": "Relationship", "object": ROBOT}],
        "observedAt": "2020-12-01T11:30:21Z",
        "assignedBy": {"type": "Relationship", "object": "urn:ngsi-ld:Person:demo:lead"},
    }
    task = Task.from_ngsild(a_wire_task(involves=involves))
    assert task.involves is not None
    assert task.involves.observed_at == datetime(2020, 12, 1, 11, 30, 21, tzinfo=UTC)
    for again in (task, copy.deepcopy(task)):
        assert again.to_normalized()["involves"] == involves
    assert a_task(involves=task.involves).to_normalized()["involves"] == involves


def test_a_place_knows_what_it_is_for() -> None:
    places = {
        "type": "Property",
        "value": [
            {
                "type": "Relationship",
                "object": "urn:ngsi-ld:Location:demo:bin-7",
                "locationFunction": {"type": "Property", "value": "source"},
            },
            {"type": "Relationship", "object": "urn:ngsi-ld:Location:demo:tray-2"},
        ],
    }
    task = Task.from_ngsild(a_wire_task(happensAt=places))
    assert isinstance(task.happens_at, Links)
    source, anywhere = task.happens_at
    assert isinstance(source, TaskLocation)
    assert source.location_function is not None
    assert source.location_function.value == "source"
    assert anywhere.location_function is None
    assert task.to_normalized()["happensAt"] == places


def test_unknown_attributes_are_kept() -> None:
    person = Person.from_ngsild(
        {
            "id": "urn:ngsi-ld:Person:demo:operator-1",
            "type": "Person",
            "status": {"type": "Property", "value": "available", "observedAt": "2020-12-01T11:23:19Z"},
            "badge": "B-17",
        }
    )
    assert person.model_extra == {
        "status": {"type": "Property", "value": "available", "observedAt": "2020-12-01T11:23:19Z"},
        "badge": {"type": "Property", "value": "B-17"},
    }
    assert person.to_normalized()["badge"] == {"type": "Property", "value": "B-17"}


def test_a_wire_name_in_snake_case_is_an_attribute_of_its_own() -> None:
    person = Person.from_ngsild({"id": "urn:x:p", "type": "Person", "first_name": "Aino"})
    assert person.first_name is None
    assert person.to_normalized()["first_name"] == {"type": "Property", "value": "Aino"}


def test_other_instances_of_an_attribute_are_kept() -> None:
    temperature = [
        {"type": "Property", "value": 21.5},
        {"type": "Property", "value": 70.7, "datasetId": "urn:ngsi-ld:Dataset:fahrenheit"},
    ]
    device = Device.from_ngsild(
        {"id": "urn:x:d", "type": "Device", "controlledProperty": ["temperature"], "value": temperature}
    )
    assert device.value is not None
    assert device.value.value == 21.5
    assert device.to_normalized()["value"] == temperature
    concise = device.to_concise()
    assert Device.from_ngsild(concise) == device
    assert device.to_key_values()["value"] == {
        "dataset": {"@none": 21.5, "urn:ngsi-ld:Dataset:fahrenheit": 70.7}
    }


def test_a_list_of_one_that_a_broker_unpacked_is_a_list_again() -> None:
    device = Device.from_ngsild(
        {"id": "urn:x:d", "type": "Device", "controlledProperty": {"type": "Property", "value": "gesture"}}
    )
    assert device.controlled_property.value == ("gesture",)
    assert device.to_normalized()["controlledProperty"]["value"] == ["gesture"]


def test_a_source_may_be_text_or_an_entity() -> None:
    device = {"id": "urn:x:d", "type": "Device", "controlledProperty": ["gesture"]}
    linked = Device.from_ngsild({**device, "source": "urn:ngsi-ld:Person:demo:operator-1"})
    reported = Device.from_ngsild({**device, "source": "own measurement"})
    assert isinstance(linked.source, Relationship)
    assert isinstance(reported.source, Property)
    as_property = {"type": "Property", "value": "urn:ngsi-ld:Person:demo:operator-1"}
    kept = Device.from_ngsild({**device, "source": as_property})
    assert isinstance(kept.source, Property)
    assert kept.to_normalized()["source"] == as_property
    assert Device.from_ngsild(kept.to_concise()) == kept


def test_what_a_notification_says_was_deleted_is_absent() -> None:
    task = Task.from_ngsild(
        a_wire_task(
            requestedStatus={"type": "Property", "value": "urn:ngsi-ld:null"}, deadline="urn:ngsi-ld:null"
        )
    )
    assert task.requested_status is None
    assert task.deadline is None


def test_an_alert_is_made_of_plain_values() -> None:
    now = datetime(2026, 3, 2, 7, 15, 44, 500_000, tzinfo=UTC)
    alert = Alert.model_validate(
        {
            "id": "urn:ngsi-ld:Alert:demo:a",
            "category": "deviceFailure",
            "severity": Severity.HIGH,
            "date_issued": now,
            "alert_source": ROBOT,
        }
    )
    assert alert.date_issued.value == now
    assert alert.to_normalized()["severity"] == {"type": "Property", "value": "high"}


def test_read_gives_the_model_of_the_type() -> None:
    assert isinstance(read(a_wire_task()), Task)
    assert isinstance(read({**a_wire_task(), "type": ["Urgent", "Task"]}), Task)
    foreign = read({"id": "urn:x:room", "type": "Room", "temperature": 21})
    assert type(foreign) is Entity
    assert foreign.to_normalized()["temperature"] == {"type": "Property", "value": 21}


def test_metadata_of_the_broker_is_preserved() -> None:
    wire = a_wire_task(
        createdAt="2026-03-02T07:15:52.118Z", modifiedAt="2026-03-02T07:15:53Z", scope="/hall/2"
    )
    assert Task.from_ngsild(wire).to_normalized() == wire


@pytest.mark.parametrize(
    ("change", "reported"),
    [
        ({"status": {"type": "Property", "value": "done"}}, r'attribute "status" \(value\): .*pending'),
        ({"status": {"type": "Property"}}, 'attribute "status": is a Property without "value"'),
        ({"status": {"type": "Relationship", "object": ROBOT}}, "is a Relationship, but must be a Property"),
        ({"isDefinedBy": {"type": "Relationship", "object": "pick"}}, r'attribute "isDefinedBy" \(object\)'),
        ({"isDefinedBy": {"type": "Relationship", "object": [ROBOT, PART]}}, r'"isDefinedBy" \(object\)'),
        ({"involves": {"type": "Property", "value": [7]}}, r'attribute "involves" \(value\.0\.object\)'),
        ({"workParameters": "pick"}, 'attribute "workParameters"'),
        ({"deadline": "2026-03-02"}, 'attribute "deadline" .*has no time zone'),
        ({"deadline": {"@type": "Date", "@value": "2026-03-02"}}, 'attribute "deadline" .*DateTime'),
        ({"deadline": 5}, "must be a time"),
        ({"status": {"value": "pending", "observedAt": "now"}}, r'attribute "status" \(observedAt\)'),
        ({"type": "Device"}, "its type is Device"),
        ({"type": 3}, 'attribute "type"'),
        ({"id": "task 1"}, 'task 1 is no valid Task: attribute "id"'),
    ],
)
def test_a_fault_is_reported_with_entity_attribute_and_rule(change: dict[str, Any], reported: str) -> None:
    with pytest.raises(DataModelError, match=reported) as refused:
        Task.from_ngsild({**a_wire_task(), **change})
    assert "is no valid Task" in str(refused.value)


def test_all_faults_are_reported_at_once() -> None:
    with pytest.raises(DataModelError) as refused:
        Task.from_ngsild({"id": "urn:ngsi-ld:Task:demo:t1", "type": "Task"})
    assert str(refused.value) == (
        'urn:ngsi-ld:Task:demo:t1 is no valid Task: attribute "isDefinedBy": is required; '
        'attribute "status": is required'
    )


@pytest.mark.parametrize("what", [None, [], "Task", 3])
def test_what_is_no_object_is_no_entity(what: Any) -> None:
    with pytest.raises(DataModelError, match="an entity is a JSON object"):
        read(what)


@pytest.mark.parametrize("number", [True, "3", 3.5])
def test_a_command_is_a_whole_number(number: Any) -> None:
    device = {"id": "urn:x:d", "type": "Device", "controlledProperty": ["gesture"], "commandId": number}
    with pytest.raises(DataModelError, match='attribute "commandId"'):
        Device.from_ngsild(device)
    device["commandId"] = 3.0
    whole = Device.from_ngsild(device).command_id
    assert whole is not None
    assert whole.value == 3


def test_a_place_on_earth_is_a_geometry() -> None:
    alert = {
        "id": "urn:x:a",
        "type": "Alert",
        "category": "c",
        "dateIssued": "2026-03-02T07:15:44Z",
        "alertSource": ROBOT,
    }
    placed = Alert.from_ngsild({**alert, "location": {"type": "Point", "coordinates": [23.8, 61.4]}})
    assert placed.to_normalized()["location"]["type"] == "GeoProperty"
    with pytest.raises(DataModelError, match="must be a GeoJSON geometry"):
        Alert.from_ngsild({**alert, "location": {"type": "Somewhere"}})


def test_an_infinite_number_is_refused() -> None:
    device = {
        "id": "urn:x:d",
        "type": "Device",
        "controlledProperty": ["charge"],
        "batteryLevel": float("nan"),
    }
    with pytest.raises(DataModelError, match='attribute "batteryLevel"'):
        Device.from_ngsild(device)


def test_a_measurement_has_one_instance_a_sensor_and_each_is_checked() -> None:
    fused = {"type": "Property", "value": 90.5, "quality": 0.9, "status": "valid", "method": "fused"}
    strap = {"type": "Property", "value": 92, "status": "stale", "datasetId": "urn:ngsi-ld:Dataset:strap"}
    state = HumanState.from_ngsild(
        {
            "id": "urn:ngsi-ld:HumanState:demo:p",
            "refPerson": "urn:ngsi-ld:Person:demo:p",
            "heartRate": [strap, fused],
        }
    )
    assert state.heart_rate is not None
    default, other = state.heart_rate.instances()
    assert (default.value, default.alternatives) == (90.5, ())
    assert other.value == 92
    assert other.status is not None
    assert other.status.value is MeasurementStatus.STALE
    wrong = state.heart_rate.model_copy(update={"alternatives": ({**strap, "status": "good"},)})
    with pytest.raises(ValidationError, match="stale"):
        wrong.instances()


@pytest.mark.parametrize("member", [{"quality": 1.5}, {"status": "good"}, {"observedBy": "strap"}])
def test_a_measurement_outside_its_rules_is_refused(member: dict[str, Any]) -> None:
    with pytest.raises(DataModelError, match="heartRate"):
        HumanState.from_ngsild(
            {
                "id": "urn:ngsi-ld:HumanState:demo:p",
                "refPerson": "urn:ngsi-ld:Person:demo:p",
                "heartRate": {"type": "Property", "value": 90, **member},
            }
        )
