"""Entities over HTTP: created, read, changed in all the ways, deleted."""

from typing import Any

import httpx
import pytest

JSON = {"Content-Type": "application/json"}
PENDING = {"type": "Property", "value": "pending", "observedAt": "2026-01-01T12:00:00Z"}


def task(name: str, **attributes: Any) -> dict[str, Any]:
    return {"id": f"urn:ngsi-ld:Task:demo:{name}", "type": "Task", **attributes}


def made(http: httpx.Client, name: str, **attributes: Any) -> str:
    entity = task(name, **attributes)
    answer = http.post("/entities", json=entity)
    assert answer.status_code == 201, answer.text
    return str(entity["id"])


def read(http: httpx.Client, entity_id: str, **parameters: str) -> Any:
    answer = http.get(f"/entities/{entity_id}", params=parameters)
    assert answer.status_code == 200, answer.text
    return answer.json()


def problem(answer: httpx.Response, status: int, kind: str, *words: str) -> None:
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    body = answer.json()
    assert body["type"] == f"https://uri.etsi.org/ngsi-ld/errors/{kind}"
    assert body["status"] == status
    for word in words:
        assert word in body["detail"]


def test_what_is_created_is_read_back_as_it_was(http: httpx.Client) -> None:
    entity = task(
        "round-trip",
        status=PENDING,
        workParameters={"type": "Property", "value": {"commandId": 3, "deep": [{"a": None}]}},
        isDefinedBy={"type": "Relationship", "object": "urn:ngsi-ld:TaskDefinition:demo:confirm"},
        involves={
            "type": "Property",
            "value": [{"type": "Relationship", "object": "urn:ngsi-ld:Device:demo:glove-1"}],
        },
        where={"type": "GeoProperty", "value": {"type": "Point", "coordinates": [24.9, 60.2]}},
        label={"type": "LanguageProperty", "languageMap": {"en": "part", "fi": "osa"}},
        raw={"type": "JsonProperty", "json": {"type": "whatever"}},
        mood={"type": "VocabProperty", "vocab": "calm"},
        speed={
            "type": "Property",
            "value": 0.5,
            "unitCode": "MTS",
            "accuracy": {"type": "Property", "value": 0.01},
        },
        steps={"type": "ListProperty", "valueList": [1, 2, 2]},
        friends={"type": "ListRelationship", "objectList": [{"object": "urn:ngsi-ld:Person:demo:a"}]},
    )
    answer = http.post("/entities", json=entity)
    assert answer.status_code == 201
    assert answer.headers["location"] == f"/ngsi-ld/v1/entities/{entity['id']}"
    assert read(http, entity["id"]) == entity


def test_concise_entities_are_understood_and_written(http: httpx.Client) -> None:
    short = {
        "status": {"value": "pending", "observedAt": "2026-01-01T12:00:00Z"},
        "count": 3,
        "isDefinedBy": {"object": "urn:ngsi-ld:TaskDefinition:demo:x"},
        "where": {"type": "Point", "coordinates": [1, 2]},
        "label": {"languageMap": {"en": "part"}},
    }
    entity_id = made(http, "concise", **short)
    assert read(http, entity_id)["status"] == PENDING
    assert read(http, entity_id)["where"]["type"] == "GeoProperty"
    assert read(http, entity_id, options="concise") == task("concise", **short)
    assert read(http, entity_id, format="simplified") == task(
        "concise",
        status="pending",
        count=3,
        isDefinedBy="urn:ngsi-ld:TaskDefinition:demo:x",
        where={"type": "Point", "coordinates": [1, 2]},
        label={"languageMap": {"en": "part"}},
    )


def test_an_id_that_is_taken_is_refused(http: httpx.Client) -> None:
    made(http, "twice", status=PENDING)
    problem(http.post("/entities", json=task("twice")), 409, "AlreadyExists", "urn:ngsi-ld:Task:demo:twice")


