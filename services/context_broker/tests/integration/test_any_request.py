"""Any request to any operation: it is answered, with the reason if it is refused, and breaks nothing.

Requests are drawn from the table of operations: names that are there or odd, parameters known and unknown,
headers, bodies that are almost right. Nothing may be answered with 500, and what was taken must be readable
after a restart.
"""

import copy
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

import httpx
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from handover_broker.app import operations_of
from handover_broker.request.routing import Operation
from handover_broker.settings import BrokerSettings

SEQUENCES = 4 * settings.default.max_examples
"""Of up to six requests."""
FROM_ELSEWHERE = {502, 503, 504, 508}
"""What is answered when a source or an @context cannot be reached."""

PLACE = {"type": "Point", "coordinates": [24.9, 60.2]}
AT = "2026-01-01T12:00:00Z"
NOBODY = "http://127.0.0.1:9"
CORE = "https://uri.etsi.org/ngsi-ld/v1/ngsi-ld-core-context-v1.8.jsonld"

ENTITY: dict[str, Any] = {
    "id": "urn:x:1",
    "type": ["Machine", "Robot"],
    "scope": ["/hall/west"],
    "speed": {"type": "Property", "value": 4.5, "unitCode": "MTS", "observedAt": AT},
    "parts": [{"type": "Property", "value": 1}, {"type": "Property", "value": 2, "datasetId": "urn:d:1"}],
    "isIn": {"type": "Relationship", "object": "urn:x:2", "objectType": "Hall"},
    "location": {"type": "GeoProperty", "value": PLACE},
    "label": {"type": "LanguageProperty", "languageMap": {"en": "Arm", "fi": "Käsi"}},
    "colour": {"type": "VocabProperty", "vocab": "red"},
    "raw": {"type": "JsonProperty", "json": {"a": [1, None]}},
    "list": {"type": "ListProperty", "valueList": [1, "x"]},
    "team": {"type": "ListRelationship", "objectList": [{"object": "urn:x:2"}]},
    "plain": "text",
}
QUERY: dict[str, Any] = {
    "type": "Query",
    "entities": [{"type": "Machine", "idPattern": "urn:.*"}],
    "q": "speed>4;isIn",
    "attrs": ["speed"],
    "geoQ": {"geometry": "Point", "coordinates": [24.9, 60.2], "georel": "near;maxDistance==2000"},
    "scopeQ": "/hall/#",
    "temporalQ": {"timerel": "after", "timeAt": AT},
    "lang": "fi",
}
PRESENT = {name: said for name, said in QUERY.items() if name != "temporalQ"}
SUBSCRIPTION: dict[str, Any] = {
    "id": "urn:x:sub:1",
    "type": "Subscription",
    "entities": [{"type": "Machine"}],
    "watchedAttributes": ["speed"],
    "q": "speed>4",
    "geoQ": QUERY["geoQ"],
    "scopeQ": "/hall/#",
    "notificationTrigger": ["attributeUpdated", "entityDeleted"],
    "expiresAt": "2036-01-01T12:00:00Z",
    "throttling": 5,
    "notification": {
        "attributes": ["speed"],
        "format": "keyValues",
        "showChanges": False,
        "endpoint": {
            "uri": f"{NOBODY}/notify",
            "accept": "application/json",
            "timeout": 1000,
            "receiverInfo": [{"key": "X-Cell", "value": "4"}],
        },
    },
}
REGISTRATION: dict[str, Any] = {
    "id": "urn:x:reg:1",
    "type": "ContextSourceRegistration",
    "information": [{"entities": [{"id": "urn:x:7", "type": "Crane"}], "propertyNames": ["load"]}],
    "endpoint": NOBODY,
    "mode": "inclusive",
    "operations": ["federationOps"],
    "management": {"timeout": 500, "cooldown": 60000},
    "location": PLACE,
    "observationInterval": {"startAt": AT},
    "contextSourceInfo": [{"key": "X-Key", "value": "v"}],
}
TEMPORAL: dict[str, Any] = {
    "id": "urn:x:1",
    "type": "Machine",
    "speed": [{"type": "Property", "value": number, "observedAt": AT} for number in range(3)],
}
SNAPSHOT: dict[str, Any] = {
    "id": "urn:x:snapshot:1",
    "type": "Snapshot",
    "snapshotQueries": [{"type": "Query", "entities": [{"type": "Machine"}]}],
    "snapshotLifetime": "PT1M",
}
SEEDS: list[Any] = [
    ENTITY,
    {name: said for name, said in ENTITY.items() if name != "id"},
    [ENTITY, {**ENTITY, "id": "urn:x:2"}],
    ["urn:x:1", "urn:x:2"],
    ENTITY["speed"],
    {"value": 5},
    QUERY,
    SUBSCRIPTION,
    {"isActive": False},
    REGISTRATION,
    TEMPORAL,
    {"@context": {"speed": "https://a.example/speed"}},
    SNAPSHOT,
    {"expiresAt": "2036-01-01T12:00:00Z"},
]

