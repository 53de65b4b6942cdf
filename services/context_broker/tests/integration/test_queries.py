"""Queries over HTTP: the right hits, in a stable order, page by page."""

import re
from collections.abc import Callable
from typing import Any

import httpx
import pytest

TYPE = "Lot"
Ask = Callable[..., list[str]]


@pytest.fixture(scope="module")
def stocked(shared_broker: Any) -> None:
    """Twenty-five lots: n from 0 to 24, colours in turn, some with more attributes."""
    colours = ("red", "green", "blue")
    entities: list[dict[str, Any]] = []
    for number in range(25):
        entity: dict[str, Any] = {
            "id": f"urn:ngsi-ld:{TYPE}:demo:{number:02}",
            "type": TYPE,
            "n": {"type": "Property", "value": number, "observedAt": f"2026-01-{number + 1:02}T00:00:00Z"},
            "colour": {"type": "Property", "value": colours[number % 3]},
            "even": {"type": "Property", "value": number % 2 == 0},
            "owner": {"type": "Relationship", "object": f"urn:ngsi-ld:Person:demo:{number % 2}"},
        }
        if number < 3:
            entity["address"] = {
                "type": "Property",
                "value": {"city": f"city-{number}", "lines": [{"storey": number}]},
            }
            entity["tags"] = {"type": "Property", "value": ["a", f"t{number}"]}
            entity["due"] = {
                "type": "Property",
                "value": {"@type": "DateTime", "@value": f"2026-06-0{number + 1}T12:00:00Z"},
            }
            entity["label"] = {
                "type": "LanguageProperty",
                "languageMap": {"en": f"lot {number}", "fi": "erä"},
            }
            entity["n"]["accuracy"] = {"type": "Property", "value": number / 10}
        entities.append(entity)
    with shared_broker.client() as client:
        answer = client.post("/entityOperations/create", json=entities)
        assert answer.status_code == 201
        assert len(answer.json()) == 25
        client.post("/entities", json={"id": "urn:x:other", "type": "Other", "n": 3})


@pytest.fixture
def ask(http: httpx.Client, stocked: None) -> Ask:
    def numbers(**parameters: Any) -> list[str]:
        answer = http.get("/entities", params={"type": TYPE, "limit": 100, **parameters})
        assert answer.status_code == 200, answer.text
        return [entity["id"].rpartition(":")[2] for entity in answer.json()]

    return numbers


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("q", "hits"),
    [
        ("n==3", "03"),
        ("n!=3;n<5", "00 01 02 04"),
        ("n>22", "23 24"),
        ("n>=23", "23 24"),
        ("n<2", "00 01"),
        ("n<=1", "00 01"),
        ("n==3..5", "03 04 05"),
        ("n!=2..24", "00 01"),
        ("n==1,3,7", "01 03 07"),
        ("n==-1", ""),
        ("n==1.0", "01"),
        ('colour=="red";n<7', "00 03 06"),
        ('colour=="red","blue";n<6', "00 02 03 05"),
        ('n<1|n>23|colour=="green";n<2', "00 01 24"),
        ('(n<1|n>23);colour=="red"', "00 24"),
        ("even==true;n<5", "00 02 04"),
        ("even==false;n<5", "01 03"),
        ("even==1", ""),
        ("tags", "00 01 02"),
        ('tags=="t1"', "01"),
        ('tags!="t1"', "00 02"),
        ('address[city]=="city-2"', "02"),
        ("address[lines.storey]==1", "01"),
        ("n.accuracy==0.1", "01"),
        ("n.accuracy>0.05;n.accuracy<0.15", "01"),
        ("n.observedAt>=2026-01-24T00:00:00Z", "23 24"),
        ("n.observedAt==2026-01-02T00:00:00Z..2026-01-03T01:00:00+01:00", "01 02"),
        ("due>2026-06-01T12:00:00Z", "01 02"),
        ("due==2026-06-02T14:00:00+02:00", "01"),
        ("owner==urn:ngsi-ld:Person:demo:1;n<4", "01 03"),
        ('owner=="urn:ngsi-ld:Person:demo:1";n<4', "01 03"),
        ('label[en]=="lot 1"', "01"),
        ('label=="erä"', "00 01 02"),
        ('colour~="^gr";n<5', "01 04"),
        ("colour~=^(re|bl)d?;n<3", "00 02"),
        ('colour!~="e";n<99', ""),
        ('colour!~="ee";n<3', "00 02"),
        ('colour>="red";n<4', "00 03"),
        ('colour=="blue".."green";n<3', "01 02"),
        ("nothing", ""),
        ("nothing!=3", ""),
        ('n=="3"', ""),
        ("modifiedAt>2020-01-01T00:00:00Z;n<2", "00 01"),
        ("createdAt>2999-01-01T00:00:00Z", ""),
        ("https://uri.etsi.org/ngsi-ld/default-context/n==3", "03"),
    ],
)
def test_q_finds_the_right_entities(ask: Ask, q: str, hits: str) -> None:
    assert ask(q=q) == hits.split()


