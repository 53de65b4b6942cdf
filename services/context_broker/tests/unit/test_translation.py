"""Dialects of sources: names of another @context, older versions, and the Via header."""

from typing import Any

import pytest

from handover_datamodels.contexts import TermMap, resolve
from handover_federation.distribution.forwarding.translation import older, translated
from handover_federation.distribution.forwarding.via import append_to_via, chain

CORE = TermMap(None, resolve)
DEFAULT = "https://uri.etsi.org/ngsi-ld/default-context/"
OTHER = TermMap(
    {
        "Auto": DEFAULT + "Car",
        "tempo": DEFAULT + "speed",
        "quelle": DEFAULT + "source",
        "rot": DEFAULT + "red",
    },
    resolve,
)
ENTITY: dict[str, Any] = {
    "id": "urn:x:1",
    "type": "Car",
    "scope": "/a",
    "speed": {
        "type": "Property",
        "value": {"speed": 1},
        "observedAt": "2026-01-01T00:00:00Z",
        "source": {"type": "Relationship", "object": "urn:x:2", "objectType": "Car"},
    },
    "colour": {"type": "VocabProperty", "vocab": ["red", "blue"]},
    "many": [
        {"type": "Property", "value": 1, "datasetId": "urn:d:1"},
        {"type": "Property", "value": 2, "datasetId": "urn:d:2", "source": {"value": "x"}},
    ],
}


def test_translation_changes_names_but_not_values() -> None:
    there = translated(ENTITY, CORE, OTHER)
    assert there["type"] == "Auto"
    assert there["tempo"]["value"] == {"speed": 1}
    assert there["tempo"]["quelle"] == {"type": "Relationship", "object": "urn:x:2", "objectType": "Auto"}
    assert there["colour"]["vocab"] == ["rot", "blue"]
    assert there["many"][1]["quelle"] == {"value": "x"}


def test_translation_is_reversible() -> None:
    assert translated(translated(ENTITY, CORE, OTHER), OTHER, CORE) == ENTITY


@pytest.mark.parametrize(
    ("document", "expected"),
    [
        ({"id": "urn:x:1", "type": "T", "a": {"type": "JsonProperty", "json": {}}}, "entity"),
        ({"a": {"type": "JsonProperty", "json": {}}}, "part"),
        ({"type": "JsonProperty", "json": {}}, "attribute"),
    ],
)
def test_an_older_source_receives_attribute_types_of_its_version(
    document: dict[str, Any], expected: str
) -> None:
    returned = older(document, "1.6")
    attribute = returned if expected == "attribute" else returned["a"]
    assert attribute == {"type": "Property", "value": {}}
    assert returned.keys() == document.keys() or expected == "attribute"
    assert older([document], "v1.6") == [returned]
    assert older(document, "1.9") is document
    assert older(document, "newest") is document


@pytest.mark.parametrize(
    ("via", "names"),
    [
        (b"1.1 a, 1.0 b (a comment, with a comma), HTTP/1.1 c", ("a", "b", "c")),
        (b"", ()),
        (b", ,  1.1, ;;; (x)", ()),
    ],
)
def test_any_via_header_is_parsed(via: bytes, names: tuple[str, ...]) -> None:
    assert chain(via) == names


def test_a_broker_appends_itself_to_the_via_header() -> None:
    assert append_to_via(b"", "me") == "1.1 me"
    assert append_to_via(b"1.1 a", "me") == "1.1 a, 1.1 me"
