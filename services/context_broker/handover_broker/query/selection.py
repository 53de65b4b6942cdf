"""Selections of entities: by id, type, attributes, query, scope and geometry.

Clauses 4.9, 4.10, 4.17, 4.19 and 5.7.2. Indexes narrow the candidates; the rest is evaluated for each entity.
"""

import asyncio
import heapq
import time
from bisect import bisect_left, bisect_right
from collections import OrderedDict
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Protocol

from handover_broker.model.context import Context
from handover_broker.model.entity import Entity
from handover_broker.model.problems import bad_request_data
from handover_broker.query.geo_query import GeoQuery
from handover_broker.query.indexes.q_index import Condition, conditions
from handover_broker.query.ordering import Ordering
from handover_broker.query.pages import PagePosition, Window
from handover_broker.query.patterns import Pattern, fits
from handover_broker.query.q_grammar import parse, paths
from handover_broker.query.q_match import ENTITY_TIMES, Lookup, Predicate, no_lookup, predicate
from handover_broker.query.scope_query import ScopeQuery
from handover_broker.query.type_selection import TypeSelection

CHUNK: Final = 256
"""Entities that are evaluated before the elapsed time is checked."""
TURN_S: Final = 0.004
"""How long a query runs before other tasks do: notifications must not wait longer."""
MAX_QUERIES: Final = 1000


class EntityStore(Protocol):
    """Where entities are searched; candidates come in the order of creation."""

    def get(self, entity_id: str) -> Entity | None:
        """Return an entity."""

    def candidates(
        self,
        ids: Iterable[str] | None = None,
        types: TypeSelection | None = None,
        conditions: Iterable[Condition] = (),
        places: GeoQuery | None = None,
    ) -> list[Entity]:
        """Return entities among which all hits are; an argument that is None does not narrow them."""


@dataclass(frozen=True, slots=True)
class Query:
    """A compiled `q`.

    `conditions` are fulfilled by every hit; `hops` is the number of relationships that it follows;
    `names_attributes` is true if it uses anything but the times that every entity has.
    """

    holds: Predicate
    conditions: tuple[Condition, ...] = ()
    hops: int = 0
    names_attributes: bool = True


@dataclass(frozen=True, slots=True)
class Selection:
    """A selection; a part that is None matches all. Attributes are IRIs.

    If `any_of` is not empty, an entity has to match one of its selections too.
    """

    ids: tuple[str, ...] | None = None
    id_pattern: Pattern | None = None
    types: TypeSelection | None = None
    attributes: frozenset[str] | None = None
    query: Query | None = None
    scopes: ScopeQuery | None = None
    places: GeoQuery | None = None
    any_of: tuple["Selection", ...] = ()

    def wants(self, entity: Entity, lookup: Lookup = no_lookup) -> bool:
        """Return whether the entity matches; `lookup` finds linked entities."""
        return all(question(entity, lookup) for question in self.questions())

    def questions(self) -> list[Predicate]:
        """Return the predicates that all have to be true, the fast ones first."""
        predicates: list[Predicate] = []
        ids, types, names, wanted = self.ids, self.types, self.attributes, self.id_pattern
        scopes, places, any_of = self.scopes, self.places, self.any_of
        if ids is not None:
            id_set = frozenset(ids)
            predicates.append(lambda entity, _=no_lookup: entity.id in id_set)
        if types is not None and not types.is_every:
            predicates.append(lambda entity, _=no_lookup: types.wants(entity.types))
        if names is not None:
            predicates.append(lambda entity, _=no_lookup: not names.isdisjoint(entity.attributes))
        if wanted is not None:
            predicates.append(lambda entity, _=no_lookup: fits(wanted, entity.id))
        if self.query is not None:
            predicates.append(self.query.holds)
        if scopes is not None:
            predicates.append(lambda entity, _=no_lookup: scopes.wants(entity.scopes))
        if places is not None:
            predicates.append(lambda entity, _=no_lookup: places.wants(entity))
        if any_of:
            ways = [selection.questions() for selection in any_of]
            predicates.append(
                lambda entity, lookup=no_lookup: any(
                    all(question(entity, lookup) for question in way) for way in ways
                )
            )
        return predicates


@dataclass(frozen=True, slots=True)
class Page:
    """A page of hits; `total` is set if it was requested.

    `more` and `before` are true if there are hits after and before it; `first` and `last` are the positions
    at its ends.
    """

    entities: list[Entity] = field(default_factory=list)
    more: bool = False
    total: int | None = None
    before: bool = False
    first: PagePosition | None = None
    last: PagePosition | None = None


_Placed = tuple[tuple[Any, ...], Entity]

_compiled: OrderedDict[tuple[str, int, Collection[str]], Query] = OrderedDict()


def compiled(text: str, context: Context, expanded: frozenset[str] = frozenset(), what: str = "q") -> Query:
    """Return the compiled `text` with the names of `context`; recent ones are cached.

    The values of the attributes `expanded` (short names) are terms of the @context (expandValues). Raises a
    problem (400) that names `what`, with the position and the cause of a syntax error.
    """
    key = (text, context.key, expanded)
    query = _compiled.get(key)
    if query is None:
        term = parse(text, expanded, what)
        expand = context.terms.expand
        ways = list(paths(term))
        query = _compiled[key] = Query(
            predicate(term, expand),
            conditions(term, expand),
            max(path.hops for path in ways),
            any(path.names[0] not in ENTITY_TIMES for path in ways),
        )
        if len(_compiled) > MAX_QUERIES:
            _compiled.popitem(last=False)
    return query


