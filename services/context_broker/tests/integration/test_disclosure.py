"""No byte of an entity about the body of a person reaches a receiver whose owner may not read it.

Two tenants hold the same things; one of them also has data about bodies. A client that may not read these
sees no difference between the tenants, whatever operation it uses, and receives none of them, no matter who
causes the message. The values are words, so that a search for them finds every copy.
"""

import itertools
import json
from collections.abc import Iterator
from typing import Any
from urllib.parse import quote

import httpx
import pytest

from handover.security.permissions import Role
from handover_broker.app import operations_of
from handover_broker.settings import BrokerSettings
from services.context_broker.tests.integration.conftest import Subscriber
from services.context_broker.tests.integration.secured import SecuredBroker, secured_broker
from tests.kit.context_sources import ScriptedSource
from tests.kit.waiting import wait_for

PRIVATE = "beats-of-the-heart"
"""In every private value."""
FORGED = "forged-by-a-source"
ROBOT = "urn:ngsi-ld:Device:demo:ur10-1"
ANNA = "urn:ngsi-ld:Person:demo:anna"
STATE = "urn:ngsi-ld:HumanState:demo:anna"
BOTH = "urn:ngsi-ld:Wearable:demo:belt-1"
"""A wearable that is a HumanState as well."""
ALIAS = {"Pulse": "https://example.org/vocabulary/HumanState", "beat": "https://example.org/vocabulary/beat"}
ALIASED = "urn:ngsi-ld:Reading:demo:anna"
"""A HumanState of another vocabulary, under an alias."""
EVER = "timerel=after&timeAt=1970-01-01T00:00:00Z"
DOCTOR = (Role.ENGINEER, Role.RESEARCHER)
WITH_DATA, WITHOUT = {"NGSILD-Tenant": "with"}, {"NGSILD-Tenant": "without"}


def prop(value: Any, **more: Any) -> dict[str, Any]:
    return {"type": "Property", "value": value, **more}


def link(target: str) -> dict[str, Any]:
    return {"type": "Relationship", "object": target}


def public_entities() -> list[dict[str, Any]]:
    return [
        {
            "id": ROBOT,
            "type": "Device",
            "speed": prop(3),
            "worksWith": link(STATE),
            "wears": link(BOTH),
            "reads": link(ALIASED),
            "location": {"type": "GeoProperty", "value": {"type": "Point", "coordinates": [8, 47]}},
            "scope": "/cell",
        },
        {"id": ANNA, "type": "Person", "firstName": prop("Anna"), "hasState": link(STATE)},
    ]


def private_entities(number: int = 1) -> list[dict[str, Any]]:
    return [
        {
            "id": STATE,
            "type": "HumanState",
            "refPerson": link(ANNA),
            "heartRate": prop(f"{PRIVATE}-{number}", observedAt=f"2026-11-01T10:{number:02}:00Z"),
            "strain": prop(100 + number),
            "location": {"type": "GeoProperty", "value": {"type": "Point", "coordinates": [8, 47]}},
            "scope": "/cell",
        },
        {"id": BOTH, "type": ["Wearable", "HumanState"], "heartRate": prop(f"{PRIVATE}-{number}")},
        {
            "@context": ALIAS,
            "id": ALIASED,
            "type": "Pulse",
            "beat": prop(f"{PRIVATE}-{number}"),
        },
    ]


def upsert(service: httpx.Client, entities: list[dict[str, Any]]) -> None:
    core = "https://uri.etsi.org/ngsi-ld/v1/ngsi-ld-core-context-v1.8.jsonld"
    body = [{"@context": core, **one} for one in entities]
    headers = {"Content-Type": "application/ld+json"}
    answer = service.post("/entityOperations/upsert", content=json.dumps(body), headers=headers)
    assert answer.status_code in {201, 204}, answer.text


@pytest.fixture(scope="module")
def broker(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SecuredBroker]:
    with secured_broker(tmp_path_factory.mktemp("secured")) as made:
        for tenant in (WITH_DATA, WITHOUT):
            upsert(made.service(**tenant), public_entities())
        upsert(made.service(**WITH_DATA), private_entities())
        yield made


@pytest.fixture
def sinks() -> Iterator[Iterator[Subscriber]]:
    made: list[Subscriber] = []

    def new() -> Iterator[Subscriber]:
        while True:
            made.append(Subscriber())
            yield made[-1]

    yield new()
    for one in made:
        one.stop()


