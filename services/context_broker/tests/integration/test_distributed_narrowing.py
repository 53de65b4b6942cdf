"""Selection of sources by coverage, and the requests that they receive."""

import time
from typing import Any

import httpx
import pytest

from tests.kit.context_sources import ScriptedSource, put, register, values

from .conftest import BrokerProcess

ENTITIES, QUERIES = "/ngsi-ld/v1/entities", "/ngsi-ld/v1/entityOperations/query"
CITY = {"type": "Polygon", "coordinates": [[[0, 0], [10, 0], [10, 10], [0, 10], [0, 0]]]}
FAR_AWAY = {"georel": "near;maxDistance==1000", "geometry": "Point", "coordinates": "[50,50]"}
IN_THE_CITY = {**FAR_AWAY, "coordinates": "[5,5]"}


@pytest.mark.parametrize(
    ("members", "asked"),
    [
        ({"location": CITY}, (FAR_AWAY, IN_THE_CITY)),
        ({"scope": "/Madrid"}, ({"scopeQ": "/Paris"}, {"scopeQ": "/Madrid/Gardens"})),
        ({"datasetId": ["urn:x:a"]}, ({"datasetId": "urn:x:b"}, {"datasetId": "urn:x:a"})),
    ],
)
def test_a_source_without_matching_coverage_is_not_queried(
    near: httpx.Client,
    source: ScriptedSource,
    kind: str,
    members: dict[str, Any],
    asked: tuple[dict[str, str], dict[str, str]],
) -> None:
    elsewhere, there = asked
    register(near, source.url, {"type": kind}, **members)
    assert near.get("/entities", params={"type": kind, **elsewhere}).status_code == 200
    assert source.asked == []
    assert near.get("/entities", params={"type": kind, **there}).status_code == 200
    assert near.get("/entities", params={"type": kind}).status_code == 200
    assert len(source.asked) == 2


def test_temporal_queries_go_to_sources_with_that_time(
    near: httpx.Client, source: ScriptedSource, kind: str
) -> None:
    spring = {"startAt": "2026-03-01T00:00:00Z", "endAt": "2026-06-01T00:00:00Z"}
    operations = ["retrieveTemporal", "queryTemporal"]
    register(near, source.url, {"type": kind}, operations=operations, observationInterval=spring)
    autumn = {"timerel": "after", "timeAt": "2026-09-01T00:00:00Z"}
    near.get("/temporal/entities", params={"type": kind, **autumn})
    near.get(f"/temporal/entities/urn:x:{kind}", params=autumn)
    query = {"type": "Query", "entities": [{"type": kind}], "temporalQ": autumn}
    near.post("/temporal/entityOperations/query", json=query)
    assert source.asked == []
    may = {**autumn, "timeAt": "2026-05-01T00:00:00Z"}
    near.get("/temporal/entities", params={"type": kind, **may})
    near.get(f"/temporal/entities/urn:x:{kind}", params=may)
    near.post("/temporal/entityOperations/query", json={**query, "temporalQ": may})
    assert len(source.asked) == 3


def test_writes_go_to_sources_with_matching_locations(
    near: httpx.Client, source: ScriptedSource, kind: str
) -> None:
    register(near, source.url, {"type": kind}, mode="redirect", location=CITY)
    source.answers["POST", ENTITIES] = 201, None
    point = {"type": "GeoProperty", "value": {"type": "Point", "coordinates": [50, 50]}}
    there, here = (f"urn:ngsi-ld:{kind}:{where}" for where in ("there", "here"))
    assert near.post("/entities", json={"id": here, "type": kind, "location": point}).status_code == 201
    assert source.asked == []
    assert near.get(f"/entities/{here}").status_code == 200
    source.answers["GET", ENTITIES] = 200, [{"id": there, "type": kind}]
    assert {one["id"] for one in near.get("/entities", params={"type": kind}).json()} == {here, there}
    point["value"] = {"type": "Point", "coordinates": [5, 5]}
    assert near.post("/entities", json={"id": there, "type": kind, "location": point}).status_code == 201
    assert source.asked[-1][4]["id"] == there
    assert near.get(f"/entities/{there}?local=true").status_code == 404


def test_only_registered_instances_of_a_source_count(
    near: httpx.Client, source: ScriptedSource, kind: str
) -> None:
    register(near, source.url, {"type": kind}, datasetId=["urn:x:a"])
    one = f"urn:ngsi-ld:{kind}:1"
    put(near, one, kind, n=1)
    returned = [
        {"type": "Property", "value": n, "datasetId": f"urn:x:{name}"} for n, name in ((2, "a"), (3, "b"))
    ]
    source.answers["GET", f"{ENTITIES}/{one}"] = 200, {"id": one, "type": kind, "n": returned}
    found = near.get(f"/entities/{one}").json()["n"]
    assert {(said["value"], said.get("datasetId")) for said in found} == {(1, None), (2, "urn:x:a")}


