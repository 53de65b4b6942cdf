"""Entities over HTTP: creation, reading, all kinds of changes, deletion."""

from typing import Any

import httpx
import pytest

DEFAULT = "https://uri.etsi.org/ngsi-ld/default-context/"
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
    assert answer.headers["content-type"] == "application/json"
    body = answer.json()
    assert body["type"] == f"https://uri.etsi.org/ngsi-ld/errors/{kind}"
    assert body["status"] == status
    for word in words:
        assert word in body["detail"]


@pytest.mark.nightly
def test_a_created_entity_is_read_back_unchanged(http: httpx.Client) -> None:
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
def test_a_missing_entity_is_not_found(http: httpx.Client, method: str, path: str) -> None:
    body = {"status": {"value": 1}} if "/attrs/" not in path else {"value": 1}
    content: dict[str, Any] = {} if method in {"GET", "DELETE"} else {"json": body}
    answer = http.request(method, f"/entities/urn:ngsi-ld:Task:demo:nobody{path}", **content)
    problem(answer, 404, "ResourceNotFound", "urn:ngsi-ld:Task:demo:nobody")


def test_deleting_deletes_and_the_id_is_free_again(http: httpx.Client) -> None:
    entity_id = made(http, "gone", status=PENDING)
    assert http.delete(f"/entities/{entity_id}").status_code == 204
    assert http.get(f"/entities/{entity_id}").status_code == 404
    made(http, "gone", count=1)
    assert "status" not in read(http, entity_id)


def test_an_update_overwrites_what_is_there_and_adds_what_is_not(http: httpx.Client) -> None:
    entity_id = made(http, "update", status=PENDING, keep=1)
    done = {"type": "Property", "value": "completed", "observedAt": "2026-01-01T12:00:05Z"}
    assert http.patch(f"/entities/{entity_id}/attrs", json={"status": done}).status_code == 204
    more = {"status": PENDING, "more": 1, "absent": "urn:ngsi-ld:null", "scope": "/ignored"}
    assert http.patch(f"/entities/{entity_id}/attrs", json=more).status_code == 204
    assert read(http, entity_id, options="keyValues") == task("update", status="pending", keep=1, more=1)


def test_append_adds_and_overwrites_unless_no_overwrite_is_set(http: httpx.Client) -> None:
    entity_id = made(http, "append", status=PENDING)
    assert http.post(f"/entities/{entity_id}/attrs", json={"status": "a", "more": 1}).status_code == 204
    answer = http.post(
        f"/entities/{entity_id}/attrs", params={"options": "noOverwrite"}, json={"status": "b", "other": 2}
    )
    assert answer.status_code == 207
    assert answer.json()["updated"] == [DEFAULT + "other"]
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


def test_instances_are_distinguished_by_dataset(http: httpx.Client) -> None:
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


def test_system_attributes_are_returned_on_request(http: httpx.Client) -> None:
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
    assert http.post(f"/entities/{entity_id}/attrs", json={"type": "Job"}).status_code == 204
    assert read(http, entity_id)["type"] == ["Task", "Job"]
    hits = http.get("/entities", params={"type": "Job"}).json()
    assert [one["id"] for one in hits] == [entity_id]


def test_an_id_with_odd_signs_is_found_when_percent_encoded(http: httpx.Client) -> None:
    entity_id = made(http, "a/b?c#d")
    assert read(http, "urn:ngsi-ld:Task:demo:a%2Fb%3Fc%23d")["id"] == entity_id


def test_many_changes_at_once_all_count(shared_broker: Any, http: httpx.Client) -> None:
    from concurrent.futures import ThreadPoolExecutor

    entity_id = made(http, "crowd", a=0)

    def append(number: int) -> int:
        with shared_broker.client() as client:
            return int(client.post(f"/entities/{entity_id}/attrs", json={f"n{number}": number}).status_code)

    with ThreadPoolExecutor(8) as pool:
        assert set(pool.map(append, range(80))) == {204}
    kept = read(http, entity_id, options="keyValues")
    assert {kept[f"n{number}"] for number in range(80)} == set(range(80))