JUNK: list[Any] = [
    None, True, 0, -1, 1.5, 10**30, 1e308, "", " ", "x", "urn:ngsi-ld:null", "@none", "urn:x:1", AT,
    "2026-13-01",
    "P1M", "/a/b", "a b", "Ä\u0000é", "x" * 3000, [], {}, [[]], [None], {"": 1}, {"a": {"b": {}}},
    {"@value": 1},
    {"type": "Property"}, {"type": "GeoProperty", "value": {"type": "Polygon", "coordinates": [[]]}}, PLACE,
    {"@context": 5}, "Property", "Relationship", ["a", "a"], [1, "a", None], "http://169.254.169.254/",
    "mqtt://",
    f"{NOBODY}/x", {"@id": "urn:x:2"}, {"languageMap": {"@none": "urn:ngsi-ld:null"}}, "mqtt://127.0.0.1:9/t",
]  # fmt: skip
TEXTS = [
    "", "x", "true", "false", "0", "1", "-1", "20", "99999999999", "urn:x:1", "urn:x:1,urn:x:2", "Machine",
    "Machine|Robot",
    "(Machine;Robot),Hall", "((", "speed", "speed,isIn", "id,type", "speed>4", "speed==1..5;isIn",
    "isIn{Hall}", "speed.unitCode==\"MTS\"",
    "label[en]==\"Arm\"", "speed~=.*", "!speed", "(speed>4|", "q" * 500, "urn:.*", "(a+)+$", "[",
    "/hall/#", "/hall/+;/x", "near;maxDistance==2000",
    "near;minDistance==x", "within", "Point", "Polygon", "[24.9,60.2]", "[[[0,0],[1,0],[1,1],[0,0]]]",
    "[1", "location", "keyValues",
    "concise", "normalized", "simplified", "sysAttrs", "temporalValues", "aggregatedValues", "entityMap",
    "keyValues,concise", "noOverwrite", "update", "after",
    "before", "between", AT, "2036-01-01T00:00:00Z", "observedAt", "createdAt", "avg,max", "totalCount",
    "P1D", "PT0S", "P1Y2M", "fi", "*", "en;q=0.5,fi",
    "@none", "urn:d:1", "flat", "inline", "@none,x", "speed;desc", "dist-asc", "Hosted", "Cached",
    "\u0000", "é", "a b", "%", "&", "urn:x:sub:1", "5",
]  # fmt: skip
NAMES = [
    "urn:x:1", "urn:x:2", "urn:x:9", "urn:x:sub:1", "urn:x:reg:1", "urn:x:snapshot:1", "speed", "parts",
    "isIn", "location",
    "Machine", "id", "@type", "type", "createdAt", "https://uri.etsi.org/ngsi-ld/default-context/speed",
    CORE, f"{NOBODY}/c", "", " ", "x y",
    "%", "é", "\u0000", "*", "x" * 3000, "..", "urn:ngsi-ld:null",
]  # fmt: skip
ODD_MEMBERS = ["odd", "@odd", "a b", "observedAt", "value", "type", "@context", "datasetId", "scope"]
CONTEXT_LINK = 'rel="http://www.w3.org/ns/json-ld#context"'
PLAIN, LINKED = "application/json", "application/ld+json"
HEADERS: dict[str, list[str]] = {
    "Content-Type": [PLAIN, LINKED, "application/merge-patch+json", "text/plain", ""],
    "Accept": [PLAIN, LINKED, "application/geo+json", "*/*;q=0.1", "text/html", "x"],
    "Link": [f"<{url}>; {CONTEXT_LINK}" for url in (CORE, f"{NOBODY}/c", "")] + ["<x", "x" * 5000],
    "NGSILD-Tenant": ["any", "other", "no such tenant", "x" * 300, ""],
    "Prefer": ["ngsi-ld=1.3", "ngsi-ld=0", "body=json", ","],
    "Via": ["1.1 someone", "1.1", ",,"],
    "NGSILD-EntityMap": ["urn:x:map", "x", ""],
    "NGSILD-Snapshot": ["urn:x:snapshot:1", "x"],
}
FITTING: dict[str, list[str]] = {
    "id": ["urn:x:1", "urn:x:1,urn:x:2"],
    "idPattern": ["urn:.*"],
    "type": ["Machine", "Machine|Robot", "(Machine;Robot),Hall"],
    "attrs": ["speed", "speed,isIn", "location"],
    "pick": ["id,speed", "label,location"],
    "omit": ["speed", "id"],
    "q": [
        "speed>4",
        "speed==1..5;isIn",
        'label[en]=="Arm"',
        "parts|raw[a]",
        'speed.unitCode=="MTS"',
        "!ghost",
    ],
    "csf": ["x==1"],
    "geometry": ["Point", "Polygon"],
    "georel": ["near;maxDistance==2000", "within", "disjoint"],
    "coordinates": ["[24.9,60.2]", "[[[0,0],[90,0],[90,90],[0,0]]]"],
    "geoproperty": ["location"],
    "geometryProperty": ["location"],
    "scopeQ": ["/hall/#", "/hall/+"],
    "lang": ["fi", "en;q=0.5,fi", "*"],
    "datasetId": ["urn:d:1", "@none"],
    "options": [
        "sysAttrs",
        "keyValues",
        "concise",
        "temporalValues",
        "aggregatedValues",
        "count",
        "noOverwrite",
    ],
    "format": ["keyValues", "concise", "temporalValues", "aggregatedValues"],
    "limit": ["1", "20", "0"],
    "offset": ["0", "1"],
    "orderBy": ["speed", "speed;desc", "id"],
    "join": ["inline", "flat"],
    "joinLevel": ["1", "2"],
    "containedBy": ["urn:x:2"],
    "timerel": ["after", "before", "between"],
    "timeAt": ["2020-01-01T00:00:00Z"],
    "endTimeAt": ["2036-01-01T00:00:00Z"],
    "timeproperty": ["observedAt", "createdAt", "modifiedAt"],
    "lastN": ["1", "5"],
    "aggrMethods": ["avg,max", "totalCount"],
    "aggrPeriodDuration": ["P1D", "PT0S", "P1M"],
    "observedAt": [AT],
    "collation": ["fi", "und"],
    "orderFrom": ["[24.9,60.2]"],
    "orderGeometry": ["Point"],
    "expandValues": ["colour"],
    "jsonKeys": ["raw"],
    "keep": ["speed"],
    "drop": ["plain", "label"],
    "entityMapLifetime": ["PT1M", "P1D"],
    "kind": ["Hosted", "Cached"],
}
"""Values that fit a parameter; others are true or false."""
NAMED: dict[str, list[str]] = {
    "entities": ["urn:x:1", "urn:x:2"],
    "attrs": ["speed", "parts", "location", "isIn"],
    "subscriptions": ["urn:x:sub:1"],
    "csourceSubscriptions": ["urn:x:sub:2"],
    "csourceRegistrations": ["urn:x:reg:1"],
    "types": ["Machine", "Robot"],
    "attributes": ["speed", "label"],
    "jsonldContexts": [CORE],
    "snapshots": ["urn:x:snapshot:1"],
}
"""Names that are there, by the part of the path before them."""
SOURCE_SUBSCRIPTION: dict[str, Any] = {
    "id": "urn:x:sub:2",
    "type": "Subscription",
    "entities": [{"type": "Crane"}],
    "notification": {"endpoint": {"uri": f"{NOBODY}/notify"}},
}
BODIES: dict[str, list[Any]] = {
    "entities": [ENTITY, {**ENTITY, "id": "urn:x:2"}, {"speed": ENTITY["speed"], "plain": 5}],
    "attrs": [{"speed": ENTITY["speed"], "new": 1}, ENTITY["speed"], {"value": 5}],
    "entityOperations": [[ENTITY, {**ENTITY, "id": "urn:x:3"}], ["urn:x:2", "urn:x:3"], PRESENT],
    "subscriptions": [
        SUBSCRIPTION,
        {**SUBSCRIPTION, "id": "urn:x:sub:3"},
        {"isActive": True},
        {"q": "speed>5"},
    ],
    "csourceSubscriptions": [SOURCE_SUBSCRIPTION, {"isActive": True}],
    "csourceRegistrations": [REGISTRATION, {"endpoint": NOBODY}],
    "temporal": [TEMPORAL, QUERY, {"speed": TEMPORAL["speed"]}, {"speed": ENTITY["speed"]}],
    "jsonldContexts": [{"@context": {"speed": "https://a.example/speed"}}, {"@context": [CORE]}],
    "snapshots": [SNAPSHOT, {"snapshotLifetime": "PT2M"}, {"snapshotPriority": 3}],
    "entityMaps": [PRESENT, {"expiresAt": "2036-01-01T12:00:00Z"}],
}
"""Bodies that fit an operation, by the first part of its path."""


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> tuple[Operation, ...]:
    return operations_of(BrokerSettings(data_dir=tmp_path_factory.mktemp("none")))


