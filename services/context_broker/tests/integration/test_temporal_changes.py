"""Recorded and provided history: additions, corrections, deletions and crashes."""

import threading
from collections.abc import Iterator
from itertools import count
from typing import Any

import httpx
import pytest

from .temporal_requests import PAST, a_car, at, fault, read_evolution, readings, values

NUMBERS = count(1)


@pytest.fixture
def entity_id() -> str:
    return f"urn:ngsi-ld:Car:demo:{next(NUMBERS)}"


@pytest.fixture
def car(http: httpx.Client, entity_id: str) -> str:
    """A car with a history only."""
    return a_car(http, entity_id)


@pytest.mark.nightly
def test_changes_of_current_entities_are_recorded(http: httpx.Client, entity_id: str) -> None:
    entity = {"id": entity_id, "type": "Car", "scope": "/a", "speed": readings([1])[0], "colour": "red"}
    path = f"/entities/{entity_id}"
    assert http.post("/entities", json=entity).status_code == 201
    assert http.patch(f"{path}/attrs/speed", json=readings([2], 1)[0]).status_code == 204
    assert http.patch(f"{path}/attrs", json={"colour": "blue"}).status_code == 204
    assert http.patch(path, json={"speed": {"value": 3, "observedAt": at(2)}}).status_code == 204
    assert http.delete(f"{path}/attrs/colour").status_code == 204
    past = read_evolution(http, entity_id)
    assert values(past) == [1, 2, 3]
    assert values(past, "colour") == ["red", "blue"]
    assert values(past, "scope") == ["/a"]
    assert "observedAt" not in past["scope"][0]  # scopes are not observed (clause 4.18)
    assert past["scope"][0]["modifiedAt"]
    ids = [one["instanceId"] for name in ("speed", "colour", "scope") for one in past[name]]
    assert len(set(ids)) == len(ids)
    gone = read_evolution(http, entity_id, timeproperty="deletedAt")
    assert [(one["value"], "deletedAt" in one) for one in gone["colour"]] == [("urn:ngsi-ld:null", True)]
    assert "speed" not in gone
    assert http.delete(path).status_code == 204
    after = read_evolution(http, entity_id, options="sysAttrs")
    assert values(after) == [1, 2, 3]
    assert after["deletedAt"] > after["modifiedAt"] >= after["createdAt"]
    assert values(read_evolution(http, entity_id, timeproperty="deletedAt")) == ["urn:ngsi-ld:null"]
    assert http.post("/entities", json=entity).status_code == 201
    assert values(read_evolution(http, entity_id, timeproperty="modifiedAt")) == [1, 2, 3, 1]


def test_instances_are_added_to_the_history(http: httpx.Client, car: str) -> None:
    more = {"id": car, "type": ["Truck"], "speed": readings([60], 5), "scope": ["/a", "/b"]}
    assert http.post(PAST, json=more).status_code == 204
    assert (
        http.post(f"{PAST}/{car}/attrs", json={"speed": readings([70, 80], 6), "colour": "red"}).status_code
        == 204
    )
    past = read_evolution(http, car)
    assert past["type"] == ["Car", "Truck"]
    assert values(past) == [10, 20, 30, 40, 50, 60, 70, 80]
    assert values(past, "scope") == [["/a", "/b"]]
    deletion = {"speed": readings(["urn:ngsi-ld:null"], 9)}
    assert http.post(f"{PAST}/{car}/attrs", json=deletion).status_code == 204
    assert values(read_evolution(http, car))[-1] == "urn:ngsi-ld:null"
    assert http.get(f"/entities/{car}").status_code == 404  # the current entity is unchanged


def test_a_repeated_instance_is_stored_once(http: httpx.Client, car: str) -> None:
    before = read_evolution(http, car, options="sysAttrs")
    again = {
        "id": car,
        "type": "Car",
        "speed": [*readings([11, 20]), *readings([60], 5)],
        "heading": [*readings([7], 1, datasetId="urn:x:gps"), *readings([3], 9)],
        "scope": readings(["/a"]),
    }
    for _ in range(2):
        assert http.post(PAST, json=again).status_code == 204
        past = read_evolution(http, car, options="sysAttrs")
        assert values(past) == [11, 20, 30, 40, 50, 60]
        assert values(past, "scope") == ["/a"]
        headings = [(one["value"], one.get("datasetId")) for one in past["heading"]]
        assert sorted(headings, key=str) == [
            (1, None),
            (2, None),
            (3, None),
            (7, "urn:x:gps"),
            (8, "urn:x:gps"),
        ]
        first, was = past["speed"][0], before["speed"][0]
        assert (first["instanceId"], first["createdAt"]) == (was["instanceId"], was["createdAt"])
        assert first["modifiedAt"] > was["modifiedAt"]
    http.post(f"{PAST}/{car}/attrs", json={"speed": readings([12])})
    assert sorted(values(read_evolution(http, car))) == [11, 12, 20, 30, 40, 50, 60]