def test_a_merge_may_be_in_simplified_form_and_each_attribute_stays_of_its_kind(http: httpx.Client) -> None:
    entity_id = made(
        http,
        "simplified-merge",
        speed={"value": 1, "unitCode": "MTS", "observedAt": "2026-01-01T12:00:00Z"},
        at={"object": "urn:ngsi-ld:Place:demo:a"},
        label={"languageMap": {"en": "part", "fi": "osa"}},
        mood={"vocab": "calm"},
        raw={"json": {"a": 1, "b": 2}},
    )
    change = {
        "speed": 2,
        "at": "urn:ngsi-ld:Place:demo:b",
        "label": "pièce",
        "mood": {"vocab": "keen"},
        "raw": {"json": {"b": 3}},
        "new": {"languageMap": {"en": "new"}},
    }
    answer = http.patch(
        f"/entities/{entity_id}",
        params={"options": "keyValues", "lang": "fr", "observedAt": "2026-01-02T12:00:00Z"},
        json=change,
    )
    assert answer.status_code == 204, answer.text
    entity = read(http, entity_id)
    assert entity["speed"] == {
        "type": "Property",
        "value": 2,
        "unitCode": "MTS",
        "observedAt": "2026-01-02T12:00:00Z",
    }
    assert entity["at"] == {"type": "Relationship", "object": "urn:ngsi-ld:Place:demo:b"}
    assert entity["label"]["languageMap"] == {"en": "part", "fi": "osa", "fr": "pièce"}
    assert entity["mood"] == {"type": "VocabProperty", "vocab": "keen"}
    assert entity["raw"]["json"] == {"a": 1, "b": 3}
    assert entity["new"]["type"] == "LanguageProperty"


def test_a_merge_may_leave_values_unsaid(http: httpx.Client) -> None:
    entity_id = made(
        http,
        "unsaid",
        speed={"value": 1, "unitCode": "MTS", "accuracy": {"value": 0.1, "unitCode": "MTS"}},
        label={"languageMap": {"en": "part", "fi": "osa"}},
    )
    change = {
        "speed": {"type": "Property", "unitCode": "KMH", "accuracy": {"unitCode": "KMH"}},
        "label": {"type": "LanguageProperty", "languageMap": {"fi": "urn:ngsi-ld:null"}},
    }
    assert http.patch(f"/entities/{entity_id}", json=change).status_code == 204
    assert read(http, entity_id, options="concise") == task(
        "unsaid",
        speed={"value": 1, "unitCode": "KMH", "accuracy": {"value": 0.1, "unitCode": "KMH"}},
        label={"languageMap": {"en": "part"}},
    )


def test_bodies_may_be_in_simplified_form(http: httpx.Client) -> None:
    simple = task(
        "simple", a=1, label={"languageMap": {"en": "part"}}, both={"dataset": {"@none": 1, "urn:x:1": 2}}
    )
    form = {"options": "keyValues"}
    assert http.post("/entities", params=form, json=simple).status_code == 201
    path = "/entities/urn:ngsi-ld:Task:demo:simple"
    assert read(http, simple["id"], options="keyValues") == simple
    assert (
        http.patch(f"{path}/attrs", params=form, json={"label": {"languageMap": {"fi": "osa"}}}).status_code
        == 204
    )
    assert http.post(f"{path}/attrs", params={"format": "simplified"}, json={"b": 2}).status_code == 204
    assert read(http, simple["id"])["label"] == {"type": "LanguageProperty", "languageMap": {"fi": "osa"}}
    replaced = task("simple", c={"json": {"x": 1}})
    assert http.put(path, params=form, json=replaced).status_code == 204
    assert read(http, simple["id"], options="keyValues") == replaced
    problem(http.post("/entities", params={"format": "odd"}, json=simple), 400, "InvalidRequest", "odd")


def test_scopes_are_kept_changed_and_deleted(http: httpx.Client) -> None:
    entity_id = made(http, "scopes", scope=["/Madrid", "/Gardens/North_2"], a=1)
    assert read(http, entity_id)["scope"] == ["/Madrid", "/Gardens/North_2"]
    path = f"/entities/{entity_id}"
    assert (
        http.post(f"{path}/attrs", params={"options": "noOverwrite"}, json={"scope": "/New"}).status_code
        == 204
    )
    assert read(http, entity_id)["scope"] == ["/Madrid", "/Gardens/North_2", "/New"]
    assert http.post(f"{path}/attrs", json={"scope": "/Only"}).status_code == 204
    assert read(http, entity_id, options="keyValues") == task("scopes", scope="/Only", a=1)
    problem(http.patch(f"{path}/attrs/scope", json={"value": "/B"}), 400, "BadRequestData", "scope")
    assert http.delete(f"{path}/attrs/scope").status_code == 204
    assert "scope" not in read(http, entity_id)
    problem(http.delete(f"{path}/attrs/scope"), 404, "ResourceNotFound", "scope")
    assert http.patch(f"{path}/attrs", json={"scope": "/B", "a": 2}).status_code == 204
    assert "scope" not in read(http, entity_id)
    assert http.patch(path, json={"scope": "/C"}).status_code == 204
    assert http.patch(path, json={"scope": "urn:ngsi-ld:null"}).status_code == 204
    assert "scope" not in read(http, entity_id)


