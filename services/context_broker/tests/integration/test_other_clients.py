"""What clients in use send: accepted where it is harmless, or refused with the remedy."""

from pathlib import Path
from typing import Any
from urllib.parse import quote

import httpx
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from handover_broker.settings import BrokerSettings
from handover_datamodels.contexts import HANDOVER_URL

POINT = {"type": "Point", "coordinates": [8, 40]}
ENDPOINT = {"endpoint": {"uri": "http://127.0.0.1:9/"}}
LINK = {"Link": f'<{HANDOVER_URL}>; rel="http://www.w3.org/ns/json-ld#context"; type="application/ld+json"'}
WARNING = "NGSILD-Warning"


def subscribed(http: httpx.Client, kind: str, q: str) -> str:
    document = {"type": "Subscription", "entities": [{"type": kind}], "q": q, "notification": ENDPOINT}
    answer = http.post("/subscriptions", json=document)
    assert answer.status_code == 201, answer.text
    stored: str = http.get(answer.headers["location"].removeprefix("/ngsi-ld/v1")).json()["q"]
    return stored


@pytest.mark.parametrize("q", ['status=="open"', "filling>0.6;filling<=0.9", 'name~="^a b"|speed!=1'])
def test_a_percent_encoded_q_in_a_body_is_decoded(http: httpx.Client, kind: str, q: str) -> None:
    encoded = quote(q)
    assert subscribed(http, kind, encoded) == q
    assert subscribed(http, kind, q) == q
    query = {"type": "Query", "entities": [{"type": kind}], "q": encoded}
    assert http.post("/entityOperations/query", json=query).status_code == 200


def test_a_q_that_is_one_as_it_stands_is_not_decoded(http: httpx.Client, kind: str) -> None:
    assert subscribed(http, kind, 'share=="5%20of"') == 'share=="5%20of"'
    document = {"type": "Subscription", "entities": [{"type": kind}], "notification": ENDPOINT}
    assert http.post("/subscriptions", json={**document, "q": "a%3D%3D"}).status_code == 400


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.text("ab1-._~", min_size=1, max_size=4), min_size=1, max_size=4), st.booleans())
def test_an_id_that_is_a_url_is_found_unencoded(http: httpx.Client, parts: list[str], secure: bool) -> None:
    entity_id = f"http{'s' if secure else ''}://a.example/{'/'.join(parts)}"
    if any(set(part) <= {"."} for part in parts):  # a client resolves these
        return
    assert http.post("/entities", json={"id": entity_id, "type": "T", "a": 1}).status_code == 201
    assert http.get(f"/entities/{entity_id}").json()["id"] == entity_id
    assert http.patch(f"/entities/{entity_id}/attrs", json={"a": 2}).status_code == 204
    assert http.get(f"/entities/{quote(entity_id, safe='')}").json()["a"]["value"] == 2
    assert http.delete(f"/entities/{entity_id}/attrs/a").status_code == 204
    assert http.delete(f"/entities/{entity_id}").status_code == 204


def test_an_unencoded_url_that_is_ambiguous_is_refused_with_the_remedy(http: httpx.Client) -> None:
    answer = http.get("/entities/http://a.example/attrs/1/attrs/b")
    assert answer.status_code == 404
    assert "percent-encode" in answer.json()["detail"]


@pytest.mark.parametrize("options", ["replace", "update"])
def test_options_of_an_upsert_change_nothing_in_an_update(
    http: httpx.Client, kind: str, options: str
) -> None:
    entity = {"id": f"urn:ngsi-ld:{kind}:1", "type": kind, "a": 1, "b": 1}
    assert http.post("/entities", json=entity).status_code == 201
    answer = http.post(f"/entityOperations/update?options={options}", json=[{**entity, "a": 2}])
    assert answer.status_code == 204, answer.text
    assert http.get(f"/entities/{entity['id']}?format=simplified").json() == {**entity, "a": 2}
    both = http.post(f"/entityOperations/update?options={options},noOverwrite", json=[entity])
    assert both.status_code == 400


