"""Registrations over HTTP: provision, discovery, conflicts, expiry and restarts."""

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Any

import httpx
import pytest

from .conftest import JSON, BrokerProcess

PATH = "/csourceRegistrations"


def register(http: httpx.Client, name: str, **members: Any) -> str:
    document = {
        "id": f"urn:ngsi-ld:ContextSourceRegistration:{name}",
        "type": "ContextSourceRegistration",
        "endpoint": "http://127.0.0.1:9",
        **members,
    }
    answer = http.post(PATH, json=document)
    assert answer.status_code == 201, answer.text
    assert answer.headers["location"] == f"/ngsi-ld/v1{PATH}/{document['id']}"
    return str(document["id"])


def found(http: httpx.Client, **parameters: str) -> list[str]:
    answer = http.get(PATH, params=parameters)
    assert answer.status_code == 200, answer.text
    return [one["id"] for one in answer.json()]


def of_type(kind: str, **members: Any) -> list[dict[str, Any]]:
    return [{"entities": [{"type": kind}], **members}]


def test_a_registration_is_stored_and_read_as_sent(http: httpx.Client) -> None:
    one = register(http, "kept", information=of_type("Kept", propertyNames=["speed"]), hall="second")
    answer = http.get(f"{PATH}/{one}", params={"options": "sysAttrs"})
    document = answer.json()
    assert document["information"] == of_type("Kept", propertyNames=["speed"])
    assert document["hall"] == "second"
    assert document["createdAt"] == document["modifiedAt"]
    assert http.get(f"{PATH}/{one}", headers={"Accept": "application/ld+json"}).json()["@context"]
    assert http.post(PATH, json={**document, "id": one}).status_code == 409
    assert http.delete(f"{PATH}/{one}").status_code == 204
    assert http.get(f"{PATH}/{one}").status_code == 404
    assert http.delete(f"{PATH}/{one}").status_code == 404


def test_an_update_replaces_members_and_null_deletes_them(http: httpx.Client) -> None:
    one = register(http, "changed", information=of_type("Changed"), description="first", hall="second")
    change = {"endpoint": "http://127.0.0.1:10", "description": None, "hall": "third"}
    assert http.patch(f"{PATH}/{one}", json=change).status_code == 204
    document = http.get(f"{PATH}/{one}").json()
    assert (document["endpoint"], document["hall"]) == ("http://127.0.0.1:10", "third")
    assert "description" not in document
    assert http.patch(f"{PATH}/{one}", json={"mode": "sideways"}).status_code == 400
    assert http.patch(f"{PATH}/{one}", json={"id": "urn:x:other"}).status_code == 400
    assert http.get(f"{PATH}/{one}").json()["mode"] == "inclusive"


def test_registrations_are_found_by_entities_and_attributes(http: httpx.Client) -> None:
    both = register(
        http,
        "both",
        information=[
            {"entities": [{"type": "FoundA"}], "propertyNames": ["speed"]},
            {"entities": [{"type": "FoundB", "id": "urn:ngsi-ld:FoundB:1"}]},
        ],
        hall="second",
    )
    past = register(
        http,
        "past",
        information=of_type("FoundA"),
        observationInterval={"startAt": "2024-01-01T00:00:00Z", "endAt": "2024-02-01T00:00:00Z"},
    )
    assert found(http, type="FoundA") == [both]
    assert found(http, type="FoundA", attrs="status") == []
    assert found(http, type="FoundA", attrs="") == [both]
    assert found(http, type="FoundB", id="urn:ngsi-ld:FoundB:2") == []
    assert found(http, type="FoundA,FoundB", csf='hall=="second"') == [both]
    assert found(http, type="FoundA", q='hall=="first"') == []
    assert found(http, csf='endpoint=="http://127.0.0.1:9"', type="FoundB") == [both]
    before = {"timerel": "before", "timeAt": "2024-01-15T00:00:00Z"}
    assert found(http, type="FoundA", **before) == [past]
    assert found(http, type="FoundA", timerel="after", timeAt="2024-03-01T00:00:00Z") == []
    assert found(http, type="FoundA", timeproperty="createdAt", **before) == []
    (document,) = http.get(PATH, params={"type": "FoundB"}).json()
    assert [piece["entities"][0]["type"] for piece in document["information"]] == ["FoundB"]
    assert http.get(PATH).status_code == 400


def test_registrations_are_found_by_location_and_scope(http: httpx.Client) -> None:
    here = {"type": "Point", "coordinates": [8.68, 49.41]}
    one = register(http, "place", information=of_type("Placed"), scope="/Madrid/Centro", location=here)
    other = register(http, "nowhere", information=of_type("Placed"), scope="/Berlin")
    near = {"georel": "near;maxDistance==2000", "geometry": "Point", "coordinates": "[8.68,49.41]"}
    assert found(http, type="Placed", **near) == [one]
    assert found(http, type="Placed", geoproperty="operationSpace", **near) == []
    assert found(http, type="Placed", scopeQ="/Madrid/#") == [one]
    assert found(http, type="Placed", scopeQ="/Berlin") == [other]
    assert http.get(PATH, params={"type": "Placed", "georel": "near"}).status_code == 400