QUERIES = [
    *(
        "",
        "type=Device",
        "type=HumanState",
        "type=Wearable",
        "type=(Wearable|Device)",
        "type=Wearable;HumanState",
    ),
    *(f"id={quote(one)}" for one in (STATE, BOTH, ALIASED)),
    *(
        f"type=Device&q={one}&join=inline&joinLevel=2"
        for one in (
            *("worksWith{strain}>50", "worksWith{strain}<50", "worksWith{strain}!=7", "worksWith{heartRate}"),
            *("wears{heartRate}", "(speed>0|worksWith{strain}>50)", "worksWith{refPerson{firstName}}"),
        )
    ),
    *("q=heartRate", "q=strain>0", "idPattern=.*", "scopeQ=/cell", "attrs=heartRate", "attrs=strain,speed"),
    *("join=inline&joinLevel=3", "join=flat&joinLevel=3", "pick=worksWith{heartRate}&join=inline"),
    *("join=inline&pick=id,wears{heartRate}", "orderBy=strain", "orderBy=id&type=HumanState"),
    "georel=near;maxDistance==1000&geometry=Point&coordinates=[8,47]",
    *("options=keyValues", "options=sysAttrs", "options=count&limit=1", "count=true&limit=0"),
    *("entityMap=true", "options=entityMap&type=HumanState"),
]
READS = [
    *(("GET", f"/entities?{one}{'&' if one else ''}count=true&local={is_local}", None)
      for one in QUERIES if "count" not in one for is_local in ("true", "false")),
    *(("GET", f"/entities?{one}", None) for one in QUERIES if "count" in one),
    *(("GET", f"/temporal/entities?{EVER}{one and '&'}{one}&count=true", None)
      for one in QUERIES
      if not any(word in one for word in ("join", "orderBy=strain", "count", "{", "entityMap"))),
    *(("GET", f"/{at}/{one}{more}", None)
      for at in ("entities", "temporal/entities") for one in (STATE, BOTH, ALIASED, ROBOT)
      for more in ("", "?options=keyValues", "?type=HumanState")),
    *(("GET", f"/entities/{ROBOT}?{one}", None) for one in QUERIES if "join" in one),
    *(("POST", "/entityOperations/query", {"type": "Query", **one}) for one in (
        {"entities": [{"type": "HumanState"}]}, {"entities": [{"id": STATE}, {"type": "Device"}]},
        {"entities": [{"type": "Device"}], "q": "worksWith{strain}>50", "join": "flat"},
        {"entities": [{"type": "Wearable"}]},
        {"entities": [{"type": "Device"}], "join": "inline", "joinLevel": 2},
    )),
    ("POST", "/temporal/entityOperations/query",
     {"type": "Query", "entities": [{"type": "HumanState"}, {"type": "Device"}],
      "temporalQ": {"timerel": "after", "timeAt": "1970-01-01T00:00:00Z"}}),
    *(("GET", f"/{one}{more}", None)
      for one in ("types", "attributes", "types/HumanState", "types/Wearable", "types/Device",
                  "attributes/heartRate", "attributes/strain", "attributes/location", "attributes/speed")
      for more in ("", "?details=true", "?local=true", "?count=true")
      if "/" not in one or more in {"", "?local=true"}),
    ("GET", "/entityMaps?type=HumanState", None),
    ("GET", "/entityMaps?type=Device&q=worksWith{strain}>50&join=inline", None),
    ("POST", "/entityMaps", {"type": "Query", "entities": [{"type": "HumanState"}]}),
    ("GET", f"/temporal/entityMaps?{EVER}", None),
]  # fmt: skip


def content_of(answer: httpx.Response) -> tuple[Any, ...]:
    """Return the content of an answer, without what differs between two equal requests."""
    text = answer.text
    headers = {
        name: value
        for name, value in answer.headers.items()
        if name.lower() in {"link", "ngsild-results-count", "ngsild-warning", "content-range", "location"}
    }
    try:
        body = answer.json() if text else None
    except json.JSONDecodeError:
        body = text
    return answer.status_code, scrubbed(body), headers


def scrubbed(value: Any) -> Any:
    if isinstance(value, dict):
        gone = {"createdAt", "modifiedAt", "expiresAt", "instanceId"}
        return {name: scrubbed(one) for name, one in value.items() if name not in gone}
    if isinstance(value, list):
        return [scrubbed(one) for one in value]
    if isinstance(value, str):
        is_map = value.startswith("urn:ngsi-ld:EntityMap:")
        return "a map" if is_map else value.replace("without/", "with/")
    return value


