"""Temporal queries over HTTP: ranges, representations, aggregation, limits and errors."""

from itertools import count
from typing import Any

import httpx
import pytest

from .temporal_requests import PAST, a_car, at, fault, read_evolution, readings, values

NUMBERS = count(1)
LD = {"Accept": "application/ld+json"}


@pytest.fixture
def entity_id() -> str:
    return f"urn:ngsi-ld:Car:demo:{next(NUMBERS)}"


@pytest.fixture
def car(http: httpx.Client, entity_id: str) -> str:
    """A car with a history only."""
    return a_car(http, entity_id)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("window", "expected"),
    [
        ({"timerel": "before", "timeAt": at(2)}, [10, 20]),
        ({"timerel": "after", "timeAt": at(2)}, [30, 40, 50]),
        ({"timerel": "between", "timeAt": at(1), "endTimeAt": at(3)}, [20, 30]),
        ({"lastN": 2}, [40, 50]),
        ({"timerel": "before", "timeAt": at(3), "lastN": 2}, [20, 30]),
        ({"timerel": "after", "timeAt": at(9)}, []),
        (
            {"timerel": "before", "timeAt": "2100-01-01T00:00:00Z", "timeproperty": "modifiedAt"},
            [10, 20, 30, 40, 50],
        ),
        ({"timerel": "before", "timeAt": at(3), "timeproperty": "createdAt"}, []),
    ],
)
def test_a_time_range_is_returned(
    http: httpx.Client, car: str, window: dict[str, Any], expected: list[int]
) -> None:
    assert values(read_evolution(http, car, **window)) == expected


def test_temporal_representations(http: httpx.Client, car: str) -> None:
    pairs = read_evolution(http, car, options="temporalValues")
    assert pairs["speed"] == {"type": "Property", "values": [[10 * (n + 1), at(n)] for n in range(5)]}
    assert [one.get("datasetId") for one in pairs["heading"]] == [None, "urn:x:gps"]
    assert pairs["heading"][1]["values"] == [[8, at(0)], [9, at(1)]]
    concise = read_evolution(http, car, format="concise", attrs="speed")
    assert set(concise) == {"id", "type", "speed"}
    assert set(concise["speed"][0]) == {"value", "observedAt", "instanceId"}
    whole = read_evolution(http, car, options="sysAttrs", pick="id,heading", datasetId="urn:x:gps")
    assert set(whole) == {"id", "heading"}
    assert all({"createdAt", "modifiedAt"} < set(one) for one in whole["heading"])
    assert values(whole, "heading") == [8, 9]
    assert set(read_evolution(http, car, omit="type,speed")) == {"id", "heading"}
    answer = http.get(f"{PAST}/{car}", headers=LD)
    assert "@context" in answer.json()
    assert answer.headers["content-type"] == "application/ld+json"


def test_every_attribute_type_has_temporal_values(http: httpx.Client, entity_id: str) -> None:
    said: dict[str, tuple[dict[str, Any], str]] = {
        "a": ({"type": "GeoProperty", "value": {"type": "Point", "coordinates": [1.0, 2.0]}}, "values"),
        "b": ({"type": "Relationship", "object": "urn:x:1"}, "objects"),
        "c": ({"type": "LanguageProperty", "languageMap": {"en": "red", "fr": "rouge"}}, "languageMaps"),
        "d": ({"type": "JsonProperty", "json": {"x": 1}}, "jsons"),
        "e": ({"type": "VocabProperty", "vocab": "monument"}, "vocabs"),
        "f": ({"type": "ListProperty", "valueList": [1.5, 2.5]}, "valueLists"),
        "g": ({"type": "ListRelationship", "objectList": [{"object": "urn:x:1"}]}, "objectLists"),
    }
    body = {name: [{**instance, "observedAt": at(0)}] for name, (instance, _) in said.items()}
    assert http.post(PAST, json={"id": entity_id, "type": "Car", **body}).status_code == 201
    pairs = read_evolution(http, entity_id, format="temporalValues")
    assert {name: [set(pairs[name]), pairs[name]["type"]] for name in said} == {
        name: [{"type", member}, instance["type"]] for name, (instance, member) in said.items()
    }
    assert pairs["c"]["languageMaps"] == [[{"languageMap": {"en": "red", "fr": "rouge"}}, at(0)]]
    assert pairs["e"]["vocabs"] == [[{"vocab": "monument"}, at(0)]]
    assert pairs["f"]["valueLists"] == [[[1.5, 2.5], at(0)]]
    assert pairs["g"]["objectLists"] == [[["urn:x:1"], at(0)]]
    assert read_evolution(http, entity_id, format="temporalValues", lang="fr")["c"]["values"] == [
        ["rouge", at(0)]
    ]
    assert read_evolution(http, entity_id, lang="en")["c"][0]["value"] == "red"


