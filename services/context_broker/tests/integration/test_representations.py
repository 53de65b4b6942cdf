"""Representations of entities: pick and omit, languages, instances, GeoJSON, system attributes."""

from typing import Any

import httpx
import pytest

GEO = {"Accept": "application/geo+json"}
LINK = '<{}>; rel="http://www.w3.org/ns/json-ld#context"; type="application/ld+json"'
CORE = "https://uri.etsi.org/ngsi-ld/v1/ngsi-ld-core-context-v1.8.jsonld"


def made(http: httpx.Client, short: str, /, **members: Any) -> str:
    entity_id = f"urn:ngsi-ld:Shop:demo:{short}"
    answer = http.post("/entities", json={"id": entity_id, "type": "Shop", **members})
    assert answer.status_code == 201, answer.text
    return entity_id


def read(http: httpx.Client, entity_id: str, **parameters: str) -> Any:
    answer = http.get(f"/entities/{entity_id}", params=parameters)
    assert answer.status_code == 200, answer.text
    return answer.json()


def refused(http: httpx.Client, entity_id: str, **parameters: str) -> str:
    answer = http.get(f"/entities/{entity_id}", params=parameters)
    assert answer.status_code == 400, answer.text
    assert answer.json()["type"].endswith("/BadRequestData")
    return str(answer.json()["detail"])


def test_members_are_picked_and_omitted(http: httpx.Client) -> None:
    shop = made(http, "pick", a=1, b=2, scope="/Madrid/Gardens")
    simple = {"options": "keyValues"}
    assert read(http, shop, pick="id,a", **simple) == {"id": shop, "a": 1}
    assert read(http, shop, pick="scope|b", **simple) == {"scope": "/Madrid/Gardens", "b": 2}
    assert read(http, shop, omit="id,type,scope,a", **simple) == {"b": 2}
    hits = http.get("/entities", params={"type": "Shop", "id": shop, "pick": "id"}).json()
    assert hits == [{"id": shop}]
    accept = {"Accept": "application/ld+json"}
    for nothing in ({"pick": "c"}, {"omit": "id,type,scope,a,b"}):
        for path in (f"/entities/{shop}", f"/temporal/entities/{shop}"):
            for headers in ({}, accept):
                answer = http.get(path, params=nothing, headers=headers)
                assert (answer.status_code, answer.json()["type"].split("/")[-1]) == (404, "ResourceNotFound")


@pytest.mark.parametrize(
    "parameters",
    [
        {"pick": "a", "omit": "a"},
        {"pick": "a", "attrs": "a"},
        {"omit": "a", "attrs": "b"},
        {"pick": "id;a"},
        {"pick": "id,b{a"},
        {"pick": "id,b{{a}"},
        {"pick": "id,,a"},
        {"pick": "a||b"},
        {"pick": "id,b{,a}"},
        {"pick": "id,b{}"},
        {"pick": "a}"},
        {"omit": ""},
        {"pick": "id{a}"},
        {"pick": "a{" * 20 + "a" + "}" * 20},
    ],
)
def test_an_invalid_projection_is_refused(http: httpx.Client, parameters: dict[str, str]) -> None:
    http.post("/entities", json={"id": "urn:ngsi-ld:Shop:demo:refused", "type": "Shop", "a": 1})
    assert refused(http, "urn:ngsi-ld:Shop:demo:refused", **parameters)


@pytest.mark.parametrize(
    ("wanted", "tag"),
    [
        ("fr", "fr"),
        ("FR", "fr"),
        ("fr-CH,fr", "fr"),
        ("fr;q=0.2,nl;q=0.9", "nl"),
        ("nl-BE", "nl"),
        ("en", "en-US"),
        ("pt,*;q=0.5", "fr"),
        ("pt", "fr"),
    ],
)
def test_a_text_is_returned_in_the_best_language(http: httpx.Client, wanted: str, tag: str) -> None:
    words = {"fr": "Grand Place", "nl": "Grote Markt", "en-US": ["Main Square", "Square"]}
    shop = "urn:ngsi-ld:Shop:demo:words"
    http.post(
        "/entities",
        json={
            "id": shop,
            "type": "Shop",
            "street": {"languageMap": words, "observedAt": "2026-01-01T00:00:00Z"},
        },
    )
    assert read(http, shop, lang=wanted)["street"] == {
        "type": "Property",
        "value": words[tag],
        "lang": tag,
        "observedAt": "2026-01-01T00:00:00Z",
    }
    assert read(http, shop, lang=wanted, format="simplified")["street"] == words[tag]


def test_an_invalid_language_is_refused(http: httpx.Client) -> None:
    shop = made(http, "languages")
    for wanted in ("", "en;q=2", "e n", "en,", "en;x=1"):
        assert refused(http, shop, lang=wanted)


