"""Entity maps and snapshots where entities are spread over several brokers."""

from collections.abc import Iterator
from typing import Any

import httpx
import pytest

from tests.kit.context_sources import ScriptedSource, put, register

from .conftest import wait_for

MAP = "NGSILD-EntityMap"


def test_only_the_sources_listed_in_a_map_are_queried(
    near: httpx.Client, source: ScriptedSource, kind: str
) -> None:
    ids = [f"urn:ngsi-ld:{kind}:{number}" for number in range(4)]
    for one in ids[:3]:
        put(near, one, kind, here=1)
    registration = register(near, source.url, {"type": kind}, ["there"]).rpartition("/")[2]
    path = ("GET", "/ngsi-ld/v1/entities")
    source.answers[path] = 200, [{"id": one, "type": kind, "there": 2} for one in ids[2:]]
    answer = near.get("/entityMaps", params={"type": kind})
    assert answer.status_code == 201, answer.text
    assert answer.json()["entityMap"] == {
        ids[0]: ["@none"],
        ids[1]: ["@none"],
        ids[2]: ["@none", registration],
        ids[3]: [registration],
    }
    pages: list[Any] = []
    for offset in ("0", "2"):
        source.asked.clear()
        page = near.get(
            "/entities",
            params={"type": kind, "limit": "2", "offset": offset},
            headers={MAP: answer.headers[MAP]},
        )
        pages += page.json()
        asked = [one[2]["id"].split(",") for one in source.asked]
        assert asked == ([] if offset == "0" else [ids[2:]])
    assert sorted(one["id"] for one in pages) == ids
    assert {one["id"] for one in pages if "there" in one} == set(ids[2:])


def test_a_query_with_a_map_queries_sources_too(
    near: httpx.Client, far: httpx.Client, brokers: list[Any], kind: str
) -> None:
    put(near, f"urn:ngsi-ld:{kind}:1", kind, a=1)
    put(far, f"urn:ngsi-ld:{kind}:2", kind, a=2)
    register(near, brokers[1].url, {"type": kind})
    answer = near.get("/entities", params={"type": kind, "entityMap": "true"})
    assert answer.status_code == 201
    assert sorted(one["a"]["value"] for one in answer.json()) == [1, 2]
    put(far, f"urn:ngsi-ld:{kind}:3", kind, a=3)
    again = near.get("/entities", params={"type": kind}, headers={MAP: answer.headers[MAP]})
    assert sorted(one["a"]["value"] for one in again.json()) == [1, 2]


def test_a_snapshot_contains_entities_of_sources(
    near: httpx.Client, far: httpx.Client, brokers: list[Any], kind: str
) -> None:
    put(near, f"urn:ngsi-ld:{kind}:1", kind, a=1)
    put(far, f"urn:ngsi-ld:{kind}:2", kind, a=2)
    put(far, f"urn:ngsi-ld:{kind}:3", kind, a=0)
    register(near, brokers[1].url, {"type": kind})
    query = {"type": "Query", "entities": [{"type": kind}], "q": "a>0"}
    made = near.post("/snapshots", json={"snapshotQueries": [query]})
    at = made.headers["location"].removeprefix("/ngsi-ld/v1")
    status = wait_for(lambda: (returned := near.get(at).json()["snapshotStatus"]) != "preparing" and returned)
    assert status == "success"
    far.delete(f"/entities/urn:ngsi-ld:{kind}:2")
    inside = {"NGSILD-Snapshot": near.get(at).json()["id"]}
    answer = near.get("/entities", params={"type": kind}, headers=inside)
    assert sorted(one["a"]["value"] for one in answer.json()) == [1, 2]


@pytest.fixture
def other() -> Iterator[ScriptedSource]:
    """A second source."""
    made = ScriptedSource()
    yield made
    made.stop()


@pytest.fixture
def chain(brokers: list[Any], kind: str) -> Iterator[list[httpx.Client]]:
    """Three brokers in a chain, each with two entities."""
    operations = ["federationOps", "createEntityMapQueryTemporal", "queryTemporal", "retrieveTemporal"]
    clients = [one.client() for one in brokers]
    paths = [
        register(clients[place], brokers[place + 1].url, {"type": kind}, operations=operations)
        for place in range(2)
    ]
    for place, client in enumerate(clients):
        for number in range(2):
            put(client, f"urn:ngsi-ld:{kind}:{place}{number}", kind, n=10 * place + number)
    put(clients[2], f"urn:ngsi-ld:{kind}:00", kind, deep=1)
    yield clients
    for client, path in zip(clients, paths, strict=False):
        client.delete(path)
    for client in clients:
        client.close()


def linked(client: httpx.Client, document: dict[str, Any]) -> dict[str, Any]:
    """Return the only linked map of a map, from the broker that created it."""
    (other,) = document["linkedMaps"].values()
    found: dict[str, Any] = client.get(f"/entityMaps/{other}").json()
    return found


