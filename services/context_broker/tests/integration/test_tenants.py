"""Tenants: isolated from each other, created by their first use (clauses 4.14, 5.5.10)."""

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import httpx
import psutil
import pytest

ERRORS = "https://uri.etsi.org/ngsi-ld/errors/"
MANY = 2000


def of(name: str) -> dict[str, str]:
    return {"NGSILD-Tenant": name}


def test_a_tenant_comes_into_being_with_the_first_thing_made_for_it(http: httpx.Client) -> None:
    for method, path in (
        ("GET", "/entities?type=T"),
        ("GET", "/entities/urn:x:1"),
        ("PATCH", "/entities/urn:x:1/attrs"),
        ("DELETE", "/entities/urn:x:1"),
        ("GET", "/types"),
        ("GET", "/attributes"),
        ("GET", "/subscriptions"),
        ("GET", "/jsonldContexts"),
        ("GET", "/csourceRegistrations?type=T"),
        ("GET", "/temporal/entities?type=T&timerel=before&timeAt=2036-01-01T00:00:00Z"),
        ("POST", "/entityOperations/delete"),
    ):
        answer = http.request(method, path, headers=of("not-yet"), json=[] if method == "POST" else None)
        if method in {"PATCH", "POST"}:
            assert answer.status_code in {400, 404, 415}, path
        else:
            assert answer.status_code == 404, path
        assert answer.json()["type"] == f"{ERRORS}NonexistentTenant", path
        assert answer.headers["ngsild-tenant"] == "not-yet"
    refused = http.post("/entities", json={"id": "urn:x:1"}, headers=of("not-yet"))
    assert refused.status_code == 400
    assert http.get("/types", headers=of("not-yet")).status_code == 404, "nothing was made"
    made = http.post("/entities", json={"id": "urn:x:1", "type": "T"}, headers=of("not-yet"))
    assert (made.status_code, made.headers["ngsild-tenant"]) == (201, "not-yet")
    assert http.get("/types", headers=of("not-yet")).json()["typeList"] == ["T"]
    assert http.delete("/entities/urn:x:1", headers=of("not-yet")).status_code == 204
    assert http.get("/types", headers=of("not-yet")).json()["typeList"] == [], "it stays when it is empty"


@pytest.mark.parametrize("name", ["a b", "ä", "x" * 200, "a/b", "a,b"])
def test_an_invalid_tenant_name_is_refused(http: httpx.Client, name: str) -> None:
    answer = http.post(
        "/entities", json={"id": "urn:x:1", "type": "T"}, headers={b"NGSILD-Tenant": name.encode()}
    )
    assert (answer.status_code, answer.json()["type"]) == (400, f"{ERRORS}BadRequestData")
    assert "A-Z, a-z, 0-9" in answer.json()["detail"]


def test_nothing_of_a_tenant_is_seen_by_another(http: httpx.Client) -> None:
    one, other = of("isolated-one"), of("isolated-other")
    entity = {"id": "urn:x:same", "type": "Same", "value1": 1}
    subscription = {
        "id": "urn:x:sub:same",
        "type": "Subscription",
        "entities": [{"type": "Same"}],
        "notification": {"endpoint": {"uri": "http://127.0.0.1:9/"}},
    }
    registration = {
        "id": "urn:x:reg:same",
        "type": "ContextSourceRegistration",
        "information": [{"entities": [{"type": "Elsewhere"}]}],
        "endpoint": "http://127.0.0.1:9",
    }
    for number, headers in enumerate((one, other)):
        assert http.post("/entities", json={**entity, "value1": number}, headers=headers).status_code == 201
    for path, document in (
        ("subscriptions", subscription),
        ("csourceSubscriptions", {**subscription, "id": "urn:x:sub:other"}),
        ("csourceRegistrations", registration),
    ):
        assert http.post(f"/{path}", json=document, headers=one).status_code == 201, path
        assert http.get(f"/{path}/{document['id']}", headers=one).status_code == 200, path
        for headers in (other, {}):
            assert http.get(f"/{path}/{document['id']}", headers=headers).status_code == 404, path
            assert http.delete(f"/{path}/{document['id']}", headers=headers).status_code == 404, path
    local = {"options": "keyValues", "local": "true"}
    for number, headers in enumerate((one, other)):
        read = http.get("/entities/urn:x:same", params=local, headers=headers)
        assert (read.json()["value1"], read.headers["ngsild-tenant"]) == (number, headers["NGSILD-Tenant"])
    assert http.get("/entities/urn:x:same", params=local).status_code == 404
    assert http.delete("/entities/urn:x:same?local=true", headers=one).status_code == 204
    assert http.get("/entities/urn:x:same", params=local, headers=other).status_code == 200


@pytest.mark.nightly
@pytest.mark.slow
def test_thousands_of_tenants_begin_at_once_and_are_there_after_a_power_cut(own_broker: Any) -> None:
    own_broker.start()
    memory = psutil.Process(own_broker.process.pid).memory_info
    before = memory().rss
    names = [f"tenant-{number}" for number in range(MANY)]
    with own_broker.client() as http, ThreadPoolExecutor(8) as pool:

        def create(name: str) -> int:
            entity = {"id": "urn:x:1", "type": "Thing", "owner": name}
            return int(http.post("/entities", json=entity, headers=of(name)).status_code)

        assert set(pool.map(create, names)) == {201}
    assert memory().rss - before < MANY * 20_000
    own_broker.kill()
    own_broker.start()
    with own_broker.client() as http:
        for name in names:
            found = http.get("/entities?type=Thing&options=keyValues", headers=of(name)).json()
            assert found == [{"id": "urn:x:1", "type": "Thing", "owner": name}]
        assert http.get("/entities?type=Thing").json() == []
        assert own_broker.metric("handover_broker_entities") == MANY


def test_simultaneous_first_notifications_are_all_delivered(http: httpx.Client) -> None:
    with ThreadPoolExecutor(16) as pool:
        answers = list(
            pool.map(
                lambda number: http.post(
                    "/entities", json={"id": f"urn:x:{number}", "type": "First"}, headers=of("rush")
                ),
                range(48),
            )
        )
    assert {answer.status_code for answer in answers} == {201}
    counted = http.get("/entities?type=First&limit=0&count=true", headers=of("rush"))
    assert counted.headers["ngsild-results-count"] == "48"