@pytest.mark.parametrize("decimals", ["", ".5", ".635", ".6350", ".635001", ".000000"])
def test_a_time_is_one_text_in_every_representation(
    http: httpx.Client, entity_id: str, decimals: str
) -> None:
    observed = f"2026-01-01T12:00:00{decimals}Z"
    speed = {"type": "Property", "value": 1, "observedAt": observed}
    given = {"id": entity_id, "type": "Car", "speed": speed, "scope": "/a"}
    assert http.post("/entities", json=given).status_code == 201
    geo = {"Accept": "application/geo+json"}
    whole = read_evolution(http, entity_id, options="sysAttrs")
    shown = [
        http.get(f"/entities/{entity_id}").json()["speed"],
        http.get(f"/entities/{entity_id}", headers=geo).json()["properties"]["speed"],
        http.get(f"/entities/{entity_id}?options=concise").json()["speed"],
        *whole["speed"],
        *read_evolution(http, entity_id, options="concise")["speed"],
    ]
    assert {one["observedAt"] for one in shown} == {observed}
    for name in ("observedAt", "createdAt", "modifiedAt"):
        past = {"timeproperty": name, "timerel": "before", "timeAt": "2100-01-01T00:00:00Z"}
        pairs = read_evolution(http, entity_id, options="temporalValues", **past)
        assert [at for _, at in pairs["speed"]["values"]] == [one[name] for one in whole["speed"]]
    assert [at for _, at in pairs["scope"]["values"]] == [one["modifiedAt"] for one in whole["scope"]]


def test_values_are_aggregated(http: httpx.Client, car: str) -> None:
    found = read_evolution(
        http, car, options="aggregatedValues", aggrMethods="avg,max", aggrPeriodDuration="PT2M", attrs="speed"
    )
    assert found["speed"] == {
        "type": "Property",
        "avg": [[15, at(0), at(2)], [35, at(2), at(4)], [50, at(4), at(6)]],
        "max": [[20, at(0), at(2)], [40, at(2), at(4)], [50, at(4), at(6)]],
    }
    window = {"timerel": "between", "timeAt": at(1), "endTimeAt": at(4)}
    whole = read_evolution(
        http, car, format="aggregatedValues", aggrMethods="totalCount,sum", attrs="speed", **window
    )
    assert whole["speed"]["totalCount"] == [[3, at(1), at(4)]]
    assert whole["speed"]["sum"] == [[90, at(1), at(4)]]


