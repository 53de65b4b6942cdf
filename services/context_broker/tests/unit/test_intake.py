"""Parsing of each kind of attribute, by the clauses of the standard, and errors."""

from datetime import UTC, datetime, timedelta
from typing import Any

import hypothesis
import pytest
from hypothesis import strategies as st

from handover.errors import Problem
from handover_broker.model.entity import NULL, is_deletion
from handover_broker.model.entity_parser import (
    Nulls,
    nulls_in,
    read_attribute,
    read_change,
    read_entity,
)
from handover_broker.model.validation import (
    _ASCII_URI,
    _URI,
    MICROS,
    is_time,
    require_time,
    written_time,
)
from handover_broker.temporal.history import micros_of
from handover_datamodels.contexts import HANDOVER_URL, TermMap

TERMS = TermMap(HANDOVER_URL)
POINT = {"type": "Point", "coordinates": [1, 2]}


def taken(given: Any, name: str = "a", nulls: Nulls = Nulls.NOWHERE) -> Any:
    """Return the stored form of an attribute: its instance, or a list of instances."""
    change = read_change({name: given}, TERMS, nulls)
    (instances,) = change.attributes.values()
    return instances[0] if len(instances) == 1 else instances


def refusal(document: dict[str, Any], nulls: Nulls = Nulls.NOWHERE) -> str:
    with pytest.raises(Problem) as raised:
        read_change(document, TERMS, nulls)
    assert raised.value.status == 400
    return str(raised.value.detail)


@pytest.mark.parametrize(
    ("given", "kept"),
    [
        (5, {"type": "Property", "value": 5}),
        (POINT, {"type": "GeoProperty", "value": POINT}),
        ({"value": POINT}, {"type": "GeoProperty", "value": POINT}),
        ({"type": "Property", "value": POINT}, {"type": "Property", "value": POINT}),
        ({"@type": "Property", "value": 5}, {"type": "Property", "value": 5}),
        (
            {"@type": "DateTime", "@value": "2026-01-01T00:00:00Z"},
            {"type": "Property", "value": {"@type": "DateTime", "@value": "2026-01-01T00:00:00Z"}},
        ),
        ({"object": "urn:x:1"}, {"type": "Relationship", "object": "urn:x:1"}),
        ({"object": ["urn:x:1", "urn:x:2"]}, {"type": "Relationship", "object": ["urn:x:1", "urn:x:2"]}),
        ({"languageMap": {"en": "a", "@none": ["b"]}}, None),
        ({"json": {"type": "any", "@context": 1}}, None),
        ({"json": [1, {"a": None}]}, None),
        ({"valueList": [1, [2]]}, None),
        (
            {"objectList": ["urn:x:1", {"object": "urn:x:2"}]},
            {"type": "ListRelationship", "objectList": [{"object": "urn:x:1"}, {"object": "urn:x:2"}]},
        ),
        ({"value": 1, "datasetId": "@none"}, {"type": "Property", "value": 1}),
        (
            {"value": 1, "createdAt": "x", "modifiedAt": "x", "instanceId": "x"},
            {"type": "Property", "value": 1},
        ),
        ({"type": "GeoProperty", "value": '{"type": "Point", "coordinates": [1, 2]}'}, None),
    ],
)
def test_every_kind_is_recognized_by_its_value_member(given: Any, kept: Any) -> None:
    instance = taken(given)
    if kept is not None:
        assert instance == kept
    else:
        assert {"type"} < set(instance)


def test_words_of_a_vocabulary_and_types_become_iris() -> None:
    default = "https://uri.etsi.org/ngsi-ld/default-context/"
    terms = TermMap(None)
    change = read_change(
        {
            "a": {"vocab": ["calm", "urn:x:keen"]},
            "b": {"object": "urn:x:1", "objectType": "Device"},
            "c": {"value": 1, "valueType": "Length"},
        },
        terms,
    )
    a, b, c = (instances[0] for instances in change.attributes.values())
    assert a["vocab"] == [default + "calm", "urn:x:keen"]
    assert b["objectType"] == default + "Device"
    assert c["valueType"] == default + "Length"


def test_a_proof_covers_its_attributes() -> None:
    proof = {"value": {"type": "DataIntegrityProof"}, "entityIdSealed": "urn:x:1", "entityTypeSealed": "Task"}
    kept = taken({"type": "Property", **proof}, "ngsildproof")
    assert kept["entityIdSealed"] == "urn:x:1"
    assert kept["entityTypeSealed"] == TERMS.expand("Task")
    assert "proof" in refusal({"ngsildproof": {"value": "no object"}})
    assert "ngsildproof" in refusal({"a": {"value": 1, "entityIdSealed": "urn:x:1"}})
    assert refusal({"ngsildproof": {"value": {}, "entityTypeSealed": 42}})