@pytest.mark.nightly
@pytest.mark.parametrize("roles", [(Role.ENGINEER,), (Role.VIEWER,), (Role.ADMIN, Role.ENGINEER)], ids=str)
def test_answers_are_the_same_with_and_without_private_data(
    broker: SecuredBroker, roles: tuple[Role, ...]
) -> None:
    token = broker.script(*roles)[1]
    one, other = broker.client(token, **WITH_DATA), broker.client(token, **WITHOUT)
    for method, path, body in READS:
        answers = [content_of(client.request(method, path, json=body)) for client in (one, other)]
        assert answers[0] == answers[1], (method, path, body)
        assert PRIVATE not in str(answers[0]), (method, path)


def test_who_may_read_private_data_sees_it(broker: SecuredBroker) -> None:
    doctor = broker.caller(*DOCTOR, **WITH_DATA)
    seen = [
        (method, path)
        for method, path, body in READS
        if PRIVATE in doctor.request(method, path, json=body).text
    ]
    assert len(seen) > 50, "the reads above can see it"
    for method, path, body in READS:
        if "{strain}" in f"{path}{body}" and ROBOT not in path:
            assert doctor.request(method, path, json=body).status_code < 400, f"{path} compares nothing"
    kinds = doctor.get("/types").json()["typeList"]
    assert "HumanState" in kinds
    assert doctor.get("/types/HumanState").json()["entityCount"] == 2


CHANGES = {
    "POST": [{"strain": prop(1)}, {"type": "Device", "x": prop(1)}, {"heartRate": {"type": "Relationship"}}],
    "PATCH": [{"strain": prop(1)}, {"type": "Device"}, {"value": 2}, {"heartRate": "urn:ngsi-ld:null"}],
    "PUT": [{"type": "HumanState", "strain": prop(1)}, prop(1)],
    "DELETE": [None],
}


@pytest.mark.nightly
def test_no_operation_changes_private_data_or_says_whether_it_exists(broker: SecuredBroker) -> None:
    token = broker.script(Role.ENGINEER)[1]
    one, other = broker.client(token, **WITH_DATA), broker.client(token, **WITHOUT)
    doctor = broker.caller(*DOCTOR, **WITH_DATA)
    before = doctor.get(f"/entities/{STATE}").text
    whole = {"id": STATE, "type": "HumanState", "strain": prop(1)}
    as_device = {"id": STATE, "type": "Device", "strain": prop(1)}
    asked: list[tuple[str, str, Any]] = []
    for operation in operations_of(BrokerSettings(_env_file=None)):
        if "entities/{id}" not in operation.path and not operation.path.startswith("entityOperations"):
            continue
        if operation.path == "entityOperations/query" or operation.method == "GET":
            continue
        path = operation.path.replace("{id}", STATE).replace("{instance}", "urn:ngsi-ld:Instance:1")
        if operation.path.startswith("entityOperations"):
            bodies: list[Any] = (
                [[STATE]] if path.endswith("delete") else [[whole], [as_device], [whole, as_device]]
            )
        else:
            bodies = CHANGES[operation.method]
        names = (
            ("heartRate", "strain", "nothing", "scope") if "{attrId}" in path or "{name}" in path else ("",)
        )
        for name, body in itertools.product(names, bodies):
            at = path.replace("{attrId}", name).replace("{name}", name)
            more = ("", "?options=noOverwrite", "?type=Device", "?deleteAll=true")
            asked += [(operation.method, f"/{at}{query}", body) for query in more]
    asked += [("POST", at, body) for at in ("/entities", "/temporal/entities") for body in (whole, as_device)]
    assert len(asked) > 100
    for method, path, body in asked:
        answers = [content_of(client.request(method, path, json=body)) for client in (one, other)]
        assert answers[0] == answers[1], (method, path, body)
        assert answers[0][0] in {207, 400, 403, 404}, (method, path, body, answers[0])
    purge = one.delete("/entities?type=HumanState")
    assert purge.status_code == other.delete("/entities?type=HumanState").status_code
    assert doctor.get(f"/entities/{STATE}").text == before