def test_the_same_hits_with_and_without_an_index(ask: Ask) -> None:
    # An equality is answered by an index; the same in a disjunction is looked for one by one.
    assert ask(q='colour=="red"') == ask(q='colour=="red"|colour=="no such colour"')


def test_an_index_follows_changes(ask: Ask, http: httpx.Client) -> None:
    assert ask(q='colour=="violet"') == []
    path = f"/entities/urn:ngsi-ld:{TYPE}:demo:07/attrs"
    http.patch(path, json={"colour": "violet"})
    assert ask(q='colour=="violet"') == ["07"]
    http.patch(path, json={"colour": ["violet", "green"]})
    assert "07" in ask(q='colour=="green"')
    http.patch(path, json={"colour": "green"})
    assert ask(q='colour=="violet"') == []


def test_entities_are_found_by_id_and_pattern(ask: Ask) -> None:
    prefix = f"urn:ngsi-ld:{TYPE}:demo:"
    assert ask(id=f"{prefix}04,{prefix}02,{prefix}99") == ["02", "04"]
    assert ask(idPattern=f"^{prefix}1[0-3]$") == ["10", "11", "12", "13"]


def test_types_are_alternatives(http: httpx.Client, stocked: None) -> None:
    for types in ("Other,Lot", "Other|Lot"):
        hits = http.get("/entities", params={"type": types, "q": "n==3"}).json()
        assert [hit["type"] for hit in hits] == ["Lot", "Other"]


def test_attrs_chooses_entities_and_what_is_shown_of_them(http: httpx.Client, stocked: None) -> None:
    hits = http.get("/entities", params={"type": TYPE, "attrs": "tags", "options": "keyValues"}).json()
    assert len(hits) == 3
    assert set(hits[0]) == {"id", "type", "tags"}


def test_pages_follow_each_other_by_their_links(http: httpx.Client, stocked: None) -> None:
    seen: list[str] = []
    url = f"/entities?type={TYPE}&limit=10&count=true"
    pages = 0
    while url:
        answer = http.get(url.removeprefix("/ngsi-ld/v1"))
        assert answer.headers["ngsild-results-count"] == "25"
        seen += [entity["id"] for entity in answer.json()]
        links = {
            relation: link for link, relation in re.findall(r'<([^>]+)>; rel="(\w+)"', answer.headers["link"])
        }
        assert ("prev" in links) is (pages > 0)
        url = links.get("next", "")
        pages += 1
    assert pages == 3
    assert seen == sorted(seen)
    assert len(set(seen)) == 25


def test_limit_zero_only_counts(http: httpx.Client, stocked: None) -> None:
    answer = http.get("/entities", params={"type": TYPE, "limit": 0, "count": "true"})
    assert answer.json() == []
    assert answer.headers["ngsild-results-count"] == "25"


