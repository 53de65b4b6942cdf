"""Pages and orders: following the links returns everything once, also during changes (5.5.9, 4.23)."""

import asyncio
import itertools
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from handover.errors import Problem
from handover_broker.model.entity import Entity
from handover_broker.query.collation import collation
from handover_broker.query.ordering import Ordering, ordering, ordering_document
from handover_broker.query.pages import PagePosition, Window, mark_of, place_of
from handover_broker.query.selection import Page, Selection, search
from handover_broker.query.type_selection import of_types
from handover_broker.storage.store import Store

VOCAB = "https://a.example/"
AT = "2026-01-01T00:00:00Z"


def expand(name: str) -> str:
    return name if ":" in name else VOCAB + name


def thing(number: int, seq: int, value: Any = None, **more: Any) -> Entity:
    attributes = {} if value is None else {expand("a"): [{"type": "Property", "value": value}]}
    attributes |= {expand(name): [said] for name, said in more.items()}
    return Entity(f"urn:x:{number}", (expand("T"),), attributes, AT, AT, seq)


def empty_store() -> Store:
    commits: Any = None
    return Store("", commits, itertools.count(), lambda _: [], lambda _: None)


def look(store: Store, window: Window, order: Ordering | None) -> Page:
    return asyncio.run(search(store, Selection(types=of_types((expand("T"),))), window, order))


def following(page: Page, limit: int, *, forwards: bool) -> Window | None:
    """Return the window of a link to a page, with its position encoded and decoded as in a URL."""
    place = page.last if forwards else page.first
    if not (page.more if forwards else page.before) or place is None:
        return None
    return Window(0, limit, False, place_of(place.written(7), 7))


VALUES = st.none() | st.integers(-2, 2) | st.sampled_from(["a", "B", "ä", "z", True, 1.5]) | st.just([1, 2])
CHANGES = st.lists(st.tuples(st.sampled_from(["create", "delete"]), st.integers(0, 30), VALUES), max_size=6)
ORDERS = st.sampled_from([None, "a", "a;desc", "id;desc", "a;desc,id"])


@settings(deadline=None)
@given(
    st.lists(VALUES, max_size=12),
    st.lists(CHANGES, max_size=12),
    st.integers(1, 4),
    ORDERS,
)
def test_a_walk_neither_repeats_nor_misses_what_was_there_all_the_time(
    staying: list[Any],
    changes: list[list[tuple[str, int, Any]]],
    limit: int,
    order_by: str | None,
) -> None:
    order = None if order_by is None else ordering({"orderBy": order_by}, expand)
    store, seqs = empty_store(), itertools.count(1)
    passing: dict[int, Entity] = {}

    def happen(some: list[tuple[str, int, Any]]) -> None:
        for what, number, value in some:
            if what == "create" and number not in passing:
                passing[number] = thing(number, next(seqs), value)
                store.take(passing[number])
            elif what == "delete" and number in passing:
                gone = passing.pop(number)
                store._put(gone, None)

    for number, value in enumerate(staying):
        happen(changes[number] if number < len(changes) else [])
        store.take(thing(100 + number, next(seqs), value))
    stay = {f"urn:x:{100 + number}" for number in range(len(staying))}
    for forwards in (True, False):
        seen: list[str] = []
        window: Window | None = Window(0, limit, False)
        if not forwards:
            end = look(store, Window(0, 1000, False), order)
            if not end.entities:
                return
            last = end.entities[-1]
            sort_key = order.sort_key(last) if order else ()
            # Back from a place behind everything: what came last is still to be seen.
            window = Window(0, limit, False, PagePosition(last.seq, sort_key, is_end=True))
            seen.append(last.id)
        rounds = itertools.chain(changes, itertools.repeat([]))
        while window is not None:
            page = look(store, window, order)
            assert len(page.entities) <= limit
            seen += [one.id for one in (page.entities if forwards else reversed(page.entities))]
            happen(next(rounds))
            window = following(page, limit, forwards=forwards)
        kept = [one for one in seen if one in stay]
        assert sorted(kept) == sorted(stay)
        assert len(set(seen) & stay) == len(kept)
        assert [one for one in everything(store, order) if one in stay] == (kept if forwards else kept[::-1])