SUBSCRIPTIONS: dict[str, dict[str, Any]] = {
    "joined inline": {"notification": {"join": "inline", "joinLevel": 2}},
    "joined flat": {"notification": {"join": "flat", "joinLevel": 2}},
    "joined and throttled": {"throttling": 1, "notification": {"join": "inline"}},
    "joined values": {"notification": {"join": "inline", "format": "keyValues"}},
    "picked": {"notification": {"join": "inline", "pick": ["id", "worksWith{heartRate}"]}},
    "periodic": {"timeInterval": 1, "notification": {"join": "flat"}},
    "of another type": {"entities": [{"type": "Wearable"}]},
    "by id": {"entities": [{"type": "(Device|Wearable)", "idPattern": ".*"}]},
    "of an alias": {"entities": [{"type": "Pulse"}], "@context": ALIAS},
    "of deletions": {
        "entities": [{"type": "Wearable"}],
        "notificationTrigger": ["entityDeleted", "attributeDeleted", "entityCreated", "entityUpdated"],
        "notification": {"showChanges": True},
    },
    "as GeoJSON": {"notification": {"join": "inline", "endpoint": {"accept": "application/geo+json"}}},
}
ORACLES = {
    "by q": {"q": "worksWith{strain}>50", "notification": {"join": "inline"}},
    "by q of nothing": {"q": "worksWith{strain}<50", "notification": {"join": "inline"}},
}


def subscription(members: dict[str, Any], uri: str) -> dict[str, Any]:
    made = {"type": "Subscription", "entities": [{"type": "Device"}], **members}
    notification = made.get("notification", {})
    made["notification"] = {**notification, "endpoint": {"uri": uri, **notification.get("endpoint", {})}}
    return made


def post(client: httpx.Client, path: str, document: dict[str, Any]) -> httpx.Response:
    kind = "application/ld+json" if "@context" in document else "application/json"
    return client.post(path, content=json.dumps(document), headers={"Content-Type": kind})


def all_changes(service: httpx.Client, number: int) -> None:
    upsert(service, private_entities(number))
    upsert(service, [{**public_entities()[0], "speed": prop(number)}])
    service.delete(f"/entities/{BOTH}")
    upsert(service, private_entities(number + 1))


def test_notifications_have_what_their_owner_may_read(
    broker: SecuredBroker, sinks: Iterator[Subscriber]
) -> None:
    tenant = {"NGSILD-Tenant": "notified"}
    service = broker.service(**tenant)
    upsert(service, public_entities())
    upsert(service, private_entities())
    engineer, (doctor_subject, token) = broker.caller(Role.ENGINEER, **tenant), broker.script(*DOCTOR)
    doctor = broker.client(token, **tenant)
    received: dict[str, Subscriber] = {}
    expected: dict[str, Subscriber] = {}
    for name, members in {**SUBSCRIPTIONS, **ORACLES}.items():
        for client, kept in ((engineer, received), (doctor, expected)):
            kept[name] = next(sinks)
            answer = post(client, "/subscriptions", subscription(members, f"{kept[name].url}/n"))
            assert answer.status_code == 201, (name, answer.text)
    all_changes(service, 10)
    public_only = {"of another type", "of deletions", "of an alias", "by q", "by q of nothing"}
    for name, sink in expected.items():
        if name != "by q of nothing":
            wait_for(lambda one=sink: PRIVATE in str(one.received), why=f"the doctor receives {name}")
    for name, sink in received.items():
        if name not in public_only:
            wait_for(lambda one=sink: ROBOT in str(one.received), why=f"the engineer receives {name}")
    for name, sink in received.items():
        assert PRIVATE not in str(sink.received), name
        assert "strain" not in str(sink.received), name
        if name in public_only:
            assert not sink.received, name
    delivered = [one for one in broker.audit(subject=doctor_subject) if one["action"] == "notification"]
    assert {one["resource"] for one in delivered} >= {f"notified/{ANNA}"}
    assert not [one for one in broker.audit() if one["action"] == "notification" and one not in delivered]