def test_entities_are_found_by_values_in_the_range(http: httpx.Client) -> None:
    window = {"timerel": "between", "timeAt": at(0), "endTimeAt": at(60)}
    for name, inside, outside in (("fast", 90, 5), ("slow", 10, 95), ("away", None, 99)):
        speeds = readings([outside], 120) + ([] if inside is None else readings([inside]))
        van = {"id": f"urn:ngsi-ld:Van:demo:{name}", "type": "Van", "speed": speeds}
        assert http.post(PAST, json=van).status_code == 201

    def found(**parameters: Any) -> list[str]:
        answer = http.get(PAST, params={"type": "Van", **window, **parameters})
        assert answer.status_code == 200, answer.text
        return [one["id"].rpartition(":")[2] for one in answer.json()]

    assert found() == ["fast", "slow"]
    assert found(q="speed>50") == ["fast"]
    assert found(q="speed<50;speed>5") == ["slow"]
    assert found(idPattern="slow$") == ["slow"]
    assert found(attrs="speed") == ["fast", "slow"]
    assert found(attrs="colour") == []
    assert found(orderBy="id;desc") == ["slow", "fast"]
    assert found(type="Van;Boat") == []
    assert found(type="Boat|Van") == ["fast", "slow"]
    answer = http.get(PAST, params={"type": "Van", **window, "limit": 1, "count": "true"})
    assert answer.headers["ngsild-results-count"] == "2"
    assert 'rel="next"' in answer.headers["link"]
    assert found(limit=1, offset=1) == ["slow"]
    body: dict[str, Any] = {
        "type": "Query",
        "entities": [{"type": "Van"}],
        "q": "speed>50",
        "temporalQ": {**window, "lastN": 1},
    }
    by_document = http.post(
        "/temporal/entityOperations/query", json=body, params={"options": "temporalValues"}
    )
    assert [one["speed"]["values"] for one in by_document.json()] == [[[90, at(0)]]]
    body["temporalQ"] = {**window, "aggrMethods": ["max"], "aggrPeriodDuration": "PT1H"}
    aggregated = http.post("/temporal/entityOperations/query", json=body)
    assert aggregated.json()[0]["speed"]["max"] == [[90, at(0), at(60)]]
    body["temporalQ"], body["aggrParams"] = window, {"aggrMethods": "min", "aggrPeriodDuration": "PT30M"}
    aggregated = http.post("/temporal/entityOperations/query", json=body)
    assert aggregated.json()[0]["speed"]["min"] == [[90, at(0), at(30)]]
    body["aggrParams"] = {"aggrMethods": "median"}
    refused = http.post("/temporal/entityOperations/query", json=body)
    assert fault(refused) == (400, "BadRequestData")
    assert "aggrMethods" in refused.json()["detail"]


def test_entities_are_found_by_locations_in_the_range(http: httpx.Client) -> None:
    for name, inside, outside in (
        ("paris", [2.29, 48.85], [10.0, 50.0]),
        ("far", [10.0, 50.0], [2.29, 48.85]),
    ):
        places = [
            {
                "type": "GeoProperty",
                "value": {"type": "Point", "coordinates": place},
                "observedAt": at(minute),
            }
            for place, minute in ((inside, 0), (outside, 120))
        ]
        body = {"id": f"urn:ngsi-ld:Bus:demo:{name}", "type": "Bus", "scope": f"/{name}", "location": places}
        assert http.post(PAST, json=body).status_code == 201

    def found(**parameters: Any) -> list[str]:
        window = {"type": "Bus", "timerel": "before", "timeAt": at(60)}
        answer = http.get(PAST, params={**window, **parameters})
        assert answer.status_code == 200, answer.text
        return [one["id"].rpartition(":")[2] for one in answer.json()]

    point = {"geometry": "Point", "coordinates": "[2.29,48.85]"}
    square = {
        "geometry": "Polygon",
        "coordinates": "[[[2.0,48.5],[2.6,48.5],[2.6,49.2],[2.0,49.2],[2.0,48.5]]]",
    }
    assert found(georel="near;maxDistance==2000", **point) == ["paris"]
    assert found(georel="within", **square) == ["paris"]
    assert found(georel="disjoint", **square) == ["far"]
    assert found(georel="near;maxDistance==2000", geoproperty="observationSpace", **point) == []
    assert found(scopeQ="/far") == ["far"]
    query: dict[str, Any] = {
        "type": "Query",
        "entities": [{"type": "Bus", "idPattern": "paris$"}, {"type": "Tram"}],
        "temporalQ": {"timerel": "before", "timeAt": at(60)},
    }
    answer = http.post("/temporal/entityOperations/query", json=query)
    assert [one["id"] for one in answer.json()] == ["urn:ngsi-ld:Bus:demo:paris"]


