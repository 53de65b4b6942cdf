"""No document of one client makes the request of another fail, at once, later, or after a restart."""

import json
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import httpx
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from handover_broker.storage import checksums
from services.context_broker.tests.integration.conftest import BrokerProcess

ENDPOINT = {"uri": "http://127.0.0.1:9/n"}
WHOLE: dict[str, dict[str, Any]] = {
    "/subscriptions": {
        "id": "urn:ngsi-ld:Subscription:{}",
        "type": "Subscription",
        "subscriptionName": "one",
        "description": "one",
        "entities": [{"type": "Task", "id": "urn:ngsi-ld:Task:1", "idPattern": ".*"}],
        "watchedAttributes": ["status"],
        "notificationTrigger": ["entityCreated"],
        "q": "status==1",
        "geoQ": {"georel": "near;maxDistance==1", "geometry": "Point", "coordinates": [8, 47]},
        "scopeQ": "/a",
        "csf": "endpoint",
        "isActive": True,
        "expiresAt": "2099-01-01T00:00:00Z",
        "throttling": 1,
        "lang": "fr",
        "datasetId": ["@none"],
        "expandValues": "status",
        "localOnly": False,
        "ngsildConformance": "1.6",
        "notification": {
            "attributes": ["status"],
            "format": "normalized",
            "sysAttrs": True,
            "showChanges": False,
            "join": "inline",
            "joinLevel": 1,
            "endpoint": {
                **ENDPOINT,
                "accept": "application/json",
                "timeout": 1,
                "cooldown": 1,
                "receiverInfo": [{"key": "X-Cell", "value": "4"}],
                "notifierInfo": [{"key": "X-Cell", "value": "4"}],
            },
        },
    },
    "/csourceRegistrations": {
        "id": "urn:ngsi-ld:ContextSourceRegistration:{}",
        "type": "ContextSourceRegistration",
        "registrationName": "one",
        "endpoint": "http://127.0.0.1:9",
        "information": [
            {"entities": [{"type": "Task", "id": "urn:ngsi-ld:Task:1"}], "propertyNames": ["status"]}
        ],
        "contextSourceInfo": [{"key": "X-Cell", "value": "4"}],
        "scope": ["/a"],
        "mode": "inclusive",
        "operations": ["retrieveOps"],
        "management": {"timeout": 1, "cooldown": 1, "localOnly": True},
        "location": {"type": "Point", "coordinates": [8, 47]},
        "observationInterval": {"startAt": "2026-01-01T00:00:00Z", "endAt": "2027-01-01T00:00:00Z"},
        "expiresAt": "2099-01-01T00:00:00Z",
        "datasetId": ["@none"],
        "level": {"type": "Property", "value": 1},
    },
    "/snapshots": {
        "id": "urn:ngsi-ld:Snapshot:{}",
        "type": "Snapshot",
        "snapshotQueries": [{"type": "Query", "entities": [{"type": "Task"}]}],
        "snapshotPriority": 3,
        "snapshotLifetime": "PT1H",
        "endpoint": ENDPOINT["uri"],
        "receiverInfo": [{"key": "X-Cell", "value": "4"}],
    },
}
WHOLE["/csourceSubscriptions"] = {
    **WHOLE["/subscriptions"], "id": "urn:ngsi-ld:Subscription:of-sources-{}",
}  # fmt: skip


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the path of every value in a document."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for name, one in items:
        yield (*path, name)
        yield from places(one, (*path, name))


def replaced(document: Any, path: tuple[Any, ...], value: Any) -> Any:
    """Return a copy of a document with another value at a path."""
    if not path:
        return value
    copied = list(document) if isinstance(document, list) else dict(document)
    copied[path[0]] = replaced(copied[path[0]], path[1:], value)
    return copied


PLACES = [(at, path) for at, document in WHOLE.items() for path in places(document)]