def everything(store: Store, order: Ordering | None) -> list[str]:
    return [one.id for one in look(store, Window(0, 1000, False), order).entities]


@settings(deadline=None)
@given(st.lists(VALUES, max_size=10), ORDERS, st.integers(0, 12), st.integers(0, 5))
def test_a_page_by_offset_is_a_piece_of_the_whole(
    values: list[Any], order_by: str | None, offset: int, limit: int
) -> None:
    order = None if order_by is None else ordering({"orderBy": order_by}, expand)
    store = empty_store()
    for number, value in enumerate(values):
        store.take(thing(number, number + 1, value))
    page = look(store, Window(offset, limit, True), order)
    whole = everything(store, order)
    assert [one.id for one in page.entities] == whole[offset : offset + limit]
    assert page.total == len(values)
    assert page.more is (len(values) > offset + limit)


def test_a_place_counts_everything_all_the_same() -> None:
    store = empty_store()
    for number in range(10):
        store.take(thing(number, number + 1, number))
    for order in (None, ordering({"orderBy": "a;desc"}, expand)):
        first = look(store, Window(0, 4, True), order)
        second = look(store, Window(4, 4, True, first.last), order)
        back = look(store, Window(0, 4, True, second.first), order)
        assert [first.total, second.total, back.total] == [10, 10, 10]
        assert [one.id for one in back.entities] == [one.id for one in first.entities]
        assert (first.before, back.before, second.before) == (False, False, True)


@pytest.mark.parametrize("text", ["", "x", "bm9uc2Vuc2U", "é", "A" * 40_000, "WzEsMiwzLDRd", "bnVsbA"])
def test_an_invalid_position_is_refused(text: str) -> None:
    with pytest.raises(Problem, match="Link header") as refused:
        place_of(text, 0)
    assert refused.value.status == 400


def test_a_place_in_another_order_is_refused() -> None:
    mark = mark_of("a", b"b")
    text = PagePosition(5, [[1, 2]]).written(mark)
    assert place_of(text, mark) == PagePosition(5, [[1, 2]])
    with pytest.raises(Problem, match="another order"):
        place_of(text, mark_of("a", b"c"))


@pytest.mark.parametrize(
    "sort_key", [[], [[1]], [[1, "x"]], [[2, 5]], [[99, 1]], [["x", 1]], [7], [[1, 1], [1, 1]]]
)
def test_a_position_with_an_invalid_sort_key_is_refused(sort_key: list[Any]) -> None:
    store = empty_store()
    store.take(thing(1, 1, 5))
    with pytest.raises(Problem) as refused:
        look(store, Window(0, 5, False, PagePosition(3, sort_key)), ordering({"orderBy": "a"}, expand))
    assert refused.value.status == 400


def ranked(values: list[Any], by: str = "a", **parameters: str) -> list[Any]:
    store = empty_store()
    for number, value in enumerate(values):
        store.take(thing(number, number + 1, value))
    order = ordering({"orderBy": by, **parameters}, expand)
    page = look(store, Window(0, 100, False), order)
    return [one.attributes[expand("a")][0]["value"] if one.attributes else None for one in page.entities]


def typed(kind: str, value: str) -> dict[str, str]:
    return {"@type": kind, "@value": value}


def test_values_of_different_kinds_have_an_order() -> None:
    values = [
        -1.5, 2, "a", "B", {"x": 1}, [1, 2], False, True, typed("Time", "12:00:00Z"),
        typed("Date", "2026-01-01"),
        typed("DateTime", "2025-01-01T00:00:00Z"), typed("DateTime", "2025-01-01T01:00:00+00:30"), None,
    ]  # fmt: skip
    assert ranked(values[::-1]) == values
    assert ranked(values, "a;desc") == [*values[-2::-1], None]


