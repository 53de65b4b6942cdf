"""Geo-queries: metres on the globe, relations of areas, and invalid queries (clauses 4.7 and 4.10)."""

import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover.errors import Problem
from handover_broker.query.geo_query import (
    GeoQuery,
    boxes_touch,
    distance_to_m,
    geo_query,
    geo_query_document,
)
from handover_broker.query.sphere import EARTH_RADIUS_M, box_around, box_of, distance_m

HOLED = "[[[0,0],[10,0],[10,10],[0,10],[0,0]],[[4,4],[6,4],[6,6],[4,6],[4,4]]]"
SQUARE = {"type": "Polygon", "coordinates": [[[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]]]}


def asked(relation: str, kind: str, coordinates: str) -> GeoQuery:
    query = geo_query({"georel": relation, "geometry": kind, "coordinates": coordinates}, str)
    assert query is not None
    return query


def point(longitude: float, latitude: float) -> dict[str, Any]:
    return {"type": "Point", "coordinates": [longitude, latitude]}


def line(*positions: tuple[float, float]) -> dict[str, Any]:
    return {"type": "LineString", "coordinates": [list(one) for one in positions]}


@pytest.mark.parametrize(
    ("a", "b", "metres"),
    [
        (point(2.3522, 48.8566), point(-0.1276, 51.5072), 343_560),  # Paris to London
        (point(179.9, 10), point(-179.9, 10), 21_901),
        (point(0, 89.9), point(180, 89.9), 22_239),
        (point(10, 60.009), line((0, 60), (10, 60)), 1_001),
        (point(0, 85), line((1, 85), (0, 85.6)), 9_692 * 0.9884),  # the way over the ice, not along 85
        (line((0, 0), (10, 0)), line((0, 1), (10, 1)), 111_195),
        (SQUARE, {"type": "Polygon", "coordinates": [[[2, 0], [3, 0], [3, 1], [2, 1], [2, 0]]]}, 111_178),
        (SQUARE, point(0.5, 0.5), 0),
        (line((-1, -1), (1, 1)), line((-1, 1), (1, -1)), 0),
        ({"type": "MultiPoint", "coordinates": [[50, 0], [3, 0]]}, point(4, 0), 111_195),
    ],
)
def test_distances_are_right_within_half_a_percent(a: Any, b: Any, metres: float) -> None:
    for there, back in ((a, b), (b, a)):
        assert distance_to_m(there, back) == pytest.approx(metres, rel=0.005)


POSITIONS = st.tuples(st.floats(-180, 180), st.floats(-90, 90))


@settings(deadline=None)  # libraries are loaded on the way
@given(POSITIONS, POSITIONS, POSITIONS, POSITIONS)
def test_the_distance_of_lines_is_the_shortest_that_samples_find(
    a: tuple[float, float], b: tuple[float, float], c: tuple[float, float], d: tuple[float, float]
) -> None:
    measured = distance_to_m(line(a, b), line(c, d))

    def along(start: tuple[float, float], end: tuple[float, float]) -> list[tuple[float, float]]:
        return [
            (start[0] + (end[0] - start[0]) * i / 20, start[1] + (end[1] - start[1]) * i / 20)
            for i in range(21)
        ]

    sampled = min(distance_m(one, other) for one in along(a, b) for other in along(c, d))
    assert measured <= sampled * 1.005 + 1


@settings(deadline=None)  # libraries are loaded on the way
@given(POSITIONS, POSITIONS, st.floats(1, 2e7))
def test_near_matches_are_inside_the_bounding_box(
    a: tuple[float, float], b: tuple[float, float], within_m: float
) -> None:
    if distance_m(a, b) <= within_m:
        assert boxes_touch(box_around(box_of(point(*a)), within_m), box_of(point(*b)))


def test_near_has_two_sides() -> None:
    inside, outside = point(8.001, 40), point(8.1, 40)
    near, far = (asked(f"near;{side}Distance==2000", "Point", "[8,40]") for side in ("max", "min"))
    assert near.fits(inside)
    assert not near.fits(outside)
    assert far.fits(outside)
    assert not far.fits(inside)