@pytest.mark.parametrize(
    "given",
    [
        {"type": "Property", "value": 1, "object": "urn:x:1"},
        {"type": "Property", "value": 1, "languageMap": {"en": "x"}},
        {"type": "Property", "value": 1, "previousValue": 0},
        {"type": "Property", "value": 1, "@context": {}},
        {"type": "Relationship", "object": "urn:x:1", "unitCode": "MTR"},
        {"type": "Relationship", "object": "urn:x:1", "valueType": "Length"},
        {"type": "Relationship", "object": "urn:x:1", "previousObject": "urn:x:0"},
        {"type": "Relationship", "object": "urn:x:1", "entity": {}},
        {"type": "Relationship", "object": []},
        {"type": "Property", "value": 1, "objectType": "Device"},
        {"type": "JsonProperty", "json": 5},
        {"type": "JsonProperty", "json": {}, "unitCode": "MTR"},
        {"type": "ListProperty", "valueList": [1], "value": 3},
        {"type": "ListRelationship", "objectList": ["no uri"]},
        {"type": "LanguageProperty", "languageMap": {"": "x"}},
        {"type": "LanguageProperty", "languageMap": {"en": ["a", 5]}},
        {"type": "LanguageProperty", "languageMap": {"en": "x"}, "valueType": "xsd:string"},
        {"type": "GeoProperty", "value": "no geometry"},
        {"type": "GeoProperty", "value": {"type": "GeometryCollection", "geometries": [POINT]}},
        {"type": "GeometryCollection", "geometries": [POINT]},
        {"value": 1, "observedAt": "2026-01-01T12:00:00"},
        {"value": 1, "datasetId": NULL},
        [{"type": "Property", "value": 1}, {"type": "Property", "value": 2, "datasetId": "@none"}],
        [{"value": 1, "datasetId": "urn:x:a"}, {"value": 2, "datasetId": "urn:x:a"}],
        None,
        {},
    ],
)
def test_members_of_other_kinds_are_refused(given: Any) -> None:
    assert refusal({"a": given})


@pytest.mark.parametrize("name", ["datasetId", "instanceId", "observedAt", "languageMap", "unitCode"])
def test_words_of_the_core_context_name_no_attribute(name: str) -> None:
    assert name in refusal({name: {"type": "Property", "value": 1}})


@pytest.mark.parametrize("name", ["location", "observationSpace", "operationSpace"])
def test_places_are_geo_properties(name: str) -> None:
    assert taken(POINT, name)["type"] == "GeoProperty"
    assert "GeoProperty" in refusal({name: {"type": "Property", "value": 7}})
    assert taken({"type": "Property", "value": NULL}, name, Nulls.ATTRIBUTES)


@pytest.mark.parametrize("name", ["výška_1", "Škola", "ex:any-thing.1", "https://a.example/x#y", "dc-title"])
def test_names_are_letters_of_any_language_or_iris(name: str) -> None:
    assert taken(1, name) == {"type": "Property", "value": 1}


@pytest.mark.parametrize("name", ["my attr", "9lives", "a.b", "_a", "", "a<b", "a;b"])
def test_other_names_are_refused(name: str) -> None:
    assert refusal({name: 1})
    assert refusal({"type": name})


@pytest.mark.parametrize(
    "sign", [*"\u202e\u200b\ufeff\u2028\u00a0<\ufe0f\U000e0100\ufdd0\ufffe\u115f\u3164\uffa0\u2800"]
)
def test_an_id_has_no_sign_that_is_not_seen(sign: str) -> None:
    assert refusal({"id": f"urn:x:A{sign}B"})
    assert read_change({"id": "urn:x:París"}, TERMS).id == "urn:x:París"


@pytest.mark.parametrize("scope", ["9bad", "/a//b", "a-b", NULL, ["/ok", "9bad"], "", "/", 7, None, "/a/"])
def test_an_invalid_scope_is_refused(scope: Any) -> None:
    assert refusal({"scope": scope})


def test_scopes_are_kept_as_they_were_written() -> None:
    assert read_change({"scope": "/Madrid/Gardens"}, TERMS).scopes == ("/Madrid/Gardens",)
    assert read_change({"scope": ["/A", "B/C_1", "/A"]}, TERMS).scopes == ("/A", "B/C_1")
    assert read_change({"scope": NULL}, TERMS).scopes == ()
    assert read_change({}, TERMS).scopes is None


@pytest.mark.parametrize(
    ("given", "allowed"),
    [
        (NULL, Nulls.ATTRIBUTES),
        ({"object": NULL}, Nulls.ATTRIBUTES),
        ({"type": "GeoProperty", "value": NULL}, Nulls.ATTRIBUTES),
        ({"languageMap": {"@none": NULL}}, Nulls.ATTRIBUTES),
        ({"vocab": NULL}, Nulls.ATTRIBUTES),
        ({"type": "JsonProperty", "json": NULL}, Nulls.ATTRIBUTES),
        ({"valueList": NULL}, Nulls.ATTRIBUTES),
        ({"objectList": NULL}, Nulls.ATTRIBUTES),
        ({"valueList": [NULL]}, Nulls.ATTRIBUTES),
        ({"objectList": [NULL]}, Nulls.ATTRIBUTES),
        ({"objectList": [{"object": NULL}]}, Nulls.ATTRIBUTES),
        ({"value": 1, "unitCode": NULL}, Nulls.ATTRIBUTES),
        ({"value": 1, "note": NULL}, Nulls.ATTRIBUTES),
        ({"languageMap": {"en": NULL, "fi": "a"}}, Nulls.ATTRIBUTES),
        ({"value": {"deep": {"a": NULL}}}, Nulls.VALUES),
        ({"value": [{"a": NULL}]}, Nulls.VALUES),
        ({"value": 1, "note": {"value": {"a": NULL}}}, Nulls.VALUES),
    ],
)
def test_null_is_refused_where_nothing_can_be_deleted(given: Any, allowed: Nulls) -> None:
    order = [Nulls.NOWHERE, Nulls.ATTRIBUTES, Nulls.VALUES]
    for nulls in order[: order.index(allowed)]:
        assert NULL in refusal({"a": given}, nulls)
    for nulls in order[order.index(allowed) :]:
        assert taken(given, "a", nulls)