def test_instances_are_chosen_by_dataset(http: httpx.Client) -> None:
    names = [
        {"type": "Property", "value": "plain", "datasetId": "@none"},
        {"type": "Property", "value": "fr", "datasetId": "urn:x:fr"},
        {"type": "Property", "value": "es", "datasetId": "urn:x:es"},
    ]
    shop = made(http, "instances", name=names, size=3)
    assert read(http, shop)["name"][0] == {"type": "Property", "value": "plain"}
    assert read(http, shop, datasetId="urn:x:fr", options="keyValues") == {
        "id": shop,
        "type": "Shop",
        "name": "fr",
    }
    assert read(http, shop, datasetId="@none,urn:x:es", options="keyValues") == {
        "id": shop,
        "type": "Shop",
        "name": {"dataset": {"@none": "plain", "urn:x:es": "es"}},
        "size": 3,
    }
    assert read(http, shop, datasetId="urn:x:de", attrs="name") == {"id": shop, "type": "Shop"}


def test_an_entity_is_returned_as_a_feature(http: httpx.Client) -> None:
    point, other = ({"type": "Point", "coordinates": [x, 2]} for x in (1, 9))
    location = [
        {"type": "GeoProperty", "value": other, "datasetId": "urn:x:gps"},
        {"type": "GeoProperty", "value": point},
    ]
    shop = made(http, "feature", location=location, size=3, spot={"type": "GeoProperty", "value": other})
    answer = http.get(f"/entities/{shop}", headers=GEO)
    assert answer.headers["content-type"] == "application/geo+json"
    assert answer.json() == {
        "id": shop,
        "type": "Feature",
        "geometry": point,
        "properties": {
            "type": "Shop",
            "location": location,
            "size": {"type": "Property", "value": 3},
            "spot": {"type": "GeoProperty", "value": other},
        },
        "@context": CORE,
    }
    answer = http.get(
        f"/entities/{shop}",
        params={"geometryProperty": "spot", "options": "keyValues", "pick": "id,size"},
        headers={**GEO, "Prefer": "body=json", "Link": LINK.format(CORE)},
    )
    assert answer.json() == {"id": shop, "type": "Feature", "geometry": other, "properties": {"size": 3}}
    assert CORE in answer.headers["link"]
    answer = http.get(f"/entities/{shop}", params={"datasetId": "urn:x:gps"}, headers=GEO)
    assert answer.json()["geometry"] == other
    for place in ("size", "nowhere"):
        answer = http.get(f"/entities/{shop}", params={"geometryProperty": place}, headers=GEO)
        assert answer.json()["geometry"] is None
    assert "geo+json" in refused(http, shop, geometryProperty="spot")


def test_a_page_is_a_feature_collection(http: httpx.Client) -> None:
    shop = made(http, "collection", location={"type": "Point", "coordinates": [1, 2]})
    answer = http.get("/entities", params={"type": "Shop", "id": shop, "count": "true"}, headers=GEO)
    assert answer.headers["ngsild-results-count"] == "1"
    body = answer.json()
    assert (body["type"], body["@context"]) == ("FeatureCollection", CORE)
    assert [one["id"] for one in body["features"]] == [shop]
    assert "@context" not in body["features"][0]


def test_expiries_are_returned_with_the_system_attributes(http: httpx.Client) -> None:
    end = "2100-01-01T00:00:00Z"
    shop = made(http, "ends", expiresAt=end, size={"type": "Property", "value": 1, "expiresAt": end})
    assert "expiresAt" not in http.get(f"/entities/{shop}").text
    shown = read(http, shop, options="sysAttrs")
    assert shown["expiresAt"] == shown["size"]["expiresAt"] == end


def test_the_format_comes_before_what_options_say(http: httpx.Client) -> None:
    one = "urn:ngsi-ld:Formed:demo:1"
    made = http.post("/entities", json={"id": one, "type": "Formed", "n": {"type": "Property", "value": 1}})
    assert made.status_code == 201
    concise = http.get(f"/entities/{one}", params={"format": "normalized", "options": "keyValues,sysAttrs"})
    assert (concise.json()["n"]["value"], "createdAt" in concise.json()) == (1, True)
    past = {"format": "temporalValues", "options": "aggregatedValues", "timeproperty": "modifiedAt"}
    assert http.get(f"/temporal/entities/{one}", params=past).json()["n"]["values"][0][0] == 1
    both = {"format": "normalized", "options": "keyValues"}
    change = {"n": {"type": "Property", "value": 2}}
    assert http.patch(f"/entities/{one}", json=change, params=both).status_code == 204
    assert http.get(f"/entities/{one}").json()["n"] == change["n"]
    refused = http.get(f"/entities/{one}", params={"options": "keyValues,concise"})
    assert refused.status_code == 400
