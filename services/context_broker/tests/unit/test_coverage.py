"""Coverage: a source is skipped only if it cannot have matching data."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from handover_broker.model.entity import Entity
from handover_broker.query.geo_query import geo_query
from handover_broker.query.scope_query import scope_query
from handover_federation.distribution.query_targets import coverage_of
from handover_federation.registrations.coverage import (
    CoverageQuery,
    has_matching_place,
    may_hold,
    placement_filter,
)
from services.context_broker.tests.unit.test_registry import CONTEXT, TASKS, registered

EXPAND = CONTEXT.terms.expand


def square(west: float, south: float, size: float) -> dict[str, Any]:
    east, north = west + size, south + size
    ring = [[west, south], [east, south], [east, north], [west, north], [west, south]]
    return {"type": "Polygon", "coordinates": [ring]}


CITY = square(0, 0, 10)
PARIS = {"georel": "near;maxDistance==100000", "geometry": "Point", "coordinates": "[30,30]"}
INSIDE = {"geometry": "Polygon", "coordinates": "[[[2,2],[3,2],[3,3],[2,3],[2,2]]]"}
AROUND = {"geometry": "Polygon", "coordinates": "[[[-5,-5],[15,-5],[15,15],[-5,15],[-5,-5]]]"}
AWAY = {"geometry": "Polygon", "coordinates": "[[[20,20],[30,20],[30,30],[20,30],[20,20]]]"}
MAY = {"timerel": "between", "timeAt": "2026-05-01T00:00:00Z", "endTimeAt": "2026-06-01T00:00:00Z"}
SPRING = {"startAt": "2026-03-01T00:00:00Z", "endAt": "2026-05-15T00:00:00Z"}
AUTUMN = {"startAt": "2026-09-01T00:00:00Z", "endAt": "2026-11-15T00:00:00Z"}


@pytest.mark.parametrize(
    ("members", "asked", "may_be_there"),
    [
        ({}, PARIS, True),
        ({"location": CITY}, PARIS, False),
        ({"location": CITY}, {**PARIS, "georel": "near;maxDistance==4000000"}, True),
        ({"location": CITY}, {**PARIS, "georel": "near;minDistance==100"}, True),
        ({"location": CITY}, {**PARIS, "geoproperty": "operationSpace"}, True),
        ({"operationSpace": CITY}, {**PARIS, "geoproperty": "operationSpace"}, False),
        ({"location": CITY}, {"georel": "within", **INSIDE}, True),
        ({"location": CITY}, {"georel": "contains", **INSIDE}, True),
        ({"location": CITY}, {"georel": "equals", **INSIDE}, True),
        ({"location": CITY}, {"georel": "within", **AROUND}, True),
        ({"location": CITY}, {"georel": "disjoint", **INSIDE}, True),
        ({"location": CITY}, {"georel": "disjoint", **AROUND}, False),
        ({"location": CITY}, {"georel": "disjoint", **AWAY}, True),
        ({"location": CITY}, {"georel": "within", **AWAY}, False),
        ({"location": CITY}, {"georel": "intersects", **AWAY}, False),
        ({"scope": "/Madrid"}, {"scopeQ": "/Madrid"}, True),
        ({"scope": "/Madrid"}, {"scopeQ": "/Madrid/Gardens"}, True),
        ({"scope": "/Madrid"}, {"scopeQ": "/+/Gardens/#"}, True),
        ({"scope": "/Madrid/Gardens"}, {"scopeQ": "/Madrid"}, False),
        ({"scope": "/Madrid/Gardens"}, {"scopeQ": "/Madrid/#"}, True),
        ({"scope": ["/Paris", "/Madrid"]}, {"scopeQ": "/Rome,/Madrid"}, True),
        ({"scope": ["/Paris"]}, {"scopeQ": "/Rome,/Madrid"}, False),
        ({}, MAY, True),
        ({"observationInterval": SPRING}, MAY, True),
        ({"observationInterval": AUTUMN}, MAY, False),
        ({"observationInterval": AUTUMN}, {}, True),
        ({"observationInterval": SPRING}, {**MAY, "timeproperty": "modifiedAt"}, False),
        ({"managementInterval": SPRING}, {**MAY, "timeproperty": "modifiedAt"}, True),
        ({"observationInterval": {"startAt": "2026-01-01T00:00:00Z"}}, MAY, True),
        ({"observationInterval": AUTUMN}, {"timerel": "after", "timeAt": "2026-10-01T00:00:00Z"}, True),
        ({"observationInterval": AUTUMN}, {"timerel": "before", "timeAt": "2026-08-01T00:00:00Z"}, False),
        ({"datasetId": ["urn:x:a", "@none"]}, {"datasetId": "urn:x:a"}, True),
        ({"datasetId": ["urn:x:a", "@none"]}, {"datasetId": "@none,urn:x:b"}, True),
        ({"datasetId": "urn:x:a"}, {"datasetId": "urn:x:b"}, False),
        ({"datasetId": "urn:x:a"}, {}, True),
    ],
)
def test_a_source_without_coverage_is_not_queried(
    members: dict[str, Any], asked: dict[str, str], may_be_there: bool
) -> None:
    assert coverage_of(asked, EXPAND).may_match(registered(TASKS, **members)) is may_be_there


GRID = st.integers(-4, 4)
RELATIONS = st.sampled_from(
    ["within", "contains", "intersects", "equals", "disjoint", "overlaps", "near;maxDistance==200000",
     "near;minDistance==200000"]
)  # fmt: skip


@given(
    RELATIONS,
    st.builds(square, GRID, GRID, st.integers(1, 3)),
    st.builds(square, *[st.integers(0, 3)] * 2, st.sampled_from([0.25, 0.5, 1])),
)
def test_a_location_within_the_coverage_matches(
    relation: str, asked: dict[str, Any], place: dict[str, Any]
) -> None:
    source = registered(TASKS, location=square(0, 0, 4))
    query = geo_query(
        {"georel": relation, "geometry": "Polygon", "coordinates": str(asked["coordinates"])}, EXPAND
    )
    assert query is not None
    if query.fits(place):
        assert CoverageQuery(place=query).may_match(source)
        assert has_matching_place(query, source)


SCOPE = st.lists(st.sampled_from(["a", "b"]), min_size=1, max_size=3).map(
    lambda levels: "/" + "/".join(levels)
)
PATTERN = st.builds(
    lambda levels, below: "/" + "/".join(levels) + below,
    st.lists(st.sampled_from(["a", "b", "+"]), min_size=1, max_size=3),
    st.sampled_from(["", "/#"]),
)


@given(SCOPE, SCOPE, PATTERN)
def test_a_scope_within_the_coverage_matches(scope: str, below: str, wanted: str) -> None:
    source, query = registered(TASKS, scope=scope), scope_query(wanted)
    for one in (scope, scope + below):
        if query.wants([one]):
            assert CoverageQuery(scope=query).may_match(source)


@pytest.mark.parametrize(
    ("members", "sent", "has_room"),
    [
        ({"location": CITY}, {}, True),
        ({"location": CITY}, {"location": {"type": "Point", "coordinates": [5, 5]}}, True),
        ({"location": CITY}, {"location": {"type": "Point", "coordinates": [50, 5]}}, False),
        ({"location": CITY}, {"location": [{"value": {"type": "Point", "coordinates": [50, 5]}}]}, False),
        ({"location": CITY}, {"location": {"value": "nowhere"}}, True),
        ({"scope": "/Madrid"}, {"scope": "/Madrid/Gardens"}, True),
        ({"scope": "/Madrid"}, {"scope": ["Paris", "Madrid"]}, True),
        ({"scope": "/Madrid"}, {"scope": "/Madrid2"}, False),
    ],
)
def test_a_document_goes_to_sources_that_may_contain_it(
    members: dict[str, Any], sent: dict[str, Any], has_room: bool
) -> None:
    where = placement_filter(sent)
    assert (where is None or where(registered(TASKS, **members))) is has_room


def test_entities_outside_the_coverage_are_not_claimed() -> None:
    source = registered(TASKS, location=CITY, mode="redirect")
    place = {"type": "GeoProperty", "value": {"type": "Point", "coordinates": [50, 5]}}
    entity = Entity("urn:x:1", (EXPAND("Task"),), {EXPAND("location"): [place]}, "", "")
    assert not may_hold(source, entity)
    assert may_hold(source, Entity("urn:x:1", (EXPAND("Task"),), {}, "", ""))
