"""Queries with links, geometries, scopes and orders: by parameters and by documents."""

import re
from collections.abc import Callable
from typing import Any

import httpx
import pytest

GEO_JSON = "application/geo+json"
Names = list[str]


def link(*names: str) -> dict[str, Any]:
    ids = [f"urn:x:{name}" for name in names]
    return {"type": "Relationship", "object": ids if len(ids) > 1 else ids[0]}


def place(longitude: float, latitude: float) -> dict[str, Any]:
    return {"type": "GeoProperty", "value": {"type": "Point", "coordinates": [longitude, latitude]}}


@pytest.fixture(scope="module")
def world(shared_broker: Any) -> None:
    """Buildings in cities in countries; scopes, places, and a circle of friends."""
    at = place(8, 40)
    entities: list[dict[str, Any]] = [
        {"id": "urn:x:b1", "type": "Building", "name": "Tower", "locatedAt": link("c1"), "location": at},
        {"id": "urn:x:b2", "type": ["Building", "Home"], "name": "house", "locatedAt": link("c2"),
         "scope": ["/Madrid/East", "/Firm"], "location": place(8.01, 40)},
        {"id": "urn:x:b3", "type": "Building", "name": "Älä", "locatedAt": link("c1", "c2", "lost"),
         "scope": "/Madrid/East/North", "location": place(9, 40)},
        {"id": "urn:x:c1", "type": "City", "name": "Pisa", "size": 3, "isIn": link("i")},
        {"id": "urn:x:c2", "type": "City", "name": "Paris", "size": 5, "isIn": link("f")},
        {"id": "urn:x:i", "type": "Country", "name": "Italy"},
        {"id": "urn:x:f", "type": "Country", "name": "France"},
        {"id": "urn:x:p1", "type": "Friend", "knows": link("p2")},
        {"id": "urn:x:p2", "type": "Friend", "knows": link("p1")},
    ]  # fmt: skip
    with shared_broker.client() as client:
        answer = client.post("/entityOperations/create", json=entities)
        assert answer.status_code == 201, answer.text


@pytest.fixture
def ids(http: httpx.Client, world: None) -> Callable[..., str]:
    def asked(**parameters: Any) -> str:
        answer = http.get("/entities", params={"type": "Building", **parameters})
        assert answer.status_code == 200, answer.text
        return " ".join(one["id"].rpartition(":")[2] for one in answer.json())

    return asked


@pytest.mark.parametrize(
    ("q", "level", "hits"),
    [
        ('locatedAt{name}=="Pisa"', 1, "b1 b3"),
        ('locatedAt{City:name}=="Pisa"', 1, "b1 b3"),
        ('locatedAt{Country:name}=="Pisa"', 1, ""),
        ("locatedAt{size}>3", 1, "b2 b3"),
        ('locatedAt{isIn{name}}=="France";name=="house"', 2, "b2"),
    ],
)
def test_q_filters_by_linked_entities(ids: Callable[..., str], q: str, level: int, hits: str) -> None:
    assert ids(q=q, join="flat", joinLevel=level).split()[: len(hits.split())] == hits.split()
    assert ids(q=q, join="inline", joinLevel=level) == hits


def test_linked_entities_stand_inside(http: httpx.Client, world: None) -> None:
    one = http.get("/entities/urn:x:b1", params={"join": "inline", "joinLevel": 2}).json()
    assert one["locatedAt"]["entity"]["isIn"]["entity"]["name"] == {"type": "Property", "value": "Italy"}
    several = http.get("/entities/urn:x:b3", params={"join": "inline", "options": "keyValues"}).json()
    assert [said if isinstance(said, str) else said["name"] for said in several["locatedAt"]] == [
        "Pisa", "Paris", "urn:x:lost",
    ]  # fmt: skip
    concise = http.get("/entities/urn:x:b3", params={"join": "inline", "format": "concise"}).json()
    assert [said["name"] for said in concise["locatedAt"]["entity"]] == ["Pisa", "Paris"]
    without = http.get("/entities/urn:x:b1", params={"join": "@none"}).json()
    assert "entity" not in without["locatedAt"]


def test_linked_entities_follow_in_the_list(http: httpx.Client, world: None) -> None:
    def found(path: str, **parameters: Any) -> Names:
        answer = http.get(path, params={"join": "flat", **parameters})
        assert answer.status_code == 200
        return [one["id"].removeprefix("urn:x:") for one in answer.json()]

    assert found("/entities/urn:x:b1") == ["b1", "c1"]
    assert found("/entities/urn:x:i") == ["i"]
    assert found("/entities", type="Building", joinLevel=2) == ["b1", "b2", "b3", "c1", "c2", "i", "f"]
    assert found("/entities", type="Building", joinLevel=2, containedBy="urn:x:c1") == [
        "b1", "b2", "b3", "c2", "f",
    ]  # fmt: skip
    features = http.get("/entities/urn:x:b1", params={"join": "flat"}, headers={"Accept": GEO_JSON}).json()
    assert [one["geometry"] is None for one in features["features"]] == [False, True]