@pytest.mark.parametrize(
    ("location", "words"),
    [
        ({"type": "Property", "value": POINT}, 'write "type": "GeoProperty"'),
        ({"type": "Relationship", "object": "urn:x:1"}, 'write "type": "GeoProperty" and give it a geometry'),
        ({"type": "Property", "value": "Espoo"}, "GeoJSON geometry"),
        ({"type": "Property", "value": {"type": "Point", "coordinates": [200, 0]}}, "longitude"),
    ],
)
def test_a_location_of_another_kind_is_refused_with_the_remedy(
    http: httpx.Client, kind: str, location: dict[str, Any], words: str
) -> None:
    answer = http.post("/entities", json={"id": f"urn:x:{kind}", "type": kind, "location": location})
    assert answer.status_code == 400
    assert words in answer.json()["detail"]


@pytest.mark.parametrize(
    ("parameters", "words", "absent"),
    [
        ({"q": "createdAt>2026-01-01T00:00:00Z"}, "q name only what every entity has", "add type, attrs, q"),
        ({"attrs": "scope"}, "attrs name only what every entity has", "attrs,"),
        ({"id": "urn:x:1"}, "id do not narrow it down", ""),
        ({}, "too broad: add type, attrs, q or georel", "because"),
    ],
)
def test_a_query_that_is_too_broad_is_refused_for_what_was_given(
    http: httpx.Client, parameters: dict[str, str], words: str, absent: str
) -> None:
    answer = http.get("/entities", params=parameters)
    assert answer.status_code == 400
    assert words in answer.json()["detail"]
    assert not absent or absent not in answer.json()["detail"]


@pytest.mark.parametrize("name", ["id", "@id", "type"])
def test_a_keyword_is_not_called_a_name_without_an_iri(http: httpx.Client, kind: str, name: str) -> None:
    entity = {
        "id": f"urn:x:{kind}",
        "type": kind,
        "a": {"type": "Property", "value": 1, "b": {name: 1, "c": 2}},
    }
    for answer in (http.get("/entities", params={"type": name}), http.post("/entities", json=entity)):
        if answer.status_code == 400:
            assert "has no IRI" not in answer.json()["detail"]


def test_an_empty_result_warns_of_a_name_that_is_stored_as_another_iri(http: httpx.Client, kind: str) -> None:
    device = {"id": f"urn:ngsi-ld:Device:{kind}", "type": "Device", "category": ["sensor"]}
    assert http.post("/entities", json=device, headers=LINK).status_code == 201
    answer = http.get("/entities", params={"type": "Device"})
    assert answer.json() == []
    assert HANDOVER_URL in answer.headers[WARNING]
    assert "HANDOVER_BROKER_DEFAULT_CONTEXT" in answer.headers[WARNING]
    by_document = {"type": "Query", "entities": [{"type": "Device"}, {"type": kind}]}
    since = {"timerel": "after", "timeAt": "1970-01-01T00:00:00Z"}
    for other in (
        http.get("/entities", params={"type": f"{kind},Device", "limit": 0, "count": "true"}),
        http.get("/entities", params={"type": "Device"}, headers={"Accept": "application/geo+json"}),
        http.get("/temporal/entities", params={"type": "Device", **since}),
        http.post("/entityOperations/query", json=by_document),
    ):
        assert other.status_code == 200, other.text
        assert HANDOVER_URL in other.headers[WARNING], other.request.url
    for silent in (
        http.get("/entities", params={"type": "Device"}, headers=LINK),
        http.get("/entities", params={"type": "Device", "q": "noSuchThing"}, headers=LINK),
        http.get("/entities", params={"type": kind}),
    ):
        assert WARNING not in silent.headers
    own = {"@context": {name: f"https://a.example/{kind}/{name}" for name in ("Device", "pitch")}}
    headers = {"Content-Type": "application/ld+json"}
    theirs = {**device, "id": f"urn:x:{kind}", "pitch": 1, **own}
    assert http.post("/entities", json=theirs, headers=headers).is_success
    for asked in ({"q": "pitch>0"}, {"attrs": "pitch"}):
        assert f"https://a.example/{kind}/pitch" in http.get("/entities", params=asked).headers[WARNING]
    several = http.get("/entities", params={"type": "Device"}).headers.get_list(WARNING)
    assert any(f"https://a.example/{kind}/Device" in one for one in several)


def test_a_setting_makes_our_context_the_default(tmp_path: Path) -> None:
    settings = BrokerSettings.load(data_dir=tmp_path, broker_default_context="handover")
    assert settings.broker_default_context == HANDOVER_URL
