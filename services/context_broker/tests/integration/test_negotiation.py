"""Media types, @contexts and invalid input: each has a clear response."""

import json
import socket
from collections.abc import Callable
from typing import Any

import httpx
import pytest

CONTEXT = {"colour": "https://a.example/colour", "Task": "https://a.example/Task"}
JSON = {"Content-Type": "application/json"}
LD = {"Content-Type": "application/ld+json"}


def post(http: httpx.Client, body: Any, headers: dict[str, str]) -> httpx.Response:
    content = body if isinstance(body, bytes) else json.dumps(body).encode()
    return http.post("/entities", content=content, headers=headers)


def task(name: str, **attributes: Any) -> dict[str, Any]:
    return {"id": f"urn:ngsi-ld:Task:demo:{name}", "type": "Task", **attributes}


def link(url: str) -> dict[str, str]:
    return {"Link": f'<{url}>; rel="http://www.w3.org/ns/json-ld#context"; type="application/ld+json"'}


@pytest.mark.nightly
def test_a_context_in_the_body_expands_names(http: httpx.Client) -> None:
    entity = task("body-context", colour="x", raw=1)
    answer = post(http, entity | {"@context": CONTEXT}, LD)
    assert answer.status_code == 201, answer.text
    read = http.get(f"/entities/{entity['id']}", params={"options": "keyValues"}).json()
    assert read == {
        "id": entity["id"],
        "type": "https://a.example/Task",
        "https://a.example/colour": "x",
        "raw": 1,
    }


def test_json_ld_is_answered_with_its_context(http: httpx.Client) -> None:
    entity = task("ld", status="x")
    post(http, entity, JSON)
    accept = {"Accept": "application/ld+json"}
    answer = http.get(f"/entities/{entity['id']}", headers=accept)
    assert answer.headers["content-type"] == "application/ld+json"
    assert "ngsi-ld-core-context" in answer.json()["@context"]
    assert "link" not in answer.headers
    assert all("@context" in one for one in http.get("/entities?type=Task", headers=accept).json())
    plain = http.get(f"/entities/{entity['id']}")
    assert plain.headers["content-type"] == "application/json"
    assert "json-ld#context" in plain.headers["link"]
    assert "@context" not in plain.json()


@pytest.mark.nightly
@pytest.mark.slow
def test_a_context_is_fetched_once_and_survives_the_loss_of_its_server(
    own_broker: Any, new_subscriber: Callable[..., Any]
) -> None:
    server = new_subscriber()
    server.document = {"@context": [CONTEXT, {"speed": "https://a.example/speed"}]}
    url = f"http://127.0.0.1:{server.port}/context.jsonld"
    entity = task("fetched", speed=3)
    own_broker.start()
    with own_broker.client() as http:
        assert post(http, entity, JSON | link(url)).status_code == 201
        read = http.get(f"/entities/{entity['id']}", params={"options": "keyValues"})
        assert read.json()["https://a.example/speed"] == 3
    server.stop()
    own_broker.kill()
    own_broker.start()
    with own_broker.client() as http:
        read = http.get(f"/entities/{entity['id']}", params={"options": "keyValues"}, headers=link(url))
        assert read.json() == entity
        assert url in read.headers["link"]