@pytest.mark.nightly
def test_the_alias_differs_by_tenant_and_is_stable(own_broker: BrokerProcess) -> None:
    tenant = {"NGSILD-Tenant": "cell4"}
    own_broker.start()
    with own_broker.client() as http:
        http.post(PATH, json={"endpoint": "http://a", "information": of_type("Owned")}, headers=tenant)
        aliases = [
            http.get("/info/sourceIdentity", headers=headers).json()["contextSourceAlias"]
            for headers in ({}, tenant)
        ]
        assert aliases[1] == f"{aliases[0]}.cell4"
    own_broker.kill()
    own_broker.start()
    with own_broker.client() as http:
        identity = http.get("/info/sourceIdentity").json()
        assert identity["contextSourceAlias"] == aliases[0]
        assert identity["contextSourceUptime"].startswith("PT")


def test_registrations_are_paged(http: httpx.Client) -> None:
    ids = [register(http, f"page-{number}", information=of_type("Paged")) for number in range(3)]
    answer = http.get(PATH, params={"type": "Paged", "limit": "2", "count": "true"})
    assert [one["id"] for one in answer.json()] == ids[:2]
    assert answer.headers["ngsild-results-count"] == "3"
    assert 'rel="next"' in answer.headers["link"]
    assert found(http, type="Paged", limit="2", offset="2") == ids[2:]


def test_a_proxied_registration_must_not_hide_existing_entities(http: httpx.Client) -> None:
    entity = {"id": "urn:ngsi-ld:Hidden:1", "type": "Hidden", "speed": {"type": "Property", "value": 1}}
    assert http.post("/entities", json=entity).status_code == 201
    refused: list[dict[str, Any]] = [
        {"mode": "redirect", "information": of_type("Hidden")},
        {
            "mode": "exclusive",
            "information": [
                {"entities": [{"type": "Hidden", "id": entity["id"]}], "propertyNames": ["speed"]}
            ],
        },
    ]
    for members in refused:
        answer = http.post(PATH, json={"endpoint": "http://127.0.0.1:9", **members})
        assert answer.status_code == 409, answer.text
        assert answer.json()["title"] == "Conflict"
    free = [{"entities": [{"type": "Hidden", "id": entity["id"]}], "propertyNames": ["weight"]}]
    one = register(http, "free", mode="exclusive", information=free)
    assert (
        http.post(PATH, json={"endpoint": "http://a", "mode": "redirect", "information": free}).status_code
        == 409
    )
    assert http.delete(f"{PATH}/{one}").status_code == 204


@pytest.mark.parametrize(
    "body",
    [
        "[]",
        "{}",
        '{"information": 3, "endpoint": "http://a"}',
        '{"information": [{"entities": [{"type": "A"}]}], "endpoint": "http://[::bad"}',
        '{"information": [{"entities": [{"type": "A"}]}], "endpoint": "http://a", "type": "Task"}',
        '{"information": [{"entities": [{"type": "A"}]}], "endpoint": "http://a", "id": "no uri"}',
        '{"information": [{"propertyNames": ["a"]}], "endpoint": "http://a", "expiresAt": "2020-01-01T00"}',
    ],
)
def test_invalid_registrations_are_refused(http: httpx.Client, body: str) -> None:
    assert http.post(PATH, content=body, headers=JSON).status_code == 400


def test_link_local_sources_are_refused(http: httpx.Client) -> None:
    document = {"endpoint": "http://169.254.169.254", "information": of_type("Closed")}
    answer = http.post(PATH, json=document)
    assert answer.status_code == 400
    assert "metadata service" in answer.json()["detail"]
    one = register(http, "open", information=of_type("Closed"))
    assert http.patch(f"{PATH}/{one}", json={"endpoint": "http://[fe80::1]"}).status_code == 400


def test_tenants_have_their_own_registrations(http: httpx.Client) -> None:
    tenant = {"NGSILD-Tenant": "cell4"}
    document = {"endpoint": "http://a", "information": of_type("Owned")}
    answer = http.post(PATH, json=document, headers=tenant)
    assert answer.status_code == 201
    assert found(http, type="Owned") == []
    assert len(http.get(PATH, params={"type": "Owned"}, headers=tenant).json()) == 1


@pytest.mark.nightly
def test_registrations_survive_a_restart_and_expire(
    own_broker: BrokerProcess, eventually: Callable[..., Any]
) -> None:
    own_broker.start()
    soon = (datetime.now(UTC) + timedelta(seconds=3)).strftime("%Y-%m-%dT%H:%M:%S.%fZ")
    with own_broker.client() as http:
        stays = register(http, "stays", information=of_type("Kept"), hall="second")
        goes = register(http, "goes", information=of_type("Kept"), expiresAt=soon)
        assert found(http, type="Kept") == [stays, goes]
    own_broker.kill()
    own_broker.start()
    with own_broker.client() as http:
        assert found(http, type="Kept", csf='hall=="second"') == [stays]
        eventually(lambda: found(http, type="Kept") == [stays], why="it does not end")
        assert http.get(f"{PATH}/{goes}").status_code == 404
