"""Temporal evolutions, types and attributes from several brokers."""

from typing import Any

import httpx
import pytest

from tests.kit.context_sources import ScriptedSource, put, register

TEMPORAL = ["retrieveTemporal", "queryTemporal"]
DISCOVERY = [
    "retrieveEntityTypes", "retrieveEntityTypeDetails", "retrieveEntityTypeInfo", "retrieveAttrTypes",
    "retrieveAttrTypeDetails", "retrieveAttrTypeInfo",
]  # fmt: skip


def provide(client: httpx.Client, entity_id: str, kind: str, **evolutions: dict[int, int]) -> None:
    """Provide evolutions of attributes: values by the second at which they were observed."""
    document: dict[str, Any] = {"id": entity_id, "type": kind}
    for name, values in evolutions.items():
        document[name] = [
            {"type": "Property", "value": value, "observedAt": f"2026-01-01T00:00:{second:02}Z"}
            for second, value in values.items()
        ]
    answer = client.post("/temporal/entities?local=true", json=document)
    assert answer.status_code == 201, answer.text


def values_of(document: dict[str, Any], name: str) -> list[Any]:
    said = document.get(name, [])
    return [one["value"] for one in (said if isinstance(said, list) else [said])]


def test_evolutions_of_sources_are_merged(
    near: httpx.Client, far: httpx.Client, brokers: list[Any], kind: str
) -> None:
    entity_id = f"urn:ngsi-ld:{kind}:1"
    register(near, brokers[1].url, {"type": kind}, operations=TEMPORAL)
    provide(near, entity_id, kind, a={1: 1, 3: 3}, b={1: 7})
    provide(far, entity_id, kind, a={2: 2, 3: 3, 4: 4}, c={9: 9})
    document = near.get(f"/temporal/entities/{entity_id}").json()
    assert values_of(document, "a") == [1, 2, 3, 4]
    assert values_of(document, "b") == [7]
    assert values_of(document, "c") == [9]
    document = near.get(f"/temporal/entities/{entity_id}?lastN=2").json()
    assert values_of(document, "a") == [3, 4]
    values = near.get(f"/temporal/entities/{entity_id}?options=temporalValues").json()["a"]["values"]
    assert [value for value, _ in values] == [1, 2, 3, 4]
    between = {"timerel": "between", "timeAt": "2026-01-01T00:00:02Z", "endTimeAt": "2026-01-01T00:00:04Z"}
    document = near.get(f"/temporal/entities/{entity_id}", params=between).json()
    assert values_of(document, "a") == [2, 3]
    assert values_of(near.get(f"/temporal/entities/{entity_id}?local=true").json(), "a") == [1, 3]


@pytest.mark.parametrize("single", [True, False])
def test_a_merged_evolution_expires_with_its_last_part(
    near: httpx.Client, far: httpx.Client, brokers: list[Any], kind: str, single: bool
) -> None:
    register(near, brokers[1].url, {"type": kind}, operations=TEMPORAL)
    one = f"urn:ngsi-ld:{kind}:1"
    path = f"/temporal/entities/{one}" if single else "/temporal/entities"
    asked = {} if single else {"type": kind, "timerel": "after", "timeAt": "2025-01-01T00:00:00Z"}
    for client, values in ((near, {1: 1}), (far, {2: 2})):
        provide(client, one, kind, a=values)

    def end(client: httpx.Client, expires_at: str) -> Any:
        at = f"/temporal/entities/{one}/attrs?local=true"
        assert client.post(at, json={"expiresAt": expires_at}).status_code == 204
        assert "expiresAt" not in near.get(path, params=asked).text
        document = near.get(path, params={**asked, "options": "sysAttrs"}).json()
        (change_data,) = document if isinstance(document, list) else [document]
        assert values_of(change_data, "a") == [1, 2]
        return change_data.get("expiresAt")

    sooner, later = "2095-01-01T00:00:00Z", "2096-01-01T00:00:00Z"
    assert end(near, later) is None
    assert end(far, sooner) == later