def test_every_way_to_delete_an_attribute_is_known() -> None:
    for given in (
        NULL,
        {"type": "Property", "value": NULL},
        {"object": NULL},
        {"languageMap": {"@none": NULL}},
        {"vocab": NULL},
        {"json": NULL},
        {"valueList": [NULL]},
        {"objectList": [{"object": NULL}]},
        {"objectList": [NULL], "datasetId": "urn:x:1"},
    ):
        assert is_deletion(taken(given, "a", Nulls.ATTRIBUTES))
    assert not is_deletion(taken({"valueList": [NULL, 1]}, "a", Nulls.ATTRIBUTES))


def test_null_inside_opaque_json_is_data() -> None:
    assert taken({"json": {"a": NULL}})["json"] == {"a": NULL}


def test_a_whole_entity_has_an_id_and_a_type() -> None:
    documents: tuple[Any, ...] = (
        {"type": "Task"},
        {"id": "urn:x:1"},
        {"id": NULL, "type": "Task"},
        {"id": 1},
        [],
        None,
    )
    for document in documents:
        with pytest.raises(Problem):
            read_entity(document, TERMS)
    change = read_entity({"@id": "urn:x:1", "@type": ["Task", "Job", "Task"]}, TERMS)
    assert (change.id, len(change.types)) == ("urn:x:1", 2)


def test_a_place_is_checked_wherever_it_is_written() -> None:
    with pytest.raises(Problem):
        read_attribute("location", {"type": "Property", "value": 7}, TERMS)
    with pytest.raises(Problem):
        read_attribute("https://uri.etsi.org/ngsi-ld/location", 7, TERMS)


def test_bytes_without_null_need_no_look_at_their_values() -> None:
    for raw in (b'{"a":"urn:ngsi-ld:null"}', b'{"a":"urn:ngsi-ld:nul\\u006c"}'):
        assert nulls_in(raw, Nulls.NOWHERE) is Nulls.NOWHERE
    assert nulls_in(b'{"a":"urn:ngsi-ld:Task:1"}', Nulls.NOWHERE) is Nulls.VALUES


def test_a_time_with_an_offset_is_stored_in_utc() -> None:
    assert require_time("2026-01-01T12:00:00+02:00", "it") == "2026-01-01T10:00:00Z"
    assert require_time("2026-01-01T12:00:00.250+00:00", "it") == "2026-01-01T12:00:00.250Z"
    assert require_time("2026-01-01T12:00:00.25Z", "it") == "2026-01-01T12:00:00.25Z"
    for outside in ("0001-01-01T00:00:00+01:00", "9999-12-31T23:59:59-01:00"):
        with pytest.raises(Problem):
            require_time(outside, "it")


def test_an_altered_time_of_the_clock_is_read_as_any_other_or_refused() -> None:
    clock = "2026-01-01T12:00:00.123456Z"
    for at in range(len(clock)):
        for sign in "09 +-_:.TZ\u0661":
            text = clock[:at] + sign + clock[at + 1 :]
            try:
                wanted = (datetime.fromisoformat(text) - datetime(1970, 1, 1, tzinfo=UTC)) // timedelta(
                    microseconds=1
                )
            except (TypeError, ValueError):
                with pytest.raises((TypeError, ValueError)):
                    micros_of(text)
            else:
                assert micros_of(text) == wanted


def test_the_quick_pattern_of_uris_matches_what_the_whole_one_does() -> None:
    for code in range(128):
        for text in (f"a:{chr(code)}", f"{chr(code)}:a", f"a{chr(code)}:a"):
            assert bool(_ASCII_URI.fullmatch(text)) is bool(_URI.fullmatch(text)), text


@hypothesis.given(st.integers(-(10**16), 10**17))
def test_a_written_time_is_its_time_with_the_decimals_it_needs(at: int) -> None:
    text = written_time(at)
    assert micros_of(text) == at
    assert is_time(text)
    decimals = text.removesuffix("Z").partition(".")[2]
    assert decimals == "" if at % MICROS == 0 else len(decimals) == (6 if at % 1000 else 3)
    assert require_time(text, "it") == text
    assert require_time(text.replace("Z", "+00:00"), "it") == text
