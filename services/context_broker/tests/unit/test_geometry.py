"""Geometries: any numbers are refused or safe to compute with."""

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover.errors import Problem
from handover_broker.model.changes import created
from handover_broker.model.context import Context
from handover_broker.model.entity import Entity
from handover_broker.model.entity_parser import read_entity
from handover_broker.model.geometry import DEPTHS, MAX_POSITIONS, fault_of
from handover_broker.query.geo_query import geo_query_document
from handover_broker.query.indexes.place_index import SKIPPED, PlaceIndex
from handover_datamodels.contexts import HANDOVER_URL, TermMap

TERMS = Context(0, TermMap(HANDOVER_URL), HANDOVER_URL, b"", HANDOVER_URL).terms
AT = "2026-01-01T00:00:00.000000Z"
PLACE = TERMS.expand("location")

NUMBERS = (
    st.integers()
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.floats(-200, 200)
    | st.sampled_from([1e308, -1e308, 180.0, -180.0, 90.0, -90.0, 180.0000001, 2**63, 5e-324])
)
NESTED: st.SearchStrategy[Any] = st.recursive(
    st.lists(NUMBERS, max_size=4), lambda inner: st.lists(inner, min_size=1, max_size=5), max_leaves=8
)


@st.composite
def geometries(draw: st.DrawFn) -> dict[str, Any]:
    """A geometry of any numbers: anything nested, or of the right form with rings that are closed."""
    kind = draw(st.sampled_from(sorted(DEPTHS)))
    if draw(st.booleans()):
        return {"type": kind, "coordinates": draw(NESTED)}
    positions = st.lists(st.lists(NUMBERS, min_size=2, max_size=3), min_size=3, max_size=5)
    coordinates: Any = draw(positions)
    if "Polygon" in kind:
        coordinates = [*coordinates, coordinates[0]]
    for _ in range(DEPTHS[kind] - 1):
        coordinates = [coordinates]
    return {"type": kind, "coordinates": coordinates[0] if kind == "Point" else coordinates}


def stored(geometry: Any, name: str = "urn:x:1") -> Entity:
    """An entity with a geometry that was not checked when it was stored."""
    document = {"id": name, "type": "Robot", "location": {"type": "Point", "coordinates": [1, 2]}}
    entity = created(read_entity(document, TERMS), AT, 1)
    entity.attributes[PLACE][0]["value"] = geometry
    return entity


QUERY = geo_query_document(
    {"georel": "near;maxDistance==1000", "geometry": "Point", "coordinates": [1, 2]}, TERMS.expand
)


@given(geometries())
def test_any_numbers_are_refused_or_safe_to_compute_with(geometry: dict[str, Any]) -> None:
    document = {"id": "urn:x:1", "type": "Robot", "location": geometry}
    if fault_of(geometry) is None:
        read_entity(document, TERMS)
    else:
        with pytest.raises(Problem) as refused:
            read_entity(document, TERMS)
        assert refused.value.status == 400
    entity = stored(geometry)
    index = PlaceIndex(PLACE, [entity, stored({"type": "Point", "coordinates": [1, 2]}, "urn:x:2")])
    assert QUERY.box is not None
    assert "urn:x:2" in index.found(QUERY.box)
    assert QUERY.wants(entity) in {True, False}
    index.refile(entity, None)
    assert len(index) == 1


@pytest.mark.parametrize(
    ("kind", "coordinates", "word"),
    [
        ("Point", [1e308, 1e308], "between -180 and 180"),
        ("Point", [180.5, 0], "antimeridian"),
        ("Point", [0, 90.5], "between -90 and 90"),
        ("Point", [0, 0, math.inf], "finite"),
        ("Point", [math.nan, 0], "between -180 and 180"),
        ("Point", [True, 0], "two or three numbers"),
        ("Point", [1, 2, 3, 4], "two or three numbers"),
        ("Point", [[1, 2]], "two or three numbers"),
        ("LineString", [[179, 0], [181, 0]], "cut what crosses the antimeridian"),
        ("Polygon", [[[0, 0], [1, 0], [1, 1], [0, 1]]], "the last the same as the first"),
        ("Polygon", [[[0, 0], [1, 0], [0, 0]]], "at least four positions"),
        ("Polygon", [[]], "fit no Polygon"),
        ("MultiPoint", [[0, 0]] * (MAX_POSITIONS + 1), "at most 10000 positions"),
        ("MultiPolygon", [[[[[[0, 0]]]]]], "fit no MultiPolygon"),
    ],
)
def test_the_fault_of_an_invalid_geometry_is_named(kind: str, coordinates: Any, word: str) -> None:
    assert word in str(fault_of({"type": kind, "coordinates": coordinates}))
    with pytest.raises(Problem, match=word):
        geo_query_document({"georel": "within", "geometry": kind, "coordinates": coordinates}, str)


@pytest.mark.parametrize(
    ("kind", "coordinates"),
    [
        ("Point", [-180, 90]),
        ("Point", [180, -90, -11_000.5]),
        ("MultiPolygon", [[[[170, 0], [180, 0], [180, 1], [170, 0]]], [[[-180, 0], [-170, 0], [-180, 1],
         [-180, 0]]]]),
        ("MultiPoint", [[0, 0]] * MAX_POSITIONS),
    ],
)  # fmt: skip
def test_a_geometry_may_cover_the_whole_globe(kind: str, coordinates: Any) -> None:
    assert fault_of({"type": kind, "coordinates": coordinates}) is None


def test_an_invalid_stored_geometry_is_skipped_and_counted() -> None:
    before = SKIPPED._value.get()
    index = PlaceIndex(PLACE, [stored({"type": "Point", "coordinates": [1e308, 1e308]})])
    assert len(index) == 0
    assert SKIPPED._value.get() == before + 1