def test_temporal_pages_cover_all_sources(
    near: httpx.Client, far: httpx.Client, brokers: list[Any], kind: str
) -> None:
    register(near, brokers[1].url, {"type": kind}, operations=TEMPORAL)
    for number in range(3):
        provide(near, f"urn:ngsi-ld:{kind}:near{number}", kind, a={1: 1})
        provide(far, f"urn:ngsi-ld:{kind}:far{number}", kind, a={1: 1})
    provide(far, f"urn:ngsi-ld:{kind}:near0", kind, a={2: 2})
    time = {"timerel": "after", "timeAt": "2025-01-01T00:00:00Z"}
    found: list[str] = []
    for offset in range(0, 8, 2):
        answer = near.get("/temporal/entities", params={"type": kind, "limit": 2, "offset": offset, **time})
        found += [one["id"].rpartition(":")[2] for one in answer.json()]
        assert ("next" in answer.links) == (offset < 4)
    assert found == ["near0", "near1", "near2", "far0", "far1", "far2"]
    query = {"type": "Query", "entities": [{"type": kind}], "temporalQ": time}
    answer = near.post("/temporal/entityOperations/query", json=query)
    assert len(answer.json()) == 6, answer.text


def test_an_exclusive_source_alone_provides_its_evolution(
    near: httpx.Client, far: httpx.Client, brokers: list[Any], kind: str
) -> None:
    entity_id = f"urn:ngsi-ld:{kind}:1"
    provide(near, entity_id, kind, a={1: 1}, b={1: 1})
    provide(far, entity_id, kind, b={2: 2})
    register(
        near, brokers[1].url, {"type": kind, "id": entity_id}, ["b"], mode="exclusive", operations=TEMPORAL
    )
    document = near.get(f"/temporal/entities/{entity_id}").json()
    assert values_of(document, "a") == [1]
    assert values_of(document, "b") == [2]


def test_a_failed_temporal_source_causes_a_warning(
    near: httpx.Client, source: ScriptedSource, kind: str
) -> None:
    path = register(near, source.url, {"type": kind}, operations=TEMPORAL)
    entity_id = f"urn:ngsi-ld:{kind}:1"
    provide(near, entity_id, kind, a={1: 1})
    source.answers["GET", f"/ngsi-ld/v1/temporal/entities/{entity_id}"] = 200, b"nonsense"
    assert near.get(f"/temporal/entities/{entity_id}").headers["ngsild-warning"].startswith("111")
    near.delete(path)
    register(near, source.url, {"type": f"{kind}x"}, operations=TEMPORAL, mode="redirect")
    source.answers["GET", f"/ngsi-ld/v1/temporal/entities/{entity_id}x"] = 500, {}
    assert near.get(f"/temporal/entities/{entity_id}x").status_code == 502


def test_types_and_attributes_of_all_sources_are_listed(
    near: httpx.Client, far: httpx.Client, brokers: list[Any], kind: str
) -> None:
    name, other = f"a{kind}", f"b{kind}"
    put(near, f"urn:ngsi-ld:{kind}:1", kind, **{name: 1})
    put(far, f"urn:ngsi-ld:{kind}:1", kind, **{other: 1})
    put(far, f"urn:ngsi-ld:{kind}:2", kind, **{other: {"type": "Relationship", "object": "urn:x:y"}})
    put(far, f"urn:ngsi-ld:{kind}:3", f"{kind}Other", c=1)
    register(near, brokers[1].url, {"type": kind}, operations=DISCOVERY)
    assert kind in near.get("/types").json()["typeList"]
    assert f"{kind}Other" not in near.get("/types").json()["typeList"]  # it is not registered
    (details,) = [one for one in near.get("/types?details=true").json() if one["typeName"] == kind]
    assert details["attributeNames"] == [name, other]
    info = near.get(f"/types/{kind}").json()
    assert info["entityCount"] == 3
    types = {one["attributeName"]: one["attributeTypes"] for one in info["attributeDetails"]}
    assert types == {name: ["Property"], other: ["Property", "Relationship"]}
    assert other in near.get("/attributes").json()["attributeList"]
    (details,) = [one for one in near.get("/attributes?details=true").json() if one["attributeName"] == other]
    assert details["typeNames"] == [kind]
    info = near.get(f"/attributes/{other}").json()
    assert (info["attributeCount"], info["typeNames"]) == (2, [kind])
    assert near.get(f"/attributes/{other}?local=true").status_code == 404


@pytest.mark.parametrize(
    "path", ["/types", "/types?details=true", "/types/Any", "/attributes", "/attributes/any"]
)
def test_an_invalid_discovery_response_causes_a_warning(
    near: httpx.Client, source: ScriptedSource, path: str
) -> None:
    register(near, source.url, {"type": "Any"}, ["any"], operations=DISCOVERY)
    source.answers["GET", f"/ngsi-ld/v1{path.partition('?')[0]}"] = 200, "nonsense"
    answer = near.get(path)
    assert answer.status_code in {200, 404}
    assert answer.headers["ngsild-warning"].startswith("111")