@pytest.mark.nightly
def test_a_grant_that_is_removed_ends_deliveries_also_of_what_waits(
    broker: SecuredBroker, sinks: Iterator[Subscriber]
) -> None:
    tenant = {"NGSILD-Tenant": "removed"}
    service = broker.service(**tenant)
    upsert(service, public_entities())
    upsert(service, private_entities())
    subject, token = broker.script(*DOCTOR)
    sink, joined = next(sinks), next(sinks)
    doctor = broker.client(token, **tenant)
    for members, to in (
        ({"entities": [{"type": "HumanState"}]}, sink),
        (SUBSCRIPTIONS["joined inline"], joined),
    ):
        assert post(doctor, "/subscriptions", subscription(members, f"{to.url}/n")).status_code == 201
    all_changes(service, 20)
    wait_for(lambda: PRIVATE in str(sink.received) and PRIVATE in str(joined.received))
    sink.status = joined.status = 503
    all_changes(service, 30)
    broker.remove_grant(subject, Role.RESEARCHER)
    wait_for(lambda: doctor.get(f"/entities/{STATE}").status_code == 404, why="the grant is gone")
    sink.received.clear()
    joined.received.clear()
    sink.status = joined.status = 200
    upsert(service, [{**public_entities()[0], "speed": prop(77)}])
    wait_for(lambda: '"value": 77' in json.dumps(joined.received))
    broker.cell.restart("context_broker")
    all_changes(service, 40)
    wait_for(lambda: '"value": 40' in json.dumps(joined.received))
    assert PRIVATE not in str(joined.received)
    assert PRIVATE not in str(sink.received)
    broker.revoke(subject)
    witness, numbers = next(sinks), itertools.count(100)
    body = subscription({}, f"{witness.url}/n")
    assert post(broker.service(**tenant), "/subscriptions", body).status_code == 201

    def has_ended() -> bool:
        """Return whether a change reaches a service, and the deleted owner no longer."""
        value = f'"value": {next(numbers)}'
        upsert(service, [{**public_entities()[0], "speed": prop(int(value.split()[1]))}])
        wait_for(lambda: value in json.dumps(witness.received))
        return value not in json.dumps(joined.received)

    wait_for(has_ended, why="the owner does not exist any more")


REGISTRATIONS: dict[str, dict[str, Any]] = {
    "of devices": {"information": [{"entities": [{"type": "Device"}]}]},
    "of anything": {"information": [{"propertyNames": ["heartRate", "strain", "value"]}]},
    "of wearables": {"information": [{"entities": [{"type": "Wearable", "idPattern": ".*"}]}]},
    "exclusive": {
        "mode": "exclusive",
        "information": [{"entities": [{"type": "Device", "id": STATE}], "propertyNames": ["heartRate"]}],
    },
    "redirect": {"mode": "redirect", "information": [{"propertyNames": ["heartRate"]}]},
    "auxiliary": {"mode": "auxiliary", "operations": ["retrieveOps"],
                  "information": [{"propertyNames": ["breathing", "heartRate"]}]},
}  # fmt: skip


@pytest.mark.nightly
@pytest.mark.parametrize("name", REGISTRATIONS)
def test_a_source_receives_and_replaces_nothing_private_without_the_right_of_its_owner(
    broker: SecuredBroker, source: ScriptedSource, name: str
) -> None:
    tenant = {"NGSILD-Tenant": f"source-{name.replace(' ', '-')}"}
    service, doctor = broker.service(**tenant), broker.caller(*DOCTOR, **tenant)
    engineer = broker.caller(Role.ENGINEER, **tenant)
    upsert(service, public_entities())
    upsert(service, private_entities())
    registration = {
        "type": "ContextSourceRegistration",
        "endpoint": source.url,
        "operations": ["federationOps", "redirectionOps", "retrieveOps", "updateOps"],
        **REGISTRATIONS[name],
    }
    answer = engineer.post("/csourceRegistrations", json=registration)
    assert answer.status_code == 201, answer.text
    forged = [
        {
            "id": one["id"],
            "type": "Device",
            **dict.fromkeys(("heartRate", "strain", "breathing"), prop(FORGED)),
        }
        for one in private_entities()
    ]
    forged += [{**one, "type": "HumanState"} for one in forged]
    source.answers[("GET", "/ngsi-ld/v1/entities")] = (200, forged)
    source.answers[("POST", "/ngsi-ld/v1/entityOperations/query")] = (200, forged)
    source.answers[("GET", "/ngsi-ld/v1/temporal/entities")] = (200, forged)
    for one in forged:
        for at in ("entities", "temporal/entities"):
            source.answers[("GET", f"/ngsi-ld/v1/{at}/{one['id']}")] = (200, one)
    all_changes(service, 55)
    state = {"heartRate": prop(f"{PRIVATE}-x")}
    path = f"/entities/{STATE}"
    for method, at, body in (
        ("PATCH", f"{path}/attrs", state), ("POST", f"{path}/attrs", state), ("PATCH", path, state),
        ("PATCH", path, {"type": "Device", **state}),
        ("PATCH", f"{path}/attrs/heartRate", prop(f"{PRIVATE}-y")),
        ("PUT", f"{path}/attrs/heartRate", prop(f"{PRIVATE}-z")),
        ("POST", "/entityOperations/update", [{"id": STATE, "type": "Wearable", **state}]),
        ("POST", "/entityOperations/merge", [{"id": STATE, "type": "Device", **state}]),
        ("POST", "/entityOperations/create", [{"id": f"{STATE}2", "type": "HumanState", **state}]),
        ("POST", "/temporal/entities", {"id": STATE, "type": "HumanState", "heartRate": [
            prop(f"{PRIVATE}-t", observedAt="2026-11-01T09:00:00Z")]}),
        ("DELETE", f"/entities/{STATE}2", None),
        ("PATCH", f"/entities/{STATE}3/attrs", state),
    ):  # fmt: skip
        answer = service.request(method, at, json=body)
        assert answer.status_code < 500, (method, at, answer.text)
    for method, at, body in READS:
        answer = doctor.request(method, at, json=body)
        assert answer.status_code < 500, (method, at, answer.text)
        if STATE in answer.text and "/entityMaps" not in at:
            assert FORGED not in answer.text, (method, at)
    assert PRIVATE in doctor.get(path).json()["heartRate"]["value"]
    assert PRIVATE in doctor.get(f"/temporal/entities/{STATE}").text
    assert PRIVATE not in str(source.asked), name