def test_results_beyond_the_limit_come_in_parts(http: httpx.Client, entity_id: str) -> None:
    minutes = [n % 1400 for n in range(2500)]
    speeds = [{"type": "Property", "value": n, "observedAt": at(m)} for n, m in enumerate(minutes)]
    assert http.post(PAST, json={"id": entity_id, "type": "Lorry", "speed": speeds}).status_code == 201
    since = "2025-01-01T00:00:00Z"
    found: list[int] = []
    for expected in (206, 206, 200):
        answer = http.get(f"{PAST}/{entity_id}", params={"timerel": "after", "timeAt": since})
        assert answer.status_code == expected
        found += values(answer.json())
        if expected == 206:
            start, _, end = (
                answer.headers["content-range"].removeprefix("date-time ").removesuffix("/*").partition("Z-")
            )
            assert f"{start}Z" == since
            assert end == answer.json()["speed"][-1]["observedAt"]
            since = end
    assert sorted(set(found)) == list(range(2500))
    assert len(found) - 2500 == 4  # two pages end at an instant of two instances, which come again
    last = http.get(f"{PAST}/{entity_id}", params={"lastN": 1500, "options": "temporalValues"})
    assert last.status_code == 206
    latest = last.json()["speed"]["values"]
    assert last.headers["content-range"] == f"date-time {latest[-1][1]}-{latest[0][1]}/1500"
    assert latest[-1][1] == at(1399)


@pytest.mark.parametrize(
    "parameters",
    [
        {"timerel": "during", "timeAt": at(0)},
        {"timerel": "after"},
        {"timeAt": at(0)},
        {"timerel": "between", "timeAt": at(0)},
        {"timerel": "between", "timeAt": at(1), "endTimeAt": at(1)},
        {"timerel": "after", "timeAt": "yesterday"},
        {"timerel": "after", "timeAt": "2026-01-01T03:02:00"},
        {"timerel": "before", "timeAt": at(0), "endTimeAt": at(1)},
        {"timeproperty": "observed"},
        {"lastN": "0"},
        {"lastN": "1.5"},
        {"lastN": "-1"},
        {"options": "aggregatedValues"},
        {"aggrMethods": "median"},
        {"aggrMethods": "avg", "aggrPeriodDuration": "1h"},
        {"pick": "owner{name}"},
        {"attrs": "speed", "pick": "speed"},
        {"aggrMethods": "avg", "options": "temporalValues"},
    ],
)
def test_invalid_temporal_queries_are_refused(
    http: httpx.Client, car: str, parameters: dict[str, str]
) -> None:
    assert fault(http.get(f"{PAST}/{car}", params=parameters)) == (400, "BadRequestData")
    some_time = {"timerel": "after", "timeAt": at(0)}
    for time in ({}, {} if "timerel" in parameters or "timeAt" in parameters else some_time):
        answer = http.get(PAST, params={"type": "Car", **time, **parameters})
        assert fault(answer) == (400, "BadRequestData")


def test_too_broad_or_unknown_temporal_queries_are_refused(http: httpx.Client) -> None:
    assert fault(http.get(PAST, params={"timerel": "after", "timeAt": at(0)})) == (400, "BadRequestData")
    assert fault(http.get(PAST, params={"type": "Car"})) == (400, "BadRequestData")
    assert fault(http.get(PAST, params={"type": "Car", "format": "csv"})) == (400, "InvalidRequest")
    assert fault(http.get(PAST, params={"type": "Car", "fromTime": at(0)})) == (400, "InvalidRequest")
    assert fault(http.get(PAST, params={"type": "Car", "join": "inline"})) == (400, "InvalidRequest")
    for wrong in ({"orderBy": "speed"}, {"q": 'owner{name}=="x"'}, {"id": "no uri"}, {"csf": "))("}):
        asked = {"type": "Car", "timerel": "after", "timeAt": at(0), **wrong}
        assert fault(http.get(PAST, params=asked)) == (400, "BadRequestData")
    system = {"attrs": "createdAt", "timerel": "after", "timeAt": at(0)}
    assert fault(http.get(PAST, params=system)) == (400, "BadRequestData")
    queries: list[Any] = [
        {"lastN": 1.5},
        {"lastN": 0},
        {"timerel": "after"},
        {"timeproperty": 3},
        {"x": 1},
        [],
    ]
    for query in queries:
        body = {"type": "Query", "entities": [{"type": "Car"}], "temporalQ": query}
        assert fault(http.post("/temporal/entityOperations/query", json=body)) == (400, "BadRequestData")


