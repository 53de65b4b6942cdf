"""Parsing and rendering: entities are returned as sent, in each form, and all forms are equivalent."""

from dataclasses import asdict
from typing import Any

import orjson
from hypothesis import given
from hypothesis import strategies as st

from handover_broker.model.changes import created, merged
from handover_broker.model.completion import completed, normalized
from handover_broker.model.entity import VALUE_MEMBER, Entity
from handover_broker.model.entity_parser import read_change, read_entity
from handover_broker.model.representation.rendering import Form, View, render
from handover_datamodels.contexts import HANDOVER_URL, TermMap

TERMS = TermMap(HANDOVER_URL)
AT = "2026-01-01T00:00:00.000000Z"
NAMES = st.sampled_from(["status", "speed", "note", "workParameters", "ex:odd"])
URIS = st.sampled_from(["urn:ngsi-ld:Device:demo:1", "https://a.example/x#y"])
VALUES = st.recursive(
    st.one_of(st.booleans(), st.integers(-(2**53), 2**53), st.floats(-1e9, 1e9), st.text(max_size=8)),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(["a", "b", "value", "type", "object"]), inner, max_size=3)
    ),
    max_leaves=6,
).filter(lambda value: value != "urn:ngsi-ld:null")
PLACES = st.integers(-90, 90)
POSITIONS = st.tuples(PLACES, PLACES).map(list)
RINGS = st.lists(POSITIONS, min_size=3, max_size=3).map(lambda ring: [*ring, ring[0]])
POINTS = st.one_of(
    st.fixed_dictionaries({"type": st.just("Point"), "coordinates": POSITIONS}),
    st.fixed_dictionaries(
        {
            "type": st.just("MultiPolygon"),
            "coordinates": st.lists(st.lists(RINGS, min_size=1, max_size=1), min_size=1, max_size=2),
        }
    ),
    st.fixed_dictionaries(
        {
            "type": st.just("MultiLineString"),
            "coordinates": st.lists(st.lists(POSITIONS, min_size=2, max_size=2), min_size=1, max_size=2),
        }
    ),
)
OBSERVED = st.fixed_dictionaries({}, optional={"observedAt": st.just("2026-01-01T12:00:00Z")})
MEASURED = st.fixed_dictionaries(
    {},
    optional={
        "observedAt": st.just("2026-01-01T12:00:00Z"),
        "unitCode": st.just("MTR"),
        "valueType": st.just("Length"),
    },
)
LINKED = st.fixed_dictionaries({}, optional={"objectType": st.just("Device") | st.just(["Device", "Part"])})
WORDINGS = st.dictionaries(
    st.sampled_from(["en", "fi", "fr-CH", "@none"]),
    st.text(max_size=5) | st.lists(st.text(max_size=5), max_size=2),
    min_size=1,
    max_size=2,
)


