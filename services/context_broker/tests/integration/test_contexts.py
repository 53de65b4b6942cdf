"""@contexts: hosted, fetched, created for subscriptions, and restarts."""

import json
import socket
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from typing import Any
from urllib.parse import quote

import httpx
import pytest

from tests.kit.waiting import wait_for

JSON = {"Content-Type": "application/json"}
LD = {"Content-Type": "application/ld+json"}
ERRORS = "https://uri.etsi.org/ngsi-ld/errors/"
CORE = "https://uri.etsi.org/ngsi-ld/v1/ngsi-ld-core-context-v1.6.jsonld"


def link(url: str) -> dict[str, str]:
    return {"Link": f'<{url}>; rel="http://www.w3.org/ns/json-ld#context"; type="application/ld+json"'}


def add(http: httpx.Client, context: Any, **headers: str) -> str:
    answer = http.post("/jsonldContexts", json={"@context": context}, headers=headers)
    assert answer.status_code == 201, answer.text
    assert answer.content == b""
    location: str = answer.headers["location"]
    assert location.startswith("/ngsi-ld/v1/jsonldContexts/")
    return location.partition("/ngsi-ld/v1")[2]


def details(http: httpx.Client, name: str, **headers: str) -> dict[str, Any]:
    answer = http.get(f"/jsonldContexts/{quote(name, safe='')}?details=true", headers=headers)
    assert answer.status_code == 200, answer.text
    found: dict[str, Any] = answer.json()
    return found


@pytest.fixture
def publisher(new_subscriber: Callable[..., Any]) -> Any:
    """A server that publishes a context at every path."""
    server = new_subscriber()
    server.document = {"@context": {"speed": "https://a.example/speed"}}
    return server


def test_a_hosted_context_is_served_listed_used_and_deleted(shared_broker: Any, http: httpx.Client) -> None:
    given = {"colour": "https://a.example/colour"}
    path = add(http, given)
    own_id = path.rpartition("/")[2]
    url = f"{shared_broker.api}{path}"
    assert http.get(path).json() == {"@context": given}
    served = http.get(path, headers={"Accept": "application/ld+json"})
    assert served.headers["content-type"] == "application/ld+json"
    assert url in http.get("/jsonldContexts").json()
    assert url in http.get("/jsonldContexts?kind=Hosted").json()
    assert url not in http.get("/jsonldContexts?kind=Cached").json()
    before = details(http, own_id)
    assert {"URL": url, "localId": own_id, "kind": "Hosted", "numberOfHits": 0}.items() <= before.items()
    assert before["createdAt"].endswith("Z")
    entity = {"id": "urn:x:hosted", "type": "Thing", "colour": "red"}
    assert http.post("/entities", json=entity, headers=link(url)).status_code == 201
    read = http.get("/entities/urn:x:hosted?options=keyValues").json()
    assert read["https://a.example/colour"] == "red"
    after = details(http, url)
    assert after["numberOfHits"] == 1
    assert after["lastUsage"] >= before["createdAt"]
    assert after in http.get("/jsonldContexts?details=true").json()
    assert http.delete(path).status_code == 204
    assert http.get(path).status_code == 404
    assert http.delete(path).status_code == 404
    assert url not in http.get("/jsonldContexts").json()


@pytest.mark.parametrize(
    ("body", "status", "kind"),
    [
        (b"{", 400, "InvalidRequest"),
        (b'{"colour": "https://a.example/colour"}', 400, "InvalidRequest"),
        (b"[]", 400, "InvalidRequest"),
        (b'{"@context": 5}', 400, "BadRequestData"),
        (b'{"@context": true}', 400, "BadRequestData"),
        (b'{"@context": ["https://a.example/c", 5]}', 400, "BadRequestData"),
        (b'{"@context": {"a": 5}}', 400, "BadRequestData"),
        (b'{"@context": {"a": "' + b"x" * 1_100_000 + b'"}}', 413, "InvalidRequest"),
    ],
)
def test_an_invalid_context_is_not_hosted(http: httpx.Client, body: bytes, status: int, kind: str) -> None:
    answer = http.post("/jsonldContexts", content=body, headers=JSON)
    assert (answer.status_code, answer.json()["type"]) == (status, ERRORS + kind)
    assert answer.json()["detail"]


