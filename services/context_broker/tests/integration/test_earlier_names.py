"""Queries by the names that attributes had before find the entities that have the present ones."""

from collections.abc import Iterator
from typing import Any

import httpx
import pytest

from handover_datamodels.contexts import HANDOVER_URL
from services.context_broker.tests.integration.conftest import Subscriber
from tests.kit.waiting import wait_for

TYPE = "PhysiologicalSession"
CORE = "https://uri.etsi.org/ngsi-ld/v1/ngsi-ld-core-context-v1.6.jsonld"
OLD_IRI = "https://uri.etsi.org/ngsi-ld/default-context/start"
LINK = {"Link": f'<{HANDOVER_URL}>; rel="http://www.w3.org/ns/json-ld#context"'}
FIRST, SECOND = (f"urn:ngsi-ld:{TYPE}:demo:{number}" for number in (1, 2))


def date_time(day: int) -> dict[str, Any]:
    return {"type": "Property", "value": {"@type": "DateTime", "@value": f"2026-03-0{day}T09:00:00Z"}}


@pytest.fixture(scope="module", autouse=True)
def sessions(shared_broker: Any) -> None:
    """Two sessions with the present names, and an entity of another type with an old one."""
    with shared_broker.client() as client:
        entities = [
            {"id": FIRST, "type": TYPE, "startedAt": date_time(2), "endedAt": date_time(8)},
            {"id": SECOND, "type": TYPE, "startedAt": date_time(3)},
            {"id": "urn:ngsi-ld:Shift:demo:1", "type": "Shift", "start": date_time(1)},
        ]
        answer = client.post("/entityOperations/create", json=entities, headers=LINK)
        assert answer.status_code == 201, answer.text


@pytest.fixture
def ours(http: httpx.Client) -> Iterator[httpx.Client]:
    """A client that sends our @context."""
    http.headers.update(LINK)
    return http


def ids(answer: httpx.Response) -> list[str]:
    assert answer.status_code == 200, answer.text
    return [entity["id"] for entity in answer.json()]


@pytest.mark.parametrize(
    ("parameters", "expected"),
    [
        ({"attrs": "start"}, [FIRST, SECOND]),
        ({"attrs": "end"}, [FIRST]),
        ({"q": "start>2026-03-02T12:00:00Z"}, [SECOND]),
        ({"q": "start>2026-03-02T12:00:00Z|end"}, [FIRST, SECOND]),
        ({"orderBy": "start;desc"}, [SECOND, FIRST]),
        ({"pick": "id,start", "orderBy": "startedAt"}, [FIRST, SECOND]),
        ({"q": "startedAt>2026-03-02T12:00:00Z"}, [SECOND]),
    ],
)
@pytest.mark.parametrize("as_document", [False, True])
def test_a_query_by_an_old_name_finds_the_sessions(
    ours: httpx.Client, parameters: dict[str, str], expected: list[str], as_document: bool
) -> None:
    if not as_document:
        answer = ours.get("/entities", params={"type": TYPE, **parameters})
    else:
        document: dict[str, Any] = {"type": "Query", "entities": [{"type": TYPE}]}
        for name, value in parameters.items():
            if name == "orderBy":
                document["ordering"] = {"orderBy": [value]}
            else:
                document[name] = value if name == "q" else value.split(",")
        answer = ours.post("/entityOperations/query", json=document)
    assert ids(answer) == expected
    named = {name for entity in answer.json() for name in entity}
    assert named <= {"id", "type", "startedAt", "endedAt"}


def test_the_attributes_are_limited_to_those_of_an_old_name(ours: httpx.Client) -> None:
    (entity,) = ours.get("/entities", params={"type": TYPE, "attrs": "end"}).json()
    assert entity.keys() == {"id", "type", "endedAt"}
    one = ours.get(f"/entities/{FIRST}", params={"attrs": "start"}).json()
    assert one.keys() == {"id", "type", "startedAt"}
    first, _ = ours.get("/entities", params={"type": TYPE, "omit": "start"}).json()
    assert first.keys() == {"id", "type", "endedAt"}


@pytest.mark.parametrize("link", [LINK, {"Link": LINK["Link"].replace(HANDOVER_URL, CORE)}, {}])
def test_the_old_names_need_no_context_of_ours(http: httpx.Client, link: dict[str, str]) -> None:
    answer = http.get("/entities", params={"type": TYPE, "attrs": "start"}, headers=link)
    assert ids(answer) == [FIRST, SECOND]


def test_the_history_is_found_by_an_old_name(ours: httpx.Client) -> None:
    answer = ours.get(
        "/temporal/entities",
        params={
            "type": TYPE,
            "attrs": "start",
            "timerel": "after",
            "timeAt": "1970-01-01T00:00:00Z",
            "timeproperty": "modifiedAt",
        },
    )
    assert ids(answer) == [FIRST, SECOND]
    assert all("startedAt" in entity for entity in answer.json())


def test_an_attribute_of_another_type_keeps_the_name(ours: httpx.Client) -> None:
    (shift,) = ours.get("/entities", params={"type": "Shift", "attrs": "start"}).json()
    assert shift["start"] == date_time(1)
    assert ids(ours.get("/entities", params={"attrs": "start"})) == ["urn:ngsi-ld:Shift:demo:1"]


def test_an_iri_means_itself(ours: httpx.Client) -> None:
    assert ids(ours.get("/entities", params={"type": TYPE, "attrs": OLD_IRI})) == []


def test_what_is_written_keeps_the_name_that_it_was_written_with(ours: httpx.Client) -> None:
    identifier = f"urn:ngsi-ld:{TYPE}:demo:written"
    entity = {"id": identifier, "type": TYPE, "start": date_time(4)}
    try:
        assert ours.post("/entities", json=entity).status_code == 201
        assert ours.get(f"/entities/{identifier}").json()["start"] == date_time(4)
        assert ids(ours.get("/entities", params={"type": TYPE, "attrs": OLD_IRI})) == [identifier]
    finally:
        ours.delete(f"/entities/{identifier}")


def test_a_subscription_by_old_names_is_notified(ours: httpx.Client, subscriber: Subscriber) -> None:
    identifier = f"urn:ngsi-ld:{TYPE}:demo:watched"
    made = ours.post(
        "/subscriptions",
        json={
            "type": "Subscription",
            "entities": [{"type": TYPE}],
            "watchedAttributes": ["end"],
            "q": "start>2026-03-04T00:00:00Z",
            "notification": {"attributes": ["end"], "endpoint": {"uri": subscriber.url}},
        },
    )
    assert made.status_code == 201, made.text
    try:
        ours.post("/entities", json={"id": identifier, "type": TYPE, "startedAt": date_time(5)})
        ours.post(f"/entities/{identifier}/attrs", json={"endedAt": date_time(6)})
        wait_for(lambda: subscriber.received, why="no notification came")
        (entity,) = subscriber.received[0]["data"]
        assert entity == {"id": identifier, "type": TYPE, "endedAt": date_time(6)}
    finally:
        ours.delete(f"/subscriptions/{made.headers['location'].rpartition('/')[2]}")
        ours.delete(f"/entities/{identifier}")