@pytest.mark.parametrize(
    ("method", "path"),
    [
        ("GET", ""),
        ("DELETE", ""),
        ("PUT", ""),
        ("PATCH", ""),
        ("POST", "/attrs"),
        ("PATCH", "/attrs"),
        ("PATCH", "/attrs/status"),
        ("PUT", "/attrs/status"),
        ("DELETE", "/attrs/status"),
    ],
)
def test_what_is_not_there_is_not_found(http: httpx.Client, method: str, path: str) -> None:
    body = {"status": {"value": 1}} if "/attrs/" not in path else {"value": 1}
    content = {} if method in {"GET", "DELETE"} else {"json": body}
    answer = http.request(method, f"/entities/urn:ngsi-ld:Task:demo:nobody{path}", **content)
    problem(answer, 404, "ResourceNotFound", "urn:ngsi-ld:Task:demo:nobody")


def test_deleting_deletes_and_the_id_is_free_again(http: httpx.Client) -> None:
    entity_id = made(http, "gone", status=PENDING)
    assert http.delete(f"/entities/{entity_id}").status_code == 204
    assert http.get(f"/entities/{entity_id}").status_code == 404
    made(http, "gone", count=1)
    assert "status" not in read(http, entity_id)


def test_an_update_overwrites_what_is_there_and_names_what_is_not(http: httpx.Client) -> None:
    entity_id = made(http, "update", status=PENDING, keep=1)
    done = {"type": "Property", "value": "completed", "observedAt": "2026-01-01T12:00:05Z"}
    assert http.patch(f"/entities/{entity_id}/attrs", json={"status": done}).status_code == 204
    answer = http.patch(f"/entities/{entity_id}/attrs", json={"status": PENDING, "absent": 1})
    assert answer.status_code == 207
    assert answer.json()["updated"] == ["status"]
    assert [one["attributeName"] for one in answer.json()["notUpdated"]] == ["absent"]
    assert read(http, entity_id, options="keyValues") == task("update", status="pending", keep=1)


def test_appending_adds_and_overwrites_unless_told_not_to(http: httpx.Client) -> None:
    entity_id = made(http, "append", status=PENDING)
    assert http.post(f"/entities/{entity_id}/attrs", json={"status": "a", "more": 1}).status_code == 204
    answer = http.post(
        f"/entities/{entity_id}/attrs", params={"options": "noOverwrite"}, json={"status": "b", "other": 2}
    )
    assert answer.status_code == 207
    assert answer.json()["updated"] == ["other"]
    assert read(http, entity_id, options="keyValues") == task("append", status="a", more=1, other=2)


def test_merging_goes_into_values_and_null_deletes(http: httpx.Client) -> None:
    entity_id = made(
        http,
        "merge",
        outputParameters={"type": "Property", "value": {"progress": 0.1, "inner": {"a": 1, "b": 2}}},
        extra=1,
    )
    change = {
        "outputParameters": {
            "type": "Property",
            "value": {"progress": 0.5, "inner": {"a": "urn:ngsi-ld:null", "c": 3}},
        },
        "extra": "urn:ngsi-ld:null",
        "new": True,
    }
    answer = http.patch(
        f"/entities/{entity_id}", json=change, headers={"Content-Type": "application/merge-patch+json"}
    )
    assert answer.status_code == 204, answer.text
    assert read(http, entity_id, options="keyValues") == task(
        "merge", outputParameters={"progress": 0.5, "inner": {"b": 2, "c": 3}}, new=True
    )


def test_replacing_leaves_nothing_of_before_but_its_creation(http: httpx.Client) -> None:
    entity_id = made(http, "replace", status=PENDING, old=1)
    created_at = read(http, entity_id, options="sysAttrs")["createdAt"]
    assert http.put(f"/entities/{entity_id}", json=task("replace", fresh=2)).status_code == 204
    after = read(http, entity_id, options="sysAttrs,keyValues")
    assert after["createdAt"] == created_at < after["modifiedAt"]
    assert {"old", "status"}.isdisjoint(after)