@pytest.mark.parametrize(
    ("method", "path", "body"),
    [
        ("GET", "", None),
        ("PATCH", "", {"a": 2}),
        ("PUT", "", {"type": "Task", "a": 2}),
        ("POST", "/attrs", {"a": 2}),
        ("PATCH", "/attrs", {"a": 2}),
        ("PATCH", "/attrs/a", {"value": 2}),
        ("PUT", "/attrs/a", {"value": 2}),
        ("DELETE", "/attrs/a", None),
        ("DELETE", "", None),
    ],
)
def test_an_operation_may_ask_for_an_entity_of_a_type(
    http: httpx.Client, method: str, path: str, body: dict[str, Any] | None
) -> None:
    entity_id = f"urn:ngsi-ld:Task:demo:typed{method}{path.replace('/', '-')}"
    assert http.post("/entities", json={"id": entity_id, "type": ["Task", "Job"], "a": 1}).status_code == 201
    for kind, wanted in (("Alert", 404), ("(Task;Alert)", 404), ("Alert,Job", 200), ("Task", 200)):
        answer = http.request(method, f"/entities/{entity_id}{path}", params={"type": kind}, json=body)
        if wanted == 404:
            problem(answer, 404, "ResourceNotFound", entity_id)
        else:
            assert answer.status_code in {200, 204}, answer.text
            break


def test_null_is_accepted_only_where_it_has_a_meaning(http: httpx.Client) -> None:
    null = "urn:ngsi-ld:null"
    entity_id = made(
        http,
        "nulls",
        a=1,
        address={"value": {"city": "B", "street": "S"}},
        label={"languageMap": {"en": "x"}},
    )
    path = f"/entities/{entity_id}"
    for method, where, body in (
        ("POST", "/attrs", {"a": null}),
        ("PUT", "", task("nulls", a=null)),
        ("PUT", "/attrs/a", {"value": null}),
        ("PATCH", "/attrs", {"address": {"value": {"city": null}}}),
        ("PATCH", "/attrs/address", {"value": {"city": null}}),
        ("PATCH", "/attrs/a", {"datasetId": null}),
        ("PATCH", "", {"id": null}),
        ("PATCH", "", {"type": null}),
    ):
        problem(http.request(method, path + where, json=body), 400, "BadRequestData")
    hidden = b'{"a": {"value": "urn:ngsi-ld:nul\\u006c"}}'
    problem(http.post(f"{path}/attrs", content=hidden, headers=JSON), 400, "BadRequestData")
    for method, where, body in (
        ("PATCH", "", {"address": {"value": {"city": null}}}),
        ("PATCH", "/attrs", {"a": {"type": "Property", "value": null}}),
        ("PATCH", "/attrs/label", {"languageMap": {"@none": null}}),
    ):
        assert http.request(method, path + where, json=body).status_code == 204
    assert read(http, entity_id, options="keyValues") == task("nulls", address={"street": "S"})


def test_instances_that_are_there_stay_when_nothing_is_to_be_overwritten(http: httpx.Client) -> None:
    entity_id = made(http, "instances", speed=1)
    path = f"/entities/{entity_id}/attrs"
    both = [{"type": "Property", "value": 5}, {"type": "Property", "value": 2, "datasetId": "urn:x:gps"}]
    answer = http.post(path, params={"options": "noOverwrite"}, json={"speed": both})
    assert answer.status_code == 207
    assert answer.json()["updated"] == [DEFAULT + "speed"]
    assert [one["attributeName"] for one in answer.json()["notUpdated"]] == [DEFAULT + "speed"]
    assert read(http, entity_id, options="keyValues")["speed"] == {"dataset": {"@none": 1, "urn:x:gps": 2}}
    answer = http.put(f"{path}/speed", json={"value": 3, "datasetId": "urn:x:radar"})
    problem(answer, 404, "ResourceNotFound", "urn:x:radar")


def test_the_kind_of_an_attribute_is_not_changed_in_part(http: httpx.Client) -> None:
    entity_id = made(http, "kind", a=1, at={"object": "urn:x:1"})
    for name, part in (
        ("a", {"object": "urn:x:2"}),
        ("a", {"type": "Relationship", "object": "urn:x:2"}),
        ("at", {"type": "Property", "value": 1}),
        ("a", {"type": "JsonProperty"}),
    ):
        problem(http.patch(f"/entities/{entity_id}/attrs/{name}", json=part), 400, "BadRequestData", name)
    assert http.put(f"/entities/{entity_id}/attrs/a", json={"object": "urn:x:2"}).status_code == 204
    assert read(http, entity_id)["a"] == {"type": "Relationship", "object": "urn:x:2"}


def test_an_attribute_may_be_called_value_as_in_the_published_device(http: httpx.Client) -> None:
    device = {
        "id": "urn:ngsi-ld:Device:demo:value",
        "type": "Device",
        "value": {"type": "Property", "value": 7},
    }
    assert http.post("/entities", json=device).status_code == 201
    assert http.get(f"/entities/{device['id']}").json() == device