def test_references_of_a_hosted_context_are_fetched_and_cached(http: httpx.Client, publisher: Any) -> None:
    url = f"http://127.0.0.1:{publisher.port}/part.jsonld"
    path = add(http, [url, CORE])
    hosted = str(http.base_url).rstrip("/") + path
    entity = {"id": "urn:x:parts", "type": "Thing", "speed": 3}
    assert http.post("/entities", json=entity, headers=link(hosted)).status_code == 201
    assert [details(http, url)[received] for received in ("kind", "numberOfHits")] == ["Cached", 2]
    assert details(http, url)["numberOfHits"] == 3  # it was found there, to be looked at
    assert details(http, path.rpartition("/")[2])["numberOfHits"] == 1
    read = http.get("/entities/urn:x:parts?options=keyValues").json()
    assert read["https://a.example/speed"] == 3
    refused = http.get(f"/jsonldContexts/{quote(url, safe='')}")
    assert (refused.status_code, refused.json()["type"]) == (422, ERRORS + "OperationNotSupported")


def test_a_cached_context_is_fetched_again_on_request(http: httpx.Client, publisher: Any) -> None:
    url = f"http://127.0.0.1:{publisher.port}/changing.jsonld"
    named = f"/jsonldContexts/{quote(url, safe='')}"
    query = {"options": "keyValues", "type": "Thing", "id": "urn:x:changing"}
    http.post("/entities", json={"id": "urn:x:changing", "type": "Thing", "speed": 3}, headers=link(url))
    publisher.document = {"@context": {"velocity": "https://a.example/speed"}}
    assert "speed" in http.get("/entities", params=query, headers=link(url)).json()[0]
    assert http.delete(f"{named}?reload=true").status_code == 204
    assert "velocity" in http.get("/entities", params=query, headers=link(url)).json()[0]
    for broken in (None, "no context", {"@context": 5}):
        publisher.document = broken
        answer = http.delete(f"{named}?reload=true")
        assert (answer.status_code, answer.json()["type"]) == (504, ERRORS + "LdContextNotAvailable")
        assert url in answer.json()["detail"]
        assert details(http, url)["kind"] == "Cached"
    assert "velocity" in http.get("/entities", params=query, headers=link(url)).json()[0]
    assert http.delete(named).status_code == 204
    assert http.get(f"{named}?details=true").status_code == 404


def test_subscriptions_are_compiled_again_when_their_context_changes(
    http: httpx.Client, publisher: Any, subscriber: Any, eventually: Callable[..., Any]
) -> None:
    url = f"http://127.0.0.1:{publisher.port}/renewed.jsonld"
    publisher.document = {"@context": {"Pump": "https://a.example/Pump", "flow": "https://a.example/flow"}}
    subscription = {
        "id": "urn:x:sub:renewed",
        "type": "Subscription",
        "entities": [{"type": "Pump"}],
        "q": "flow>1",
        "notification": {"endpoint": {"uri": subscriber.url}, "format": "keyValues"},
    }
    assert http.post("/subscriptions", json=subscription, headers=link(url)).status_code == 201
    registration = {
        "id": "urn:x:csr:renewed",
        "type": "ContextSourceRegistration",
        "endpoint": "http://127.0.0.1:9",
        "information": [{"entities": [{"type": "Valve"}]}],
        "flow": {"type": "Property", "value": 1},
    }
    assert http.post("/csourceRegistrations", json=registration, headers=link(url)).status_code == 201
    pump = {"id": "urn:x:pump", "type": "Pump", "flow": 2}
    assert http.post("/entities", json=pump, headers=link(url)).status_code == 201
    assert eventually(lambda: subscriber.entities("urn:x:sub:renewed"))[0]["flow"] == 2
    terms = {
        "Pump": "https://a.example/Pump",
        "flow": "https://a.example/rpm",
        "stream": "https://a.example/flow",
    }
    publisher.document = {"@context": terms}
    assert http.delete(f"/jsonldContexts/{quote(url, safe='')}?reload=true").status_code == 204
    http.patch("/entities/urn:x:pump/attrs", json={"stream": 0}, headers=link(url))
    http.patch("/entities/urn:x:pump/attrs", json={"flow": 3}, headers=link(url))
    received = eventually(lambda: subscriber.entities("urn:x:sub:renewed")[1:])
    assert received == [{"id": "urn:x:pump", "type": "Pump", "stream": 0, "flow": 3}]
    eventually(
        lambda: http.get("/subscriptions/urn:x:sub:renewed").json()["notification"].get("timesSent") == 2
    )
    assert http.delete("/csourceRegistrations/urn:x:csr:renewed").status_code == 204