@pytest.mark.parametrize(
    ("body", "headers", "status", "word"),
    [
        (task("n1") | {"@context": CONTEXT}, JSON, 400, "Link"),
        (task("n1"), LD, 400, "@context"),
        (task("n1") | {"@context": CONTEXT}, LD | link("https://a.example/c"), 400, "Link"),
        (task("n1") | {"@context": 5}, LD, 400, "@context"),
        (task("n1") | {"@context": "ftp://a.example/c"}, LD, 400, "http"),
        (b"{", JSON, 400, "line 1"),
        (b"", JSON, 400, "not JSON"),
        (b"\xff\xfe", JSON, 400, "not JSON"),
        (b'{"id": NaN}', JSON, 400, "not JSON"),
        (b'{"id": 1e999}', JSON, 400, "not JSON"),
        (b'{"id": "\\ud800"}', JSON, 400, "not JSON"),
        ([], JSON, 400, "list"),
        ("x", JSON, 400, "object"),
        ({"type": "Task"}, JSON, 400, "id"),
        ({"id": "urn:x:1"}, JSON, 400, "type"),
        ({"id": "urn:x:1", "type": []}, JSON, 400, "type"),
        ({"id": "urn:x:1", "type": 7}, JSON, 400, "7"),
        ({"id": 7, "type": "Task"}, JSON, 400, "URI"),
        ({"id": "not a uri", "type": "Task"}, JSON, 400, "URI"),
        ({"id": "urn:x:" + "y" * 5000, "type": "Task"}, JSON, 400, "2048"),
        (task("n1", **{"a b": 1}), JSON, 400, "a b"),
        (task("n1", **{"@odd": 1}), JSON, 400, "@odd"),
        (task("n1", **{"": 1}), JSON, 400, "name"),
        (task("n1", **{"n" * 600: 1}), JSON, 400, "512"),
        (task("n1", a=None), JSON, 400, "null"),
        (task("n1", a="urn:ngsi-ld:null"), JSON, 400, "urn:ngsi-ld:null"),
        (task("n1", a={"type": "Propertee", "value": 1}), JSON, 400, "Propertee"),
        (task("n1", a={"type": "Property"}), JSON, 400, '"value"'),
        (task("n1", a={"type": "Property", "object": "urn:x:1"}), JSON, 400, '"object"'),
        (task("n1", a={"type": "Relationship", "object": "nowhere"}), JSON, 400, "URI"),
        (task("n1", a={"type": "Relationship", "object": 4}), JSON, 400, "URI"),
        (
            task("n1", a={"type": "GeoProperty", "value": {"type": "Point", "coordinates": ["x"]}}),
            JSON,
            400,
            "Point",
        ),
        (task("n1", a={"type": "GeoProperty", "value": 4}), JSON, 400, "GeoJSON"),
        (
            task(
                "n1",
                a={"type": "GeoProperty", "value": {"type": "Polygon", "coordinates": [[[0, 0], [1, 1]]]}},
            ),
            JSON,
            400,
            "ring",
        ),
        (task("n1", a={"type": "LanguageProperty", "languageMap": {"en": 4}}), JSON, 400, "languageMap"),
        (task("n1", a={"type": "VocabProperty", "vocab": 4}), JSON, 400, "vocab"),
        (task("n1", a={"type": "ListProperty", "valueList": 4}), JSON, 400, "valueList"),
        (task("n1", a={"value": 1, "observedAt": "yesterday"}), JSON, 400, "observedAt"),
        (task("n1", a={"value": 1, "unitCode": 4}), JSON, 400, "unitCode"),
        (task("n1", a={"value": 1, "datasetId": "x y"}), JSON, 400, "datasetId"),
        (task("n1", a={"observedAt": "2026-01-01T00:00:00Z"}), JSON, 400, "says nothing"),
        (
            task("n1", a=[{"type": "Property", "value": 1}, {"type": "Property", "value": 2}]),
            JSON,
            400,
            "datasetId",
        ),
        (task("n1", scope="/a//b"), JSON, 400, "scope"),
    ],
)
def test_an_invalid_registration_is_refused_with_the_reason(
    http: httpx.Client, body: Any, headers: dict[str, str], status: int, word: str
) -> None:
    answer = post(http, body, headers)
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/json"
    assert word in answer.json()["detail"]
    assert http.get("/entities/urn:ngsi-ld:Task:demo:n1").status_code == 404


@pytest.mark.parametrize("media_type", ["text/plain", "application/merge-patch+json", "application/xml", ""])
def test_an_unsupported_media_type_is_refused_without_a_body(http: httpx.Client, media_type: str) -> None:
    headers = {"NGSILD-Tenant": "media", **({"Content-Type": media_type} if media_type else {})}
    answer = http.post("/entities", content=b'{"id": "urn:x:1", "type": "T"}', headers=headers)
    assert (answer.status_code, answer.content) == (415, b"")
    assert answer.headers["accept"] == "application/json, application/ld+json"
    assert answer.headers["ngsild-tenant"] == "media"


def test_nesting_without_end_is_refused(http: httpx.Client) -> None:
    for depth, status in ((100, 201), (190, 201), (201, 400), (900, 400), (5000, 400)):
        entity = f'{{"id":"urn:x:depth{depth}","type":"Deep","a":{{"value":{"[" * depth}{"]" * depth}}}}}'
        assert post(http, entity.encode(), JSON).status_code == status, depth
    nested: dict[str, Any] = {"value": 1}
    for _ in range(60):
        nested = {"value": 1, "b": nested}
    assert post(http, task("nested", a=nested), JSON).status_code == 400
    for form in ("keyValues", "concise", "normalized"):
        assert len(http.get(f"/entities?type=Deep&format={form}").json()) == 2