async def search(
    store: EntityStore, selection: Selection, window: Window, order: Ordering | None = None
) -> Page:
    """Return the hits in `window`, in the order of creation or in `order`."""
    candidates = store.candidates(*_narrowed(selection))
    if order is not None:
        return await _ordered(store, selection, window, candidates, order)
    place = window.place
    if place is not None and place.is_end:
        return await _backwards(store, selection, window, candidates, place)
    start, offset = 0, window.offset
    if place is not None:
        start, offset = bisect_right(candidates, place.seq, key=_seq), 0
    most = None if window.count else offset + window.limit + 1
    hits = await _hits(store, selection, candidates[start:] if start else candidates, most)
    page = hits[offset : offset + window.limit]
    total = len(hits)
    if window.count and start:
        total += len(await _hits(store, selection, candidates[:start]))
    return Page(
        page,
        len(hits) > offset + window.limit,
        total if window.count else None,
        place is not None or window.offset > 0,
        PagePosition(page[0].seq, (), is_end=True) if page else _turned(place),
        PagePosition(page[-1].seq) if page else None,
    )


async def hits_of(store: EntityStore, selection: Selection, most: int | None = None) -> list[Entity]:
    """Return all hits, or the first `most` of them, in the order of creation."""
    return await _hits(store, selection, store.candidates(*_narrowed(selection)), most)


async def _backwards(
    store: EntityStore, selection: Selection, window: Window, candidates: list[Entity], place: PagePosition
) -> Page:
    end, limit = bisect_left(candidates, place.seq, key=_seq), window.limit
    hits = await _hits(store, selection, candidates[:end][::-1], None if window.count else limit + 1)
    page = hits[:limit][::-1]
    total = len(hits) + len(await _hits(store, selection, candidates[end:])) if window.count else None
    first = PagePosition(page[0].seq, (), is_end=True) if page else None
    last = PagePosition(page[-1].seq) if page else _turned(place)
    return Page(page, True, total, len(hits) > limit, first, last)


async def _ordered(
    store: EntityStore, selection: Selection, window: Window, candidates: list[Entity], order: Ordering
) -> Page:
    """Return a page of ordered hits, without sorting more than the page needs."""
    place, limit = window.place, window.limit
    border = None if place is None else _border(order, place)
    hits = await _hits(store, selection, candidates)
    placed: list[_Placed] = []
    began_s = time.perf_counter()
    for start in range(0, len(hits), CHUNK):
        began_s = await _yield_to_others(began_s)
        for entity in hits[start : start + CHUNK]:
            at = order.place_of(entity)
            if border is None or (at < border if place and place.is_end else at > border):
                placed.append((at, entity))
    if place is not None and place.is_end:
        chosen = heapq.nlargest(limit + 1, placed, key=_at)
        before, more = len(chosen) > limit, True
        page = chosen[:limit][::-1]
    else:
        offset = 0 if place is not None else window.offset
        page = heapq.nsmallest(offset + limit + 1, placed, key=_at)[offset:]
        more, before = len(page) > limit, place is not None or offset > 0
        page = page[:limit]
    entities = [entity for _, entity in page]
    first = last = _turned(place)
    if entities:
        first = PagePosition(entities[0].seq, order.sort_key(entities[0]), is_end=True)
        last = PagePosition(entities[-1].seq, order.sort_key(entities[-1]))
    return Page(entities, more, len(hits) if window.count else None, before, first, last)


def _border(order: Ordering, place: PagePosition) -> tuple[Any, ...]:
    try:
        return order.place(place.sort_key, place.seq)
    except (LookupError, TypeError, ValueError):
        raise bad_request_data(
            "place is not from a Link header of this broker; leave it out to start again"
        ) from None


async def _hits(
    store: EntityStore, selection: Selection, candidates: Sequence[Entity], most: int | None = None
) -> list[Entity]:
    """Return the candidates that match, or the first `most` of them."""
    lookup, questions = store.get, selection.questions()
    hits: list[Entity] = []
    began_s = time.perf_counter()
    for start in range(0, len(candidates), CHUNK):
        if start:
            began_s = await _yield_to_others(began_s)
        for entity in candidates[start : start + CHUNK]:
            for question in questions:  # no helper functions: this is the innermost loop of a query
                if not question(entity, lookup):
                    break
            else:
                hits.append(entity)
                if len(hits) == most:
                    return hits
    return hits


async def _yield_to_others(began_s: float) -> float:
    """Let other tasks run if it is time; return when this one resumed."""
    if time.perf_counter() - began_s < TURN_S:
        return began_s
    await asyncio.sleep(0)
    return time.perf_counter()


def _narrowed(
    selection: Selection,
) -> tuple[tuple[str, ...] | None, TypeSelection | None, tuple[Condition, ...], GeoQuery | None]:
    """Return what the indexes narrow the candidates by."""
    ids, types = selection.ids, selection.types
    if selection.any_of:
        if all(part.ids is not None for part in selection.any_of):
            ids = tuple(entity_id for part in selection.any_of for entity_id in part.ids or ())
        if all(part.types is not None for part in selection.any_of):
            types = TypeSelection(
                tuple(kinds for part in selection.any_of if part.types for kinds in part.types.alternatives)
            )
    return ids, types, selection.query.conditions if selection.query else (), selection.places


def _turned(place: PagePosition | None) -> PagePosition | None:
    """Return the same position for the other direction."""
    return None if place is None else PagePosition(place.seq, place.sort_key, not place.is_end)


def _seq(entity: Entity) -> int:
    return entity.seq


def _at(placed: _Placed) -> tuple[Any, ...]:
    return placed[0]