def test_an_instance_is_corrected_and_deleted(http: httpx.Client, car: str) -> None:
    first, second, *_ = read_evolution(http, car)["speed"]
    path = f"{PAST}/{car}/attrs/speed"
    assert http.patch(f"{path}/{first['instanceId']}", json={"value": 11}).status_code == 204
    part = {"type": "Property", "value": 21, "observedAt": at(30), "unitCode": "KMH"}
    assert http.patch(f"{path}/{second['instanceId']}", json=part).status_code == 204
    past = read_evolution(http, car, options="sysAttrs")["speed"]
    assert [one["value"] for one in past] == [11, 30, 40, 50, 21]
    assert past[-1]["instanceId"] == second["instanceId"]
    assert past[-1]["unitCode"] == "KMH"
    assert past[-1]["modifiedAt"] > past[-1]["createdAt"]
    newer = {"timerel": "after", "timeAt": past[0]["modifiedAt"], "timeproperty": "modifiedAt"}
    assert values(read_evolution(http, car, **newer)) == [11, 21]
    assert http.delete(f"{path}/{first['instanceId']}").status_code == 204
    assert values(read_evolution(http, car)) == [30, 40, 50, 21]
    assert fault(http.delete(f"{path}/{first['instanceId']}")) == (404, "ResourceNotFound")
    for wrong in ("urn:ngsi-ld:Instance:1-1-0", "urn:x:1", first["instanceId"]):
        assert fault(http.patch(f"{path}/{wrong}", json={"value": 1})) == (404, "ResourceNotFound")
    assert (
        fault(http.patch(f"{PAST}/{car}/attrs/heading/{second['instanceId']}", json={"value": 1}))[0] == 404
    )


def test_attributes_and_entities_are_deleted_from_the_history(http: httpx.Client, car: str) -> None:
    path = f"{PAST}/{car}"
    assert http.delete(f"{path}/attrs/heading", params={"datasetId": "urn:x:gps"}).status_code == 204
    assert values(read_evolution(http, car), "heading") == [1, 2]
    assert http.delete(f"{path}/attrs/heading").status_code == 204
    assert fault(http.delete(f"{path}/attrs/heading", params={"deleteAll": "true"})) == (
        404,
        "ResourceNotFound",
    )
    assert http.delete(f"{path}/attrs/speed", params={"deleteAll": "true"}).status_code == 204
    assert set(read_evolution(http, car)) == {"id", "type"}
    assert http.delete(path).status_code == 204
    for method, at_path in (("GET", path), ("DELETE", path), ("DELETE", f"{path}/attrs/speed")):
        assert fault(http.request(method, at_path)) == (404, "ResourceNotFound")
    assert fault(http.post(f"{path}/attrs", json={"speed": readings([1])})) == (404, "ResourceNotFound")


def test_deleting_history_keeps_the_current_entity(http: httpx.Client, entity_id: str) -> None:
    assert http.post("/entities", json={"id": entity_id, "type": "Car", "speed": 1}).status_code == 201
    assert http.delete(f"{PAST}/{entity_id}").status_code == 204
    assert http.get(f"/entities/{entity_id}").status_code == 200
    assert set(read_evolution(http, entity_id)) == {"id", "type"}
    assert http.patch(f"/entities/{entity_id}/attrs", json={"speed": 2}).status_code == 204
    assert values(read_evolution(http, entity_id)) == [2]


@pytest.mark.parametrize(
    "part",
    [
        {"speed": []},
        {"speed": [{"value": None}]},
        {"speed": [{"value": 1, "observedAt": "now"}]},
        {"speed": [{"type": "Property"}]},
        {"scope": "no scope"},
        {"scope": [{"type": "Relationship", "object": "urn:x:1"}]},
        {"expiresAt": "urn:ngsi-ld:null"},
        {"type": []},
        {"id": "no uri"},
    ],
)
def test_invalid_temporal_input_is_refused(http: httpx.Client, entity_id: str, part: dict[str, Any]) -> None:
    body = {"id": entity_id, "type": "Car", **part}
    answer = http.post(PAST, json=body)
    if part != {"speed": []}:  # which is a Property whose value is an empty list
        assert fault(answer) == (400, "BadRequestData")
        assert http.get(f"{PAST}/{entity_id}").status_code == 404


def test_nothing_is_recorded_if_history_is_switched_off(own_broker: Any) -> None:
    own_broker.extra = {"HANDOVER_BROKER_HISTORY": "false"}
    own_broker.start()
    with own_broker.client() as http:
        assert http.post("/entities", json={"id": "urn:x:1", "type": "Car", "speed": 1}).status_code == 201
        assert set(read_evolution(http, "urn:x:1")) == {"id", "type"}
        assert (
            http.post(PAST, json={"id": "urn:x:2", "type": "Car", "speed": readings([1])}).status_code == 201
        )
        assert values(read_evolution(http, "urn:x:2")) == [1]


class Writer(threading.Thread):
    """Patches one entity as fast as it can, and records the acknowledged values."""

    def __init__(self, broker: Any, entity_id: str) -> None:
        super().__init__(daemon=True)
        self.broker = broker
        self.entity_id = entity_id
        self.acknowledged = 0
        self.over = threading.Event()

    def run(self) -> None:
        with self.broker.client() as http:
            try:
                for number in self._numbers():
                    if http.patch(f"/entities/{self.entity_id}/attrs", json={"n": number}).status_code == 204:
                        self.acknowledged = number
            except httpx.TransportError:
                return

    def _numbers(self) -> Iterator[int]:
        number = self.acknowledged
        while not self.over.is_set():
            number += 1
            yield number


@pytest.mark.nightly
def test_acknowledged_history_survives_a_crash(own_broker: Any, eventually: Any) -> None:
    own_broker.start()
    ids = [f"urn:x:{number}" for number in range(4)]
    with own_broker.client() as http:
        for entity_id in ids:
            assert (
                http.post("/entities", json={"id": entity_id, "type": "Counter", "n": 0}).status_code == 201
            )
    writers = [Writer(own_broker, entity_id) for entity_id in ids]
    for writer in writers:
        writer.start()
    eventually(lambda: all(one.acknowledged > 50 for one in writers))
    own_broker.kill()
    for writer in writers:
        writer.join(120)
    own_broker.start()
    with own_broker.client() as http:
        for writer in writers:
            change_data = values(read_evolution(http, writer.entity_id, timeproperty="modifiedAt"), "n")
            assert change_data == list(range(len(change_data)))
            assert len(change_data) - 1 in {writer.acknowledged, writer.acknowledged + 1}