def test_the_default_context_is_a_setting(own_broker: Any, publisher: Any) -> None:
    url = f"http://127.0.0.1:{publisher.port}/default.jsonld"
    publisher.document = {"@context": {"speed": "https://a.example/speed"}}
    own_broker.extra["HANDOVER_BROKER_DEFAULT_CONTEXT"] = url
    own_broker.start()
    with own_broker.client() as http:
        assert (
            http.post("/entities", json={"id": "urn:x:set", "type": "Thing", "speed": 3}).status_code == 201
        )
        read = http.get("/entities/urn:x:set?options=keyValues")
        assert (read.json()["speed"], url in read.headers["link"]) == (3, True)
        assert (
            http.get("/entities?type=Thing&q=speed==3", headers={"Accept": LD["Content-Type"]}).json()[0][
                "@context"
            ]
            == url
        )
        core = http.get("/entities/urn:x:set?options=keyValues", headers=link(CORE))
        assert core.json()["https://a.example/speed"] == 3


def test_a_hosted_context_cannot_be_fetched_again(http: httpx.Client) -> None:
    answer = http.delete(f"{add(http, {})}?reload=true")
    assert (answer.status_code, answer.json()["type"]) == (400, ERRORS + "BadRequestData")


@pytest.mark.parametrize("version", ["", *(f"-v1.{minor}" for minor in range(10))])
def test_the_core_context_of_every_version_is_there_and_stays(http: httpx.Client, version: str) -> None:
    core = f"https://uri.etsi.org/ngsi-ld/v1/ngsi-ld-core-context{version}.jsonld"
    assert http.get("/entities?type=Thing", headers=link(core)).status_code == 200
    assert details(http, core)["kind"] == "Cached"
    named = f"/jsonldContexts/{quote(core, safe='')}"
    for query in ("", "?reload=false"):
        answer = http.delete(named + query)
        assert (answer.status_code, answer.json()["type"]) == (400, ERRORS + "BadRequestData")
    assert http.delete(f"{named}?reload=true").status_code == 204
    assert details(http, core)


def test_hosted_contexts_belong_to_their_tenant(http: httpx.Client) -> None:
    ours, theirs = {"NGSILD-Tenant": "contexts-a"}, {"NGSILD-Tenant": "contexts-b"}
    path, _ = add(http, {"secret": "https://a.example/secret"}, **ours), add(http, {}, **theirs)
    own_id = path.rpartition("/")[2]
    assert http.get(path, headers=theirs).status_code == 404
    assert http.get(f"{path}?details=true", headers=theirs).status_code == 404
    assert http.delete(path, headers=theirs).status_code == 404
    for query in ("", "?details=true"):
        assert own_id not in http.get(f"/jsonldContexts{query}", headers=theirs).text
        assert own_id not in http.get(f"/jsonldContexts{query}").text
        assert own_id in http.get(f"/jsonldContexts{query}", headers=ours).text
    assert http.get(path, headers=ours).status_code == 200
    assert http.get(f"{path}?details=true").status_code == 404
    assert "secret" in http.get(path).text, "what reads an @context cannot name a tenant"
    assert http.delete(path, headers=ours).status_code == 204
    assert http.get(path).status_code == 404


