"""The temporal API over HTTP: what has been is told, added to and corrected, and survives a power cut."""

import threading
from collections.abc import Iterator
from itertools import count
from typing import Any

import httpx
import pytest

PAST = "/temporal/entities"
NUMBERS = count(1)
LD = {"Accept": "application/ld+json"}


def at(minute: int) -> str:
    return f"2026-01-01T{minute // 60:02}:{minute % 60:02}:00Z"


def readings(values: list[Any], first: int = 0, **more: Any) -> list[dict[str, Any]]:
    return [
        {"type": "Property", "value": value, "observedAt": at(first + minute), **more}
        for minute, value in enumerate(values)
    ]


@pytest.fixture
def entity_id() -> str:
    return f"urn:ngsi-ld:Car:demo:{next(NUMBERS)}"


@pytest.fixture
def car(http: httpx.Client, entity_id: str) -> str:
    """A car that only has a past: five speeds, two headings of a second sensor."""
    body = {
        "id": entity_id,
        "type": "Car",
        "speed": readings([10, 20, 30, 40, 50]),
        "heading": [*readings([1, 2]), *readings([8, 9], datasetId="urn:x:gps")],
    }
    answer = http.post(PAST, json=body)
    assert answer.status_code == 201, answer.text
    assert answer.headers["location"] == f"/ngsi-ld/v1{PAST}/{entity_id}"
    return entity_id


def told(http: httpx.Client, entity_id: str, **parameters: Any) -> dict[str, Any]:
    answer = http.get(f"{PAST}/{entity_id}", params=parameters)
    assert answer.status_code == 200, answer.text
    found: dict[str, Any] = answer.json()
    return found


def values(told_of: dict[str, Any], name: str = "speed") -> list[Any]:
    return [one["value"] for one in told_of.get(name, [])]


def fault(answer: httpx.Response) -> tuple[int, str]:
    return answer.status_code, answer.json()["type"].rpartition("/")[2]


def test_changes_of_the_present_become_the_past(http: httpx.Client, entity_id: str) -> None:
    entity = {"id": entity_id, "type": "Car", "scope": "/a", "speed": readings([1])[0], "colour": "red"}
    path = f"/entities/{entity_id}"
    assert http.post("/entities", json=entity).status_code == 201
    assert http.patch(f"{path}/attrs/speed", json=readings([2], 1)[0]).status_code == 204
    assert http.patch(f"{path}/attrs", json={"colour": "blue"}).status_code == 204
    assert http.patch(path, json={"speed": {"value": 3, "observedAt": at(2)}}).status_code == 204
    assert http.delete(f"{path}/attrs/colour").status_code == 204
    past = told(http, entity_id)
    assert values(past) == [1, 2, 3]
    assert values(past, "colour") == ["red", "blue"]
    assert values(past, "scope") == ["/a"]
    assert past["scope"][0]["observedAt"]
    ids = [one["instanceId"] for name in ("speed", "colour", "scope") for one in past[name]]
    assert len(set(ids)) == len(ids)
    gone = told(http, entity_id, timeproperty="deletedAt")
    assert [(one["value"], "deletedAt" in one) for one in gone["colour"]] == [("urn:ngsi-ld:null", True)]
    assert "speed" not in gone
    assert http.delete(path).status_code == 204
    after = told(http, entity_id, options="sysAttrs")
    assert values(after) == [1, 2, 3]
    assert after["deletedAt"] > after["modifiedAt"] >= after["createdAt"]
    assert values(told(http, entity_id, timeproperty="deletedAt")) == ["urn:ngsi-ld:null"]
    assert http.post("/entities", json=entity).status_code == 201
    assert values(told(http, entity_id, timeproperty="modifiedAt")) == [1, 2, 3, 1]


