"""Entity maps: made from queries, used for pages that stay the same, changed, ended, kept."""

import re
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import pytest

from .conftest import BrokerProcess

MAP = "NGSILD-EntityMap"


def make(http: httpx.Client, kind: str, *speeds: int) -> list[str]:
    ids = [f"urn:ngsi-ld:{kind}:{number}" for number in range(len(speeds))]
    for one, speed in zip(ids, speeds, strict=True):
        entity = {"id": one, "type": kind, "speed": {"type": "Property", "value": speed}}
        assert http.post("/entities", json=entity).status_code == 201
    return ids


def walk(http: httpx.Client, url: str, headers: dict[str, str]) -> Iterator[list[str]]:
    while True:
        answer = http.get(url, headers=headers)
        assert answer.status_code == 200, answer.text
        yield [one["id"] for one in answer.json()]
        following = re.search(r'<([^>]*)>; rel="next"', answer.headers.get("link", ""))
        if following is None:
            return
        url = f"{http.base_url.scheme}://{http.base_url.netloc.decode()}{following[1]}"


def test_a_map_lists_what_a_query_finds(http: httpx.Client) -> None:
    slow, fast = make(http, "Listed", 30, 90)
    answer = http.get("/entityMaps", params={"type": "Listed"})
    assert answer.status_code == 201
    document = answer.json()
    assert document["entityMap"] == {slow: ["@none"], fast: ["@none"]}
    assert (document["type"], document["linkedMaps"]) == ("EntityMap", {})
    at = answer.headers[MAP]
    assert at == f"/ngsi-ld/v1/entityMaps/{document['id']}"
    assert http.get(f"/entityMaps/{document['id']}").json() == document
    narrow = http.get("/entityMaps", params={"type": "Listed", "q": "speed>50"}).json()
    assert list(narrow["entityMap"]) == [fast]
    posted = http.post("/entityMaps", json={"type": "Query", "entities": [{"type": "Listed"}]})
    assert list(posted.json()["entityMap"]) == [slow, fast]
    assert http.delete(f"/entityMaps/{document['id']}").status_code == 204
    assert http.get(f"/entityMaps/{document['id']}").status_code == 404
    anew = http.get("/entities", params={"type": "Listed"}, headers={MAP: at})
    assert (anew.status_code, len(anew.json())) == (201, 2)
    assert anew.headers[MAP] != at


def test_pages_of_a_map_stay_the_same_while_entities_come_and_go(http: httpx.Client) -> None:
    ids = make(http, "Walked", *range(7))
    answer = http.get(
        "/entities", params={"type": "Walked", "entityMap": "true", "limit": "2", "count": "true"}
    )
    assert answer.status_code == 201
    assert [one["id"] for one in answer.json()] == ids[:2]
    assert answer.headers["ngsild-results-count"] == "7"
    named = {MAP: answer.headers[MAP]}
    pages = walk(http, "/entities?type=Walked&limit=2", named)
    seen = next(pages)
    http.delete(f"/entities/{ids[0]}")
    http.delete(f"/entities/{ids[4]}")
    http.post("/entities", json={"id": "urn:ngsi-ld:Walked:new", "type": "Walked"})
    for page in pages:
        seen += page
    assert seen == [ids[0], ids[1], ids[2], ids[3], ids[5], ids[6]]
    over = http.get("/entities", params={"type": "Walked", "offset": "100"}, headers=named)
    assert (over.status_code, over.json()) == (200, [])
    assert over.headers[MAP] == named[MAP]


def test_a_map_keeps_the_order_that_was_asked_for(http: httpx.Client) -> None:
    slow, fast, middle = make(http, "Ordered", 10, 90, 50)
    asked = {"type": "Ordered", "orderBy": "speed;desc", "limit": "2"}
    first = http.get("/entities", params={**asked, "entityMap": "true"})
    assert [one["id"] for one in first.json()] == [fast, middle]
    named = {MAP: first.headers[MAP]}
    second = http.get("/entities", params={**asked, "offset": "2"}, headers=named)
    assert [one["id"] for one in second.json()] == [slow]


def test_a_map_can_be_wished_for_among_the_options(http: httpx.Client) -> None:
    make(http, "Optional", 1, 2)
    asked = {"type": "Optional", "options": "keyValues,entityMap", "limit": "1"}
    answer = http.get("/entities", params=asked)
    assert answer.status_code == 201
    assert answer.json()[0]["speed"] == 1
    assert "options=keyValues&" in answer.headers["link"]
    assert http.get("/entities", params={"type": "Optional", "options": "keyValues"}).status_code == 200


def test_of_a_map_a_request_may_want_some_entities_alone(http: httpx.Client) -> None:
    first, second, third = make(http, "Alone", 1, 2, 3)
    named = {MAP: http.get("/entityMaps", params={"type": "Alone", "q": "speed>1"}).headers[MAP]}
    some = http.get("/entities", params={"type": "Alone", "id": f"{first},{third}"}, headers=named)
    assert [one["id"] for one in some.json()] == [third]
    query = {"type": "Query", "entities": [{"type": "Alone", "id": [first, second]}]}
    some = http.post("/entityOperations/query", json=query, headers=named)
    assert [one["id"] for one in some.json()] == [second]


