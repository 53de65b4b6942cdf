"""Three brokers in a ring, each a source of the one before it: loops end."""

from collections.abc import Iterator
from typing import Any

import httpx
import pytest

from tests.kit.context_sources import ScriptedSource, put, register, values

OPERATIONS = [
    "redirectionOps", "queryBatch", "retrieveTemporal", "queryTemporal", "createBatch", "upsertBatch",
    "updateBatch", "mergeBatch", "deleteBatch", "upsertTemporal", "appendAttrsTemporal", "deleteTemporal",
    "deleteAttrsTemporal", "createSubscription", "createEntityMapQueryTemporal",
]  # fmt: skip
SINCE_ALWAYS = {"timerel": "after", "timeAt": "2020-01-01T00:00:00Z"}


@pytest.fixture
def ring(brokers: list[Any], kind: str) -> Iterator[list[httpx.Client]]:
    """Clients of three brokers registered in a ring, without aliases."""
    clients = [one.client() for one in brokers]
    paths = [
        register(client, brokers[(place + 1) % 3].url, {"type": kind}, operations=OPERATIONS)
        for place, client in enumerate(clients)
    ]
    yield clients
    for client, path in zip(clients, paths, strict=True):
        client.delete(path)
        client.close()


def held(client: httpx.Client, entity_id: str) -> dict[str, Any] | None:
    """Return a broker's own part of an entity."""
    answer = client.get(f"/entities/{entity_id}?local=true")
    return values(answer) if answer.status_code == 200 else None


def test_changes_pass_a_ring_once(ring: list[httpx.Client], kind: str) -> None:
    one = f"urn:ngsi-ld:{kind}:1"
    entity = {"id": one, "type": kind, "n": 1}
    at, batch = f"/entities/{one}", "/entityOperations"
    steps: list[tuple[str, str, Any, int, dict[str, Any] | None]] = [
        ("POST", "/entities", entity, 201, {"n": 1}),
        ("PATCH", f"{at}/attrs", {"n": 2}, 204, {"n": 2}),
        ("POST", f"{at}/attrs", {"m": 1}, 204, {"n": 2, "m": 1}),
        ("PATCH", at, {"n": 3}, 204, {"n": 3, "m": 1}),
        ("PATCH", f"{at}/attrs/n", {"value": 4}, 204, {"n": 4, "m": 1}),
        ("DELETE", f"{at}/attrs/m", None, 204, {"n": 4}),
        ("PUT", at, {**entity, "n": 5}, 204, {"n": 5}),
        ("POST", f"{batch}/upsert", [{**entity, "n": 6}], 204, {"n": 6}),
        ("POST", f"{batch}/merge", [{**entity, "n": 7}], 204, {"n": 7}),
        ("POST", f"{batch}/update", [{**entity, "n": 8}], 204, {"n": 8}),
        ("DELETE", at, None, 204, None),
        ("POST", f"{batch}/create", [entity], 201, {"n": 1}),
        ("DELETE", f"/entities?type={kind}", None, 204, None),
        ("POST", f"{batch}/upsert", [entity], 201, {"n": 1}),
        ("POST", f"{batch}/delete", [one], 204, None),
    ]
    for place, (method, path, body, status, state) in enumerate(steps):
        answer = ring[place % 3].request(method, path, json=body)
        assert answer.status_code == status, (place, answer.text)
        assert "ngsild-warning" not in answer.headers
        assert [held(client, one) for client in ring] == [state] * 3, place


def test_each_broker_of_a_ring_gets_a_created_entity(ring: list[httpx.Client], kind: str) -> None:
    entity: dict[str, Any] = {"id": f"urn:ngsi-ld:{kind}:1", "type": kind, "n": 1}
    assert ring[0].post("/entities", json=entity).status_code == 201
    assert [held(client, entity["id"]) for client in ring] == [{"n": 1}] * 3
    past = {
        "id": f"urn:ngsi-ld:{kind}:2",
        "type": kind,
        "n": [{"type": "Property", "value": 1, "observedAt": "2026-01-01T00:00:00Z"}],
    }
    made = ring[1].post("/temporal/entities", json=past)
    assert made.status_code == 201, made.text
    for client in ring:
        notified = client.get(f"/temporal/entities/{past['id']}", params={**SINCE_ALWAYS, "local": "true"})
        assert [one["value"] for one in notified.json()["n"]] == [1]


