"""Changes: the effect of each operation on an entity, and what of it is notified."""

import sys
from typing import Any

import pytest

from handover_broker.model import changes
from handover_broker.model.entity import NULL, Entity
from handover_broker.model.entity_parser import read_change, read_entity
from handover_broker.model.representation.rendering import Form, View, render
from handover_broker.model.validation import moment
from handover_datamodels.contexts import HANDOVER_URL, TermMap

TERMS = TermMap(HANDOVER_URL)
BEFORE, AFTER = "2026-01-01T00:00:00.000000Z", "2026-01-02T00:00:00.000000Z"


def entity(**attributes: Any) -> Entity:
    document = {"id": "urn:ngsi-ld:Task:demo:1", "type": "Task", **attributes}
    return changes.created(read_entity(document, TERMS), BEFORE, 7)


def change(**attributes: Any) -> Any:
    return read_change(attributes, TERMS)


def shown(one: Entity, form: Form = Form.KEY_VALUES) -> dict[str, Any]:
    document = render(one, TERMS, View(form))
    return {name: value for name, value in document.items() if name not in {"id", "type"}}


def names(iris: frozenset[str]) -> set[str]:
    return {TERMS.compact(iri) for iri in iris}


def test_a_change_makes_a_new_entity_and_leaves_the_old_one() -> None:
    before = entity(status="pending")
    outcome = changes.updated(before, change(status="assigned"), AFTER)
    assert shown(before) == {"status": "pending"}
    assert shown(outcome.entity) == {"status": "assigned"}
    assert outcome.entity.seq == before.seq
    assert (outcome.entity.created_at, outcome.entity.modified_at) == (BEFORE, AFTER)


def test_only_what_was_written_is_news() -> None:
    outcome = changes.updated(entity(status="a", note="b"), change(status="c", more=1), AFTER)
    assert names(outcome.touched) == {"status", "more"}
    assert shown(outcome.entity) == {"status": "c", "note": "b", "more": 1}


def test_a_change_that_changes_nothing_makes_no_new_entity() -> None:
    before = entity(status="a")
    assert changes.updated(before, change()._replace(scopes=("/a",)), AFTER).entity is before
    assert changes.appended(before, change(status=1), AFTER, overwrite=False).entity is before


def test_deleted_attributes_are_not_part_of_an_expiry() -> None:
    outcome = changes.merged(entity(status="a", note="b"), change(note="urn:ngsi-ld:null"), AFTER)
    assert shown(outcome.entity) == {"status": "a"}
    assert outcome.touched == frozenset()
    assert changes.without(entity(note=1), TERMS.expand("note"), None, AFTER).touched == frozenset()


def test_an_attribute_keeps_its_creation_time_when_it_is_overwritten() -> None:
    outcome = changes.appended(entity(status="a"), change(status="b", note="c"), AFTER)
    written = render(outcome.entity, TERMS, View(sys_attrs=True))
    assert (written["status"]["createdAt"], written["status"]["modifiedAt"]) == (BEFORE, AFTER)
    assert written["note"]["createdAt"] == AFTER


def test_merging_keeps_metadata_and_attributes_of_attributes_that_are_not_named() -> None:
    before = entity(
        speed={"value": 1, "unitCode": "MTS", "accuracy": {"value": 0.1}, "source": {"value": "lidar"}}
    )
    part = change(speed={"value": 2, "accuracy": {"value": 0.2}, "source": "urn:ngsi-ld:null"})
    assert shown(changes.merged(before, part, AFTER).entity, Form.CONCISE) == {
        "speed": {"value": 2, "unitCode": "MTS", "accuracy": 0.2}
    }


def test_merging_another_kind_replaces_the_attribute() -> None:
    outcome = changes.merged(
        entity(isDefinedBy={"value": 1, "unitCode": "X"}), change(isDefinedBy={"object": "urn:x:1"}), AFTER
    )
    assert shown(outcome.entity, Form.CONCISE) == {"isDefinedBy": {"object": "urn:x:1"}}


def test_metadata_can_be_deleted_in_a_merge() -> None:
    before = entity(speed={"value": 1, "unitCode": "MTS"})
    outcome = changes.merged(before, change(speed={"value": 1, "unitCode": "urn:ngsi-ld:null"}), AFTER)
    assert shown(outcome.entity, Form.CONCISE) == {"speed": 1}