def test_a_subscription_that_brings_its_context_gets_one_that_a_link_can_name(
    http: httpx.Client, subscriber: Any, eventually: Callable[..., Any]
) -> None:
    context = [{"glow": "https://a.example/glow", "Lamp": "https://a.example/Lamp"}, CORE]
    wanted = {
        "id": "urn:x:sub:implicit",
        "type": "Subscription",
        "entities": [{"type": "Lamp"}],
        "notification": {"endpoint": {"uri": subscriber.url}},
        "@context": context,
    }
    assert http.post("/subscriptions", content=json.dumps(wanted), headers=LD).status_code == 201
    url = http.get("/subscriptions/urn:x:sub:implicit").json()["jsonldContext"]
    assert url in http.get("/jsonldContexts?kind=ImplicitlyCreated").json()
    implicit = details(http, url.rpartition("/")[2])
    assert (implicit["kind"], implicit["numberOfHits"]) == ("ImplicitlyCreated", 1)
    assert details(http, url)["numberOfHits"] == 1
    assert httpx.get(url, trust_env=False, timeout=120).json() == {"@context": context}
    lamp = {"id": "urn:x:lamp", "type": "Lamp", "glow": 5, "@context": context}
    assert http.post("/entities", content=json.dumps(lamp), headers=LD).status_code == 201
    eventually(lambda: subscriber.received)
    assert url in subscriber.headers[0]["link"]
    assert subscriber.entities()[0]["glow"]["value"] == 5
    assert http.delete(f"/jsonldContexts/{url.rpartition('/')[2]}").status_code == 204
    http.patch("/entities/urn:x:lamp/attrs", content='{"https://a.example/glow": 6}', headers=JSON)
    eventually(lambda: len(subscriber.received) == 2)
    assert subscriber.entities()[1]["glow"]["value"] == 6


def test_a_context_that_cannot_be_loaded_is_named_and_tried_again(
    http: httpx.Client, publisher: Any, eventually: Callable[..., Any]
) -> None:
    publisher.document = None
    url = f"http://127.0.0.1:{publisher.port}/later.jsonld"

    def create() -> httpx.Response:
        return http.post("/entities", json={"id": "urn:x:later", "type": "T"}, headers=link(url))

    for _ in range(3):
        answer = create()
        assert (answer.status_code, answer.json()["type"]) == (504, ERRORS + "LdContextNotAvailable")
        assert url in answer.json()["detail"]
        assert "404" in answer.json()["detail"]
    publisher.document = "no object"
    answer = eventually(lambda: (one := create()).status_code == 400 and one)
    assert answer.json()["type"] == ERRORS + "BadRequestData"
    assert url in answer.json()["detail"]
    assert '"@context"' in answer.json()["detail"]
    publisher.document = {"@context": {}}
    eventually(lambda: create().status_code == 201)


def test_ten_requests_ask_a_server_that_hangs_once(own_broker: Any) -> None:
    own_broker.extra["HANDOVER_BROKER_CONTEXT_TIMEOUT_S"] = "0.5"
    own_broker.start()
    with socket.create_server(("127.0.0.1", 0), backlog=64) as silent, own_broker.client() as http:
        silent.setblocking(False)
        assert http.get("/entities?type=T", headers=link("http://127.0.0.1:9/nobody")).status_code == 504
        url = f"http://127.0.0.1:{silent.getsockname()[1]}/never.jsonld"
        with ThreadPoolExecutor(10) as pool:
            answers = list(pool.map(lambda _: http.get("/entities?type=T", headers=link(url)), range(10)))
        assert {answer.status_code for answer in answers} == {504}
        assert "no response within 0.5 s" in answers[0].json()["detail"]
        asked = 0
        with suppress(BlockingIOError):
            while True:
                silent.accept()[0].close()
                asked += 1
        assert asked == 1


