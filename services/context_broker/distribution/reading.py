"""Entities read from several sources: retrieve and query (clauses 5.7.1.4, 5.7.2.4 and 4.5.5.3).

Whoever may know something is asked for the plain data; the fragments become entities; and the room that
answers for the broker's own entities answers for these: filters, pages and forms are applied once, to
whole entities.
"""

import copy
from collections import Counter
from collections.abc import Iterable
from typing import Any, Final

from handover.errors import Problem
from services.context_broker.api.exchange import Answer, Exchange, problem_answer
from services.context_broker.api.words import require_uri
from services.context_broker.contexts.book import Context
from services.context_broker.distribution.distribution import (
    Performing,
    Sources,
    all_of,
    gateway_problem,
    in_place_of,
)
from services.context_broker.distribution.fetching import ONE, answering, fetch_many, fetch_one
from services.context_broker.distribution.gathering import Gathering
from services.context_broker.distribution.mapping import MAKES, Mapper
from services.context_broker.distribution.questions import (
    asked_by,
    may_be_split,
    names_of,
    questions_in,
    refuse_order,
    types_of,
    where_of,
)
from services.context_broker.entities.entity import Entity
from services.context_broker.queries.reading import datasets_of
from services.context_broker.queries.type_selection import of_types
from services.context_broker.sources.reach import Reach
from services.context_broker.sources.registration import Asked, Match

MOST_LINKING: Final = 1000
"""Of so many of the broker's own entities the links are followed to other sources."""
MOST_LEVELS: Final = 10
"""Levels of linked entities that sources are asked for."""


async def retrieve(sources: Sources, exchange: Exchange, perform: Performing) -> Answer:
    """GET entities/{id}, from all that may know it."""
    context = await exchange.reader_context()
    entity_id = require_uri(exchange.names[0], "the entity id in the path")
    own = exchange.tenant.store.get(entity_id)
    types = types_of(exchange.parameter("type"), context)
    if types is None and own is not None:
        types = frozenset(own.types)
    asked = Asked((entity_id,), None, types, names_of(exchange.parameters, context))
    datasets = Reach(datasets=datasets_of(exchange.parameter("datasetId")))
    matches = sources.unasked(sources.registry.matching(ONE, asked, where_of(None, context, datasets)))
    if not matches and (own is None or not _wants_links(exchange)):
        return await perform(exchange)
    gathering = Gathering()
    await all_of(*(fetch_one(sources, one, entity_id, context, gathering) for one in matches))
    if exchange.elsewhere is not None:
        exchange.elsewhere.entities = gathering.origins(exchange.tenant.store)
    proxied = [one.registration for one in matches if one.registration.mode.is_proxied]
    others = {entity_id: gathering.entity(own, entity_id, proxied)}
    await _add_linked(sources, exchange, context, others)
    mix = exchange.tenant.store.mixed((entity_id,), None, others)
    try:
        return await perform(_over(exchange, mix))
    except Problem as problem:
        silent = [one for one in sources.unheard if one.registration.mode.is_proxied]
        if problem.status == 404 and silent:  # it may well be there, where nobody else can tell of it
            return problem_answer(gateway_problem(silent[0]))
        raise


async def query(sources: Sources, exchange: Exchange, perform: Performing) -> Answer:
    """GET entities, and entities of all that may know some."""
    context = await exchange.reader_context()
    return await _query(sources, exchange, perform, context, [dict(exchange.parameters)])


async def query_batch(sources: Sources, exchange: Exchange, perform: Performing) -> Answer:
    """POST entityOperations/query."""
    document, context = await exchange.body()
    if not isinstance(document, dict):
        return await perform(exchange)
    return await _query(
        sources, exchange, perform, context, list(questions_in(document, exchange.parameters))
    )


async def map_entities(sources: Sources, exchange: Exchange, perform: Performing) -> Answer:
    """GET or POST entityMaps, which ask as the two queries do (clause 5.14.4)."""
    if exchange.method == "GET":
        context, questions = await exchange.reader_context(), [dict(exchange.parameters)]
    else:
        document, context = await exchange.body()
        if not isinstance(document, dict):
            return await perform(exchange)
        questions = list(questions_in(document, exchange.parameters))
    mapper = Mapper(sources, context, exchange.parameter("entityMapLifetime"))
    return await _query(sources, exchange, perform, context, questions, mapper=mapper)


