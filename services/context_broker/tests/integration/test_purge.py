"""Purge: selected entities are deleted or lose attributes; a selection of everything is refused."""

from typing import Any

import httpx
import pytest


def made(http: httpx.Client, name: str, kind: str, **attributes: Any) -> str:
    entity_id = f"urn:ngsi-ld:{kind}:demo:{name}"
    assert http.post("/entities", json={"id": entity_id, "type": kind, **attributes}).status_code == 201
    return entity_id


def read(http: httpx.Client, entity_id: str) -> Any:
    answer = http.get(f"/entities/{entity_id}", params={"options": "keyValues"})
    return answer.json() if answer.status_code == 200 else answer.status_code


def purge(http: httpx.Client, **parameters: str) -> int:
    return http.delete("/entities", params=parameters).status_code


def test_all_entities_of_a_type_are_purged_and_no_others(http: httpx.Client) -> None:
    gone = [made(http, f"{number}", "Crate", full=number % 2 == 0) for number in range(3)]
    other = made(http, "other", "Barrel")
    assert purge(http, type="Crate", q="full==true") == 204
    assert [read(http, one) == 404 for one in gone] == [True, False, True]
    assert purge(http, type="Crate", id=f"{other},{gone[1]}") == 204
    assert read(http, gone[1]) == 404
    assert read(http, other) != 404
    assert purge(http, type="Crate") == 204


def test_entities_are_purged_by_place_and_scope(http: httpx.Client) -> None:
    here, there = (
        made(http, name, "Buoy", location={"type": "Point", "coordinates": [x, 0]}, scope=f"/Sea/{name}")
        for name, x in (("here", 0), ("there", 50))
    )
    near = {"georel": "near;maxDistance==1000", "geometry": "Point", "coordinates": "[0,0]"}
    assert purge(http, **near, scopeQ="/Sea/there") == 204
    assert read(http, here) != 404
    assert purge(http, **near, scopeQ="/Sea/#") == 204
    assert (read(http, here), read(http, there) != 404) == (404, True)
    assert purge(http, type="Buoy", scopeQ="/Sea/#") == 204
    assert read(http, there) == 404


def test_attributes_are_dropped_or_kept(http: httpx.Client) -> None:
    first = made(http, "first", "Bottle", a=1, b=2, c=3)
    second = made(http, "second", "Bottle", b=2)
    assert purge(http, type="Bottle", drop="a") == 204
    assert read(http, first) == {"id": first, "type": "Bottle", "b": 2, "c": 3}
    assert purge(http, id=first, keep="b") == 204
    assert read(http, first) == {"id": first, "type": "Bottle", "b": 2}
    assert read(http, second) == {"id": second, "type": "Bottle", "b": 2}


@pytest.mark.parametrize(
    "parameters",
    [
        {},
        {"id": "urn:ngsi-ld:Jar:demo:stays"},
        {"idPattern": ".*"},
        {"attrs": "createdAt"},
        {"q": 'modifiedAt>"2020-01-01T00:00:00Z"'},
        {"type": "Jar", "keep": "a", "drop": "b"},
        {"type": "Jar", "attrs": "owner{name}"},
        {"type": "Jar", "q": 'owner{name}=="x"'},
        {"scopeQ": "/#"},
        {"type": "Jar", "pick": "a"},
    ],
)
def test_a_purge_that_chooses_nothing_is_refused(http: httpx.Client, parameters: dict[str, str]) -> None:
    http.post("/entities", json={"id": "urn:ngsi-ld:Jar:demo:stays", "type": "Jar"})
    assert purge(http, **parameters) == 400
    assert read(http, "urn:ngsi-ld:Jar:demo:stays") != 404


def test_a_purge_of_everything_needs_local(http: httpx.Client) -> None:
    tenant = {"NGSILD-Tenant": "purged"}
    entity = {"id": "urn:ngsi-ld:Jar:demo:tenant", "type": "Jar"}
    assert http.post("/entities", json=entity, headers=tenant).status_code == 201
    assert http.delete("/entities", params={"local": "true"}, headers=tenant).status_code == 204
    assert http.get(f"/entities/{entity['id']}", headers=tenant).status_code == 404