def test_contexts_are_not_fetched_from_link_local_addresses(http: httpx.Client) -> None:
    answer = http.get("/entities?type=T", headers=link("http://169.254.169.254/latest/meta-data"))
    assert answer.status_code == 504
    assert "metadata service" in answer.json()["detail"]


@pytest.mark.nightly
@pytest.mark.slow
def test_contexts_survive_a_power_cut(own_broker: Any, publisher: Any, subscriber: Any) -> None:
    url = f"http://127.0.0.1:{publisher.port}/kept.jsonld"
    own_broker.start()
    with own_broker.client() as http:
        path = add(http, {"colour": "https://a.example/colour"})
        tenants = add(http, {"secret": "https://a.example/secret"}, **{"NGSILD-Tenant": "kept"})
        http.post("/entities", json={"id": "urn:x:1", "type": "T", "speed": 1}, headers=link(url))
        context = {"Lamp": "https://a.example/Lamp", "glow": "https://a.example/glow"}
        for number, used in enumerate((context, url)):
            wanted = {
                "id": f"urn:x:sub:{number}",
                "type": "Subscription",
                "entities": [{"type": "T"}],
                "q": "glow>4" if number == 0 else "speed>0",
                "notification": {"endpoint": {"uri": subscriber.url}},
                "@context": used,
            }
            assert http.post("/subscriptions", content=json.dumps(wanted), headers=LD).status_code == 201
        made = http.get("/subscriptions/urn:x:sub:0").json()["jsonldContext"]
        assert http.delete(f"/jsonldContexts/{made.rpartition('/')[2]}").status_code == 204
        assert http.delete(f"/jsonldContexts/{quote(url, safe='')}").status_code == 204
        gone = add(http, {"gone": "https://a.example/gone"})
        assert http.delete(gone).status_code == 204
    publisher.stop()
    own_broker.kill()
    own_broker.start()
    with own_broker.client() as http:
        assert http.get(path).json() == {"@context": {"colour": "https://a.example/colour"}}
        assert http.get(tenants, headers={"NGSILD-Tenant": "kept"}).status_code == 200
        assert http.get(gone).status_code == 404
        assert http.get("/entities?type=T", headers=link(url)).status_code == 504, "it was deleted"
        assert http.get("/subscriptions/urn:x:sub:0").json()["status"] == "active"
        full = {"id": "urn:x:2", "type": "T", "https://a.example/glow": 5, "https://a.example/speed": 1}
        assert http.post("/entities", json=full).status_code == 201
        wait_for(lambda: len(subscriber.received) >= 2)
        received = {one["subscriptionId"]: one["data"][0] for one in subscriber.received}
        assert received["urn:x:sub:0"]["glow"]["value"] == 5, "a deleted context serves its subscriptions on"
        assert received["urn:x:sub:1"]["speed"]["value"] == 1


@pytest.mark.nightly
@pytest.mark.slow
def test_how_contexts_are_used_is_kept_over_a_restart(own_broker: Any) -> None:
    own_broker.start()
    with own_broker.client() as http:
        path = add(http, {})
        for _ in range(3):
            http.get("/entities?type=T", headers=link(f"{own_broker.api}{path}"))
        before = details(http, path.rpartition("/")[2])
    own_broker.stop()
    own_broker.start()
    with own_broker.client() as http:
        assert before["numberOfHits"] == 3
        assert details(http, path.rpartition("/")[2]) == before


def test_the_address_of_hosted_contexts_can_be_set(own_broker: Any) -> None:
    own_broker.extra["HANDOVER_BROKER_PUBLIC_URL"] = "https://broker.example/"
    own_broker.start()
    with own_broker.client() as http:
        path = add(http, {})
        assert f"https://broker.example/ngsi-ld/v1{path}" in http.get("/jsonldContexts").json()
        read = http.get("/entities?type=T", headers=link(f"https://broker.example/ngsi-ld/v1{path}"))
        assert read.status_code == 200, "its own address needs no way round"