@pytest.mark.parametrize(
    ("relation", "kind", "coordinates", "place", "fits"),
    [
        ("within", "Polygon", HOLED, point(2, 2), True),
        ("within", "Polygon", HOLED, point(5, 5), False),
        ("within", "Polygon", HOLED, point(20, 5), False),
        ("contains", "Point", "[0.5,0.5]", SQUARE, True),
        ("contains", "Point", "[3,3]", SQUARE, False),
        ("intersects", "LineString", "[[-1,0.5],[2,0.5]]", SQUARE, True),
        ("intersects", "LineString", "[[-1,5],[2,5]]", SQUARE, False),
        ("disjoint", "LineString", "[[-1,5],[2,5]]", SQUARE, True),
        ("disjoint", "LineString", "[[-1,0.5],[2,0.5]]", SQUARE, False),
        ("equals", "Polygon", "[[[1,0],[1,1],[0,1],[0,0],[1,0]]]", SQUARE, True),
        ("equals", "Point", "[1,0]", SQUARE, False),
        ("overlaps", "Polygon", "[[[0.5,0],[2,0],[2,1],[0.5,1],[0.5,0]]]", SQUARE, True),
        ("overlaps", "Polygon", "[[[0,0],[2,0],[2,2],[0,2],[0,0]]]", SQUARE, False),
        ("within", "MultiPolygon", "[[[[170,-5],[180,-5],[180,5],[170,5],[170,-5]]],"
         "[[[-180,-5],[-170,-5],[-170,5],[-180,5],[-180,-5]]]]", point(-175, 0), True),
        ("within", "MultiPolygon", "[[[[0,0],[3,0],[3,3],[0,0]]],[[[9,9],[10,9],[10,10],[9,9]]]]",
         point(2, 1), True),
        ("intersects", "MultiLineString", "[[[0,0],[1,1]],[[5,5],[6,6]]]", point(5.5, 5.5), True),
    ],
)  # fmt: skip
def test_relations_are_those_of_simple_features(
    relation: str, kind: str, coordinates: str, place: Any, fits: bool
) -> None:
    assert asked(relation, kind, coordinates).fits(place) is fits


@pytest.mark.parametrize(
    ("parameters", "word"),
    [
        ({"georel": "near;maxDistance==0"}, "more than 0"),
        ({"georel": "near;maxDistance==-100"}, "metres"),
        ({"georel": "near;maxDistance==5;minDistance==1"}, "near;maxDistance==2000"),
        ({"georel": "near"}, "near;maxDistance==2000"),
        ({"georel": "touches"}, "overlaps"),
        ({"georel": "near;maxDistance==inf"}, "metres"),
        ({"georel": "near;maxDistance==1e400"}, "metres"),
        ({"geometry": "GeometryCollection"}, "MultiPolygon"),
        ({"coordinates": "8,40"}, "JSON list"),
        ({"coordinates": "[[8,40]]"}, "longitude first"),
        ({"coordinates": ""}, "JSON list"),
        ({"geoproperty": "a b"}, "geoproperty"),
        ({"geometry": "Polygon", "coordinates": "[[[0,0],[1,1],[0,0]]]"}, "four positions"),
        ({"geometry": "MultiLineString", "coordinates": "[[[0,0]]]"}, "two positions"),
        ({"geometry": "MultiPoint", "coordinates": str([[0, 0]] * 10_001).replace(" ", "")}, "simplify"),
    ],
)
def test_an_invalid_geo_query_is_refused_with_the_way_out(parameters: dict[str, str], word: str) -> None:
    whole = {"georel": "near;maxDistance==1", "geometry": "Point", "coordinates": "[8,40]"}
    with pytest.raises(Problem, match=word) as refused:
        geo_query({**whole, **parameters}, str)
    assert refused.value.status == 400
    with pytest.raises(Problem):
        geo_query_document({**whole, **parameters}, str)


def test_a_geoquery_is_whole_or_not_there() -> None:
    assert geo_query({"geoproperty": "location"}, str) is None
    for name in ("georel", "geometry", "coordinates"):
        with pytest.raises(Problem, match=r"add (georel|geometry|coordinates)"):
            geo_query({name: "Point"}, str)
    with pytest.raises(Problem, match="no member"):
        geo_query_document({"georel": "within", "near": 1}, str)
    made = geo_query_document({"georel": "within", "geometry": "Point", "coordinates": [1, 2]}, str)
    assert made.attribute == "location"


@settings(deadline=None)  # libraries are loaded on the way
@given(st.sampled_from(["within", "contains", "intersects", "equals", "overlaps", "near;maxDistance==1e5"]),
       st.lists(POSITIONS, min_size=4, max_size=6), st.lists(POSITIONS, min_size=2, max_size=4))  # fmt: skip
def test_any_geometries_have_an_answer(
    relation: str, ring: list[tuple[float, float]], path: list[tuple[float, float]]
) -> None:
    area = [list(one) for one in [*ring, ring[0]]]
    query = geo_query_document({"georel": relation, "geometry": "Polygon", "coordinates": [area]}, str)
    assert query.fits(line(*path)) in {True, False}
    assert query.fits({"type": "Point", "coordinates": list(ring[0])}) in {True, False}
    assert not query.fits({"type": "Point?"})


def test_the_earth_is_as_large_as_it_is() -> None:
    assert distance_m((0, 0), (180, 0)) == pytest.approx(math.pi * EARTH_RADIUS_M)