@pytest.mark.parametrize("past", [False, True])
def test_maps_are_linked_all_the_way_down_a_chain(chain: list[httpx.Client], kind: str, past: bool) -> None:
    asked = {"type": kind, "entityMapLifetime": "PT30M"}
    at = "entities"
    if past:
        at = "temporal/entities"
        asked |= {"timerel": "after", "timeAt": "2020-01-01T00:00:00Z", "timeproperty": "createdAt"}
    made = chain[0].get(f"/{at.replace('entities', 'entityMaps')}", params=asked)
    assert made.status_code == 201, made.text
    document = made.json()
    (registration,) = document["linkedMaps"]
    ids = [f"urn:ngsi-ld:{kind}:{name}" for name in ("00", "01", "10", "11", "20", "21")]
    expected = {one: [registration] for one in ids} | {ids[0]: ["@none", registration], ids[1]: ["@none"]}
    assert document["entityMap"] == expected
    second = linked(chain[1], document)
    assert second["entityMap"].keys() == set(ids) - {ids[1]}
    third = linked(chain[2], second)
    assert third["entityMap"] == {one: ["@none"] for one in (ids[0], *ids[4:])}
    assert third["linkedMaps"] == {}
    assert third["expiresAt"][:16] <= document["expiresAt"][:16]
    named = {MAP: made.headers[MAP]}
    for client in chain:
        client.post("/entities?local=true", json={"id": f"urn:ngsi-ld:{kind}:new", "type": kind})
    seen: list[Any] = []
    for offset in range(0, 8, 2):
        page = chain[0].get(f"/{at}", params={**asked, "limit": 2, "offset": offset}, headers=named)
        assert page.status_code == 200, page.text
        seen += page.json()
    assert sorted(one["id"] for one in seen) == ids
    assert {"n", "deep"} <= next(one for one in seen if one["id"] == ids[0]).keys()


def test_filters_apply_to_linked_maps(chain: list[httpx.Client], kind: str) -> None:
    made = chain[0].get("/entities", params={"type": kind, "q": "n>0", "entityMap": "true", "limit": 3})
    assert made.status_code == 201, made.text
    rest = chain[0].get(
        "/entities", params={"type": kind, "q": "n>0", "offset": 3}, headers={MAP: made.headers[MAP]}
    )
    assert sorted(one["n"]["value"] for one in made.json() + rest.json()) == [1, 10, 11, 20, 21]
    split = {"type": kind, "q": "n>5|deep==1", "splitEntities": "true"}
    document = chain[0].get("/entityMaps", params=split).json()
    assert len(document["linkedMaps"]) == 1
    assert {one[-2:] for one in document["entityMap"]} == {"00", "10", "11", "20", "21"}


def test_a_page_is_requested_by_the_map_of_the_source(
    near: httpx.Client, source: ScriptedSource, kind: str
) -> None:
    path = register(near, source.url, {"type": kind}, operations=["federationOps"])
    other = register(near, source.url, {"type": kind}, operations=["retrieveOps"])
    registration = path.rpartition("/")[2]
    one, two = (f"urn:ngsi-ld:{kind}:{number}" for number in (1, 2))
    theirs = "urn:ngsi-ld:EntityMap:theirs"
    returned = {"id": theirs, "type": "EntityMap", "entityMap": {one: ["@none"], two: ["@none"], "x": 1}}
    source.answers["GET", "/ngsi-ld/v1/entityMaps"] = 201, returned
    source.answers["GET", "/ngsi-ld/v1/entities"] = 200, []
    made = near.get("/entityMaps", params={"type": kind, "entityMapLifetime": "PT10M"})
    assert made.json()["linkedMaps"] == {registration: theirs}
    assert made.json()["entityMap"] == {one: [registration], two: [registration]}
    (asked,) = (each for each in source.asked if each[1].endswith("entityMaps"))
    assert (asked[2]["entityMapLifetime"], asked[2]["type"]) == ("PT10M", kind)
    source.asked.clear()
    source.answers["GET", "/ngsi-ld/v1/entities"] = 200, [{"id": two, "type": kind, "n": 1}]
    page = near.get(
        "/entities", params={"type": kind, "limit": 1, "offset": 1}, headers={MAP: made.headers[MAP]}
    )
    assert [each["id"] for each in page.json()] == [two]
    (asked,) = source.asked  # the other registration does not match
    assert asked[2]["id"] == two
    assert asked[3]["ngsild-entitymap"] == f"/ngsi-ld/v1/entityMaps/{theirs}"
    source.answers["GET", "/ngsi-ld/v1/entities"] = 404, None
    source.asked.clear()
    near.get("/entities", params={"type": kind, "limit": 1}, headers={MAP: made.headers[MAP]})
    assert ["ngsild-entitymap" in each[3] for each in source.asked][:2] == [True, False]
    at = f"/entityMaps/{made.json()['id']}"
    assert list(near.get(at).json()["entityMap"]) == [], "what the source has no more leaves the map"
    near.delete(other)


