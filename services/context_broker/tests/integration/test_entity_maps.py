"""Entity maps: creation, consistent pages, changes, expiry and restarts."""

import asyncio
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from handover_broker.app import create_broker
from handover_broker.settings import BrokerSettings
from handover_federation.operations import entity_map_pages

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


def test_a_map_lists_the_matches_of_a_query(http: httpx.Client) -> None:
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
    updated = http.get("/entities", params={"type": "Listed"}, headers={MAP: at})
    assert (updated.status_code, len(updated.json())) == (201, 2)
    assert updated.headers[MAP] != at


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


def link_of(answer: httpx.Response, relation: str) -> str:
    """Return the path of another page, empty if there is none."""
    found = re.search(rf'<([^>]*)>; rel="{relation}"', answer.headers.get("link", ""))
    return "" if found is None else found[1].removeprefix("/ngsi-ld/v1")


@pytest.mark.parametrize("look", [{}, {"pick": "speed"}, {"options": "keyValues"}, {"join": "flat"}])
def test_pages_are_filled_after_deletions_and_the_count_is_current(
    http: httpx.Client, look: dict[str, str]
) -> None:
    kind = f"Filled{''.join(look)}"
    ids = make(http, kind, *range(1, 11))

    def shown(answer: httpx.Response) -> list[int]:
        returned = [one["speed"] for one in answer.json()]
        return [one["value"] if isinstance(one, dict) else one for one in returned]

    asked = {"type": kind, "q": "speed>0", "limit": "3", "count": "true", **look}
    first = http.get("/entities", params={**asked, "entityMap": "true"})
    assert (shown(first), first.headers["ngsild-results-count"]) == ([1, 2, 3], "10")
    named = {MAP: first.headers[MAP]}
    for gone in (ids[0], ids[4], ids[9]):
        assert http.delete(f"/entities/{gone}").status_code == 204
    assert http.patch(f"/entities/{ids[5]}/attrs", json={"speed": -1}).status_code == 204
    second = http.get(link_of(first, "next"), headers=named)
    assert (shown(second), second.headers["ngsild-results-count"]) == ([4, 7, 8], "6")
    at = first.headers[MAP].removeprefix("/ngsi-ld/v1")
    assert list(http.get(at).json()["entityMap"]) == [*ids[1:4], *ids[6:9]], "the others have left the map"
    third = http.get(link_of(second, "next"), headers=named)
    assert (shown(third), third.headers["ngsild-results-count"]) == ([9], "6")
    assert link_of(third, "next") == ""
    before = http.get(link_of(third, "prev"), headers=named)
    assert shown(before) == [4, 7, 8]
    assert shown(http.get(link_of(before, "prev"), headers=named)) == [2, 3, 4], "one before it is gone"
    counted = http.get("/entities", params={**asked, "limit": "0"}, headers=named)
    assert (counted.json(), counted.headers["ngsild-results-count"]) == ([], "6")