AGGREGATES = {"options": "aggregatedValues", "aggrMethods": "totalCount,avg,distinctCount,stddev,min,max,sum"}
THAT_DAY = {"timerel": "between", "timeAt": "2026-01-01T00:00:00Z", "endTimeAt": "2026-01-02T00:00:00Z"}


def totals(document: dict[str, Any], name: str) -> dict[str, list[Any]]:
    said = {method: pairs for method, pairs in document[name].items() if method != "type"}
    return {method: [pair[0] for pair in pairs] for method, pairs in said.items()}


def test_aggregations_cover_the_values_of_all_sources(
    near: httpx.Client, far: httpx.Client, brokers: list[Any], kind: str
) -> None:
    one, other = f"urn:ngsi-ld:{kind}:1", f"urn:ngsi-ld:{kind}:2"
    register(near, brokers[1].url, {"type": kind}, operations=TEMPORAL)
    provide(near, one, kind, a={1: 1, 2: 2, 3: 3}, b={1: 5})
    provide(far, one, kind, a={3: 3, 4: 3, 5: 11}, c={2: 8})
    provide(far, other, kind, a={1: 100})
    expected = {
        "totalCount": [5],
        "avg": [4],
        "distinctCount": [4],
        "stddev": [pytest.approx(3.5777, abs=1e-3)],
        "min": [1],
        "max": [11],
        "sum": [20],
    }
    found = near.get(f"/temporal/entities/{one}", params={**AGGREGATES, **THAT_DAY}).json()
    assert totals(found, "a") == expected
    assert totals(found, "b")["sum"] == [5]
    assert totals(found, "c")["sum"] == [8]
    assert totals(near.get(f"/temporal/entities/{one}", params=AGGREGATES).json(), "a") == expected
    answer = near.get("/temporal/entities", params={"type": kind, **AGGREGATES, **THAT_DAY})
    assert [(said["id"], totals(said, "a")["sum"]) for said in answer.json()] == [(one, [20]), (other, [100])]
    query = {
        "type": "Query",
        "entities": [{"type": kind}],
        "temporalQ": THAT_DAY,
        "aggrParams": {"aggrMethods": "sum", "aggrPeriodDuration": "PT2S"},
    }
    at = "/temporal/entityOperations/query"
    answer = near.post(at, json=query, params={"options": "aggregatedValues"})
    assert totals(answer.json()[0], "a")["sum"] == [1, 5, 14], answer.text
    picked = near.get(f"/temporal/entities/{one}", params={**AGGREGATES, **THAT_DAY, "pick": "id,c"}).json()
    assert picked.keys() == {"id", "c"}
    (first, _) = near.get("/temporal/entities", params={"type": kind, **THAT_DAY, "pick": "c,type"}).json()
    assert first.keys() == {"type", "c"}
    (first, _) = near.post(at, json={**query, "pick": ["c"]}, params={"options": "aggregatedValues"}).json()
    assert first.keys() == {"c"}
    (first, _) = near.get("/temporal/entities", params={"type": kind, **THAT_DAY, "omit": "c,type"}).json()
    assert first.keys() == {"id", "a", "b"}


def test_for_one_time_the_own_instance_counts(
    near: httpx.Client, far: httpx.Client, brokers: list[Any], kind: str
) -> None:
    entity_id = f"urn:ngsi-ld:{kind}:1"
    register(near, brokers[1].url, {"type": kind}, operations=TEMPORAL)
    provide(near, entity_id, kind, a={1: 700})
    provide(far, entity_id, kind, a={1: 800, 2: 900})
    assert values_of(near.get(f"/temporal/entities/{entity_id}").json(), "a") == [700, 900]
    pairs = near.get(f"/temporal/entities/{entity_id}?options=temporalValues").json()["a"]["values"]
    assert [value for value, _ in pairs] == [700, 900]


