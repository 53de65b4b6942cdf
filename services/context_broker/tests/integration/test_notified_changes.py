"""What subscriptions notify: triggers, changes, places, scopes, periods, headers of requests."""

from collections.abc import Callable
from typing import Any

import httpx
import pytest

from services.context_broker.tests.integration.acts import Eventually, create, patch, subscribe

HERE = {"type": "Point", "coordinates": [8.0, 40.0]}
FAR = {"type": "Point", "coordinates": [9.0, 41.0]}


@pytest.mark.nightly
def test_the_deletion_of_an_entity_is_notified_on_request(
    http: httpx.Client, subscriber: Any, eventually: Eventually
) -> None:
    subscribe(http, "End", subscriber.url, notificationTrigger=["entityDeleted"])
    entity = create(http, "End", a=1)
    patch(http, entity, a=2)
    assert http.delete(f"/entities/{entity}").status_code == 204
    (received,) = eventually(subscriber.entities)
    assert received.pop("deletedAt").endswith("Z")
    assert received == {"id": entity, "type": "End"}


def test_previous_values_are_notified_on_request(
    http: httpx.Client, subscriber: Any, eventually: Eventually
) -> None:
    kinds = ["attributeUpdated", "attributeDeleted"]
    view = {"showChanges": True, "format": "concise"}
    subscribe(http, "Before", subscriber.url, notificationTrigger=kinds, notification=view)
    entity = create(http, "Before", a=1, b=1)
    patch(http, entity, a=2)
    assert http.delete(f"/entities/{entity}/attrs/b").status_code == 204
    eventually(lambda: len(subscriber.received) == 2)
    received = subscriber.entities()
    assert received[0]["a"] == {"value": 2, "previousValue": 1}
    assert received[1]["b"] == {"value": "urn:ngsi-ld:null", "previousValue": 1}
    assert received[1]["a"] == 2


def test_geometries_and_scopes_select_notified_entities(
    http: httpx.Client, subscriber: Any, eventually: Eventually
) -> None:
    near = {"georel": "near;maxDistance==2000", "geometry": "Point", "coordinates": [8, 40]}
    subscribe(http, "Place", subscriber.url, geoQ=near)
    subscribe(http, "Scope", subscriber.url, scopeQ="/hall/#")
    create(http, "Place", "far", location=FAR)
    here = create(http, "Place", "here", location=HERE)
    create(http, "Scope", "out", scope="/yard", a=1)
    inside = create(http, "Scope", "in", scope=["/hall/a1"], a=1)
    eventually(lambda: len(subscriber.received) >= 2)
    assert {one["id"] for one in subscriber.entities()} == {here, inside}


def test_types_may_be_combined(http: httpx.Client, subscriber: Any, eventually: Eventually) -> None:
    subscribe(http, "Mixed", subscriber.url, entities=[{"type": "(Lamp;Signal),Siren"}])
    create(http, "Lamp", a=1)
    siren = create(http, "Siren", a=1)
    both = {"id": "urn:ngsi-ld:Lamp:demo:both", "type": ["Lamp", "Signal"], "a": 1}
    assert http.post("/entities", json=both).status_code == 201
    eventually(lambda: len(subscriber.received) >= 2)
    assert {one["id"] for one in subscriber.entities()} == {siren, both["id"]}


def test_all_types_may_be_meant(http: httpx.Client, subscriber: Any, eventually: Eventually) -> None:
    every = subscribe(http, "Every", subscriber.url, entities=[{"type": "*", "idPattern": "demo:every$"}])
    entity = create(http, "Whatever", "every", a=1)
    eventually(lambda: [one["id"] for one in subscriber.entities()] == [entity])
    assert http.delete(f"/subscriptions/{every}").status_code == 204


def test_members_languages_and_instances_are_chosen(
    http: httpx.Client, subscriber: Any, eventually: Eventually
) -> None:
    subscribe(
        http,
        "Choice",
        subscriber.url,
        lang="fr",
        datasetId="@none",
        notification={"pick": ["id", "word", "n"], "format": "keyValues"},
    )
    create(
        http,
        "Choice",
        word={"type": "LanguageProperty", "languageMap": {"fr": "pince", "en": "gripper"}},
        n=[{"type": "Property", "value": 1}, {"type": "Property", "value": 2, "datasetId": "urn:x:d"}],
        other=3,
    )
    (received,) = eventually(subscriber.entities)
    assert received == {"id": "urn:ngsi-ld:Choice:demo:1", "word": "pince", "n": 1}


def test_geometries_are_returned_as_geojson(
    http: httpx.Client, subscriber: Any, eventually: Eventually
) -> None:
    endpoint = {"accept": "application/geo+json", "receiverInfo": [{"key": "Prefer", "value": "body=json"}]}
    subscribe(http, "Geo", subscriber.url, notification={"endpoint": endpoint, "format": "keyValues"})
    entity = create(http, "Geo", location=HERE, a=1)
    eventually(lambda: subscriber.received)
    feature = {
        "id": entity,
        "type": "Feature",
        "geometry": HERE,
        "properties": {"type": "Geo", "location": HERE, "a": 1},
    }
    assert subscriber.received[0]["data"] == {"type": "FeatureCollection", "features": [feature]}
    assert subscriber.headers[0]["content-type"] == "application/geo+json"