def test_a_body_that_is_too_large_is_refused(http: httpx.Client) -> None:
    big = json.dumps(task("big", a="x" * 11 * 1024 * 1024)).encode()
    assert post(http, big, JSON).status_code == 413
    assert http.get("/types").status_code == 200


@pytest.mark.parametrize(
    ("accept", "status"),
    [
        ("application/json", 200),
        ("*/*", 200),
        ("application/*;q=0.5", 200),
        ("text/html, application/ld+json;q=0.1", 200),
        ("text/html", 406),
        ("application/json;q=0", 406),
    ],
)
def test_an_unacceptable_media_type_is_refused(http: httpx.Client, accept: str, status: int) -> None:
    answer = http.get("/entities?type=Task", headers={"Accept": accept})
    assert answer.status_code == status
    if status == 406:
        assert "application/json" in answer.json()["detail"]
        assert "application/geo+json" in answer.json()["availableRepresentations"]


@pytest.mark.parametrize(
    ("method", "path", "status"),
    [
        ("GET", "/nowhere", 404),
        ("GET", "/entities/urn:x:1/nowhere", 404),
        ("GET", "/entities/urn:x:1/attrs/a/b", 404),
        ("PATCH", "/entities", 405),
        ("PUT", "/entities/", 400),
        ("PATCH", "/entities/", 400),
        ("DELETE", "/entities/", 400),
        ("GET", "/entities/", 400),
        ("DELETE", "/temporal/entities/", 405),
        ("DELETE", "/entities/urn:x:1/attrs/", 405),
        ("DELETE", "/entities//attrs/a", 400),
        ("DELETE", "/entities/urn:x:1/attrs/%2E", 400),
        ("DELETE", "/entities/urn:x:1/attrs/%2e%2E", 400),
        ("DELETE", "/entities/urn:x:1/attrs/%00", 400),
        ("GET", "/entities/%2e%2e", 400),
        ("DELETE", "/entityOperations/create", 405),
        ("GET", "/entities/%FF", 400),
        ("GET", "/entities/no%20uri", 400),
        ("GET", "/entities?type=%FF", 400),
        ("GET", "/entities?type=%zz", 400),
        ("GET", "/entities?type=A&type=B", 400),
    ],
)
def test_odd_requests_get_clear_answers(http: httpx.Client, method: str, path: str, status: int) -> None:
    content: dict[str, Any] = {} if method in {"GET", "DELETE"} else {"json": {}}
    answer = http.request(method, path, **content)
    assert answer.status_code == status
    assert answer.json()["detail"]
    assert "link" not in answer.headers


def test_a_body_without_a_length_is_refused_without_a_word(http: httpx.Client) -> None:
    for method, path in (
        ("POST", "entities"),
        ("PATCH", "entities/urn:x:1/attrs/"),
        ("PUT", "entities/urn:x:1"),
    ):
        headers = JSON | {"NGSILD-Tenant": "no-such-tenant"}
        answer = http.request(method, f"/{path}", content=iter([b'{"id": "urn:x:1"}']), headers=headers)
        assert (answer.status_code, answer.content) == (411, b"")


def test_a_percent_sign_stands_before_two_digits(shared_broker: Any) -> None:
    with socket.create_connection(("127.0.0.1", shared_broker.port), timeout=120) as line:
        line.sendall(
            b"GET /ngsi-ld/v1/entities/urn:x:%zz HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n\r\n"
        )
        text = b"".join(iter(lambda: line.recv(4096), b"")).decode()
    assert text.startswith("HTTP/1.1 400")
    assert "%25" in text


def test_options_and_head_conform_to_http(http: httpx.Client) -> None:
    entity = task("head", a=1)
    post(http, entity, JSON)
    path = f"/entities/{entity['id']}"
    asked = http.options(path)
    assert asked.status_code == 204
    assert {"GET", "HEAD", "PATCH", "DELETE", "OPTIONS"} <= set(asked.headers["allow"].split(", "))
    read, head = http.get(path), http.head(path)
    assert (head.status_code, head.content) == (200, b"")
    assert head.headers["content-length"] == str(len(read.content))
    assert http.head("/entities/urn:x:nobody").status_code == 404
    refused = http.post(path, json={})
    assert refused.status_code == 405
    assert refused.headers["allow"] == asked.headers["allow"]
    assert http.options("/nowhere").status_code == 404