async def _query(
    sources: Sources,
    exchange: Exchange,
    perform: Performing,
    context: Context,
    questions: list[dict[str, str]],
    *,
    mapper: Mapper | None = None,
) -> Answer:
    gathering = Gathering()
    matched: list[tuple[Match, dict[str, str], bool]] = []
    wanted: list[Asked] = []
    for parameters in questions:
        asked, where = asked_by(parameters, context, names_of(parameters, context))
        wanted.append(asked)
        or_takes = None if mapper is None else MAKES
        if "orderBy" in parameters:
            refuse_order(parameters, answering(sources, asked, where, heeds_map=False, or_takes=or_takes))
        matches = answering(sources, asked, where, or_takes=or_takes)
        is_split = may_be_split(parameters, matches)
        matched += [(match, parameters, is_split) for match in matches]
    times = Counter(match.registration.id for match, _, _ in matched)
    registrations = {match.registration.id: match.registration for match, _, _ in matched}
    asked_of: list[Any] = [
        mapper.ask(match, parameters, gathering, is_split=is_split)
        if mapper is not None and times[match.registration.id] == 1  # of several maps one could be linked
        else fetch_many(sources, match, parameters, context, gathering, is_split=is_split)
        for match, parameters, is_split in matched
    ]
    wants_links = _wants_links(exchange)
    if not asked_of and not wants_links:
        return await perform(exchange)
    await all_of(*asked_of)
    ids = None if any(one.ids is None for one in wanted) else [i for one in wanted for i in one.ids or ()]
    types = (
        None if any(one.types is None for one in wanted) else [t for one in wanted for t in one.types or ()]
    )
    store = exchange.tenant.store
    claims = [one for one in registrations.values() if one.mode.is_proxied]
    touched = set(gathering.fragments)
    if claims or wants_links:
        own = store.candidates(ids, None if types is None else of_types(types))
        touched |= {one.id for one in (own if claims else own[:MOST_LINKING])}
    others = {one: gathering.entity(store.get(one), one, claims) for one in touched}
    await _add_linked(sources, exchange, context, others)
    mix = store.mixed(ids, None if ids is not None else types, others)
    mix.origins = gathering.origins(store)
    mixed = _over(exchange, mix)
    mixed.elsewhere = None if mapper is None else mapper.listed
    return await perform(mixed)


def _wants_links(exchange: Exchange) -> bool:
    return exchange.parameter("join") in {"inline", "flat"}


async def _add_linked(
    sources: Sources, exchange: Exchange, context: Context, others: dict[str, Entity | None]
) -> None:
    """Add the entities that a reader wants to have joined and that other sources may know (clause 4.5.23)."""
    if not _wants_links(exchange):
        return
    given = exchange.parameter("joinLevel") or "1"
    levels = min(int(given), MOST_LEVELS) if given.isascii() and given.isdecimal() else 1
    store = exchange.tenant.store
    edge = [one for one in others.values() if one is not None]
    for _ in range(levels):
        ids = [one for one in dict.fromkeys(_objects(edge)) if one not in others]
        if not ids:
            return
        gathering = Gathering()
        asked = Asked(ids=tuple(ids))
        matches = answering(sources, asked, heeds_map=False)
        await all_of(
            *(fetch_many(sources, match, {}, context, gathering, is_split=True) for match in matches)
        )
        proxied = [one.registration for one in matches if one.registration.mode.is_proxied]
        found = {one: gathering.entity(store.get(one), one, proxied) for one in ids}
        edge = [one for one in found.values() if one is not None]
        others.update({one.id: one for one in edge})


def _objects(entities: Iterable[Entity]) -> Iterable[str]:
    for entity in entities:
        for instances in entity.attributes.values():
            for instance in instances:
                said = instance.get("object")
                yield from said if isinstance(said, list) else [said] if isinstance(said, str) else ()
                for one in instance.get("objectList") or ():
                    if isinstance(one, dict) and isinstance(one.get("object"), str):
                        yield one["object"]


def _over(exchange: Exchange, mix: Any) -> Exchange:
    """Return the exchange with the mix in the place of the tenant's own entities."""
    tenant = copy.copy(exchange.tenant)
    tenant.store = mix
    return in_place_of(exchange, tenant=tenant)