def test_a_source_with_batch_queries_only_is_queried_by_post(
    near: httpx.Client, source: ScriptedSource, kind: str
) -> None:
    register(near, source.url, {"type": kind}, operations=["queryBatch"])
    one = f"urn:ngsi-ld:{kind}:1"
    source.answers["POST", QUERIES] = 200, [{"id": one, "type": kind, "n": 7}]
    asked = {"type": kind, "q": "n>5", **IN_THE_CITY, "georel": "near;minDistance==1"}
    assert near.get("/entities", params=asked).json() == []  # it has no location
    _, _, query, headers, document = source.asked[-1]
    assert document == {
        "type": "Query",
        "entities": [{"type": kind}],
        "q": "n>5",
        "geoQ": {"georel": "near;minDistance==1", "geometry": "Point", "coordinates": [5, 5]},
    }
    assert (query["limit"], headers["content-type"]) == ("1000", "application/json")
    assert values(near.get(f"/entities/{one}")) == {"n": 7}
    assert source.asked[-1][4]["entities"] == [{"id": one, "type": kind}]
    near.get("/entities", params={"type": kind, "attrs": "n"})
    assert source.asked[-1][4]["attrs"] == ["n"]


def test_one_entity_is_read_by_a_query_if_the_source_takes_no_retrieve(
    near: httpx.Client, source: ScriptedSource, kind: str
) -> None:
    register(near, source.url, {"type": kind}, operations=["queryEntity"])
    one = f"urn:ngsi-ld:{kind}:1"
    source.answers["GET", ENTITIES] = 200, [{"id": one, "type": kind, "n": 7}]
    assert values(near.get(f"/entities/{one}")) == {"n": 7}
    assert source.asked[-1][2]["id"] == one


def test_a_source_with_single_reads_only_is_queried_by_known_ids(
    near: httpx.Client, source: ScriptedSource, kind: str
) -> None:
    one = f"urn:ngsi-ld:{kind}:1"
    register(near, source.url, {"type": kind, "id": one}, operations=["retrieveEntity"])
    source.answers["GET", f"{ENTITIES}/{one}"] = 200, {"id": one, "type": kind, "n": 7}
    assert [said["n"]["value"] for said in near.get("/entities", params={"type": kind}).json()] == [7]
    register(near, source.url, {"type": f"{kind}x"}, operations=["retrieveEntity"])
    source.asked.clear()
    assert near.get("/entities", params={"type": f"{kind}x"}).json() == []
    assert source.asked == []


@pytest.mark.parametrize(
    ("group", "takes"),
    [
        ("federationOps", {"GET one", "GET all", "GET types"}),
        ("associationOps", {"GET one", "GET all", "GET types"}),
        ("retrieveOps", {"GET one", "GET all"}),
        ("updateOps", {"PATCH attrs", "PUT"}),
        ("redirectionOps", {"GET one", "GET all", "GET types", "PATCH attrs", "PUT", "POST", "DELETE"}),
    ],
)
def test_an_operation_group_selects_the_forwarded_operations(
    near: httpx.Client, source: ScriptedSource, kind: str, group: str, takes: set[str]
) -> None:
    register(near, source.url, {"type": kind}, operations=[group])
    one = put(near, f"urn:ngsi-ld:{kind}:1", kind, n=1)
    requests: dict[str, tuple[str, str, Any]] = {
        "GET one": ("GET", f"/entities/{one}", None),
        "GET all": ("GET", f"/entities?type={kind}", None),
        "GET types": ("GET", f"/types/{kind}", None),
        "PATCH attrs": ("PATCH", f"/entities/{one}/attrs", {"n": 2}),
        "PUT": ("PUT", f"/entities/{one}", {"id": one, "type": kind, "n": 3}),
        "POST": ("POST", "/entities", {"id": f"{one}2", "type": kind}),
        "DELETE": ("DELETE", f"/entities/{one}", None),
    }
    passed_on = set()
    for name, (method, path, document) in requests.items():
        source.asked.clear()
        near.request(method, path, json=document)
        if source.asked:
            passed_on.add(name)
            assert source.asked[0][0] == method
    assert passed_on == takes