@pytest.mark.parametrize(
    ("window", "expected"),
    [
        ({"timerel": "before", "timeAt": at(2)}, [10, 20]),
        ({"timerel": "after", "timeAt": at(2)}, [40, 50]),
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
def test_a_window_of_time_is_told_of(
    http: httpx.Client, car: str, window: dict[str, Any], expected: list[int]
) -> None:
    assert values(told(http, car, **window)) == expected


def test_forms_of_the_past(http: httpx.Client, car: str) -> None:
    pairs = told(http, car, options="temporalValues")
    assert pairs["speed"] == {"type": "Property", "values": [[10 * (n + 1), at(n)] for n in range(5)]}
    assert [one.get("datasetId") for one in pairs["heading"]] == [None, "urn:x:gps"]
    assert pairs["heading"][1]["values"] == [[8, at(0)], [9, at(1)]]
    concise = told(http, car, format="concise", attrs="speed")
    assert set(concise) == {"id", "type", "speed"}
    assert set(concise["speed"][0]) == {"value", "observedAt", "instanceId"}
    whole = told(http, car, options="sysAttrs", pick="id,heading", datasetId="urn:x:gps")
    assert set(whole) == {"id", "heading"}
    assert all({"createdAt", "modifiedAt"} < set(one) for one in whole["heading"])
    assert values(whole, "heading") == [8, 9]
    assert set(told(http, car, omit="type,speed")) == {"id", "heading"}
    answer = http.get(f"{PAST}/{car}", headers=LD)
    assert "@context" in answer.json()
    assert answer.headers["content-type"] == "application/ld+json"


def test_every_kind_of_attribute_has_its_pairs(http: httpx.Client, entity_id: str) -> None:
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
    pairs = told(http, entity_id, format="temporalValues")
    assert {name: [set(pairs[name]), pairs[name]["type"]] for name in said} == {
        name: [{"type", member}, instance["type"]] for name, (instance, member) in said.items()
    }
    assert pairs["c"]["languageMaps"] == [[{"languageMap": {"en": "red", "fr": "rouge"}}, at(0)]]
    assert pairs["e"]["vocabs"] == [[{"vocab": "monument"}, at(0)]]
    assert pairs["f"]["valueLists"] == [[[1.5, 2.5], at(0)]]
    assert pairs["g"]["objectLists"] == [[["urn:x:1"], at(0)]]
    assert told(http, entity_id, format="temporalValues", lang="fr")["c"]["values"] == [["rouge", at(0)]]
    assert told(http, entity_id, lang="en")["c"][0]["value"] == "red"


def test_values_are_aggregated(http: httpx.Client, car: str) -> None:
    found = told(
        http, car, options="aggregatedValues", aggrMethods="avg,max", aggrPeriodDuration="PT2M", attrs="speed"
    )
    assert found["speed"] == {
        "type": "Property",
        "avg": [[15, at(0), at(2)], [35, at(2), at(4)], [50, at(4), at(6)]],
        "max": [[20, at(0), at(2)], [40, at(2), at(4)], [50, at(4), at(6)]],
    }
    window = {"timerel": "between", "timeAt": at(1), "endTimeAt": at(4)}
    whole = told(http, car, format="aggregatedValues", aggrMethods="totalCount,sum", attrs="speed", **window)
    assert whole["speed"]["totalCount"] == [[3, at(1), at(4)]]
    assert whole["speed"]["sum"] == [[90, at(1), at(4)]]


def test_entities_are_found_by_what_they_were_in_the_window(http: httpx.Client) -> None:
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


def test_entities_are_found_by_where_they_were_in_the_window(http: httpx.Client) -> None:
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


def test_more_than_fits_an_answer_is_told_in_parts(http: httpx.Client, entity_id: str) -> None:
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
    assert sorted(found) == list(range(2500))
    last = http.get(f"{PAST}/{entity_id}", params={"lastN": 1500, "options": "temporalValues"})
    assert last.status_code == 206
    latest = last.json()["speed"]["values"]
    assert last.headers["content-range"] == f"date-time {latest[-1][1]}-{latest[0][1]}/1500"
    assert latest[-1][1] == at(1399)


def test_the_past_is_added_to(http: httpx.Client, car: str) -> None:
    more = {"id": car, "type": ["Truck"], "speed": readings([60], 5), "scope": ["/a", "/b"]}
    assert http.post(PAST, json=more).status_code == 204
    assert (
        http.post(f"{PAST}/{car}/attrs", json={"speed": readings([70, 80], 6), "colour": "red"}).status_code
        == 204
    )
    past = told(http, car)
    assert past["type"] == ["Car", "Truck"]
    assert values(past) == [10, 20, 30, 40, 50, 60, 70, 80]
    assert values(past, "scope") == [["/a", "/b"]]
    deletion = {"speed": readings(["urn:ngsi-ld:null"], 9)}
    assert http.post(f"{PAST}/{car}/attrs", json=deletion).status_code == 204
    assert values(told(http, car))[-1] == "urn:ngsi-ld:null"
    assert http.get(f"/entities/{car}").status_code == 404  # the present knows nothing of it


def test_what_is_said_twice_is_known_once(http: httpx.Client, car: str) -> None:
    before = told(http, car, options="sysAttrs")
    again = {
        "id": car,
        "type": "Car",
        "speed": [*readings([11, 20]), *readings([60], 5)],
        "heading": [*readings([7], 1, datasetId="urn:x:gps"), *readings([3], 9)],
        "scope": readings(["/a"]),
    }
    for _ in range(2):
        assert http.post(PAST, json=again).status_code == 204
        past = told(http, car, options="sysAttrs")
        assert values(past) == [11, 20, 30, 40, 50, 60]
        assert values(past, "scope") == ["/a"]
        headings = [(one["value"], one.get("datasetId")) for one in past["heading"]]
        assert sorted(headings, key=str) == [
            (1, None),
            (2, None),
            (3, None),
            (7, "urn:x:gps"),
            (8, "urn:x:gps"),
        ]
        first, was = past["speed"][0], before["speed"][0]
        assert (first["instanceId"], first["createdAt"]) == (was["instanceId"], was["createdAt"])
        assert first["modifiedAt"] > was["modifiedAt"]
    http.post(f"{PAST}/{car}/attrs", json={"speed": readings([12])})
    assert sorted(values(told(http, car))) == [11, 12, 20, 30, 40, 50, 60]


def test_an_instance_is_corrected_and_deleted(http: httpx.Client, car: str) -> None:
    first, second, *_ = told(http, car)["speed"]
    path = f"{PAST}/{car}/attrs/speed"
    assert http.patch(f"{path}/{first['instanceId']}", json={"value": 11}).status_code == 204
    part = {"type": "Property", "value": 21, "observedAt": at(30), "unitCode": "KMH"}
    assert http.patch(f"{path}/{second['instanceId']}", json=part).status_code == 204
    past = told(http, car, options="sysAttrs")["speed"]
    assert [one["value"] for one in past] == [11, 30, 40, 50, 21]
    assert past[-1]["instanceId"] == second["instanceId"]
    assert past[-1]["unitCode"] == "KMH"
    assert past[-1]["modifiedAt"] > past[-1]["createdAt"]
    newer = {"timerel": "after", "timeAt": past[1]["modifiedAt"], "timeproperty": "modifiedAt"}
    assert values(told(http, car, **newer)) == [11, 21]
    assert http.delete(f"{path}/{first['instanceId']}").status_code == 204
    assert values(told(http, car)) == [30, 40, 50, 21]
    assert fault(http.delete(f"{path}/{first['instanceId']}")) == (404, "ResourceNotFound")
    for wrong in ("urn:ngsi-ld:Instance:1-1-0", "urn:x:1", first["instanceId"]):
        assert fault(http.patch(f"{path}/{wrong}", json={"value": 1})) == (404, "ResourceNotFound")
    assert (
        fault(http.patch(f"{PAST}/{car}/attrs/heading/{second['instanceId']}", json={"value": 1}))[0] == 404
    )


def test_attributes_and_entities_are_forgotten(http: httpx.Client, car: str) -> None:
    path = f"{PAST}/{car}"
    assert http.delete(f"{path}/attrs/heading", params={"datasetId": "urn:x:gps"}).status_code == 204
    assert values(told(http, car), "heading") == [1, 2]
    assert http.delete(f"{path}/attrs/heading").status_code == 204
    assert fault(http.delete(f"{path}/attrs/heading", params={"deleteAll": "true"})) == (
        404,
        "ResourceNotFound",
    )
    assert http.delete(f"{path}/attrs/speed", params={"deleteAll": "true"}).status_code == 204
    assert set(told(http, car)) == {"id", "type"}
    assert http.delete(path).status_code == 204
    for method, at_path in (("GET", path), ("DELETE", path), ("DELETE", f"{path}/attrs/speed")):
        assert fault(http.request(method, at_path)) == (404, "ResourceNotFound")
    assert fault(http.post(f"{path}/attrs", json={"speed": readings([1])})) == (404, "ResourceNotFound")


def test_forgetting_the_past_leaves_the_present_alone(http: httpx.Client, entity_id: str) -> None:
    assert http.post("/entities", json={"id": entity_id, "type": "Car", "speed": 1}).status_code == 201
    assert http.delete(f"{PAST}/{entity_id}").status_code == 204
    assert http.get(f"/entities/{entity_id}").status_code == 200
    assert set(told(http, entity_id)) == {"id", "type"}
    assert http.patch(f"/entities/{entity_id}/attrs", json={"speed": 2}).status_code == 204
    assert values(told(http, entity_id)) == [2]


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
def test_what_cannot_be_asked_is_refused(http: httpx.Client, car: str, parameters: dict[str, str]) -> None:
    assert fault(http.get(f"{PAST}/{car}", params=parameters)) == (400, "BadRequestData")
    some_time = {"timerel": "after", "timeAt": at(0)}
    for time in ({}, {} if "timerel" in parameters or "timeAt" in parameters else some_time):
        answer = http.get(PAST, params={"type": "Car", **time, **parameters})
        assert fault(answer) == (400, "BadRequestData")


def test_queries_that_are_too_broad_or_unknown_are_refused(http: httpx.Client) -> None:
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


@pytest.mark.parametrize(
    "part",
    [
        {"speed": []},
        {"speed": [{"value": None}]},
        {"speed": [{"value": 1, "observedAt": "now"}]},
        {"speed": [{"type": "Property"}]},
        {"scope": "no scope"},
        {"scope": [{"type": "Relationship", "object": "urn:x:1"}]},
        {"expiresAt": "urn:ngsi-ld:null"},
        {"type": []},
        {"id": "no uri"},
    ],
)
def test_what_cannot_have_been_is_refused(http: httpx.Client, entity_id: str, part: dict[str, Any]) -> None:
    body = {"id": entity_id, "type": "Car", **part}
    answer = http.post(PAST, json=body)
    if part != {"speed": []}:  # which is a Property whose value is an empty list
        assert fault(answer) == (400, "BadRequestData")
        assert http.get(f"{PAST}/{entity_id}").status_code == 404


def test_tenants_have_their_own_past(http: httpx.Client, car: str, entity_id: str) -> None:
    assert fault(http.get(f"{PAST}/{car}", headers={"NGSILD-Tenant": "nobody"}))[1] == "NonexistentTenant"
    theirs = {"NGSILD-Tenant": "theirs"}
    body = {"id": car, "type": "Car", "speed": readings([7])}
    assert http.post(PAST, json=body, headers=theirs).status_code == 201
    assert values(http.get(f"{PAST}/{car}", headers=theirs).json()) == [7]
    assert values(told(http, car)) == [10, 20, 30, 40, 50]
    asked = {"type": "Car", "attrs": "speed", "timerel": "after", "timeAt": "2026-01-01T03:00:00+04:00"}
    found = http.get(PAST, params=asked, headers=theirs).json()
    assert [one["id"] for one in found] == [car]


def test_nothing_is_recorded_where_that_is_turned_off(own_broker: Any) -> None:
    own_broker.extra = {"HANDOVER_BROKER_HISTORY": "false"}
    own_broker.start()
    with own_broker.client() as http:
        assert http.post("/entities", json={"id": "urn:x:1", "type": "Car", "speed": 1}).status_code == 201
        assert set(told(http, "urn:x:1")) == {"id", "type"}
        assert (
            http.post(PAST, json={"id": "urn:x:2", "type": "Car", "speed": readings([1])}).status_code == 201
        )
        assert values(told(http, "urn:x:2")) == [1]


class Writer(threading.Thread):
    """Patches one entity as fast as it can, and notes what was acknowledged."""

    def __init__(self, broker: Any, entity_id: str) -> None:
        super().__init__(daemon=True)
        self.broker = broker
        self.entity_id = entity_id
        self.acknowledged = 0
        self.over = threading.Event()

    def run(self) -> None:
        with self.broker.client() as http:
            try:
                for number in self._numbers():
                    if http.patch(f"/entities/{self.entity_id}/attrs", json={"n": number}).status_code == 204:
                        self.acknowledged = number
            except httpx.TransportError:
                return

    def _numbers(self) -> Iterator[int]:
        number = self.acknowledged
        while not self.over.is_set():
            number += 1
            yield number


def test_a_power_cut_takes_nothing_acknowledged_out_of_the_past(own_broker: Any, eventually: Any) -> None:
    own_broker.start()
    ids = [f"urn:x:{number}" for number in range(4)]
    with own_broker.client() as http:
        for entity_id in ids:
            assert (
                http.post("/entities", json={"id": entity_id, "type": "Counter", "n": 0}).status_code == 201
            )
    writers = [Writer(own_broker, entity_id) for entity_id in ids]
    for writer in writers:
        writer.start()
    eventually(lambda: all(one.acknowledged > 50 for one in writers))
    own_broker.kill()
    for writer in writers:
        writer.join(10)
    own_broker.start()
    with own_broker.client() as http:
        for writer in writers:
            told_of = values(told(http, writer.entity_id, timeproperty="modifiedAt"), "n")
            assert told_of == list(range(len(told_of)))
            assert len(told_of) - 1 in {writer.acknowledged, writer.acknowledged + 1}


def test_a_map_of_entities_also_serves_looks_into_the_past(http: httpx.Client) -> None:
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