def test_tenants_have_their_own_history(http: httpx.Client, car: str, entity_id: str) -> None:
    assert fault(http.get(f"{PAST}/{car}", headers={"NGSILD-Tenant": "nobody"}))[1] == "NonexistentTenant"
    theirs = {"NGSILD-Tenant": "theirs"}
    body = {"id": car, "type": "Car", "speed": readings([7])}
    assert http.post(PAST, json=body, headers=theirs).status_code == 201
    assert values(http.get(f"{PAST}/{car}", headers=theirs).json()) == [7]
    assert values(read_evolution(http, car)) == [10, 20, 30, 40, 50]
    asked = {"type": "Car", "attrs": "speed", "timerel": "after", "timeAt": "2026-01-01T03:00:00+04:00"}
    found = http.get(PAST, params=asked, headers=theirs).json()
    assert [one["id"] for one in found] == [car]


def test_a_map_of_current_entities_serves_temporal_queries(http: httpx.Client) -> None:
    for number in range(3):
        body = {"id": f"urn:ngsi-ld:Tram:demo:{number}", "type": "Tram", "speed": readings([number, number])}
        assert http.post(PAST, json=body).status_code == 201
    asked = {
        "type": "Tram",
        "timerel": "after",
        "timeAt": "2025-01-01T00:00:00Z",
        "options": "temporalValues",
    }
    first = http.get(PAST, params={**asked, "entityMap": "true", "limit": 2})
    assert first.status_code == 201, first.text
    named = {"NGSILD-EntityMap": first.headers["NGSILD-EntityMap"]}
    second = http.get(PAST, params={**asked, "limit": 2, "offset": 2}, headers=named)
    assert second.status_code == 200, second.text
    assert [one["speed"]["values"][0][0] for one in (*first.json(), *second.json())] == [0, 1, 2]


def test_entities_are_found_by_scopes_in_the_range(http: httpx.Client, entity_id: str) -> None:
    path = f"/entities/{entity_id}"
    body = {"id": entity_id, "type": "Trolley", "scope": "/hall/a", "load": {"type": "Property", "value": 1}}
    assert http.post("/entities", json=body).status_code == 201
    assert http.patch(f"{path}/attrs/load", json={"value": 2}).status_code == 204
    assert http.post(f"{path}/attrs", json={"scope": "/hall/b"}).status_code == 204
    assert http.patch(f"{path}/attrs/load", json={"value": 3}).status_code == 204
    past = read_evolution(http, entity_id, options="sysAttrs")
    moved = past["scope"][1]["modifiedAt"]
    second, third = (one["modifiedAt"] for one in past["load"][1:])

    def found(scope: str, **window: str) -> bool:
        parameters = {"type": "Trolley", "scopeQ": scope, "timeproperty": "modifiedAt", **window}
        answer = http.get(PAST, params=parameters)
        assert answer.status_code == 200, answer.text
        return entity_id in [one["id"] for one in answer.json()]

    before = {"timerel": "between", "timeAt": second, "endTimeAt": moved}
    assert found("/hall/a", **before)  # set before the window, and still so in it
    assert not found("/hall/b", **before)  # only set after it
    assert found("/hall/+", **before)
    after = {"timerel": "after", "timeAt": third}
    assert found("/hall/b", **after)
    assert not found("/hall/a", **after)
    assert not found("(/hall/a;/hall/b)", timerel="after", timeAt=second)  # never both at once
    assert http.delete(path).status_code == 204
    assert found("/hall/a", **before)


@pytest.mark.parametrize("narrow", [{}, {"id": "urn:ngsi-ld:Car:demo:1"}, {"idPattern": ".*"}])
def test_ids_alone_are_too_broad_for_a_temporal_query(http: httpx.Client, narrow: dict[str, str]) -> None:
    some_time = {"timerel": "after", "timeAt": at(0)}
    answer = http.get(PAST, params={**some_time, **narrow})
    assert fault(answer) == (400, "BadRequestData")
    assert "too broad" in answer.json()["detail"]
    assert http.get(PAST, params={**some_time, **narrow, "type": "Car"}).status_code == 200