def test_instances_are_written_one_by_one() -> None:
    before = entity(speed=[{"type": "Property", "value": 1}, {"value": 2, "datasetId": "urn:x:gps"}])
    outcome = changes.updated(before, change(speed={"value": 3, "datasetId": "urn:x:gps"}), AFTER)
    assert shown(outcome.entity) == {"speed": {"dataset": {"@none": 1, "urn:x:gps": 3}}}
    name = TERMS.expand("speed")
    assert shown(changes.without(outcome.entity, name, "urn:x:gps", AFTER).entity) == {"speed": 1}
    assert shown(changes.without(outcome.entity, name, None, AFTER, every=True).entity) == {}
    with pytest.raises(KeyError):
        changes.without(outcome.entity, name, "urn:x:radar", AFTER)


def test_every_entity_has_its_earliest_expiry() -> None:
    early, late = "2100-01-01T00:00:00Z", "2200-01-01T00:00:00Z"
    before = entity(expiresAt=late, a={"value": 1, "expiresAt": early}, b=1)
    assert before.ends_at == early
    assert changes.updated(before, change(b=2), AFTER).entity.ends_at == early
    assert changes.updated(before, change(a=2), AFTER).entity.ends_at == late
    assert changes.merged(before, change(expiresAt="urn:ngsi-ld:null", a=NULL), AFTER).entity.ends_at is None
    assert (
        changes.updated(entity(a=1), change(a={"value": 1, "expiresAt": late}), AFTER).entity.ends_at == late
    )
    assert changes.replaced(before, change(b=1), AFTER).entity.ends_at is None
    outlived = changes.outlived(before, moment(early) or 0.0, AFTER).entity
    assert shown(outlived) == {"b": 1}
    assert (outlived.ends_at, outlived.modified_at) == (late, AFTER)


def test_an_instance_that_ends_leaves_the_others() -> None:
    early = "2100-01-01T00:00:00Z"
    ending = {"value": 2, "datasetId": "urn:x:gps", "expiresAt": early}
    outcome = changes.outlived(
        entity(a=[{"type": "Property", "value": 1}, ending], b=1), moment(early) or 0.0, AFTER
    )
    assert shown(outcome.entity) == {"a": 1, "b": 1}
    assert names(outcome.touched) == {"a"}


def test_pruning_takes_attributes_or_leaves_them() -> None:
    before = entity(a=1, b=2, c=3)
    names_of = frozenset({TERMS.expand("a"), TERMS.expand("absent")})
    assert shown(changes.pruned(before, names_of, AFTER, keep=False).entity) == {"b": 2, "c": 3}
    assert shown(changes.pruned(before, names_of, AFTER, keep=True).entity) == {"a": 1}
    assert changes.pruned(before, frozenset({"x:y"}), AFTER, keep=False).entity is before


def test_a_merge_with_observed_at_updates_existing_times() -> None:
    old, new, own = (f"2026-01-0{day}T00:00:00Z" for day in (1, 2, 3))
    before = entity(a={"value": 1, "observedAt": old}, b={"value": 1, "observedAt": old}, c=1)
    part = change(a=2, b={"value": 2, "observedAt": own}, c=2)
    result = shown(changes.merged(before, part, AFTER, new).entity, Form.CONCISE)
    assert result == {"a": {"value": 2, "observedAt": new}, "b": {"value": 2, "observedAt": own}, "c": 2}


def test_a_merge_leaves_no_null_in_what_is_new() -> None:
    result = shown(
        changes.merged(entity(), change(a={"value": {"x": NULL, "y": {"z": NULL, "w": 1}}}), AFTER).entity
    )
    assert result == {"a": {"y": {"w": 1}}}


def test_scopes_are_overwritten_added_or_left_alone() -> None:
    before = entity(scope="/A")
    assert changes.appended(before, change(scope="/B"), AFTER).entity.scopes == ("/B",)
    assert changes.appended(before, change(scope=["/B", "/A"]), AFTER, overwrite=False).entity.scopes == (
        "/A",
        "/B",
    )
    assert changes.updated(before, change(scope=["/B"]), AFTER).entity.scopes == ("/B",)
    without = entity()
    assert changes.updated(without, change(scope="/B"), AFTER).entity is without
    assert changes.replaced(before, change(a=1), AFTER).entity.scopes == ()


def test_a_text_too_long_for_a_time_is_not_remembered() -> None:
    text = "2026-01-01T00:00:00." + "0" * 100_000 + "Z"
    held = sys.getrefcount(text)
    assert moment(text) is None
    assert sys.getrefcount(text) == held