def test_a_query_by_document_goes_through_a_map_too(http: httpx.Client) -> None:
    ids = make(http, "Posted", 1, 2, 3)
    query = {"type": "Query", "entities": [{"type": "Posted", "idPattern": "Posted"}], "q": "speed>0"}
    at = "/entityOperations/query"
    first = http.post(at, json=query, params={"entityMap": "true", "limit": "2"})
    assert first.status_code == 201, first.text
    named = {MAP: first.headers[MAP]}
    http.delete(f"/entities/{ids[0]}")
    second = http.post(at, json=query, params={"limit": "2", "offset": "2"}, headers=named)
    assert [one["id"] for one in first.json() + second.json()] == ids


@pytest.mark.parametrize(
    "parameters",
    [{}, {"type": "Any", "entityMapLifetime": "1hour"}, {"type": "Any", "colour": "red"}],
)
def test_what_makes_no_map_is_refused(http: httpx.Client, parameters: dict[str, str]) -> None:
    assert http.get("/entityMaps", params=parameters).status_code == 400


def test_only_the_end_of_a_map_can_be_changed(http: httpx.Client, eventually: Callable[..., Any]) -> None:
    make(http, "Ended", 1)
    one = http.get("/entityMaps", params={"type": "Ended", "entityMapLifetime": "PT2H"}).json()
    at = f"/entityMaps/{one['id']}"
    assert http.patch(at, json={"entityMap": {}, "linkedMaps": {}}).status_code == 204
    assert http.get(at).json() == one
    assert http.patch(at, json={"expiresAt": "soon"}).status_code == 400
    assert http.patch(at, json={"expiresAt": "2020-01-01T00:00:00Z"}).status_code == 400
    assert http.patch(at, json={"expiresAt": "2999-01-01T00:00:00Z"}).status_code == 204
    assert one["expiresAt"] < http.get(at).json()["expiresAt"] < "2999"
    brief = http.get("/entityMaps", params={"type": "Ended", "entityMapLifetime": "PT0.1S"}).json()["id"]
    eventually(lambda: http.get(f"/entityMaps/{brief}").status_code == 404)
    assert http.get("/entityMaps/no-uri").status_code == 400


def test_the_past_has_maps_too(http: httpx.Client) -> None:
    ids = make(http, "Past", 1, 2)
    when = {"type": "Past", "timerel": "after", "timeAt": "2020-01-01T00:00:00Z", "timeproperty": "createdAt"}
    answer = http.get("/temporal/entityMaps", params=when)
    assert answer.status_code == 201, answer.text
    assert list(answer.json()["entityMap"]) == ids
    told = http.get("/temporal/entities", params={**when, "limit": "1"}, headers={MAP: answer.headers[MAP]})
    assert [one["id"] for one in told.json()] == ids[:1]


def test_maps_are_there_after_a_power_cut(own_broker: BrokerProcess) -> None:
    own_broker.start()
    with own_broker.client() as http:
        make(http, "Kept", 1)
        one = http.get("/entityMaps", params={"type": "Kept"}).json()
    own_broker.kill()
    own_broker.start()
    with own_broker.client() as http:
        assert http.get(f"/entityMaps/{one['id']}").json() == one


@pytest.mark.parametrize("path", ["/entities", "/temporal/entities"])
def test_one_entity_is_retrieved_by_a_map_too(http: httpx.Client, path: str) -> None:
    (one,) = make(http, "Single" + path.count("temporal") * "Past", 30)
    plain = http.get(f"{path}/{one}")
    assert MAP not in plain.headers
    asked = {"entityMap": "true", "entityMapLifetime": "PT20M"}
    answer = http.get(f"{path}/{one}", params=asked)
    assert (answer.status_code, answer.json()) == (200, plain.json())
    at = answer.headers[MAP]
    document = http.get(at.removeprefix("/ngsi-ld/v1")).json()
    assert document["entityMap"] == {one: ["@none"]}
    again = http.get(f"{path}/{one}", headers={MAP: at})
    assert (again.status_code, again.headers[MAP], again.json()) == (200, at, plain.json())
    gone = http.get(f"{path}/{one}", headers={MAP: "/ngsi-ld/v1/entityMaps/urn:ngsi-ld:EntityMap:gone"})
    assert gone.status_code == 200
    assert gone.headers[MAP] not in {at, "/ngsi-ld/v1/entityMaps/urn:ngsi-ld:EntityMap:gone"}
    absent = http.get(f"{path}/urn:ngsi-ld:Single:absent", params=asked)
    assert absent.status_code == 404
    assert MAP not in absent.headers
    assert http.get(f"{path}/{one}", params={**asked, "entityMapLifetime": "soon"}).status_code == 400
