"""The content digest shows whether an entity is as a component of ours has written it."""

from typing import Any

import pytest

from handover.files.content_digest import digest_of, is_ours, with_digest

ENTITY = {
    "id": "urn:ngsi-ld:TaskDefinition:demo:pick",
    "type": "TaskDefinition",
    "name": {"type": "Property", "value": "Pick"},
    "workParametersSchema": {"type": "Property", "value": {"properties": {"speed": {"maximum": 1.0}}}},
    "isPartOf": {"type": "Relationship", "object": "urn:ngsi-ld:ProcessDefinition:demo:p"},
}


def test_an_entity_with_its_digest_is_ours_however_a_broker_writes_it() -> None:
    signed = with_digest(ENTITY)
    assert is_ours(signed)
    as_stored = dict(reversed(signed.items()))
    as_stored["name"] = {"value": "Pick", "type": "Property", "createdAt": "2026-01-01T00:00:00Z"}
    schema = {"properties": {"speed": {"maximum": 1}}}
    as_stored["workParametersSchema"] = {"type": "Property", "value": schema}
    assert is_ours({**as_stored, "modifiedAt": "2026-01-01T00:00:00Z", "@context": "x"})
    assert digest_of(as_stored) == digest_of(ENTITY)


@pytest.mark.parametrize(
    "changes",
    [
        {"name": {"type": "Property", "value": "Place"}},
        {"gesture": {"type": "Property", "value": "Horns"}},
        {"id": "urn:ngsi-ld:TaskDefinition:demo:place"},
        {"isPartOf": {"type": "Relationship", "object": "urn:ngsi-ld:ProcessDefinition:demo:q"}},
        {"contentDigest": {"type": "Property", "value": "0" * 32}},
        {"contentDigest": 7},
    ],
)
def test_an_entity_that_others_have_changed_is_not_ours(changes: dict[str, Any]) -> None:
    assert not is_ours({**with_digest(ENTITY), **changes})
    assert not is_ours(ENTITY)