def test_an_attribute_is_updated_in_part_replaced_and_deleted(http: httpx.Client) -> None:
    entity_id = made(http, "attr", speed={"value": 1, "unitCode": "MTS"})
    path = f"/entities/{entity_id}/attrs/speed"
    assert http.patch(path, json={"value": 2}).status_code == 204
    assert read(http, entity_id)["speed"] == {"type": "Property", "value": 2, "unitCode": "MTS"}
    assert http.patch(path, json={"unitCode": "KMH"}).status_code == 204
    assert read(http, entity_id)["speed"] == {"type": "Property", "value": 2, "unitCode": "KMH"}
    assert http.put(path, json={"type": "Property", "value": 3}).status_code == 204
    assert read(http, entity_id)["speed"] == {"type": "Property", "value": 3}
    assert http.delete(path).status_code == 204
    assert "speed" not in read(http, entity_id)
    problem(http.delete(path), 404, "ResourceNotFound", "speed")


def test_instances_are_told_apart_by_dataset(http: httpx.Client) -> None:
    instances = [
        {"type": "Property", "value": 1},
        {"type": "Property", "value": 2, "datasetId": "urn:gps"},
    ]
    entity_id = made(http, "datasets", speed=instances)
    assert read(http, entity_id)["speed"] == instances
    assert read(http, entity_id, options="keyValues")["speed"] == {"dataset": {"@none": 1, "urn:gps": 2}}
    path = f"/entities/{entity_id}/attrs/speed"
    assert http.patch(path, json={"value": 5, "datasetId": "urn:gps"}).status_code == 204
    assert http.delete(path).status_code == 204
    assert read(http, entity_id)["speed"] == {"type": "Property", "value": 5, "datasetId": "urn:gps"}
    problem(http.delete(path, params={"datasetId": "urn:radar"}), 404, "ResourceNotFound", "urn:radar")
    assert http.delete(path, params={"deleteAll": "true"}).status_code == 204
    assert "speed" not in read(http, entity_id)


def test_system_attributes_are_shown_when_asked_for(http: httpx.Client) -> None:
    entity_id = made(http, "times", status=PENDING)
    assert "createdAt" not in read(http, entity_id)
    assert "createdAt" not in read(http, entity_id)["status"]
    before = read(http, entity_id, options="sysAttrs")
    http.patch(f"/entities/{entity_id}/attrs", json={"status": PENDING})
    after = read(http, entity_id, options="sysAttrs")
    assert before["status"]["createdAt"] == after["status"]["createdAt"]
    assert before["status"]["modifiedAt"] < after["status"]["modifiedAt"] == after["modifiedAt"]


def test_attrs_limits_what_is_read(http: httpx.Client) -> None:
    entity_id = made(http, "limited", a=1, b=2)
    assert read(http, entity_id, attrs="b", options="keyValues") == task("limited", b=2)
    problem(http.get(f"/entities/{entity_id}", params={"attrs": "c"}), 404, "ResourceNotFound", "c")


def test_a_second_type_is_appended(http: httpx.Client) -> None:
    entity_id = made(http, "types", a=1)
    assert http.post(f"/entities/{entity_id}/attrs", json={"type": "Chore"}).status_code == 204
    assert read(http, entity_id)["type"] == ["Task", "Chore"]
    hits = http.get("/entities", params={"type": "Chore"}).json()
    assert [one["id"] for one in hits] == [entity_id]


def test_an_id_with_odd_signs_is_found_when_percent_encoded(http: httpx.Client) -> None:
    entity_id = made(http, "a/b?c#d")
    assert read(http, "urn:ngsi-ld:Task:demo:a%2Fb%3Fc%23d")["id"] == entity_id


def test_many_changes_at_once_all_count(shared_broker: Any, http: httpx.Client) -> None:
    from concurrent.futures import ThreadPoolExecutor

    entity_id = made(http, "crowd", a=0)

    def append(number: int) -> int:
        with shared_broker.client() as client:
            return client.post(f"/entities/{entity_id}/attrs", json={f"n{number}": number}).status_code

    with ThreadPoolExecutor(8) as pool:
        assert set(pool.map(append, range(80))) == {204}
    kept = read(http, entity_id, options="keyValues")
    assert {kept[f"n{number}"] for number in range(80)} == set(range(80))
