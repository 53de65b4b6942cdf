"""Which entities a reader or a subscriber wants: by id, pattern of id, type, attributes and query.

Clauses 4.9, 4.17 and 5.7.2. An index answers what it can; the rest is looked at one by one.
"""

import asyncio
import re
from collections import OrderedDict
from dataclasses import dataclass, field
from typing import Final

from services.context_broker.contexts import Context
from services.context_broker.entity import Entity
from services.context_broker.patterns import fits
from services.context_broker.q_grammar import parse
from services.context_broker.q_match import Equality, Predicate, equality, predicate
from services.context_broker.store import Store

CHUNK: Final = 2000
"""Entities looked at before others get their turn."""
MOST_QUERIES: Final = 1000


@dataclass(frozen=True, slots=True)
class Query:
    """A compiled `q`."""

    holds: Predicate
    equality: Equality | None


@dataclass(frozen=True, slots=True)
class Selection:
    """What is wanted; an absent part (None) wants all. Types and attributes are IRIs."""

    ids: tuple[str, ...] | None = None
    id_pattern: re.Pattern[str] | None = None
    types: tuple[str, ...] | None = None
    attributes: frozenset[str] | None = None
    query: Query | None = None

    def wants(self, entity: Entity) -> bool:
        """Say whether the entity is among those wanted."""
        return (
            (self.ids is None or entity.id in self.ids)
            and (self.types is None or not set(self.types).isdisjoint(entity.types))
            and (self.attributes is None or not self.attributes.isdisjoint(entity.attributes))
            and (self.id_pattern is None or fits(self.id_pattern, entity.id))
            and (self.query is None or self.query.holds(entity))
        )


@dataclass(frozen=True, slots=True)
class Page:
    """A piece of the hits; `total` is there if it was asked for."""

    entities: list[Entity] = field(default_factory=list)
    more: bool = False
    total: int | None = None


_compiled: OrderedDict[tuple[str, int], Query] = OrderedDict()


def compiled(text: str, context: Context) -> Query:
    """Return `text` compiled with the names of `context`; what is asked again is not compiled again."""
    key = (text, context.key)
    query = _compiled.get(key)
    if query is None:
        term = parse(text)
        expand = context.terms.expand
        query = _compiled[key] = Query(predicate(term, expand), equality(term, expand))
        if len(_compiled) > MOST_QUERIES:
            _compiled.popitem(last=False)
    return query


async def search(store: Store, selection: Selection, offset: int, limit: int, *, count: bool) -> Page:
    """Return the hits from `offset` on, at most `limit`, in the order of their creation."""
    by_index = selection.query.equality if selection.query else None
    candidates = store.candidates(selection.ids, selection.types, by_index)
    wanted = offset + limit
    hits: list[Entity] = []
    seen = 0
    for start in range(0, len(candidates), CHUNK):
        if start:
            await asyncio.sleep(0)
        for entity in candidates[start : start + CHUNK]:
            if selection.wants(entity):
                seen += 1
                if offset < seen <= wanted:
                    hits.append(entity)
                elif seen > wanted and not count:
                    return Page(hits, more=True)
    return Page(hits, seen > wanted, seen if count else None)