def test_linked_entities_are_included(
    http: httpx.Client, subscriber: Any, new_subscriber: Callable[..., Any], eventually: Eventually
) -> None:
    inside = new_subscriber()
    subscribe(http, "Flat", subscriber.url, entities=[{"type": "Trip"}], notification={"join": "flat"})
    view = {"join": "inline", "joinLevel": 2, "format": "keyValues"}
    subscribe(http, "Inline", inside.url, entities=[{"type": "Trip"}], notification=view)
    city = create(http, "City", title="Paris")
    trip = create(http, "Trip", goesTo={"type": "Relationship", "object": city})
    eventually(lambda: subscriber.received and inside.received)
    assert [one["id"] for one in subscriber.received[0]["data"]] == [trip, city]
    assert inside.entities()[0]["goesTo"] == {"id": city, "type": "City", "title": "Paris"}


def test_linked_entities_select_notifications_too(
    http: httpx.Client, subscriber: Any, eventually: Eventually
) -> None:
    subscribe(http, "Linked", subscriber.url, entities=[{"type": "Ride"}], q='goesTo{title}=="Rome"')
    rome = create(http, "City", "rome", title="Rome")
    oslo = create(http, "City", "oslo", title="Oslo")
    create(http, "Ride", "north", goesTo={"type": "Relationship", "object": oslo})
    south = create(http, "Ride", "south", goesTo={"type": "Relationship", "object": rome})
    (received,) = eventually(subscriber.entities)
    assert received["id"] == south


def test_headers_of_the_request_are_forwarded_on_request(
    http: httpx.Client, subscriber: Any, eventually: Eventually
) -> None:
    wanted = [
        {"key": "Authorization", "value": "urn:ngsi-ld:request"},
        {"key": "X-Absent", "value": "urn:ngsi-ld:request"},
        {"key": "X-Cell", "value": "4"},
    ]
    subscribe(http, "Pass", subscriber.url, notification={"endpoint": {"receiverInfo": wanted}})
    entity = {"id": "urn:ngsi-ld:Pass:demo:1", "type": "Pass", "a": 1}
    http.post("/entities", json=entity, headers={"Authorization": "Bearer one"})
    http.patch(f"/entities/{entity['id']}/attrs", json={"a": 2})
    eventually(lambda: len(subscriber.received) == 2)
    assert subscriber.headers[0]["authorization"] == "Bearer one"
    assert subscriber.headers[0]["x-cell"] == "4"
    assert "x-absent" not in subscriber.headers[0]
    assert "authorization" not in subscriber.headers[1]


def test_a_periodic_subscriber_receives_all_entities_changed_or_not(
    http: httpx.Client, subscriber: Any, eventually: Eventually
) -> None:
    every_second = subscribe(http, "Round", subscriber.url, timeInterval=1, q="n>0")
    entities = [create(http, "Round", str(number), n=number) for number in range(3)]
    eventually(lambda: len(subscriber.received) >= 2)
    for one in subscriber.received:
        assert [entity["id"] for entity in one["data"]] == entities[1:]
    assert http.patch(f"/subscriptions/{every_second}", json={"isActive": False}).status_code == 204
    path = f"/subscriptions/{every_second}"
    eventually(lambda: http.get(path).json()["notification"].get("timesSent", 0) >= 2)


def test_a_throttled_subscriber_is_notified_of_expiries_too(
    http: httpx.Client, subscriber: Any, eventually: Eventually
) -> None:
    kinds = ["entityCreated", "attributeUpdated", "entityDeleted"]
    subscribe(http, "ThrottledEnd", subscriber.url, throttling=0.5, notificationTrigger=kinds)
    entity = create(http, "ThrottledEnd", a=0)
    eventually(lambda: subscriber.received)
    for number in range(5):
        patch(http, entity, a=number)
    assert http.delete(f"/entities/{entity}").status_code == 204
    eventually(lambda: "deletedAt" in subscriber.entities()[-1])
    assert len(subscriber.received) == 2


def test_the_context_of_notifications_may_differ_from_that_of_the_names(
    http: httpx.Client, subscriber: Any, eventually: Eventually
) -> None:
    context = "https://w3id.org/handover/context.jsonld"
    core = "https://uri.etsi.org/ngsi-ld/v1/ngsi-ld-core-context-v1.8.jsonld"
    link = {"Link": f'<{context}>; rel="http://www.w3.org/ns/json-ld#context"; type="application/ld+json"'}
    body = {
        "id": "urn:ngsi-ld:Subscription:demo:names",
        "type": "Subscription",
        "entities": [{"type": "Device"}],
        "q": 'deviceState=="busy"',
        "jsonldContext": core,
        "notification": {"endpoint": {"uri": subscriber.url}, "pick": ["id", "deviceState"]},
    }
    assert http.post("/subscriptions", json=body, headers=link).status_code == 201
    for state in ("idle", "busy"):
        entity = {"id": f"urn:ngsi-ld:Device:demo:{state}", "type": "Device", "deviceState": state}
        assert http.post("/entities", json=entity, headers=link).status_code == 201
    (received,) = eventually(subscriber.entities)
    assert received["id"] == "urn:ngsi-ld:Device:demo:busy"
    assert core in subscriber.headers[0]["link"]
    kept = http.get(f"/subscriptions/{body['id']}", headers=link).json()
    assert kept["jsonldContext"] == core
    assert kept["entities"] == [{"type": "Device"}]
    assert "namesIn" not in kept