def test_circles_of_links_end(http: httpx.Client, world: None) -> None:
    one = http.get("/entities/urn:x:p1", params={"join": "inline", "joinLevel": 10}).json()
    assert one["knows"]["entity"]["knows"] == {"type": "Relationship", "object": "urn:x:p1"}
    flat = http.get("/entities/urn:x:p1", params={"join": "flat", "joinLevel": 10}).json()
    assert [each["id"] for each in flat] == ["urn:x:p1", "urn:x:p2"]


def test_braces_choose_members_of_linked_entities(http: httpx.Client, world: None) -> None:
    asked: dict[str, Any] = {"type": "Building", "limit": 1, "joinLevel": 2, "options": "keyValues"}
    picked = http.get("/entities", params={**asked, "join": "inline", "pick": "id,locatedAt{id,isIn{name}}"})
    assert picked.json() == [
        {"id": "urn:x:b1", "locatedAt": {"id": "urn:x:c1", "isIn": {"name": "Italy"}}},
    ]
    omitted = http.get(
        "/entities", params={**asked, "join": "flat", "omit": "type,location,locatedAt{name,size}"}
    )
    assert omitted.json()[:2] == [
        {"id": "urn:x:b1", "name": "Tower", "locatedAt": "urn:x:c1"},
        {"id": "urn:x:c1", "type": "City", "isIn": "urn:x:i"},
    ]
    whole = http.get("/entities", params={**asked, "join": "inline", "omit": "name", "joinLevel": 1}).json()[
        0
    ]
    assert whole["locatedAt"]["name"] == "Pisa"


@pytest.mark.parametrize(
    ("parameters", "hits"),
    [
        ({"scopeQ": "/Madrid/#"}, "b2 b3"),
        ({"scopeQ": "/Madrid/East"}, "b2"),
        ({"scopeQ": "(/Madrid/East;/Firm)"}, "b2"),
        ({"scopeQ": "/Madrid/+/North"}, "b3"),
        ({"scopeQ": "/#"}, "b2 b3"),
        ({"type": "(Building;Home)"}, "b2"),
        ({"type": "(Building;Home)|Country"}, "b2 i f"),
        ({"type": "*", "id": "urn:x:i,urn:x:b1"}, "b1 i"),
        ({"georel": "near;maxDistance==1000", "geometry": "Point", "coordinates": "[8,40]"}, "b1 b2"),
        ({"georel": "near;minDistance==1000", "geometry": "Point", "coordinates": "[8,40]"}, "b3"),
        ({"georel": "within", "geometry": "Polygon",
          "coordinates": "[[[7,39],[8.5,39],[8.5,41],[7,41],[7,39]]]"}, "b1 b2"),
        ({"georel": "equals", "geometry": "Point", "coordinates": "[9,40]"}, "b3"),
        ({"georel": "equals", "geometry": "Point", "coordinates": "[9,40]", "geoproperty": "name"}, ""),
        ({"orderBy": "name"}, "b3 b2 b1"),
        ({"orderBy": "name;desc"}, "b1 b2 b3"),
        ({"orderBy": "name", "collation": "fi"}, "b2 b1 b3"),
        ({"orderBy": "location;dist-desc", "orderFrom": "[8,40]"}, "b3 b2 b1"),
        ({"orderBy": "scope,id;desc"}, "b2 b3 b1"),
        ({"q": "location"}, "b1 b2 b3"),
    ],
)  # fmt: skip
def test_entities_are_chosen_and_ordered(
    ids: Callable[..., str], parameters: dict[str, str], hits: str
) -> None:
    assert ids(**parameters) == hits


def test_a_local_query_may_select_everything(http: httpx.Client, world: None) -> None:
    for parameters in ({"local": "true"}, {"type": "*"}, {"type": "*", "local": "true"}):
        answer = http.get("/entities", params={**parameters, "limit": 0, "count": "true"})
        assert answer.headers["ngsild-results-count"] == "9"