def places_in(document: Any, way: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    yield way
    pairs = (
        document.items()
        if isinstance(document, dict)
        else enumerate(document)
        if isinstance(document, list)
        else ()
    )
    for key, value in pairs:
        yield from places_in(value, (*way, key))


def spoiled(draw: st.DrawFn, given_document: Any, times: int) -> Any:
    """Return a document with some of its places spoiled."""
    document = copy.deepcopy(given_document)
    for _ in range(times):
        way = draw(st.sampled_from(list(places_in(document))))
        junk = copy.deepcopy(draw(st.sampled_from(JUNK)))
        if not way:
            return junk
        parent = document
        for key in way[:-1]:
            parent = parent[key]
        how = draw(st.integers(0, 3))
        if how == 0:
            del parent[way[-1]]
        elif how == 1:
            parent[way[-1]] = [parent[way[-1]], junk]
        elif how == 2 and isinstance(parent, dict):
            parent[draw(st.sampled_from(ODD_MEMBERS))] = junk
        else:
            parent[way[-1]] = junk
    return document


@st.composite
def requests(draw: st.DrawFn, table: tuple[Operation, ...]) -> dict[str, Any]:
    """One request, of which most parts fit its operation."""

    def fits() -> bool:
        return draw(st.integers(0, 9)) < 8

    operation = draw(st.sampled_from(table))
    parts = operation.path.split("/")
    for place, part in enumerate(parts):
        if part.startswith("{"):
            known = NAMED.get(parts[place - 1], NAMES)
            parts[place] = draw(st.sampled_from(known if fits() else NAMES))
    query: dict[str, str] = {}
    if operation.parameters:
        for name in draw(st.lists(st.sampled_from(sorted(operation.parameters)), max_size=4, unique=True)):
            query[name] = draw(st.sampled_from(FITTING.get(name, ["true", "false"]) if fits() else TEXTS))
    if draw(st.integers(0, 19)) == 0:
        query["odd"] = "1"
    if "type" in operation.parameters and operation.method == "GET" and fits():
        query.setdefault("type", "Machine")
    headers = {"Content-Type": PLAIN}
    for name in draw(st.lists(st.sampled_from(sorted(HEADERS)), max_size=2, unique=True)):
        if not fits():
            headers[name] = draw(st.sampled_from(HEADERS[name]))
    body = None
    if operation.method in {"POST", "PATCH", "PUT"}:
        kind = "attrs" if "attrs" in parts and parts[0] == "entities" else parts[0]
        document = draw(st.sampled_from(BODIES.get(kind, SEEDS) if fits() else SEEDS))
        document = spoiled(draw, document, draw(st.sampled_from([0, 0, 1, 1, 2])))
        if headers["Content-Type"] == LINKED and isinstance(document, dict):
            document = {**document, "@context": CORE}
        body = json.dumps(document).encode() if fits() or fits() else draw(st.binary(max_size=40))
    return {"method": operation.method, "parts": parts, "query": query, "headers": headers, "body": body}


def send(http: httpx.Client, drawn: dict[str, Any]) -> httpx.Response:
    path = "/".join(quote(part, safe="") for part in drawn["parts"])
    text = "&".join(f"{name}={quote(value, safe='')}" for name, value in drawn["query"].items())
    url = httpx.URL(f"{http.base_url}").copy_with(raw_path=f"/ngsi-ld/v1/{path}?{text}".encode())
    return http.request(drawn["method"], url, content=drawn["body"], headers=drawn["headers"])


def furnish(http: httpx.Client) -> None:
    """See that there is something for requests to be about."""
    http.post("/entityOperations/upsert?options=update", json=[ENTITY, {**ENTITY, "id": "urn:x:2"}])
    for path, document in (
        ("subscriptions", {**SOURCE_SUBSCRIPTION, "id": "urn:x:sub:1"}),
        ("csourceSubscriptions", SOURCE_SUBSCRIPTION),
        ("csourceRegistrations", REGISTRATION),
        ("temporal/entities", TEMPORAL),
        ("snapshots", SNAPSHOT),
    ):
        http.post(f"/{path}", json=document)


def check(answer: httpx.Response, drawn: dict[str, Any]) -> None:
    result = f"{answer.request.method} {answer.request.url} {drawn}: {answer.status_code} {answer.text[:500]}"
    assert answer.status_code < 500 or answer.status_code in FROM_ELSEWHERE, result
    if answer.status_code in {411, 415}:
        assert not answer.content, result
    elif answer.status_code >= 400:
        assert answer.json()["detail"], result
        assert answer.json()["title"], result
    elif answer.content:
        assert "json" in answer.headers["content-type"], result
        answer.json()


@pytest.mark.nightly
@pytest.mark.slow
def test_any_request_is_answered(own_broker: Any, table: tuple[Operation, ...]) -> None:
    own_broker.extra["HANDOVER_BROKER_CONTEXT_TIMEOUT_S"] = "1"
    own_broker.start()
    with own_broker.client() as http:

        @settings(
            max_examples=SEQUENCES, deadline=None, database=None, suppress_health_check=list(HealthCheck)
        )
        @given(st.lists(requests(table), min_size=1, max_size=6))
        def ask(sequence: list[dict[str, Any]]) -> None:
            furnish(http)
            for drawn in sequence:
                check(send(http, drawn), drawn)

        ask()
        assert http.get("/types").status_code == 200
        before = [entity["id"] for entity in http.get("/entities?type=Machine&limit=1000").json()]
    own_broker.kill()
    own_broker.start()
    with own_broker.client() as http:
        after = [entity["id"] for entity in http.get("/entities?type=Machine&limit=1000").json()]
        assert after == before
        for path in ("subscriptions", "csourceRegistrations?type=Crane", "jsonldContexts", "types"):
            assert http.get(f"/{path}").status_code == 200, path
    log = Path(own_broker.data_dir / "log").read_text()
    assert "Traceback" not in log, log[log.index("Traceback") :][:3000]