def test_a_source_of_an_owner_with_the_right_is_used_and_recorded(
    broker: SecuredBroker, source: ScriptedSource
) -> None:
    tenant = {"NGSILD-Tenant": "entitled"}
    service, (subject, token) = broker.service(**tenant), broker.script(*DOCTOR)
    doctor, engineer = broker.client(token, **tenant), broker.caller(Role.ENGINEER, **tenant)
    upsert(service, public_entities())
    registration = {
        "type": "ContextSourceRegistration",
        "endpoint": source.url,
        "information": [{"entities": [{"type": "HumanState"}]}],
        "operations": ["federationOps", "redirectionOps", "retrieveOps", "updateOps", "retrieveTemporal",
                       "queryTemporal", "retrieveEntityTypes", "retrieveAttrTypes", "retrieveEntityTypeInfo"],
    }  # fmt: skip
    assert engineer.post("/csourceRegistrations", json=registration).status_code == 403
    made = doctor.post("/csourceRegistrations", json=registration)
    assert made.status_code == 201, made.text
    there = {"id": f"{STATE}-there", "type": "HumanState", "heartRate": prop(PRIVATE)}
    source.answers[("GET", "/ngsi-ld/v1/entities")] = (200, [there])
    source.answers[("GET", f"/ngsi-ld/v1/entities/{there['id']}")] = (200, there)
    past = {**there, "heartRate": [prop(PRIVATE, observedAt="2026-11-01T10:00:00Z")]}
    source.answers[("GET", "/ngsi-ld/v1/temporal/entities")] = (200, [past])
    source.answers[("GET", f"/ngsi-ld/v1/temporal/entities/{there['id']}")] = (200, past)
    listed = {"id": "urn:x:1", "type": "EntityTypeList", "typeList": ["HumanState"]}
    source.answers[("GET", "/ngsi-ld/v1/types")] = (200, listed)
    upsert(service, private_entities(3))
    assert PRIVATE in str(source.asked), "it is forwarded"
    sent = [one for one in broker.audit(subject=subject) if one["action"] == "forwarded request"]
    assert sent, "it is recorded who receives it"
    reads = ("/entities?type=HumanState", f"/entities/{there['id']}", "/entities?attrs=heartRate&count=true",
             f"/temporal/entities?{EVER}&type=HumanState", f"/temporal/entities/{there['id']}")  # fmt: skip
    for read in reads:
        assert PRIVATE in doctor.get(read).text, read
        assert PRIVATE not in engineer.get(read).text, read
        assert there["id"] not in engineer.get(read).headers.get("link", ""), read
    assert "HumanState" in doctor.get("/types").text
    assert "HumanState" not in engineer.get("/types").text
    change = {"heartRate": prop("by an engineer")}
    assert engineer.patch(f"/entities/{there['id']}/attrs", json=change).status_code == 403
    assert "by an engineer" not in str(source.asked)
    at = made.headers["location"].removeprefix("/ngsi-ld/v1")
    assert engineer.patch(at, json={"description": "mine now"}).status_code == 403
    before = len(source.asked)
    broker.remove_grant(subject, Role.RESEARCHER)
    wait_for(lambda: doctor.get(f"/entities/{STATE}").status_code == 404)
    upsert(service, private_entities(4))
    assert PRIVATE not in str(source.asked[before:]), "a grant that is removed takes effect"