def require_all_reads(http: httpx.Client) -> None:
    """Require that another client can read, create, change and delete."""
    for at in (
        *("/subscriptions", "/subscriptions?options=sysAttrs", "/csourceSubscriptions"),
        *("/csourceRegistrations?type=Task", "/csourceRegistrations?csf=endpoint", "/types", "/attributes"),
        *("/types?details=true", "/entities?type=Task&local=true", "/entities?type=Task", "/jsonldContexts"),
        "/temporal/entities?type=Task&timerel=after&timeAt=1970-01-01T00:00:00Z",
    ):
        for media_type in ("application/json", "application/ld+json"):
            answer = http.get(at, headers={"Accept": media_type})
            assert answer.status_code == 200, (at, answer.text)
    task = {"id": "urn:ngsi-ld:Task:1", "type": "Task", "status": {"type": "Property", "value": 1}}
    assert http.post("/entities?local=true", json=task).status_code == 201
    assert http.patch(
        "/entities/urn:ngsi-ld:Task:1/attrs?local=true", json={"status": task["status"]}
    ).is_success
    assert http.delete("/entities/urn:ngsi-ld:Task:1?local=true").status_code == 204
    plain = {
        "id": "urn:ngsi-ld:Subscription:plain",
        "type": "Subscription",
        "entities": [{"type": "Other"}],
        "notification": {"endpoint": ENDPOINT},
    }
    for at in ("/subscriptions", "/csourceSubscriptions"):
        assert http.post(at, json=plain).status_code == 201
        assert http.patch(f"{at}/{plain['id']}", json={"description": "mine"}).status_code == 204
        assert http.delete(f"{at}/{plain['id']}").status_code == 204
    source = {
        "id": "urn:ngsi-ld:ContextSourceRegistration:plain",
        "type": "ContextSourceRegistration",
        "endpoint": "http://127.0.0.1:9",
        "information": [{"entities": [{"type": "Other"}]}],
    }
    assert http.post("/csourceRegistrations", json=source).status_code == 201
    assert http.delete(f"/csourceRegistrations/{source['id']}").status_code == 204
    assert http.delete("/snapshots", params={"q": "snapshotPriority==9"}).status_code == 204


def test_a_null_is_refused_with_its_place(http: httpx.Client) -> None:
    for at, path in PLACES:
        document = replaced(WHOLE[at], path, None)
        if path != ("id",):
            document["id"] = document["id"].format("null")
        answer = http.post(at, json=document)
        assert answer.status_code == 400, (at, path, answer.text)
        assert str(path[-1]) in answer.json()["detail"], (at, path, answer.text)
    assert http.post("/jsonldContexts", json={"@context": None}).status_code == 400
    nulls: list[Any] = [
        {"id": None, "type": "T"},
        {"id": "urn:a:b", "type": None},
        {"id": "urn:a:b", "type": "T", "x": None},
        {"type": "Query", "entities": None},
    ]
    for at in ("/entities", "/entityOperations/create", "/entityOperations/query"):
        for body in nulls:
            answer = http.post(at, json=[body] if at.endswith("create") else body)
            assert answer.status_code in {400, 207}, (at, body, answer.text)
            assert "urn:a:b" not in http.get("/entities?type=T").text
    require_all_reads(http)


def test_a_null_in_a_change_deletes_a_member_or_is_refused(http: httpx.Client) -> None:
    for at, whole in WHOLE.items():
        document = {**whole, "id": whole["id"].format("changed")}
        made = http.post(at, json=document)
        assert made.status_code in {201, 400}, made.text
        if made.status_code == 400:  # a subscription to sources has no such filters
            continue
        for path in places(document):
            change = replaced(document, path, None)
            change = {path[0]: change[path[0]]}
            answer = http.patch(f"{at}/{document['id']}", json=change)
            assert answer.status_code in {200, 204, 400}, (at, path, answer.text)
            assert http.get(f"{at}/{document['id']}").status_code == 200, (at, path)
        require_all_reads(http)
        assert http.delete(f"{at}/{document['id']}").status_code == 204


TEXTS = ["", "*", "urn:a:b", "Task", "urn:ngsi-ld:null", "@none", "a,b", "1=1", "((", "\u0000", "é"]
SHAPES = [[], {}, [[]], [{}], {"": ""}, {"type": "Property"}, [None], {"a": None}, ["urn:a:b", 1]]
VALUES = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-2, 2**70),
    st.floats(allow_nan=False, allow_infinity=False),
    st.sampled_from(TEXTS),
    st.sampled_from(SHAPES),
)


