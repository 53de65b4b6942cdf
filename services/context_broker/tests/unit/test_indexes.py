"""Indexes contain all matches, and follow every change."""

import itertools
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from handover_broker.model.entity import Entity
from handover_broker.query.geo_query import geo_query_document
from handover_broker.query.indexes.place_index import PlaceIndex
from handover_broker.query.indexes.q_index import Equality, Range
from handover_broker.query.type_selection import of_types, type_selection
from handover_broker.storage.store import MAX_INDEXES, Store

PLACE = "https://a.example/place"
VALUE = "https://a.example/value"

POSITIONS = st.tuples(st.floats(-180, 180), st.floats(-90, 90)) | st.sampled_from(
    [(0.0, 0.0), (180.0, 0.0), (-180.0, 0.0), (0.0, 90.0), (8.0, 40.0), (8.0001, 40.0001)]
)
GEOMETRIES = st.one_of(
    POSITIONS.map(lambda at: {"type": "Point", "coordinates": list(at)}),
    st.lists(POSITIONS, min_size=2, max_size=3).map(
        lambda path: {"type": "LineString", "coordinates": [list(one) for one in path]}
    ),
)


def entity(number: int, place: Any = None, value: Any = None, kind: str = "urn:t:a", seq: int = 1) -> Entity:
    attributes: dict[str, Any] = {}
    if place is not None:
        attributes[PLACE] = [{"type": "GeoProperty", "value": place}]
    if value is not None:
        attributes[VALUE] = [{"type": "Property", "value": value}]
    return Entity(f"urn:x:{number}", (kind,), attributes, "", "", seq)


@settings(deadline=None)  # libraries are loaded on the way
@given(
    st.lists(st.tuples(st.integers(0, 5), st.none() | GEOMETRIES), max_size=12),
    GEOMETRIES,
    st.sampled_from(
        ["near;maxDistance==10", "near;maxDistance==20000", "near;maxDistance==3e6", "intersects"]
    ),
)
def test_an_index_of_places_names_all_that_are_near(
    changes: list[tuple[int, Any]], reference: Any, relation: str
) -> None:
    query = geo_query_document(
        {"georel": relation, "geometry": reference["type"], "coordinates": reference["coordinates"],
         "geoproperty": PLACE}, str
    )  # fmt: skip
    assert query.box is not None
    index, entities = PlaceIndex(PLACE, []), dict[int, Entity]()
    for number, place in changes:
        index.found(query.box)
        after = entity(number, place)
        index.refile(entities.get(number), after)
        entities[number] = after
    hits = {one.id for one in entities.values() if query.wants(one)}
    assert hits <= set(index.found(query.box))
    assert set(index.found(query.box)) == set(PlaceIndex(PLACE, entities.values()).found(query.box))
    for one in entities.values():
        index.refile(one, None)
    assert not index.found(query.box)
    assert not len(index)


def store_of(entities: list[Entity]) -> Store:
    commits: Any = None
    store = Store("", commits, itertools.count(), lambda _: [], lambda _: None)
    for one in entities:
        store.take(one)
    return store


def test_the_fewest_candidates_are_looked_at() -> None:
    kinds = ("urn:t:a", "urn:t:b")
    store = store_of(
        [
            entity(
                number,
                {"type": "Point", "coordinates": [number / 10, 0]},
                number % 10,
                kinds[number % 100 == 0],
                number + 1,
            )
            for number in range(200)
        ]
    )
    near = geo_query_document(
        {
            "georel": "near;maxDistance==12000",
            "geometry": "Point",
            "coordinates": [1, 0],
            "geoproperty": PLACE,
        },
        str,
    )
    five, high = Equality(VALUE, frozenset({5})), Range(VALUE, 9, 99)

    def count(*asked: Any) -> int:
        found = store.candidates(None, *asked)
        assert [one.seq for one in found] == sorted(one.seq for one in found)
        return len(found)

    assert count() == 200
    assert count(of_types(["urn:t:b"])) == 2
    assert count(of_types(["urn:t:a"]), (five,)) == 20
    assert count(of_types(["urn:t:b"]), (five,)) == 2
    assert count(of_types(["urn:t:a"]), (high,)) == 20
    assert count(of_types(["urn:t:a"]), (), near) == 3
    assert count(of_types(["urn:t:a"]), (five,), near) == 3
    assert count(type_selection("(urn:t:a;urn:t:b)", str)) == 2
    assert count(type_selection("*", str)) == 200
    assert count(None, (Equality(VALUE, frozenset({77})),)) == 0


def test_entities_added_out_of_order_are_returned_in_order() -> None:
    store = store_of([entity(number, seq=seq) for number, seq in enumerate((5, 2, 9, 1))])
    for found in (store.candidates(), store.candidates(types=of_types(["urn:t:a"]))):
        assert [one.seq for one in found] == [1, 2, 5, 9]
    first = store.candidates()[0]
    also_b = Entity(first.id, ("urn:t:a", "urn:t:b"), {}, "", "", first.seq)
    store.take(entity(7, kind="urn:t:b", seq=20))
    store._put(first, also_b)
    assert [one.seq for one in store.candidates(types=of_types(["urn:t:b"]))] == [1, 20]


def test_an_unused_index_is_replaced() -> None:
    store = store_of([entity(1, value=5)])
    for number in range(3 * MAX_INDEXES):
        assert not store.candidates(conditions=(Equality(f"urn:a:{number}", frozenset({1})),))
    assert len(store._indexes) == MAX_INDEXES
    assert [one.id for one in store.candidates(conditions=(Equality(VALUE, frozenset({5})),))] == ["urn:x:1"]
    many = Entity("urn:x:2", ("urn:t:a",), {f"urn:a:{number}": [{"type": "Property", "value": 1}]
                                           for number in range(2 * MAX_INDEXES)}, "", "", 2)  # fmt: skip
    store.take(many)
    for number in range(2 * MAX_INDEXES):
        found = store.candidates(conditions=(Equality(f"urn:a:{number}", frozenset({1})),))
        assert many in found