def both(one: st.SearchStrategy[Any], other: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    return st.tuples(one, other).map(lambda parts: parts[0] | parts[1])


PROPERTIES = st.fixed_dictionaries({"type": st.just("Property"), "value": VALUES | POINTS})
LISTS = st.fixed_dictionaries({"type": st.just("ListProperty"), "valueList": st.lists(VALUES, max_size=3)})
LINKS = st.fixed_dictionaries(
    {"type": st.just("Relationship"), "object": URIS | st.lists(URIS, min_size=1, max_size=2)}
)
LINK_LISTS = st.fixed_dictionaries(
    {
        "type": st.just("ListRelationship"),
        "objectList": st.lists(st.fixed_dictionaries({"object": URIS}), max_size=2),
    }
)
KINDS = st.one_of(
    both(PROPERTIES | LISTS, MEASURED),
    both(LINKS | LINK_LISTS, both(LINKED, OBSERVED)),
    both(st.fixed_dictionaries({"type": st.just("GeoProperty"), "value": POINTS}), OBSERVED),
    both(st.fixed_dictionaries({"type": st.just("LanguageProperty"), "languageMap": WORDINGS}), OBSERVED),
    both(
        st.fixed_dictionaries(
            {
                "type": st.just("JsonProperty"),
                "json": st.dictionaries(st.sampled_from(["a", "@id"]), VALUES) | st.lists(VALUES, max_size=2),
            }
        ),
        OBSERVED,
    ),
    st.fixed_dictionaries(
        {"type": st.just("VocabProperty"), "vocab": st.just("calm") | st.just(["calm", "keen"])}
    ),
)


@st.composite
def attributes(draw: st.DrawFn, depth: int = 1) -> Any:
    attribute = draw(KINDS)
    if depth and draw(st.booleans()):
        attribute["accuracy"] = draw(attributes(depth - 1))
    if depth and draw(st.integers(0, 4)) == 0:
        return [attribute, draw(KINDS) | {"datasetId": "urn:x:second"}]
    return attribute


ENTITIES = st.dictionaries(NAMES, attributes(), max_size=4).map(
    lambda given: {"id": "urn:ngsi-ld:Task:demo:1", "type": "Task", **given}
)
SCOPES = st.sampled_from([{}, {"scope": "/Madrid/Gardens"}, {"scope": ["/A", "B/C_1"]}])


def kept(document: Any) -> Entity:
    return created(read_entity(document, TERMS), AT, 1)


@given(ENTITIES)
def test_normalized_comes_back_as_it_was(document: dict[str, Any]) -> None:
    assert render(kept(document), TERMS, View()) == document


@given(ENTITIES)
def test_concise_is_read_back_to_the_same_entity(document: dict[str, Any]) -> None:
    concise = render(kept(document), TERMS, View(Form.CONCISE))
    assert render(kept(concise), TERMS, View()) == document
    assert len(orjson.dumps(concise)) <= len(orjson.dumps(document))


@given(both(ENTITIES, SCOPES))
def test_scopes_are_returned_in_every_form(document: dict[str, Any]) -> None:
    for form in Form:
        assert render(kept(document), TERMS, View(form)).get("scope") == document.get("scope")


@given(ENTITIES)
def test_an_entity_merged_with_its_simplified_form_stays_what_it_was(document: dict[str, Any]) -> None:
    before = kept(document)
    simple = render(before, TERMS, View(Form.KEY_VALUES))
    after = merged(before, read_change(normalized(simple, before, TERMS), TERMS), AT).entity
    assert render(after, TERMS, View()) == document


@given(ENTITIES)
def test_an_entity_merged_with_any_part_of_itself_stays_what_it_was(document: dict[str, Any]) -> None:
    before = kept(document)
    for says in (frozenset[str](), frozenset(VALUE_MEMBER.values())):
        part = {
            name: {member: value for member, value in given.items() if member not in says}
            for name, given in document.items()
            if isinstance(given, dict)
        }
        after = merged(before, read_change(completed(part, before, TERMS), TERMS), AT).entity
        assert render(after, TERMS, View()) == document


@given(ENTITIES, ENTITIES)
def test_a_merge_is_the_same_when_it_comes_twice(first: dict[str, Any], second: dict[str, Any]) -> None:
    once = merged(kept(first), read_change(second, TERMS), AT).entity
    twice = merged(once, read_change(second, TERMS), AT).entity
    assert render(twice, TERMS, View()) == render(once, TERMS, View())


@given(ENTITIES)
def test_key_values_has_the_values_of_normalized(document: dict[str, Any]) -> None:
    simple = render(kept(document), TERMS, View(Form.KEY_VALUES))
    for name, attribute in document.items():
        if isinstance(attribute, dict) and attribute["type"] in {"Property", "GeoProperty"}:
            assert simple[name] == attribute["value"]
        elif isinstance(attribute, dict) and attribute["type"] == "Relationship":
            assert simple[name] == attribute["object"]
    assert set(simple) == set(document)


@given(ENTITIES)
def test_the_journal_returns_the_stored_entity(document: dict[str, Any]) -> None:
    entity = kept(document)
    again = Entity.restored(entity.stored())
    assert asdict(again) == asdict(entity)


@given(ENTITIES, ENTITIES)
def test_merging_leaves_the_entity_before_untouched_and_the_change_in_place(
    first: dict[str, Any], second: dict[str, Any]
) -> None:
    before = kept(first)
    as_stored = before.stored()
    after = merged(before, read_change(second, TERMS), AT).entity
    assert before.stored() == as_stored
    named = {TERMS.expand(name) for name in second if name not in {"id", "type"}}
    assert set(after.attributes) == set(before.attributes) | named


RESERVED = ["scope", "createdAt", "unitCode", "hasValue", "hasObject", "observedAt", "expiresAt", "datasetId"]
CORE_NAMES = st.sampled_from([f"https://uri.etsi.org/ngsi-ld/{name}" for name in RESERVED])


@given(CORE_NAMES, CORE_NAMES, st.sampled_from([Form.NORMALIZED, Form.CONCISE]), st.booleans())
def test_an_attribute_with_the_iri_of_a_member_hides_no_member(
    name: str, below: str, form: Form, sys_attrs: bool
) -> None:
    sent = {
        "id": "urn:x:1",
        "type": "Task",
        "scope": "/line",
        name: {"type": "Property", "value": 1, "unitCode": "MTR", below: {"type": "Property", "value": 2}},
    }
    entity = created(read_entity(sent, TERMS), AT, 1)
    again = created(read_entity(render(entity, TERMS, View(form, sys_attrs=sys_attrs)), TERMS), AT, 1)
    assert again.scopes == entity.scopes == ("/line",)
    assert again.attributes == entity.attributes