def test_partial_responses_of_sources_end_at_one_time(
    near: httpx.Client, far: httpx.Client, brokers: list[Any], kind: str
) -> None:
    entity_id = f"urn:ngsi-ld:{kind}:1"
    register(near, brokers[1].url, {"type": kind}, operations=TEMPORAL)
    times = [f"2026-01-01T00:{number // 60:02}:{number % 60:02}Z" for number in range(1500)]
    many = [{"type": "Property", "value": 1, "observedAt": at} for at in times]
    assert far.post("/temporal/entities", json={"id": entity_id, "type": kind, "a": many}).status_code == 201
    late = [{"type": "Property", "value": 2, "observedAt": at.replace("00Z", "00.5Z")} for at in times[::60]]
    answer = near.post("/temporal/entities?local=true", json={"id": entity_id, "type": kind, "a": late})
    assert answer.status_code == 201
    first = near.get(f"/temporal/entities/{entity_id}", params=THAT_DAY)
    assert first.status_code == 206
    seen = values_of(first.json(), "a")
    edge = first.headers["content-range"].removeprefix("date-time ").partition("/")[0][-20:]
    assert edge == times[999]
    after = {**THAT_DAY, "timeAt": edge.replace("Z", ".000001Z")}
    rest = near.get(f"/temporal/entities/{entity_id}", params=after)
    assert rest.status_code == 200
    seen += values_of(rest.json(), "a")
    assert (seen.count(1), seen.count(2)) == (1500, 25)
    assert totals(near.get(f"/temporal/entities/{entity_id}", params={**AGGREGATES, **THAT_DAY}).json(), "a")[
        "sum"
    ] == [1550]
    assert near.get(f"/temporal/entities/{entity_id}", params=AGGREGATES).status_code == 403


def test_temporal_pages_do_not_depend_on_the_order_of_ids(
    near: httpx.Client, far: httpx.Client, brokers: list[Any], kind: str
) -> None:
    register(near, brokers[1].url, {"type": kind}, operations=TEMPORAL)
    register(near, brokers[2].url, {"type": kind}, operations=TEMPORAL)
    with brokers[2].client() as third:
        for name in "dabc":
            provide(far, f"urn:ngsi-ld:{kind}:{name}", kind, a={1: 1})
        for name in "zbx":
            provide(third, f"urn:ngsi-ld:{kind}:{name}", kind, b={1: 1})
    provide(near, f"urn:ngsi-ld:{kind}:x", kind, c={1: 1})
    seen: dict[str, set[str]] = {}
    for offset in range(7):
        asked = {"type": kind, "limit": 1, "offset": offset, **THAT_DAY}
        for one in near.get("/temporal/entities", params=asked).json():
            assert one["id"] not in seen
            seen[one["id"]] = one.keys() & {"a", "b", "c"}
    assert {one[-1]: names for one, names in seen.items()} == {
        "x": {"b", "c"},
        "a": {"a"},
        "b": {"a", "b"},
        "c": {"a"},
        "d": {"a"},
        "z": {"b"},
    }


def test_temporal_filters_apply_to_merged_evolutions(
    near: httpx.Client, far: httpx.Client, brokers: list[Any], kind: str
) -> None:
    register(near, brokers[1].url, {"type": kind}, ["there"], operations=TEMPORAL)
    ids = [f"urn:ngsi-ld:{kind}:{number}" for number in range(5)]
    for number, one in enumerate(ids):
        provide(near, one, kind, here={1: number})
        provide(far, one, kind, there={1: 0, 2: 10 * number})
    provide(far, f"urn:ngsi-ld:{kind}:elsewhere", kind, there={1: 50})
    asked = {"type": kind, "q": "here>1;there<40", **THAT_DAY}
    answer = near.get("/temporal/entities", params={**asked, "limit": 2, "count": "true"})
    assert [one["id"] for one in answer.json()] == ids[2:4], answer.text
    assert values_of(answer.json()[0], "there") == [0, 20]
    assert answer.headers["ngsild-results-count"] == "3"  # of the last one, 0 is below 40, too
    assert "next" in answer.links
    rest = near.get("/temporal/entities", params={**asked, "limit": 2, "offset": 2}).json()
    assert [one["id"] for one in rest] == [ids[4]]
    assert near.get("/temporal/entities", params={**asked, "offset": 9}).json() == []
    pairs = near.get("/temporal/entities", params={**asked, "options": "temporalValues", "pick": "id,there"})
    assert [one["there"]["values"][-1][0] for one in pairs.json()] == [20, 30, 40]
    assert "here" not in pairs.json()[0]
    query = {"type": "Query", "entities": [{"type": kind}], "q": asked["q"], "temporalQ": THAT_DAY}
    posted = near.post("/temporal/entityOperations/query", json=query, params={**AGGREGATES})
    assert posted.status_code == 200, posted.text
    assert [totals(one, "there")["max"] for one in posted.json()] == [[20], [30], [40]]
    whole = near.get("/temporal/entities", params={**asked, "splitEntities": "false"}).json()
    assert whole == []