def test_maps_and_the_history_of_deleted_entities_are_private(broker: SecuredBroker) -> None:
    tenant = {"NGSILD-Tenant": "past"}
    service, doctor = broker.service(**tenant), broker.caller(*DOCTOR, **tenant)
    engineer = broker.caller(Role.ENGINEER, **tenant)
    upsert(service, public_entities())
    belt = {**private_entities()[1], "id": "urn:ngsi-ld:Belt:demo:1"}
    upsert(service, [belt])
    made = doctor.get("/entityMaps?attrs=heartRate")
    assert belt["id"] in made.text
    at = f"/entityMaps/{made.json()['id']}"
    assert engineer.get(at).status_code == 404
    assert engineer.delete(at).status_code == 404
    assert belt["id"] not in engineer.get("/entities", headers={"NGSILD-EntityMap": f"/ngsi-ld/v1{at}"}).text
    assert doctor.get(at).status_code == 200
    service.delete(f"/entities/{belt['id']}")
    past = f"/temporal/entities/{belt['id']}"
    assert engineer.get(past).status_code == 404
    engineer.post("/entities", json={"id": belt["id"], "type": "Device"})
    assert PRIVATE not in engineer.get(past).text, "an entity of the same id does not open the history"
    for read in (f"/temporal/entities?{EVER}", f"/temporal/entities?{EVER}&type=Device"):
        assert PRIVATE not in engineer.get(read).text
    assert PRIVATE in doctor.get(past).text


COUNTED = {"timesSent", "timesFailed", "lastNotification", "lastSuccess", "lastFailure"}


def counts_in(document: dict[str, Any]) -> set[str]:
    return {name for name in COUNTED if name in document or name in document.get("notification", {})}


@pytest.mark.nightly
def test_no_count_says_how_often_private_data_was_sent_to_others(
    broker: SecuredBroker, sinks: Iterator[Subscriber], source: ScriptedSource
) -> None:
    tenant = {"NGSILD-Tenant": "counts"}
    service, doctor = broker.service(**tenant), broker.caller(*DOCTOR, **tenant)
    engineer, colleague = broker.caller(Role.ENGINEER, **tenant), broker.caller(Role.ENGINEER, **tenant)
    upsert(service, public_entities())
    sink, of_engineer, watching = next(sinks), next(sinks), next(sinks)
    members = {"entities": [{"type": "HumanState"}], "q": "strain>50"}
    made = post(doctor, "/subscriptions", subscription(members, f"{sink.url}/n"))
    subscribed = made.headers["location"].removeprefix("/ngsi-ld/v1")
    post(engineer, "/csourceSubscriptions", subscription({"timeInterval": 1}, f"{watching.url}/n"))
    own = post(engineer, "/subscriptions", subscription({}, f"{of_engineer.url}/n")).headers["location"]
    registration = {
        "type": "ContextSourceRegistration",
        "endpoint": source.url,
        "information": [{"entities": [{"type": "HumanState"}, {"type": "Device"}]}],
        "operations": ["redirectionOps"],
    }
    registered = post(doctor, "/csourceRegistrations", registration).headers["location"]
    registered = registered.removeprefix("/ngsi-ld/v1")
    upsert(service, private_entities())
    upsert(service, [{**public_entities()[0], "speed": prop(5)}])
    wait_for(lambda: sink.received and of_engineer.received and source.asked)
    for at in (subscribed, registered):
        wait_for(lambda one=at: counts_in(doctor.get(one).json()), why="the counts are there")
    listings = ("/subscriptions", *(f"/csourceRegistrations?type={one}" for one in ("HumanState", "Device")))
    for at in (subscribed, registered, *listings):
        answer = colleague.get(at)
        assert answer.status_code == 200, at
        listed = answer.json() if isinstance(answer.json(), list) else [answer.json()]
        assert listed, at
        for one in listed:
            is_own = one["id"] in own
            assert bool(counts_in(one)) is is_own, (at, one)
            assert ("status" in one.get("notification", {})) is is_own, (at, one)
    watching.received.clear()
    wait_for(lambda: "HumanState" in str(watching.received))
    assert not [name for name in COUNTED if name in str(watching.received[-1])]
    for at in (subscribed, registered):
        assert engineer.patch(at, json={"description": "mine"}).status_code in {204, 403}, at
    assert engineer.get(subscribed).json()["description"] == "mine"
    assert not counts_in(engineer.get(subscribed).json()), "the counts of the previous owner"
    broker.cell.restart("context_broker")
    assert not counts_in(engineer.get(subscribed).json())
    assert counts_in(colleague.get(own.removeprefix("/ngsi-ld/v1")).json()), "its owner is verified again"


