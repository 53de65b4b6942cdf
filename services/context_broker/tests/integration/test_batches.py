"""Batches over HTTP: each entity has its own result."""

import json
from typing import Any

import httpx
import pytest


def lamp(name: str, **attributes: Any) -> dict[str, Any]:
    return {"id": f"urn:ngsi-ld:Lamp:demo:{name}", "type": "Lamp", **attributes}


def read(http: httpx.Client, name: str) -> Any:
    return http.get(f"/entities/urn:ngsi-ld:Lamp:demo:{name}", params={"options": "keyValues"}).json()


def post(http: httpx.Client, operation: str, body: Any, **parameters: str) -> httpx.Response:
    return http.post(f"/entityOperations/{operation}", json=body, params=parameters)


@pytest.mark.nightly
def test_a_batch_creates_what_it_can_and_reports_the_rest(http: httpx.Client) -> None:
    answer = post(http, "create", [lamp("a"), lamp("b", lit=True)])
    assert answer.status_code == 201
    assert answer.json() == [lamp("a")["id"], lamp("b")["id"]]
    answer = post(http, "create", [lamp("a"), lamp("c"), {"id": "no uri", "type": "Lamp"}, 7])
    assert answer.status_code == 207
    body = answer.json()
    assert body["success"] == [lamp("c")["id"]]
    assert [one["error"]["status"] for one in body["errors"]] == [409, 400, 400]
    assert body["errors"][0]["entityId"] == lamp("a")["id"]


def test_an_upsert_replaces_or_updates(http: httpx.Client) -> None:
    assert post(http, "upsert", [lamp("u", a=1, b=2)]).status_code == 201
    assert post(http, "upsert", [lamp("u", a=5)], options="update").status_code == 204
    assert read(http, "u") == lamp("u", a=5, b=2)
    answer = post(http, "upsert", [lamp("u", a=6), lamp("v")])
    assert answer.status_code == 201
    assert answer.json() == [lamp("v")["id"]]
    assert read(http, "u") == lamp("u", a=6)
    assert post(http, "upsert", [lamp("u")], options="update,replace").status_code == 400


def test_one_batch_may_speak_of_an_entity_twice(http: httpx.Client) -> None:
    assert post(http, "upsert", [lamp("w", a=1), lamp("w", b=2)], options="update").status_code == 201
    assert read(http, "w") == lamp("w", a=1, b=2)


def test_batches_update_merge_and_delete(http: httpx.Client) -> None:
    post(http, "create", [lamp("x", a={"value": {"p": 1}}), lamp("y", a=1)])
    assert post(http, "merge", [lamp("x", a={"value": {"q": 2}})]).status_code == 204
    assert read(http, "x")["a"] == {"p": 1, "q": 2}
    answer = post(http, "update", [lamp("y", a=2, b=3), lamp("nobody", a=1)])
    assert answer.status_code == 207
    assert answer.json()["errors"][0]["error"]["status"] == 404
    assert read(http, "y") == lamp("y", a=2, b=3)
    answer = post(http, "update", [lamp("y", a=9, c=4)], options="noOverwrite")
    assert answer.status_code == 207
    assert read(http, "y") == lamp("y", a=2, b=3, c=4)
    answer = post(http, "delete", [lamp("x")["id"], lamp("nobody")["id"], lamp("y")["id"]])
    assert answer.status_code == 207
    assert answer.json()["success"] == [lamp("x")["id"], lamp("y")["id"]]


def test_an_invalid_batch_is_refused(http: httpx.Client) -> None:
    bodies: tuple[Any, ...] = ({}, [], "x")
    for operation in ("create", "upsert", "update", "merge", "delete"):
        for body in bodies:
            assert post(http, operation, body).status_code == 400, (operation, body)


def test_each_entity_of_a_batch_may_bring_its_own_context(http: httpx.Client) -> None:
    given = [
        lamp("own", size=1)
        | {"@context": {"size": "https://a.example/size", "Lamp": "https://a.example/Lamp"}},
        lamp("none", size=2),
    ]
    answer = http.post(
        "/entityOperations/create",
        content=json.dumps(given),
        headers={"Content-Type": "application/ld+json"},
    )
    assert answer.status_code == 207
    assert answer.json()["success"] == [lamp("own")["id"]]
    assert "@context" in answer.json()["errors"][0]["error"]["detail"]
    assert read(http, "own")["https://a.example/size"] == 1