def test_a_walk_along_the_links_sees_everything_once(http: httpx.Client, world: None) -> None:
    lots: list[dict[str, Any]] = [
        {"id": f"urn:x:lot{number:02}", "type": "WalkLot", "n": number % 4} for number in range(12)
    ]
    assert http.post("/entityOperations/create", json=lots).status_code == 201

    def walk(url: str, relation: str) -> tuple[Names, str]:
        seen: Names = []
        while True:
            answer = http.get(url.removeprefix("/ngsi-ld/v1"))
            page = [one["id"] for one in answer.json()]
            seen += page if relation == "next" else page[::-1]
            links = dict(re.findall(r'<([^>]+)>; rel="(next|prev)"', answer.headers.get("link", "")))
            following = [one for one, name in links.items() if name == relation]
            if not following:
                return seen, url
            # What was seen last goes, and something new comes at the front of every order.
            http.delete(f"/entities/{page[-1]}")
            http.post("/entities", json={"id": f"urn:x:a{len(seen)}-{relation}", "type": "WalkLot", "n": -1})
            url = following[0]

    seen, last = walk("/entities?type=WalkLot&limit=3&orderBy=n,id", "next")
    assert seen == sorted((one["id"] for one in lots), key=lambda one: (int(one[-2:]) % 4, one))
    back, _ = walk(last, "prev")
    assert len(back) == len(set(back))
    answer = http.get("/entities", params={"type": "WalkLot", "limit": 2, "offset": 1, "orderBy": "id"})
    assert "offset=3" in answer.headers["link"]


def test_a_query_may_be_a_document(http: httpx.Client, world: None) -> None:
    def asked(status: int = 200, **members: Any) -> Names:
        answer = http.post("/entityOperations/query", json={"type": "Query", **members})
        assert answer.status_code == status, answer.text
        return [one["id"].removeprefix("urn:x:") for one in answer.json()] if status == 200 else []

    building = [{"type": "Building"}]
    near = {"georel": "near;maxDistance==1000", "geometry": "Point", "coordinates": [8, 40]}
    assert asked(entities=building, geoQ=near) == ["b1", "b2"]
    assert asked(entities=building, scopeQ="/Firm") == ["b2"]
    assert asked(entities=[{"type": "Country"}, {"type": "City", "id": "urn:x:c2"}]) == ["c2", "i", "f"]
    assert asked(entities=[{"type": "City", "id": ["urn:x:c1", "urn:x:i"], "idPattern": "nothing"}]) == ["c1"]
    assert asked(entities=[{"type": "City", "idPattern": "c2$"}, {"type": "Country", "idPattern": "f$"}]) == [
        "c2", "f",
    ]  # fmt: skip
    order = {"orderBy": ["location;dist-desc"], "coordinates": [8, 40], "geometry": "Point"}
    assert asked(entities=building, ordering=order) == ["b3", "b2", "b1"]
    linked: dict[str, Any] = {
        "q": 'locatedAt{name}=="Paris"',
        "join": "flat",
        "joinLevel": 1,
        "pick": ["id", "locatedAt"],
    }
    assert asked(entities=building, **linked) == ["b2", "b3", "c2", "c1"]
    assert asked(entities=building, csf="speed>5", lang="fi", splitEntities=False) == ["b1", "b2", "b3"]
    for members in (
        {"entities": [{"id": "urn:x:b1"}]},
        {"entities": [{"type": "Building", "id": ["urn:x:b1", 5]}]},
        {"entities": building, "attrs": []},
        {"entities": building, "q": 42},
        {"entities": building, "join": "inline", "joinLevel": 0},
        {"entities": building, "temporalQ": {}},
        {"entities": building, "ordering": {"orderBy": ["location;dist-asc"]}},
        {"entities": building, "geoQ": {"georel": "near"}},
        {"entities": building, "nonsense": 1},
        {"q": "createdAt>2020-01-01"},
        {},
    ):
        asked(400, **members)


def test_pages_of_a_document_follow_by_their_links(http: httpx.Client, world: None) -> None:
    document = {"type": "Query", "entities": [{"type": "Building"}], "ordering": {"orderBy": ["name;desc"]}}
    url, seen = "/entityOperations/query?limit=1", []
    while url:
        answer = http.post(url.removeprefix("/ngsi-ld/v1"), json=document)
        seen += [one["id"] for one in answer.json()]
        found = re.findall(r'<([^>]+)>; rel="next"', answer.headers.get("link", ""))
        url = found[0] if found else ""
    assert seen == ["urn:x:b1", "urn:x:b2", "urn:x:b3"]
    other = re.findall(
        r'<([^>]+)>; rel="next"', http.post("/entityOperations/query?limit=1", json=document).headers["link"]
    )
    refused = http.post(
        other[0].removeprefix("/ngsi-ld/v1"), json={**document, "ordering": {"orderBy": ["id"]}}
    )
    assert refused.status_code == 400
    assert "another order" in refused.json()["detail"]