@pytest.mark.nightly
def test_the_history_of_an_entity_stays_private_when_it_loses_the_type(broker: SecuredBroker) -> None:
    tenant = {"NGSILD-Tenant": "types"}
    service, doctor = broker.service(**tenant), broker.caller(*DOCTOR, **tenant)
    engineer = broker.caller(Role.ENGINEER, **tenant)
    both = {"type": ["Device", "HumanState"], "heartRate": prop(PRIVATE)}
    public = {"type": "Device", "speed": prop(1)}
    replaced, upserted = "urn:ngsi-ld:Thing:demo:1", "urn:ngsi-ld:Thing:demo:2"
    for one in (replaced, upserted):
        assert service.post("/entities", json={"id": one, **both}).status_code == 201

    def require_private() -> None:
        for one in (replaced, upserted):
            assert engineer.get(f"/temporal/entities/{one}").status_code == 404
            assert PRIVATE in doctor.get(f"/temporal/entities/{one}").text
            changed = engineer.post(f"/temporal/entities/{one}/attrs", json={"speed": [prop(2)]})
            assert changed.status_code in {403, 404}, changed.text
        for read in (f"/temporal/entities?{EVER}&type=Device", f"/temporal/entities?{EVER}&attrs=heartRate"):
            assert PRIVATE not in engineer.get(read).text, read

    assert service.put(f"/entities/{replaced}", json={"id": replaced, **public}).status_code == 204
    upsert(service, [{"id": upserted, **public}])
    assert service.patch(f"/entities/{replaced}/attrs", json={"speed": prop(3)}).status_code == 204
    assert engineer.get(f"/entities/{replaced}").json()["speed"]["value"] == 3, "its present state is public"
    require_private()
    broker.cell.restart("context_broker")
    require_private()
    for one in (replaced, upserted):
        assert service.delete(f"/entities/{one}").status_code == 204
    require_private()
    assert doctor.get(f"/temporal/entities/{replaced}").json()["type"] == "Device"
    past = {"id": "urn:ngsi-ld:Thing:demo:3", "type": "HumanState", "heartRate": [prop(PRIVATE)]}
    assert service.post("/entities", json={"id": past["id"], **public}).status_code == 201
    refused = doctor.post("/temporal/entities", json=past)
    assert (refused.status_code, "add the type to it first" in refused.text) == (400, True)
    assert service.post("/entities", json={"id": replaced, **public}).status_code == 201
    require_private()


@pytest.mark.nightly
def test_the_result_of_a_snapshot_is_for_those_who_may_see_what_its_creator_may(
    broker: SecuredBroker, sinks: Iterator[Subscriber]
) -> None:
    tenant = {"NGSILD-Tenant": "snapshots"}
    service, doctor = broker.service(**tenant), broker.caller(*DOCTOR, **tenant)
    engineer, colleague = broker.caller(Role.ENGINEER, **tenant), broker.caller(Role.ENGINEER, **tenant)
    upsert(service, private_entities())
    query = {"type": "Query", "entities": [{"type": "HumanState"}], "q": "strain>50"}

    def created(by: httpx.Client, name: str) -> str:
        made = {"id": f"urn:ngsi-ld:Snapshot:{name}", "type": "Snapshot", "snapshotQueries": [query]}
        assert by.post("/snapshots", json=made).status_code == 201
        at = f"/snapshots/{made['id']}"
        wait_for(lambda: by.get(at).json()["snapshotStatus"] != "preparing")
        return at

    private, public = created(doctor, "doctor"), created(engineer, "engineer")
    of_service = created(service, "service")
    assert doctor.get(private).json()["snapshotStatus"] == "success"
    assert "owner" not in doctor.get(private).json()
    thief = next(sinks)
    for at in (private, of_service):
        for method, path, body in (
            ("GET", at, None),
            ("PATCH", at, {"endpoint": f"{thief.url}/n"}),
            ("POST", f"{at}/clone", {"type": "Snapshot"}),
            ("DELETE", at, None),
        ):
            refused = engineer.request(method, path, json=body)
            assert (refused.status_code, refused.json()["permission"]) == (403, "readHealthData"), path
    assert engineer.delete("/snapshots", params={"q": 'snapshotStatus=="success"'}).status_code == 204
    assert doctor.get(private).status_code == doctor.get(of_service).status_code == 200
    assert colleague.get(public).json()["snapshotStatus"] == "empty"
    assert doctor.get(public).status_code == 200
    broker.cell.restart("context_broker")
    assert engineer.get(private).status_code == 403
    assert doctor.delete(private).status_code == 204
    assert not thief.received