def test_reading_ends_if_a_source_ignores_the_offset(
    near: httpx.Client, source: ScriptedSource, kind: str
) -> None:
    register(near, source.url, {"type": kind})
    everything = [{"id": f"urn:ngsi-ld:{kind}:{number}", "type": kind} for number in range(1000)]
    source.answers["GET", ENTITIES] = 200, everything
    answer = near.get("/entities", params={"type": kind, "limit": "1", "count": "true"})
    assert answer.headers["ngsild-results-count"] == "1000"
    assert len(source.asked) == 2


def test_expired_parts_of_a_source_are_left_out(
    near: httpx.Client, source: ScriptedSource, kind: str
) -> None:
    register(near, source.url, {"type": kind})
    over = {"expiresAt": "2020-01-01T00:00:00Z"}
    returned = [
        {"id": "urn:x:1", "type": kind, "n": 1, **over},
        {"id": "urn:x:2", "type": kind, "n": {"value": 1, **over}, "m": 2},
    ]
    source.answers["GET", ENTITIES] = 200, returned
    answer = near.get("/entities", params={"type": kind, "options": "keyValues"})
    assert answer.json() == [{"id": "urn:x:2", "type": kind, "m": 2}]
    assert "ngsild-warning" not in answer.headers


@pytest.mark.parametrize("mode", ["inclusive", "redirect"])
@pytest.mark.parametrize("host", ["127.0.0.1", "localhost"])
def test_a_broker_registered_with_itself_does_not_query_itself(
    near: httpx.Client, brokers: list[BrokerProcess], kind: str, mode: str, host: str
) -> None:
    endpoint = f"http://{host}:{brokers[0].port}/ngsi-ld/v1"
    operations = ["redirectionOps", "createSubscription", "retrieveTemporal", "queryTemporal", "upsertBatch"]
    path = register(near, endpoint, {"type": kind}, mode=mode, operations=operations)
    one = f"urn:ngsi-ld:{kind}:1"
    answers = [
        near.post("/entities", json={"id": one, "type": kind, "n": 1}),
        near.get(f"/entities/{one}"),
        near.get("/entities", params={"type": kind}),
        near.get(f"/temporal/entities/{one}"),
        near.get(f"/types/{kind}"),
        near.post("/entityOperations/upsert", json=[{"id": one, "type": kind, "n": 2}]),
        near.patch(f"/entities/{one}/attrs", json={"n": 3}),
        near.delete(f"/entities/{one}"),
    ]
    assert [one.status_code for one in answers] == [201, 200, 200, 200, 200, 204, 204, 204]
    assert not any("ngsild-warning" in one.headers for one in answers)
    assert "timesSent" not in near.get(path).json()


def test_many_slow_pages_of_a_source_end_with_a_warning(
    near: httpx.Client, source: ScriptedSource, kind: str
) -> None:
    register(near, source.url, {"type": kind}, management={"timeout": 400})

    def page(query: dict[str, str]) -> tuple[int, list[dict[str, str]]]:
        time.sleep(0.3)
        first = int(query.get("offset", "0"))
        return 200, [{"id": f"urn:x:{number}", "type": kind} for number in range(first, first + 1000)]

    source.answers["GET", ENTITIES] = page
    answer = near.get("/entities", params={"type": kind, "limit": 1})
    assert answer.status_code == 200
    assert answer.headers["ngsild-warning"].startswith("199")
    assert len(source.asked) < 20


def test_many_registered_ids_are_split_over_several_requests(
    near: httpx.Client, source: ScriptedSource, kind: str
) -> None:
    ids = [f"urn:ngsi-ld:{kind}:{number:03}" for number in range(120)]
    operations = ["queryEntity", "queryTemporal", "purgeEntity"]
    path = register(near, source.url, {"type": kind}, operations=operations)
    entities = [{"type": kind, "id": one} for one in ids]
    assert near.patch(path, json={"information": [{"entities": entities}]}).status_code == 204
    past = "/ngsi-ld/v1/temporal/entities"

    def returned(query: dict[str, str]) -> tuple[int, list[dict[str, Any]]]:
        n = {"type": "Property", "value": 1, "observedAt": "2026-01-01T00:00:00Z"}
        return 200, [{"id": one, "type": kind, "n": [n]} for one in query["id"].split(",")]

    source.answers["GET", past] = returned
    source.answers["DELETE", ENTITIES] = 204, None
    since = {"timerel": "after", "timeAt": "2020-01-01T00:00:00Z"}
    found = near.get("/temporal/entities", params={"type": kind, "limit": 1000, **since}).json()
    assert [one["id"] for one in found] == ids
    near.get("/entities", params={"type": kind})
    assert near.delete("/entities", params={"type": kind}).status_code == 204
    assert len(source.asked) == 9
    assert all(len(one[2]["id"].split(",")) <= 50 for one in source.asked)