@pytest.mark.nightly
def test_a_walk_without_count_sees_every_entity_once(http: httpx.Client) -> None:
    ids = make(http, "Thinned", *range(400))
    made = http.get("/entityMaps", params={"type": "Thinned"})
    named = {MAP: made.headers[MAP]}
    kept = ids[::7]
    for one in set(ids) - set(kept):
        assert http.delete(f"/entities/{one}").status_code == 204
    pages = list(walk(http, "/entities?type=Thinned&limit=10", named))
    assert [one for page in pages for one in page] == kept
    assert [len(page) for page in pages] == [10] * (len(kept) // 10) + [len(kept) % 10]


def test_another_query_leaves_a_map_as_it_is(http: httpx.Client) -> None:
    ids = make(http, "Kept", 1, 2, 3, 4, 5)
    made = http.get("/entityMaps", params={"type": "Kept"})
    named = {MAP: made.headers[MAP]}
    asked = {"type": "Kept", "q": "speed!=2", "limit": "2", "count": "true"}
    first = http.get("/entities", params=asked, headers=named)
    assert [one["id"] for one in first.json()] == [ids[0], ids[2]]
    assert first.headers["ngsild-results-count"] == "4"
    second = http.get(link_of(first, "next"), headers=named)
    assert [one["id"] for one in second.json()] == ids[3:]
    assert list(http.get(f"/entityMaps/{made.json()['id']}").json()["entityMap"]) == ids


def test_pages_of_a_query_by_document_are_filled(http: httpx.Client) -> None:
    ids = make(http, "Document", 1, 2, 3, 4, 5)
    query = {"type": "Query", "entities": [{"type": "Document"}], "q": "speed>0", "pick": ["speed"]}
    made = http.post("/entityMaps", json=query)
    named = {MAP: made.headers[MAP]}
    http.delete(f"/entities/{ids[1]}")
    at = "/entityOperations/query"
    page = http.post(at, json=query, params={"limit": "2", "count": "true"}, headers=named)
    assert [one["speed"]["value"] for one in page.json()] == [1, 3]
    assert page.headers["ngsild-results-count"] == "4"
    rest = http.post(at, json=query, params={"limit": "2", "offset": "2"}, headers=named)
    assert [one["speed"]["value"] for one in rest.json()] == [4, 5]


def test_temporal_pages_of_a_map_are_filled(http: httpx.Client) -> None:
    ids = make(http, "Forgotten", 1, 2, 3, 4, 5)
    since = {"timerel": "after", "timeAt": "2020-01-01T00:00:00Z", "timeproperty": "modifiedAt"}
    asked = {"type": "Forgotten", **since, "limit": "2"}
    made = http.get("/temporal/entities", params={**asked, "entityMap": "true"})
    assert [one["id"] for one in made.json()] == ids[:2]
    for one in ids[2:4]:
        assert http.delete(f"/entities/{one}").status_code == 204
        assert http.delete(f"/temporal/entities/{one}").status_code == 204
    window = {"offset": "2", "count": "true"}
    rest = http.get("/temporal/entities", params={**asked, **window}, headers={MAP: made.headers[MAP]})
    assert [one["id"] for one in rest.json()] == [ids[4]]
    assert rest.headers["ngsild-results-count"] == "3"


def test_a_map_keeps_the_requested_order(http: httpx.Client) -> None:
    slow, fast, middle = make(http, "Ordered", 10, 90, 50)
    asked = {"type": "Ordered", "orderBy": "speed;desc", "limit": "2"}
    first = http.get("/entities", params={**asked, "entityMap": "true"})
    assert [one["id"] for one in first.json()] == [fast, middle]
    named = {MAP: first.headers[MAP]}
    second = http.get("/entities", params={**asked, "offset": "2"}, headers=named)
    assert [one["id"] for one in second.json()] == [slow]


def test_a_map_can_be_requested_in_options(http: httpx.Client) -> None:
    make(http, "Optional", 1, 2)
    asked = {"type": "Optional", "options": "keyValues,entityMap", "limit": "1"}
    answer = http.get("/entities", params=asked)
    assert answer.status_code == 201
    assert answer.json()[0]["speed"] == 1
    assert "options=keyValues&" in answer.headers["link"]
    assert http.get("/entities", params={"type": "Optional", "options": "keyValues"}).status_code == 200


def test_a_request_may_select_entities_of_a_map(http: httpx.Client) -> None:
    first, second, third = make(http, "Alone", 1, 2, 3)
    named = {MAP: http.get("/entityMaps", params={"type": "Alone", "q": "speed>1"}).headers[MAP]}
    some = http.get("/entities", params={"type": "Alone", "id": f"{first},{third}"}, headers=named)
    assert [one["id"] for one in some.json()] == [third]
    query = {"type": "Query", "entities": [{"type": "Alone", "id": [first, second]}]}
    some = http.post("/entityOperations/query", json=query, headers=named)
    assert [one["id"] for one in some.json()] == [second]


def test_a_query_document_uses_a_map(http: httpx.Client) -> None:
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
def test_invalid_map_requests_are_refused(http: httpx.Client, parameters: dict[str, str]) -> None:
    assert http.get("/entityMaps", params=parameters).status_code == 400


def test_only_the_expiry_of_a_map_can_be_changed(http: httpx.Client, eventually: Callable[..., Any]) -> None:
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


def test_temporal_queries_have_maps(http: httpx.Client) -> None:
    ids = make(http, "Past", 1, 2)
    when = {"type": "Past", "timerel": "after", "timeAt": "2020-01-01T00:00:00Z", "timeproperty": "createdAt"}
    answer = http.get("/temporal/entityMaps", params=when)
    assert answer.status_code == 201, answer.text
    assert list(answer.json()["entityMap"]) == ids
    returned = http.get(
        "/temporal/entities", params={**when, "limit": "1"}, headers={MAP: answer.headers[MAP]}
    )
    assert [one["id"] for one in returned.json()] == ids[:1]


@pytest.mark.nightly
def test_maps_survive_a_crash(own_broker: BrokerProcess) -> None:
    own_broker.start()
    with own_broker.client() as http:
        make(http, "Kept", 1)
        one = http.get("/entityMaps", params={"type": "Kept"}).json()
    own_broker.kill()
    own_broker.start()
    with own_broker.client() as http:
        assert http.get(f"/entityMaps/{one['id']}").json() == one


@pytest.mark.parametrize("path", ["/entities", "/temporal/entities"])
def test_one_entity_is_retrieved_by_a_map(http: httpx.Client, path: str) -> None:
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


async def test_other_requests_are_served_while_a_large_map_is_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(entity_map_pages, "CHECK_BATCH_SIZE", 2)
    broker = create_broker(BrokerSettings(data_dir=tmp_path))
    await broker._serve()
    transport = httpx.ASGITransport(broker)
    async with httpx.AsyncClient(transport=transport, base_url="http://localhost/ngsi-ld/v1") as client:
        made = [{"id": f"urn:ngsi-ld:Many:{number}", "type": "Many"} for number in range(100)]
        assert (await client.post("/entityOperations/create", json=made)).status_code == 201
        query = {"type": "Many", "limit": "1"}
        first = await client.get("/entities", params={**query, "entityMap": "true"})
        headers = {MAP: first.headers[MAP].rpartition("/")[2]}

        async def turns_during(parameters: dict[str, str]) -> int:
            """Return how often other tasks ran on the event loop while a page was read."""
            page = asyncio.create_task(client.get("/entities", params=parameters, headers=headers))
            turns = 0
            while not page.done():
                await asyncio.sleep(0)
                turns += 1
            assert page.result().status_code == 200
            return turns

        plain = await turns_during(query)
        assert await turns_during({**query, "count": "true"}) >= plain + 50
    await broker._broker.stop()