def test_an_earlier_version_is_spoken_to_who_prefers_it(http: httpx.Client) -> None:
    entity = task("older", kind={"type": "VocabProperty", "vocab": "food"}, a={"value": 1})
    post(http, entity, JSON)
    path = f"/entities/{entity['id']}"
    older = http.get(path, headers={"Prefer": "ngsi-ld=1.6"})
    assert (older.status_code, older.headers["preference-applied"]) == (203, "ngsi-ld=1.6")
    assert older.json()["kind"] == {"type": "Property", "value": "food"}
    for prefer in ('NGSI-LD="1.0";q=0.1, respond-async', "respond-async, ngsi-ld=1.0"):
        others = http.get("/subscriptions", headers={"Prefer": prefer})
        assert (others.status_code, others.headers["preference-applied"]) == (200, "ngsi-ld=1.0")
    assert "preference-applied" not in http.get("/types", headers={"Prefer": "respond-async"}).headers
    newer = http.get(path, headers={"Prefer": "ngsi-ld=2.0"})
    assert (newer.status_code, newer.headers["preference-applied"]) == (200, "ngsi-ld=1.9")
    assert newer.json()["kind"]["type"] == "VocabProperty"
    assert "preference-applied" not in http.get(path, headers={"Prefer": "respond-async"}).headers
    features = http.get(path, headers={"Prefer": "ngsi-ld=1.6", "Accept": "application/geo+json"})
    assert (features.status_code, features.json()["properties"]["kind"]["type"]) == (203, "Property")
    assert http.get("/types", headers={"Prefer": "ngsi-ld=1.6"}).status_code == 200
    refused = http.get(path, headers={"Prefer": "ngsi-ld=old"})
    assert refused.status_code == 400
    assert "1.6" in refused.json()["detail"]


def test_errors_echo_the_tenant_too(http: httpx.Client) -> None:
    for _ in range(2):
        for path, status in (("/types", 404), ("/nowhere", 404), ("/entityOperations/create", 405)):
            answer = http.get(path, headers={"NGSILD-Tenant": "no-such-tenant"})
            assert answer.status_code == status
            assert answer.headers.get_list("ngsild-tenant") == ["no-such-tenant"]
    assert "ngsild-tenant" not in http.get("/entities?type=Task").headers


def test_a_tenant_is_refused_where_there_is_only_one(http: httpx.Client) -> None:
    answer = http.get("/types", headers={"NGSILD-Tenant": "cell-4"})
    assert answer.status_code == 404
    assert answer.json()["type"].endswith("NonexistentTenant")


def test_a_disconnect_during_a_request_affects_no_other_client(
    shared_broker: Any, http: httpx.Client
) -> None:
    for _ in range(50):
        with socket.create_connection(("127.0.0.1", shared_broker.port)) as rude:
            rude.sendall(
                b"POST /ngsi-ld/v1/entities HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\n"
                b"Content-Length: 500\r\n\r\n{"
            )
    with socket.create_connection(("127.0.0.1", shared_broker.port)) as garbage:
        garbage.sendall(b"\x00\xff\x00 rubbish\r\n\r\n" * 100)
    assert http.get("/types").status_code == 200
    assert "Traceback" not in shared_broker.log()


def test_headers_and_queries_without_end_are_refused(shared_broker: Any, http: httpx.Client) -> None:
    for headers in ({"Link": "x" * 5000}, {"Accept": "a/b," * 2000}):
        answer = http.get("/entities?type=Task", headers=headers)
        assert answer.status_code == 400
        assert next(iter(headers)) in answer.json()["detail"]
    with socket.create_connection(("127.0.0.1", shared_broker.port), timeout=120) as line:
        line.sendall(
            b"GET /ngsi-ld/v1/entities?type=" + b"A" * 65_500 + b" HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
        )
        assert line.recv(100).startswith(b"HTTP/1.1 4")


def test_health_and_metrics_are_there(shared_broker: Any, http: httpx.Client) -> None:
    assert httpx.get(f"{shared_broker.url}/healthz", trust_env=False, timeout=120).json() == {"status": "ok"}
    assert httpx.get(f"{shared_broker.url}/readyz", trust_env=False, timeout=120).status_code == 200
    http.get("/types")
    assert shared_broker.metric("handover_broker_requests_total") >= 1
    identity = http.get("/info/sourceIdentity").json()
    assert identity["type"] == "ContextSourceIdentity"
