"""Normalized, concise and keyValues are equivalent for every entity."""

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from datamodels.tests.unit.drawn_entities import anything, entities, names, others, uris, words
from handover_datamodels import TYPES, DataModelError, Form, read
from handover_datamodels.forms import kind_of, normalized_attribute, to_concise, to_key_values


def same(one: Any, other: Any) -> bool:
    """Return whether two JSON values are equal; 1, 1.0 and True are different."""
    return json.dumps(one, sort_keys=True) == json.dumps(other, sort_keys=True)


@given(entities())
def test_a_normalized_entity_comes_back_unchanged(entity: dict[str, Any]) -> None:
    assert same(read(entity).to_normalized(), entity)


@given(entities())
def test_the_concise_form_loses_nothing(entity: dict[str, Any]) -> None:
    concise = read(entity).to_concise()
    assert same(read(concise).to_normalized(), entity)
    assert len(json.dumps(concise)) <= len(json.dumps(entity))


@given(entities())
def test_bare_values_lose_only_what_stands_beside_the_values(entity: dict[str, Any]) -> None:
    bare = read(entity).to_key_values()
    again = read(bare, Form.KEY_VALUES)
    assert same(again.to_key_values(), bare)
    first = read(entity)
    for name in type(first).model_fields.keys() - {"source", "created_at", "modified_at"}:
        one, other = getattr(first, name), getattr(again, name)
        assert getattr(one, "value", one) == getattr(other, "value", other) or (
            [link.object for link in one] == [link.object for link in other]
            if isinstance(one, tuple)
            else one.object == other.object
        )


@given(st.sampled_from(sorted(TYPES)), st.dictionaries(words | names, anything), st.data())
def test_any_json_is_read_or_refused_with_a_reason(
    name: str, entity: dict[str, Any], data: st.DataObject
) -> None:
    known = [field.alias or field_name for field_name, field in TYPES[name].model_fields.items()]
    entity |= data.draw(st.dictionaries(st.sampled_from(known), anything | others()))
    entity |= {"type": name, "id": data.draw(uris | words)}
    for form in (None, Form.KEY_VALUES):
        written, refusal = read_or_refused(entity, form)
        if refusal is not None:
            assert f"is no valid {name}: " in refusal
        else:
            assert same(read(written).to_normalized(), written)


def test_a_keyword_of_json_ld_is_no_attribute_in_any_form() -> None:
    entity = {"type": "Asset", "id": "urn:x:y", "@vocab": {}}
    for form in (None, Form.KEY_VALUES):
        assert read(entity, form).to_normalized()["@vocab"] == {}


def read_or_refused(entity: dict[str, Any], form: Form | None) -> tuple[dict[str, Any], str | None]:
    """Return the entity as it is written again, or why it was refused; nothing else may happen."""
    try:
        return read(entity, form).to_normalized(), None
    except DataModelError as refused:
        return {}, str(refused)


def test_concise_leaves_out_what_goes_without_saying() -> None:
    assert to_concise(
        {
            "id": "urn:x:y",
            "type": "T",
            "plain": {"type": "Property", "value": 1},
            "timed": {"type": "Property", "value": 1, "observedAt": "2026-01-01T00:00:00Z"},
            "deep": {"type": "Property", "value": 1, "of": {"type": "Property", "value": 2}},
            "link": {"type": "Relationship", "object": "urn:x:z"},
            "place": {"type": "GeoProperty", "value": {"type": "Point", "coordinates": [1, 2]}},
            "data": {"type": "Property", "value": {"value": 1}},
            "shape": {"type": "Property", "value": {"type": "Point", "coordinates": [1, 2]}},
        }
    ) == {
        "id": "urn:x:y",
        "type": "T",
        "plain": 1,
        "timed": {"value": 1, "observedAt": "2026-01-01T00:00:00Z"},
        "deep": {"value": 1, "of": 2},
        "link": {"object": "urn:x:z"},
        "place": {"type": "Point", "coordinates": [1, 2]},
        "data": {"value": {"value": 1}},
        "shape": {"type": "Property", "value": {"type": "Point", "coordinates": [1, 2]}},
    }


def test_key_values_are_the_bare_values() -> None:
    assert to_key_values(
        {
            "id": "urn:x:y",
            "type": "T",
            "@context": ["https://example.com/c.jsonld"],
            "plain": {"type": "Property", "value": [1], "observedAt": "2026-01-01T00:00:00Z"},
            "link": {"type": "Relationship", "object": "urn:x:z"},
            "links": {"type": "Property", "value": [{"type": "Relationship", "object": "urn:x:z"}]},
            "said": {"type": "LanguageProperty", "languageMap": {"fi": "käsi"}},
        },
        link_lists=["links"],
    ) == {
        "id": "urn:x:y",
        "type": "T",
        "@context": ["https://example.com/c.jsonld"],
        "plain": [1],
        "link": "urn:x:z",
        "links": ["urn:x:z"],
        "said": {"languageMap": {"fi": "käsi"}},
    }


def test_bare_objects_with_a_member_value_need_an_explicit_form() -> None:
    bare = {
        "id": "urn:x:t",
        "type": "Task",
        "isDefinedBy": "urn:x:d",
        "status": "pending",
        "workParameters": {"value": 5},
    }
    reported = read(bare, Form.KEY_VALUES)
    assert reported.to_normalized()["workParameters"] == {"type": "Property", "value": {"value": 5}}
    with pytest.raises(DataModelError, match='attribute "workParameters"'):
        read(bare)


@pytest.mark.parametrize(
    ("written", "kind"),
    [
        ({"value": 1}, "Property"),
        ({"value": {"type": "Point", "coordinates": [1, 2]}}, "GeoProperty"),
        ({"object": "urn:x:y"}, "Relationship"),
        ({"languageMap": {"fi": "käsi"}}, "LanguageProperty"),
        ({"json": {"a": 1}}, "JsonProperty"),
        ({"vocab": "open"}, "VocabProperty"),
        ({"valueList": [1]}, "ListProperty"),
        ({"objectList": []}, "ListRelationship"),
        ({"type": "Point", "coordinates": [1, 2]}, "GeoProperty"),
        ({"type": "screw", "value": 3}, "Property"),
        (7, "Property"),
        ([], "Property"),
        (None, "Property"),
    ],
)
def test_a_shortened_attribute_is_known_by_what_it_has(written: Any, kind: str) -> None:
    assert kind_of(normalized_attribute(written)) == kind
