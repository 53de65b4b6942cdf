"""Conditions on how entities have been, where one entity's past may be spread over several sources (5.7.4.4).

A condition on one attribute must not hide what another source has of the same entity: everybody is asked
without conditions, and those are looked at once the evolutions are whole.
"""

from collections.abc import Awaitable, Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any, Final

import orjson

from handover.errors import Problem
from services.context_broker.api.exchange import Exchange
from services.context_broker.distribution import evolutions
from services.context_broker.distribution.distribution import Performing, Sources, in_place_of
from services.context_broker.distribution.evolutions import Evolution
from services.context_broker.distribution.fetching_past import (
    SHOWING,
    Asking,
    Part,
    Wish,
    ask_source,
    edge_of,
    plain,
    values_of,
)
from services.context_broker.distribution.questions import FILTERS
from services.context_broker.entities.entity import Entity, Instance
from services.context_broker.entities.intake import expand, read_attribute
from services.context_broker.queries.query_document import selectors_of
from services.context_broker.queries.reading import LARGEST_LIMIT, selection_of
from services.context_broker.queries.selection import Selection
from services.context_broker.sources.registration import Match, Registration
from services.context_broker.temporal.query import TIME_PARAMETERS

MOST_PAGES: Final = 20
"""Pages of a thousand entities that are read of one source."""
_CONDITIONS: Final = frozenset({"q", "geoQ", "scopeQ", "expandValues", "jsonKeys"})
"""Members of a Query document that are conditions."""
_IN_DOCUMENTS: Final = _CONDITIONS | {"aggrParams", "attrs", "datasetId", "lang", *SHOWING}
_NOT_ASKED: Final = frozenset({*FILTERS, "lastN", "count", "offset", "limit", "attrs", "datasetId", "lang"})
"""What is looked at when evolutions are whole, or is about how they are shown."""
_NOT_SAID: Final = frozenset({"instanceId", "createdAt", "modifiedAt", "expiresAt"})
_TIMES: Final = ("createdAt", "modifiedAt")


async def split_hits(
    sources: Sources,
    exchange: Exchange,
    perform: Performing,
    matched: Iterable[tuple[Match, Mapping[str, str]]],
    wish: Wish,
) -> list[str]:
    """Return the ids of the entities whose evolution, put together, meets the conditions; in order."""
    asked = {name: said for name, said in wish.parameters.items() if name not in _NOT_ASKED}
    everything = replace(wish.view.view, attributes=None, projection=None, datasets=None)
    whole = Wish(wish.context, asked, replace(wish.query, last=None), replace(wish.view, view=everything))
    tellers: list[tuple[Registration | None, Asking]] = [(None, _pages_of_own(exchange, perform, wish))]
    tellers += [(match.registration, _pages_of(sources, match, wish)) for match, _ in matched]
    known: dict[str, list[evolutions.Told]] = {}
    for registration, document in await values_of(tellers, whole):
        known.setdefault(document["id"], []).append((registration, document))
    selection = _selection(exchange, wish)
    return [
        one
        for one, told in known.items()
        if selection.wants(_as_entity(evolutions.together(told, wish.context, None), wish))
    ]


def narrowed_to(exchange: Exchange, ids: list[str]) -> Exchange:
    """Return the request for these entities alone, without conditions."""
    gone = {*FILTERS, "idPattern", "count", "offset", "limit"}
    kept = {name: said for name, said in exchange.parameters.items() if name not in gone}
    shape = {"limit": str(len(ids))}
    if exchange.method == "GET":
        return in_place_of(exchange, parameters={**kept, **shape, "id": ",".join(ids)})
    document = {name: said for name, said in exchange.document().items() if name not in _CONDITIONS}
    document.pop("entityMap", None)
    document["entities"] = [
        {"id": ids, **({"type": one["type"]} if "type" in one else {})}
        for one in document.get("entities") or [{}]
    ]
    return in_place_of(exchange, parameters={**kept, **shape}, raw=orjson.dumps(document))


def _selection(exchange: Exchange, wish: Wish) -> Selection:
    any_of = () if exchange.method == "GET" else selectors_of(exchange.document(), wish.context)
    return selection_of(wish.parameters, wish.context, any_of)


def _pages_of(sources: Sources, match: Match, wish: Wish) -> Asking:
    def of_source(parameters: Mapping[str, str]) -> Awaitable[Part]:
        return ask_source(sources, match, "temporal/entities", parameters, wish.context)

    return _all_pages(of_source, wish)


def _pages_of_own(exchange: Exchange, perform: Performing, wish: Wish) -> Asking:
    async def of_own(parameters: Mapping[str, str]) -> Part:
        asked = in_place_of(exchange, parameters=parameters)
        if exchange.method == "POST":
            document = {name: said for name, said in exchange.document().items() if name not in _IN_DOCUMENTS}
            times = {name: parameters[name] for name in TIME_PARAMETERS if name in parameters}
            asked.raw = orjson.dumps({**document, "temporalQ": times})
            asked.parameters = {name: parameters[name] for name in ("options", "offset", "limit")}
        told = await perform(asked)
        return Part([plain(one) for one in orjson.loads(told.body)], edge_of(told))

    return _all_pages(of_own, wish)


def _all_pages(ask: Asking, wish: Wish) -> Asking:
    """Return how to ask for all entities, page by page."""

    async def all_of_them(parameters: Mapping[str, str]) -> Part:
        documents: dict[str, Evolution] = {}
        edges: list[int | None] = []
        for number in range(MOST_PAGES):
            window = {"offset": str(number * LARGEST_LIMIT), "limit": str(LARGEST_LIMIT)}
            part = await ask({**parameters, **window})
            before = len(documents)
            documents |= {one["id"]: one for one in part.documents}
            edges.append(part.edge)
            if len(part.documents) < LARGEST_LIMIT or len(documents) == before:
                break
        return Part(list(documents.values()), evolutions.common_edge(edges, wish.query))

    return all_of_them


def _as_entity(document: Evolution, wish: Wish) -> Entity:
    """Return an entity that holds all instances of an evolution at once, for conditions to be put to it."""
    terms = wish.context.terms
    attributes: dict[str, list[Instance]] = {}
    for name in document.keys() - evolutions.MEMBERS:
        said = document[name]
        for one in said if isinstance(said, list) else [said]:
            if not isinstance(one, dict) or "deletedAt" in one:
                continue
            given = {member: value for member, value in one.items() if member not in _NOT_SAID}
            try:
                (instance,) = read_attribute(name, given, terms)
            except (Problem, ValueError):  # which no condition can be about
                continue
            times = {member: one[member] for member in _TIMES if isinstance(one.get(member), str)}
            attributes.setdefault(expand(name, terms), []).append({**instance, **times})
    kinds = document.get("type")
    types = [kind for kind in (kinds if isinstance(kinds, list) else [kinds]) if isinstance(kind, str)]
    return Entity(
        document["id"],
        tuple(terms.expand(kind) for kind in types),
        attributes,
        str(document.get("createdAt", "")),
        str(document.get("modifiedAt", "")),
        scopes=tuple(_scopes(document.get("scope"))),
    )


def _scopes(said: Any) -> Iterator[str]:
    """Yield the scopes that an entity has had: each as it is, or in the instances of a series."""
    for one in said if isinstance(said, list) else [said]:
        told = one.get("value") if isinstance(one, dict) else one
        yield from (each for each in (told if isinstance(told, list) else [told]) if isinstance(each, str))