@pytest.mark.parametrize(
    ("tag", "texts"),
    [
        (None, ["", " x", "-x", "10", "2", "a", "A", "á", "ae", "b", "Z"]),
        ("und", ["A", "á", "b"]),
        ("und", ["cote", "coté", "côte", "d"]),
        ("und", ["_a", "1", "9", "a", "A", "ab", "æ", "b", "ø", "ß"]),
        ("fi", ["a", "o", "z", "å", "ä", "ö"]),
        ("en", ["a", "å", "o", "ö", "z"]),
        ("de-u-co-phonebk", ["Ad", "Ä", "Af"]),
        ("und-u-kn-true", ["a2", "a10"]),
        ("und", ["a10", "a2"]),
        ("und-u-kf-upper", ["A", "a"]),
        ("und-u-ks-level1", ["a", "b"]),
    ],
)
def test_texts_are_in_the_order_of_readers(tag: str | None, texts: list[str]) -> None:
    shuffled = texts[::-1]
    assert sorted(shuffled, key=collation(tag)) == texts


@pytest.mark.parametrize("tag", ["!!nope", "", "xx", "fi-u-co-phonebk", "und-u-zz-x", "de-u-ks", "u" * 200])
def test_an_unknown_collation_is_refused(tag: str) -> None:
    with pytest.raises(Problem, match="collation"):
        collation(tag)


@settings(deadline=None)
@given(st.text(max_size=8), st.text(max_size=8))
def test_any_two_texts_have_an_order(one: str, other: str) -> None:
    key = collation("fi")
    assert (key(one) < key(other)) or (key(other) < key(one)) or key(one) == key(other)


def test_members_and_paths_put_entities_in_order() -> None:
    assert ranked([{"b": 2}, {"b": 1}, {}], "a[b]") == [{"b": 1}, {"b": 2}, {}]
    assert ranked([1, 2, 3], "id;desc") == [3, 2, 1]
    assert ranked([1, 2, 3], "createdAt,id;desc") == [3, 2, 1]
    assert ranked([1, 2, 3], "type;desc,scope,a;desc") == [3, 2, 1]


def test_distances_put_entities_in_order() -> None:
    store = empty_store()
    places: dict[str, Any] = {
        "near": {"type": "Point", "coordinates": [8.01, 40.01]},
        "far": {"type": "Point", "coordinates": [10, 45]},
        "middle": {"type": "LineString", "coordinates": [[9, 41], [9, 42]]},
    }
    for number, value in enumerate(places.values()):
        store.take(thing(number, number + 1, None, location={"type": "GeoProperty", "value": value}))
    store.take(thing(9, 9))

    def ids(direction: str) -> str:
        order = ordering({"orderBy": f"location;{direction}", "orderFrom": "[8,40]"}, expand)
        return "".join(one.id[-1] for one in look(store, Window(0, 9, False), order).entities)

    assert ids("dist-asc") == "0219"
    assert ids("dist-desc") == "1209"


@pytest.mark.parametrize(
    ("given_ordering", "word"),
    [
        ({"orderBy": []}, "orderBy"),
        ({"orderBy": "name"}, "orderBy"),
        ([], "object"),
        ({"orderBy": ["a;dist-asc"]}, "orderFrom"),
        ({"orderBy": ["a;dist-asc"], "coordinates": "8,40"}, "list"),
        ({"orderBy": ["id"], "geometry": 5}, "geometry"),
        ({"orderBy": ["id"], "collation": 5}, "collation"),
        ({"orderBy": ["id"], "colation": "und"}, "colation"),
        ({"orderBy": ["id"] * 20}, "allowed"),
        ({"orderBy": ["a["]}, "expected"),
        ({"orderBy": ["a{b}"]}, "expected the name"),
        ({"orderBy": ["a;sideways"]}, "direction"),
    ],
)
def test_an_invalid_order_is_refused(given_ordering: Any, word: str) -> None:
    with pytest.raises(Problem, match=word) as refused:
        ordering_document(given_ordering, expand)
    assert refused.value.status == 400


def test_long_texts_fit_into_the_way_to_the_next_page() -> None:
    store = empty_store()
    for number in range(4):
        store.take(thing(number, number + 1, "\U0001f600" * 5000 + str(9 - number)))
    order = ordering({"orderBy": ",".join(["a"] * 10)}, expand)
    window: Window | None = Window(0, 1, False)
    seen: list[str] = []
    while window is not None:
        page = look(store, window, order)
        seen += [one.id for one in page.entities]
        window = following(page, 1, forwards=True)
    assert seen == [f"urn:x:{number}" for number in range(4)]