@pytest.mark.nightly
@settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.sampled_from(PLACES), VALUES, st.booleans())
def test_whatever_is_accepted_others_read_and_write_as_before(
    http: httpx.Client, place: tuple[str, tuple[Any, ...]], value: Any, is_change: bool
) -> None:
    at, path = place
    whole = {**WHOLE[at], "id": WHOLE[at]["id"].format("any")}
    document = replaced(whole, path, value)
    if is_change:
        http.post(at, json=whole)
        made = http.patch(f"{at}/{whole['id']}", json={path[0]: document[path[0]]})
    else:
        made = http.post(at, json=document)
    assert made.status_code < 500, (at, path, value, made.text)
    if made.status_code < 300:
        require_all_reads(http)
    name = made.headers.get("location", f"/{whole['id']}").rpartition("/")[2]
    http.delete(f"{at}/{name}")
    http.delete(f"{at}/{whole['id']}")


POISON: dict[str, list[dict[str, Any]]] = {
    "subscription": [
        {"entities": None},
        {"watchedAttributes": None},
        {"notification": None},
        {"entities": [None]},
        {"entities": [{"type": 5}]},
        {"watchedAttributes": [None]},
        {"notification": {"endpoint": None}},
        {"notification": {"attributes": [7], "endpoint": ENDPOINT}},
        {"context": 7},
        {"q": None, "geoQ": None},
    ],
    "registration": [
        {"information": None},
        {"information": [{"entities": [{"type": None}]}]},
        {"endpoint": None},
        {"properties": {"https://a/b": None}},
        {"contextSourceInfo": None, "operations": None},
        {"context": 7},
    ],
    "snapshot": [{"id": None}],
}


@pytest.mark.nightly
def test_stored_documents_that_poison_an_earlier_version_neither_stop_the_start_nor_the_reads(
    own_broker: BrokerProcess, tmp_path: Path
) -> None:
    if own_broker.extra:
        pytest.skip("the documents are written into a SQLite file")
    own_broker.start()
    with own_broker.client() as http:
        for at in ("/subscriptions", "/csourceSubscriptions", "/csourceRegistrations", "/snapshots"):
            document = {**WHOLE[at], "id": WHOLE[at]["id"].format("sound")}
            document.pop("csf", None)
            assert http.post(at, json=document).status_code == 201, at
    own_broker.stop()
    poisoned = poison(tmp_path / "broker.db")
    own_broker.start()
    with own_broker.client() as http:
        require_all_reads(http)
        listed = {one["id"]: one for one in http.get("/subscriptions?limit=100").json()}
        assert listed["urn:ngsi-ld:Subscription:sound"]["status"] == "active"
        reported = 0
        for kind, name in poisoned:
            at = {"subscription": "/subscriptions", "source subscription": "/csourceSubscriptions",
                  "registration": "/csourceRegistrations", "snapshot": "/snapshots"}[kind]  # fmt: skip
            if kind == "subscription":
                assert name in listed, "it is listed with its id"
            shown = http.get(f"{at}/{name}")
            assert shown.status_code in {200, 409}, (kind, name, shown.text)
            if "failed" in shown.text or shown.status_code == 409:
                reported += 1
                assert name in own_broker.log(), "it is reported with its id"
            assert http.delete(f"{at}/{name}").status_code == 204, (kind, name)
            assert http.get(f"{at}/{name}").status_code == 404
        assert reported > 10
        require_all_reads(http)
    own_broker.kill()
    own_broker.start()
    with own_broker.client() as http:
        assert len(http.get("/subscriptions?limit=100").json()) == 1, "what was deleted is gone"


def poison(database: Path) -> list[tuple[str, str]]:
    """Store documents as an earlier version may have; return their kinds and ids."""
    made: list[tuple[str, str]] = []
    with closing(sqlite3.connect(database)) as connection, connection:
        rows = connection.execute("SELECT kind, tenant, body FROM documents").fetchall()
        for kind, tenant, body in rows:
            for number, members in enumerate(POISON.get(kind.replace("source ", ""), [])):
                name = f"urn:ngsi-ld:Poison:{kind.replace(' ', '-')}-{number}"
                document = {**json.loads(body), "id": name, **members}
                document.pop("owner", None)
                written = json.dumps(document).encode()
                checksum = checksums.of_document(kind, tenant, name, written)
                row = (kind, tenant, name, written, checksum)
                connection.execute("INSERT INTO documents VALUES (?, ?, ?, ?, ?)", row)
                made.append((kind, name))
    return made