def test_a_batch_with_null_in_it_is_refused_as_a_whole(http: httpx.Client) -> None:
    for operation in ("create", "upsert", "update", "merge"):
        assert post(http, operation, [lamp("sibling"), None]).status_code == 400
        assert http.get("/entities/urn:ngsi-ld:Lamp:demo:sibling").status_code == 404
    assert post(http, "delete", [None]).status_code == 400


def test_batches_may_be_in_simplified_form(http: httpx.Client) -> None:
    simple = lamp(
        "simple", at={"type": "Relationship", "object": "urn:x:1"}, label={"languageMap": {"en": "a"}}
    )
    assert post(http, "create", [simple]).status_code == 201
    change = lamp("simple", at="urn:x:2", label={"languageMap": {"fi": "b"}})
    assert post(http, "merge", [change], options="keyValues").status_code == 204
    entity = http.get(f"/entities/{simple['id']}").json()
    assert entity["at"] == {"type": "Relationship", "object": "urn:x:2"}
    assert entity["label"]["languageMap"] == {"en": "a", "fi": "b"}
    assert post(http, "update", [lamp("simple", at="urn:x:3")], options="keyValues").status_code == 204
    assert (
        post(http, "upsert", [lamp("simple", c=1)], options="update", format="simplified").status_code == 204
    )
    assert read(http, "simple") == lamp(
        "simple", at="urn:x:3", label={"languageMap": {"en": "a", "fi": "b"}}, c=1
    )
    assert post(http, "upsert", [lamp("new", c={"json": {"d": 1}})], options="keyValues").status_code == 201
    assert http.get("/entities/urn:ngsi-ld:Lamp:demo:new").json()["c"]["type"] == "JsonProperty"
    assert post(http, "merge", [change], options="odd").status_code == 400


def test_a_batch_merge_deletes_what_is_null_and_leaves_the_rest(http: httpx.Client) -> None:
    null = "urn:ngsi-ld:null"
    assert post(http, "create", [lamp("null", a=1, b={"value": {"x": 1, "y": 2}})]).status_code == 201
    answer = post(http, "merge", [lamp("null", a=null, b={"value": {"x": null}}), lamp("nowhere", a=1)])
    assert answer.status_code == 207
    assert answer.json()["success"] == [lamp("null")["id"]]
    assert [one["entityId"] for one in answer.json()["errors"]] == [lamp("nowhere")["id"]]
    assert read(http, "null") == lamp("null", b={"y": 2})
    answer = post(http, "create", [lamp("never", a=null)])
    assert answer.status_code == 207
    assert answer.json()["success"] == []


def test_an_invalid_element_is_reported_before_a_missing_entity(http: httpx.Client) -> None:
    wrong = {"id": "urn:ngsi-ld:Lamp:demo:absent", "type": "Lamp", "on": {"type": "Nonsense", "value": 1}}
    for operation in ("update", "merge"):
        (error,) = post(http, operation, [wrong]).json()["errors"]
        assert error["entityId"] == wrong["id"]
        assert error["error"]["type"].endswith("BadRequestData"), operation
    absent = {**wrong, "on": {"type": "Property", "value": 1}}
    for operation in ("update", "merge"):
        (error,) = post(http, operation, [absent]).json()["errors"]
        assert error["error"]["type"].endswith("ResourceNotFound"), operation


def test_a_link_header_beside_a_context_in_the_body_is_one_fault_of_the_request(http: httpx.Client) -> None:
    link = '<https://a.example/c>; rel="http://www.w3.org/ns/json-ld#context"; type="application/ld+json"'
    headers = {"Content-Type": "application/ld+json", "Link": link}
    context = "https://uri.etsi.org/ngsi-ld/v1/ngsi-ld-core-context-v1.8.jsonld"
    entities = [{**lamp(name), "@context": context} for name in ("linked-1", "linked-2")]
    for operation in ("create", "upsert", "update", "merge"):
        answer = http.post(f"/entityOperations/{operation}", json=entities, headers=headers)
        assert answer.status_code == 400, operation
        assert answer.json()["type"].endswith("BadRequestData")
        assert "Link" in answer.json()["detail"]
    assert http.get(f"/entities/{entities[0]['id']}").status_code == 404