def test_queries_in_a_ring_end_with_complete_results(ring: list[httpx.Client], kind: str) -> None:
    one = f"urn:ngsi-ld:{kind}:1"
    for place, client in enumerate(ring):
        put(client, one, kind, **{f"n{place}": place})
        put(client, f"{one}{place}", kind, n=place)
    times = {**SINCE_ALWAYS, "timeproperty": "modifiedAt"}
    totals = {**times, "options": "aggregatedValues", "aggrMethods": "totalCount"}
    query = {"type": "Query", "entities": [{"type": kind}]}
    for client in ring:
        assert values(client.get(f"/entities/{one}")) == {"n0": 0, "n1": 1, "n2": 2}
        answers = [
            client.get("/entities", params={"type": kind}),
            client.get("/entities", params={"type": kind, "entityMap": "true"}),
            client.post("/entityOperations/query", json=query),
            client.get("/temporal/entities", params={"type": kind, **times}),
            client.get("/temporal/entities", params={"type": kind, "entityMap": "true", **times}),
            client.get("/temporal/entities", params={"type": kind, **totals}),
            client.post("/temporal/entityOperations/query", json={**query, "temporalQ": times}),
        ]
        for place, answer in enumerate(answers):
            assert answer.status_code in {200, 201}, (place, answer.text)
            assert "ngsild-warning" not in answer.headers, (place, answer.headers)
            found = {said["id"]: said for said in answer.json()}
            assert found.keys() == {one, f"{one}0", f"{one}1", f"{one}2"}, place
            assert {"n0", "n1", "n2"} <= found[one].keys(), place
        details = client.get(f"/types/{kind}").json()
        assert {each["attributeName"] for each in details["attributeDetails"]} == {"n", "n0", "n1", "n2"}


@pytest.mark.parametrize(
    "request_",
    [
        ("GET", "/entities/{id}", None),
        ("GET", "/entities?type={kind}", None),
        ("GET", "/entityMaps?type={kind}", None),
        ("GET", "/temporal/entities/{id}", None),
        ("GET", "/temporal/entities?type={kind}&timerel=after&timeAt=2020-01-01T00:00:00Z", None),
        ("GET", "/temporal/entityMaps?type={kind}&timerel=after&timeAt=2020-01-01T00:00:00Z", None),
        ("GET", "/types", None),
        ("GET", "/types/{kind}", None),
        ("GET", "/attributes", None),
        ("GET", "/attributes/n", None),
        ("POST", "/entities", {"id": "{id}", "type": "{kind}"}),
        ("POST", "/entityOperations/query", {"type": "Query", "entities": [{"type": "{kind}"}]}),
        ("POST", "/entityOperations/upsert", [{"id": "{id}", "type": "{kind}"}]),
        ("POST", "/entityOperations/delete", ["{id}"]),
        ("POST", "/temporal/entities", {"id": "{id}", "type": "{kind}"}),
        ("POST", "/subscriptions", {"type": "Subscription", "entities": [{"type": "{kind}"}]}),
        ("PATCH", "/entities/{id}", {"n": 2}),
        ("PATCH", "/entities/{id}/attrs", {"n": 2}),
        ("PATCH", "/entities/{id}/attrs/n", {"value": 2}),
        ("PUT", "/entities/{id}", {"id": "{id}", "type": "{kind}"}),
        ("DELETE", "/entities/{id}", None),
        ("DELETE", "/entities/{id}/attrs/n", None),
        ("DELETE", "/entities?type={kind}", None),
        ("DELETE", "/temporal/entities/{id}", None),
    ],
)
def test_a_returning_request_is_a_loop_and_is_not_forwarded(
    near: httpx.Client, source: ScriptedSource, kind: str, request_: tuple[str, str, Any]
) -> None:
    method, path, body = request_
    one = f"urn:ngsi-ld:{kind}:1"
    register(near, source.url, {"type": kind}, operations=OPERATIONS)
    near.get(f"/entities/{one}")
    via = source.asked.pop()[3]["via"]
    put(near, one, kind, n=1)

    def filled(said: Any) -> Any:
        if isinstance(said, str):
            return said.replace("{id}", one).replace("{kind}", kind)
        if isinstance(said, dict):
            return {name: filled(each) for name, each in said.items()}
        return [filled(each) for each in said] if isinstance(said, list) else said

    answer = near.request(method, filled(path), json=filled(body), headers={"Via": f"1.1 first, {via}"})
    assert answer.status_code == 508, answer.text
    assert answer.json()["type"].endswith("LoopDetected")
    assert source.asked == []
    assert held(near, one) == {"n": 1}
    near.delete(f"/entities/{one}?local=true")
