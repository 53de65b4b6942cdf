"""Entities for readers of earlier versions (clause 4.3.6.8)."""

from typing import Any

from handover_broker.model.representation.conformance import OURS, conformed

ENTITY: dict[str, Any] = {
    "id": "urn:ngsi-ld:Store:1",
    "type": ["Store", "Shop"],
    "scope": "/a",
    "expiresAt": "2030-01-01T00:00:00Z",
    "name": {"type": "LanguageProperty", "languageMap": {"en": "Corner"}},
    "category": {"type": "VocabProperty", "vocab": "food"},
    "raw": {"type": "JsonProperty", "json": {"vocab": 1}},
    "stock": {"type": "ListProperty", "valueList": [1, 2]},
    "owners": {"type": "ListRelationship", "objectList": [{"object": "urn:x:1"}]},
    "place": {
        "type": "Relationship",
        "object": "urn:x:2",
        "objectType": "City",
        "since": {"type": "Property", "value": 1, "valueType": "Int", "unitCode": "ANN"},
    },
    "speed": [
        {"type": "Property", "value": 1, "datasetId": "urn:d:1"},
        {"type": "Property", "value": {"vocab": "a value may hold anything"}},
    ],
}


def test_our_own_version_changes_nothing() -> None:
    assert conformed(ENTITY, OURS) is ENTITY
    assert conformed([ENTITY], (2, 0)) == [ENTITY]


def test_later_kinds_are_converted_to_earlier_ones() -> None:
    shown = conformed(ENTITY, (1, 6))
    assert shown["category"] == {"type": "Property", "value": "food"}
    assert shown["raw"] == {"type": "Property", "value": {"vocab": 1}}
    assert shown["stock"] == {"type": "Property", "value": [1, 2]}
    assert shown["owners"] == {"type": "Relationship", "object": ["urn:x:1"]}
    assert shown["name"] == ENTITY["name"]
    assert "expiresAt" not in shown
    assert "objectType" not in shown["place"]
    assert shown["place"]["since"] == {"type": "Property", "value": 1, "unitCode": "ANN"}
    assert shown["speed"] == ENTITY["speed"]
    assert shown["scope"] == "/a"
    assert shown["type"] == ["Store", "Shop"]


def test_the_first_version_has_one_type_and_one_instance_of_each() -> None:
    shown = conformed(ENTITY, (1, 0))
    assert shown["type"] == "Store"
    assert shown["speed"] == {"type": "Property", "value": {"vocab": "a value may hold anything"}}
    assert shown["name"] == {"type": "Property", "value": {"en": "Corner"}}
    assert "scope" not in shown
    assert "unitCode" not in shown["place"]["since"]


def test_concise_attributes_conform_too_and_simplified_ones_stay() -> None:
    concise = {"id": "urn:x:1", "type": "T", "a": {"vocab": "food"}, "b": 1}
    assert conformed(concise, (1, 6)) == {**concise, "a": {"value": "food"}}
    assert conformed(concise, (1, 6), simplified=True) is concise


def test_notifications_and_lists_conform_and_other_documents_stay() -> None:
    notification = {"id": "urn:n:1", "type": "Notification", "data": [ENTITY]}
    assert conformed(notification, (1, 6))["data"][0] == conformed(ENTITY, (1, 6))
    assert conformed([ENTITY, {"x": 1}], (1, 6)) == [conformed(ENTITY, (1, 6)), {"x": 1}]
    for other in (None, 1, "x", {"x": 1}, [1, None]):
        assert conformed(other, (1, 0)) == other


def test_features_conform_as_their_entities_do() -> None:
    properties = {name: said for name, said in ENTITY.items() if name != "id"}
    feature = {"id": ENTITY["id"], "type": "Feature", "geometry": None, "properties": properties}
    expected = {name: said for name, said in conformed(ENTITY, (1, 6)).items() if name != "id"}
    assert conformed(feature, (1, 6)) == {**feature, "properties": expected}
    many = {"type": "FeatureCollection", "features": [feature]}
    assert conformed(many, (1, 6))["features"] == [conformed(feature, (1, 6))]