def test_pages_are_filled_after_deletions_at_a_source(
    near: httpx.Client, far: httpx.Client, kind: str
) -> None:
    register(near, str(far.base_url), {"type": kind}, operations=["federationOps"])
    ids = [put((near, far)[number % 2], f"urn:ngsi-ld:{kind}:{number}", kind, n=1) for number in range(8)]
    asked = {"type": kind, "q": "n>0", "limit": "3", "count": "true"}
    made = near.get("/entities", params={**asked, "entityMap": "true"})
    at = made.headers[MAP].removeprefix("/ngsi-ld/v1")
    listed = list(near.get(at).json()["entityMap"])
    assert sorted(listed) == ids

    def holder(one: str) -> httpx.Client:
        return (near, far)[int(one[-1]) % 2]

    for one in listed[3:5]:
        assert holder(one).delete(f"/entities/{one}?local=true").status_code == 204
    changed = holder(listed[6]).patch(f"/entities/{listed[6]}/attrs?local=true", json={"n": 0})
    assert changed.status_code == 204
    page = near.get("/entities", params={**asked, "offset": "3"}, headers={MAP: made.headers[MAP]})
    assert sorted(one["id"] for one in page.json()) == sorted([listed[5], listed[7]])
    assert page.headers["ngsild-results-count"] == "5"
    assert list(near.get(at).json()["entityMap"]) == [*listed[:3], listed[5], listed[7]]


def test_a_map_keeps_its_entities_while_a_source_fails(
    near: httpx.Client, source: ScriptedSource, kind: str
) -> None:
    register(near, source.url, {"type": kind}, operations=["queryEntity"], management={"timeout": 300})
    own = put(near, f"urn:ngsi-ld:{kind}:1", kind, n=1)
    theirs = f"urn:ngsi-ld:{kind}:2"
    source.answers["GET", "/ngsi-ld/v1/entities"] = 200, [{"id": theirs, "type": kind}]
    made = near.get("/entityMaps", params={"type": kind})
    assert made.json()["entityMap"].keys() == {own, theirs}
    source.go_on.clear()
    asked = {"type": kind, "count": "true"}
    page = near.get("/entities", params=asked, headers={MAP: made.headers[MAP]})
    assert [one["id"] for one in page.json()] == [own]
    assert page.headers["ngsild-warning"].startswith("199")
    source.go_on.set()
    page = near.get("/entities", params=asked, headers={MAP: made.headers[MAP]})
    assert {one["id"] for one in page.json()} == {own, theirs}
    assert page.headers["ngsild-results-count"] == "2"


@pytest.mark.parametrize("answer", [(404, None), (501, {}), (200, []), (200, b"<html>"), (200, {"id": 1})])
def test_a_source_without_maps_is_queried_for_entities(
    near: httpx.Client, source: ScriptedSource, kind: str, answer: tuple[int, Any]
) -> None:
    path = register(near, source.url, {"type": kind}, operations=["federationOps"])
    source.answers["GET", "/ngsi-ld/v1/entityMaps"] = answer
    one = f"urn:ngsi-ld:{kind}:1"
    source.answers["GET", "/ngsi-ld/v1/entities"] = 200, [{"id": one, "type": kind}]
    made = near.get("/entityMaps", params={"type": kind})
    assert made.status_code == 201
    assert made.json()["entityMap"] == {one: [path.rpartition("/")[2]]}
    assert made.json()["linkedMaps"] == {}


@pytest.mark.parametrize("past", [False, True])
def test_one_entity_is_read_from_the_sources_in_its_map(
    near: httpx.Client, source: ScriptedSource, other: ScriptedSource, kind: str, past: bool
) -> None:
    one = f"urn:ngsi-ld:{kind}:1"
    since = {"observationInterval": {"startAt": "2020-01-01T00:00:00Z"}} if past else {}
    operations = ["retrieveTemporal" if past else "retrieveEntity"]
    path = f"/{'temporal/' if past else ''}entities/{one}"
    put(near, one, kind, here=1)
    registration = register(near, source.url, {"type": kind}, operations=operations, **since)
    register(near, other.url, {"type": kind}, operations=operations, **since)
    there: Any = {"type": "Property", "value": 2, "observedAt": "2026-01-01T00:00:00Z"}
    returned = {"id": one, "type": kind, "there": [there] if past else there}
    source.answers["GET", f"/ngsi-ld/v1{path}"] = 200, returned
    made = near.get(path, params={"entityMap": "true"})
    assert {"here", "there"} <= made.json().keys(), made.text
    assert (len(source.asked), len(other.asked)) == (1, 1)
    at = made.headers[MAP]
    document = near.get(at.removeprefix("/ngsi-ld/v1")).json()
    assert document["entityMap"] == {one: ["@none", registration.rpartition("/")[2]]}
    again = near.get(path, headers={MAP: at})
    assert (again.json(), again.headers[MAP]) == (made.json(), at)
    assert (len(source.asked), len(other.asked)) == (2, 1)