@pytest.mark.parametrize(
    ("parameters", "status", "word"),
    [
        ({}, 400, "too broad"),
        ({"limit": "5"}, 400, "too broad"),
        ({"id": "urn:ngsi-ld:Room:1"}, 400, "too broad"),
        ({"idPattern": ".*"}, 400, "too broad"),
        ({"type": "Room", "local": "foo"}, 400, "local is true or false"),
        ({"type": "Room", "count": "1"}, 400, "count is true or false"),
        ({"type": "Room", "entityMap": ""}, 400, "entityMap is true or false"),
        ({"type": "Room", "splitEntities": "True"}, 400, "splitEntities is true or false"),
        ({"type": TYPE, "limit": "-1"}, 400, "limit"),
        ({"type": TYPE, "limit": "0"}, 400, "count=true"),
        ({"type": TYPE, "limit": "100000"}, 403, "1000"),
        ({"type": TYPE, "offset": "x"}, 400, "offset"),
        ({"type": TYPE, "options": "pretty"}, 400, "pretty"),
        ({"type": TYPE, "options": "keyValues,concise"}, 400, "choose one"),
        ({"type": TYPE, "format": "xml"}, 400, "xml"),
        ({"type": TYPE, "colour": "red"}, 400, "colour"),
        ({"type": TYPE, "count": "maybe"}, 400, "count"),
        ({"type": "a b"}, 400, "a b"),
        ({"type": "(A;B"}, 400, "expected )"),
        ({"type": "*", "local": "false"}, 400, "contradicts"),
        ({"attrs": "createdAt"}, 400, "too broad"),
        ({"q": "modifiedAt>2020-01-01T00:00:00Z"}, 400, "too broad"),
        ({"type": TYPE, "q": "owner{name}"}, 400, "joinLevel=1"),
        ({"type": TYPE, "q": "owner{a{b}}", "join": "inline"}, 400, "joinLevel=2"),
        ({"type": TYPE, "pick": "owner{name}"}, 400, "joinLevel=1"),
        ({"type": TYPE, "join": "sideways"}, 400, "flat"),
        ({"type": TYPE, "join": "flat", "joinLevel": "0"}, 400, "from 1"),
        ({"type": TYPE, "joinLevel": "2"}, 400, "goes with join"),
        ({"type": TYPE, "join": "flat", "containedBy": "x"}, 400, "URI"),
        ({"type": TYPE, "csf": "))bad(("}, 400, "csf has an error"),
        ({"type": TYPE, "scopeQ": "/a//b"}, 400, "scopeQ"),
        ({"type": TYPE, "georel": "within"}, 400, "add geometry"),
        ({"type": TYPE, "orderBy": "n;up"}, 400, "dist-desc"),
        ({"type": TYPE, "orderBy": "place;dist-asc"}, 400, "orderFrom"),
        ({"type": TYPE, "orderBy": "n", "collation": "!!nope"}, 400, "collation"),
        ({"type": TYPE, "collation": "und"}, 400, "orderBy"),
        ({"type": TYPE, "place": "nonsense"}, 400, "Link header"),
        ({"type": TYPE, "expandValues": "a b"}, 400, "expandValues"),
        ({"type": TYPE, "q": "status==pending"}, 400, 'double quotes: "pending"'),
        ({"type": TYPE, "q": "n=="}, 400, "character 4"),
        ({"type": TYPE, "q": "(n==1"}, 400, "expected )"),
        ({"type": TYPE, "q": "n>1,2"}, 400, "one value"),
        ({"type": TYPE, "q": 'n~="(?=a)b"'}, 400, "no look-around"),
        ({"type": TYPE, "idPattern": "("}, 400, "pattern"),
        ({"id": "no uri"}, 400, "URI"),
    ],
)
def test_an_invalid_query_is_refused_with_the_reason(
    http: httpx.Client, stocked: None, parameters: dict[str, str], status: int, word: str
) -> None:
    answer = http.get("/entities", params=parameters)
    assert answer.status_code == status, answer.text
    assert word in answer.json()["detail"]


def test_a_query_can_be_posted(http: httpx.Client, stocked: None) -> None:
    answer = http.post(
        "/entityOperations/query",
        params={"limit": 2, "count": "true", "options": "keyValues"},
        json={"type": "Query", "entities": [{"type": TYPE}], "q": "n>10", "attrs": ["n"]},
    )
    assert [entity["n"] for entity in answer.json()] == [11, 12]
    assert answer.headers["ngsild-results-count"] == "14"
    for refused in (
        {"type": "Nonsense"},
        {"q": 5},
        {"entities": []},
        {"entities": [{"type": 3}]},
        {"attrs": "n"},
    ):
        assert http.post("/entityOperations/query", json=refused).status_code == 400, refused


def test_types_are_listed(http: httpx.Client, stocked: None) -> None:
    assert {"Lot", "Other"} <= set(http.get("/types").json()["typeList"])
    details = http.get("/types/Lot").json()
    assert details["entityCount"] == 25
    assert {"attributeName": "owner", "attributeTypes": ["Relationship"]}.items() <= next(
        one for one in details["attributeDetails"] if one["attributeName"] == "owner"
    ).items()
    assert any(one["typeName"] == "Lot" for one in http.get("/types", params={"details": "true"}).json())
    assert http.get("/types/Nobody").status_code == 404


def test_expand_values_and_json_keys_change_the_meaning_of_q(http: httpx.Client) -> None:
    shop = {
        "id": "urn:x:terms-and-keys",
        "type": "TermShop",
        "category": {"type": "VocabProperty", "vocab": "food"},
        "raw": {"type": "JsonProperty", "json": {"size": {"x": 5}}},
    }
    assert http.post("/entities", json=shop).status_code == 201

    def hits(q: str, **parameters: str) -> int:
        return len(http.get("/entities", params={"type": "TermShop", "q": q, **parameters}).json())

    assert hits('category=="food"') == 0, "a vocab is an IRI"
    assert hits('category=="food"', expandValues="category") == 1
    assert hits("category==food", expandValues="category") == 1
    assert hits('category=="https://uri.etsi.org/ngsi-ld/default-context/food"') == 1
    assert hits("raw[size.x]==5", jsonKeys="raw") == 1
    assert hits("raw[size.x]==6", jsonKeys="raw") == 0
