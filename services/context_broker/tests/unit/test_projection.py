"""Projections: pick and omit, languages, geometries."""

from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover.errors import Problem
from handover_broker.model.changes import created
from handover_broker.model.entity_parser import read_entity
from handover_broker.model.representation.geojson import feature_of, geometry
from handover_broker.model.representation.language import best_tag, preferences
from handover_broker.model.representation.projection import read_projection
from handover_broker.model.representation.rendering import Form, View, render
from handover_datamodels.contexts import HANDOVER_URL, TermMap

TERMS = TermMap(HANDOVER_URL)
POINT = {"type": "Point", "coordinates": [1, 2]}


def entity(**members: Any) -> Any:
    document = {"id": "urn:x:1", "type": "Task", **members}
    return created(read_entity(document, TERMS), "2026-01-01T00:00:00.000000Z", 1)


def status_of(act: Callable[[], object]) -> int | None:
    """Return the status of a refusal; None if there was none."""
    try:
        act()
    except Problem as problem:
        return problem.status
    return None


def test_braces_select_members_of_linked_entities() -> None:
    wanted = read_projection("id,at{name,in{id|description}}", "at{type},b", TERMS)
    assert wanted is not None
    at = TERMS.expand("at")
    assert wanted.picked == frozenset({"id", at})
    assert wanted.omitted == frozenset({TERMS.expand("b")})
    below = wanted.below(at)
    assert below is not None
    assert below.picked == frozenset({TERMS.expand("name"), TERMS.expand("in")})
    assert below.omitted == frozenset({"type"})
    deepest = below.below(TERMS.expand("in"))
    assert deepest is not None
    assert deepest.picked == frozenset({"id", TERMS.expand("description")})
    assert wanted.below(TERMS.expand("other")) is None


def test_omitting_members_of_a_linked_entity_keeps_the_link() -> None:
    wanted = read_projection(None, "type,at{name}", TERMS)
    assert wanted is not None
    assert wanted.wants(TERMS.expand("at"))
    assert not wanted.wants("type")


@given(st.text("ab{},|;id ", max_size=12), st.text("ab{},|", max_size=6) | st.none())
def test_any_projection_is_read_or_refused(pick: str, omit: str | None) -> None:
    assert status_of(lambda: read_projection(pick, omit, TERMS)) in {None, 400}


@given(st.text("enfr-*,;q=.019 ", max_size=14))
def test_any_language_is_read_or_refused(given_text: str) -> None:
    assert status_of(lambda: best_tag({"en": "a", "fr": "b"}, preferences(given_text))) in {None, 400}


@pytest.mark.parametrize(
    ("wordings", "wanted", "tag"),
    [
        (("fr", "nl"), "fr;q=0.2,nl;q=0.9", "nl"),
        (("fr", "nl"), "nl-BE", "nl"),
        (("de", "en-US"), "en", "en-US"),
        (("de", "@none"), "pt", "@none"),
        (("de", "en"), "en;q=0,*", "de"),
        (("DE", "en"), "de", "DE"),
    ],
)
def test_the_best_language_is_found(wordings: tuple[str, ...], wanted: str, tag: str) -> None:
    assert best_tag(dict.fromkeys(wordings, "x"), preferences(wanted)) == tag


def test_texts_of_sub_attributes_are_returned_in_the_language_too() -> None:
    one = entity(a={"value": 1, "note": {"languageMap": {"en": "part", "fi": "osa"}}})
    result = render(one, TERMS, View(Form.CONCISE, languages=preferences("fi")))
    assert result["a"] == {"value": 1, "note": {"value": "osa", "lang": "fi"}}


def test_a_feature_has_the_geometry_of_the_default_instance() -> None:
    other = {"type": "Point", "coordinates": [9, 9]}
    one = entity(
        location=[{"value": other, "datasetId": "urn:x:gps"}, {"type": "GeoProperty", "value": POINT}],
        spot={"value": other, "datasetId": "urn:x:gps"},
        size=3,
    )
    location = TERMS.expand("location")
    made = feature_of(render(one, TERMS, View(Form.KEY_VALUES)), geometry(one, location))
    assert (made["id"], made["type"], made["geometry"]) == ("urn:x:1", "Feature", POINT)
    assert made["properties"]["size"] == 3
    assert set(made["properties"]["location"]["dataset"]) == {"@none", "urn:x:gps"}
    assert geometry(one, location, frozenset({"urn:x:gps"})) == other
    assert geometry(one, location, frozenset({None})) == POINT
    assert geometry(one, location, frozenset({"urn:x:other"})) is None
    assert geometry(one, TERMS.expand("spot")) == other
    assert geometry(one, TERMS.expand("size")) is None
    assert geometry(one, TERMS.expand("nowhere")) is None
