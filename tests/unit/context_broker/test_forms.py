"""Intake and rendering: what was sent comes back, in each form, and all forms tell the same."""

from typing import Any

import orjson
from hypothesis import given
from hypothesis import strategies as st

from datamodels.contexts import HANDOVER_URL, TermMap
from services.context_broker.changes import created, merged
from services.context_broker.entity import Entity
from services.context_broker.intake import read_change, read_entity
from services.context_broker.rendering import Form, View, render

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
POINTS = st.fixed_dictionaries(
    {"type": st.just("Point"), "coordinates": st.lists(st.integers(-90, 90), min_size=2, max_size=3)}
)
METADATA = st.fixed_dictionaries(
    {}, optional={"observedAt": st.just("2026-01-01T12:00:00Z"), "unitCode": st.just("MTR")}
)
KINDS = st.one_of(
    st.fixed_dictionaries({"type": st.just("Property"), "value": VALUES | POINTS}),
    st.fixed_dictionaries({"type": st.just("Relationship"), "object": URIS}),
    st.fixed_dictionaries({"type": st.just("GeoProperty"), "value": POINTS}),
    st.fixed_dictionaries(
        {
            "type": st.just("LanguageProperty"),
            "languageMap": st.just({"en": "part", "fi": ["osa", "kappale"]}),
        }
    ),
    st.fixed_dictionaries({"type": st.just("JsonProperty"), "json": VALUES}),
    st.fixed_dictionaries(
        {"type": st.just("VocabProperty"), "vocab": st.just("calm") | st.just(["calm", "keen"])}
    ),
    st.fixed_dictionaries({"type": st.just("ListProperty"), "valueList": st.lists(VALUES, max_size=3)}),
)


@st.composite
def attributes(draw: st.DrawFn, depth: int = 1) -> Any:
    attribute = draw(KINDS) | draw(METADATA)
    if depth and draw(st.booleans()):
        attribute["accuracy"] = draw(attributes(depth - 1))
    if depth and draw(st.integers(0, 4)) == 0:
        return [attribute, draw(KINDS) | {"datasetId": "urn:x:second"}]
    return attribute


ENTITIES = st.dictionaries(NAMES, attributes(), max_size=4).map(
    lambda given: {"id": "urn:ngsi-ld:Task:demo:1", "type": "Task", **given}
)


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


@given(ENTITIES)
def test_key_values_says_what_normalized_says(document: dict[str, Any]) -> None:
    simple = render(kept(document), TERMS, View(Form.KEY_VALUES))
    for name, attribute in document.items():
        if isinstance(attribute, dict) and attribute["type"] in {"Property", "GeoProperty"}:
            assert simple[name] == attribute["value"]
        elif isinstance(attribute, dict) and attribute["type"] == "Relationship":
            assert simple[name] == attribute["object"]
    assert set(simple) == set(document)


@given(ENTITIES)
def test_what_the_journal_keeps_is_what_it_was(document: dict[str, Any]) -> None:
    entity = kept(document)
    again = Entity.restored(entity.stored())
    assert (again.id, again.types, again.attributes, again.seq) == (
        entity.id,
        entity.types,
        entity.attributes,
        entity.seq,
    )


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
