"""Entities read from several sources: retrieve and query (clauses 5.7.1.4, 5.7.2.4 and 4.5.5.3).

Whoever may know something is asked for the plain data; the fragments become entities; and the room that
answers for the broker's own entities answers for these: filters, order, pages and forms are applied once, to
whole entities.
"""

import copy
import re
from collections.abc import AsyncIterator, Iterable, Mapping
from typing import Any, Final

import orjson

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
from services.context_broker.distribution.forwarding import SILENT, Question, Tongue, Unheard, quoted
from services.context_broker.distribution.gathering import Gathering
from services.context_broker.distribution.source_answers import heard, read_entities
from services.context_broker.entities.entity import Entity
from services.context_broker.entities.intake import expand
from services.context_broker.queries.patterns import pattern
from services.context_broker.queries.selection import compiled
from services.context_broker.queries.type_selection import of_types
from services.context_broker.sources.registration import Asked, Match, Registration, Where

PAGE: Final = 1000
"""Entities that a source is asked for at once."""
SMALL_PAGE: Final = 100
"""The same for a source that refuses so many."""
MOST_ENTITIES: Final = 20_000
"""Entities of one source that are read for one query; what goes beyond is warned of."""
MOST_IDS: Final = 50
"""Ids that fit into one question."""
MOST_LEVELS: Final = 10
"""Levels of linked entities that sources are asked for."""
_FILTERS: Final = ("q", "scopeQ", "georel", "geometry", "coordinates", "geoproperty")
_NEEDS_MORE: Final = (*_FILTERS, "orderBy", "join")
"""Parameters for which attributes count that are not to be shown."""
_TYPE_SIGNS: Final = re.compile(r"[,;|()]+")


async def retrieve(sources: Sources, exchange: Exchange, perform: Performing) -> Answer:
    """GET entities/{id}, from all that may know it."""
    context = await exchange.reader_context()
    entity_id = require_uri(exchange.names[0], "the entity id in the path")
    own = exchange.tenant.store.get(entity_id)
    types = _types_of(exchange.parameter("type"), context)
    if types is None and own is not None:
        types = frozenset(own.types)
    asked = Asked((entity_id,), None, types, _names_of(exchange.parameters, context))
    matches = sources.unasked(sources.registry.matching("retrieveEntity", asked))
    if not matches and (own is None or not _wants_links(exchange)):
        return await perform(exchange)
    gathering = Gathering()
    await all_of(*(_retrieve_from(sources, one, entity_id, context, gathering) for one in matches))
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


async def _retrieve_from(
    sources: Sources, match: Match, entity_id: str, context: Context, into: Gathering
) -> None:
    registration = match.registration
    try:
        tongue = await sources.forwarder.tongue(registration, context, body=None)
        names = match.attributes_for(entity_id)
        parameters = [("attrs", _joined(names, tongue))] if names is not None else []
        parameters.append(("options", "sysAttrs"))
        question = Question("GET", f"entities/{quoted(entity_id)}", tongue, tuple(parameters))
        reply = await heard(sources, registration, question)
        if reply is not None:
            into.add(registration, await read_entities(sources, registration, reply, tongue, single=True))
    except Unheard as unheard:
        sources.note(unheard)
    except Problem as problem:  # its @context
        sources.note(Unheard(registration, SILENT, 502, problem.detail))


async def query(sources: Sources, exchange: Exchange, perform: Performing) -> Answer:
    """GET entities, and entities of all that may know some."""
    context = await exchange.reader_context()
    return await _query(sources, exchange, perform, context, [dict(exchange.parameters)])


async def query_by_method(sources: Sources, exchange: Exchange, perform: Performing) -> Answer:
    """GET or POST entityMaps, which ask as the two queries do (clause 5.14.4)."""
    ask = query if exchange.method == "GET" else query_batch
    return await ask(sources, exchange, perform)


async def query_batch(sources: Sources, exchange: Exchange, perform: Performing) -> Answer:
    """POST entityOperations/query."""
    document, context = await exchange.body()
    if not isinstance(document, dict):
        return await perform(exchange)
    return await _query(
        sources, exchange, perform, context, list(questions_in(document, exchange.parameters))
    )


def questions_in(document: Mapping[str, Any], parameters: Mapping[str, str]) -> Iterable[dict[str, str]]:
    """Yield the parameters that a GET for the same, or for one of its selectors, would have."""
    plain = {name: said for name, said in {**parameters, **document}.items() if isinstance(said, str)}
    for name in ("attrs", "pick", "omit"):
        if isinstance(document.get(name), list):
            plain[name] = ",".join(str(one) for one in document[name])
    geo = document.get("geoQ")
    if isinstance(geo, dict):
        for name in ("georel", "geometry", "geoproperty", "coordinates"):
            if name in geo:
                said = geo[name]
                plain[name] = said if isinstance(said, str) else orjson.dumps(said).decode()
    plain.pop("type", None)  # which is that of the document, "Query"
    selectors = document.get("entities")
    if not isinstance(selectors, list) or not selectors:
        yield plain
        return
    for one in selectors:
        if isinstance(one, dict):
            yield {
                **plain,
                **{
                    name: said if isinstance(said, str) else ",".join(str(part) for part in said)
                    for name, said in one.items()
                    if isinstance(said, str | list)
                },
            }


async def _query(
    sources: Sources,
    exchange: Exchange,
    perform: Performing,
    context: Context,
    questions: list[dict[str, str]],
) -> Answer:
    gathering = Gathering()
    proxied: dict[str, Registration] = {}
    asked_of: list[Any] = []
    wanted: list[Asked] = []
    for parameters in questions:
        asked, where = asked_by(parameters, context, _names_of(parameters, context))
        wanted.append(asked)
        matches = sources.unasked(sources.registry.matching("queryEntity", asked, where))
        is_split = _is_split(parameters, matches)
        for match in matches:
            if match.registration.mode.is_proxied:
                proxied[match.registration.id] = match.registration
            asked_of.append(_query_from(sources, match, parameters, context, gathering, is_split=is_split))
    wants_links = _wants_links(exchange)
    if not asked_of and not wants_links:
        return await perform(exchange)
    await all_of(*asked_of)
    ids = None if any(one.ids is None for one in wanted) else [i for one in wanted for i in one.ids or ()]
    types = (
        None if any(one.types is None for one in wanted) else [t for one in wanted for t in one.types or ()]
    )
    store = exchange.tenant.store
    claims = list(proxied.values())
    touched = set(gathering.fragments)
    if claims or wants_links:
        own = store.candidates(ids, None if types is None else of_types(types))
        touched |= {one.id for one in (own if claims else own[:PAGE])}
    others = {one: gathering.entity(store.get(one), one, claims) for one in touched}
    await _add_linked(sources, exchange, context, others)
    mix = store.mixed(ids, None if ids is not None else types, others)
    mix.origins = gathering.origins(store)
    return await perform(_over(exchange, mix))


async def _query_from(
    sources: Sources,
    match: Match,
    parameters: Mapping[str, str],
    context: Context,
    into: Gathering,
    *,
    is_split: bool,
) -> None:
    registration = match.registration
    try:
        tongue = await sources.forwarder.tongue(registration, context, body=None)
        for given in _narrowed(match, parameters, context, tongue, is_split=is_split):
            async for entities in _pages(sources, registration, tongue, given):
                into.add(registration, entities)
    except Unheard as unheard:
        sources.note(unheard)
    except Problem as problem:
        sources.note(Unheard(registration, SILENT, 502, problem.detail))


async def _pages(
    sources: Sources, registration: Registration, tongue: Tongue, given: list[tuple[str, str]]
) -> AsyncIterator[list[Entity]]:
    """Yield all that a source answers to one question, page by page."""
    small = sources.forwarder.small_pages
    offset = 0
    while offset < MOST_ENTITIES:
        limit = SMALL_PAGE if registration.endpoint in small else PAGE
        paged = [*given, ("limit", str(limit))] + ([("offset", str(offset))] if offset else [])
        try:
            reply = await heard(sources, registration, Question("GET", "entities", tongue, tuple(paged)))
        except Unheard as unheard:
            if unheard.answered not in {400, 403} or offset or limit == SMALL_PAGE:
                raise
            small.add(registration.endpoint)
            continue
        if reply is None:
            return
        entities = await read_entities(sources, registration, reply, tongue)
        yield entities
        if len(entities) < limit:
            return
        offset += limit
    sources.warn(SILENT, f"{registration.endpoint} has more than {MOST_ENTITIES} entities of these")


def _narrowed(
    match: Match, parameters: Mapping[str, str], context: Context, tongue: Tongue, *, is_split: bool
) -> Iterable[list[tuple[str, str]]]:
    """Yield the questions to ask a source: for those entities and attributes that it is registered for."""
    groups: dict[tuple[bool, frozenset[str] | None], tuple[dict[str, None], set[str], bool]] = {}
    for part in match.parts:
        ids, types, any_type = groups.get((part.ids is None, part.attributes), ({}, set(), False))
        ids.update(dict.fromkeys(part.ids or ()))
        types |= part.types or set()
        groups[part.ids is None, part.attributes] = ids, types, any_type or part.types is None
    filters: list[tuple[str, str]] = []
    if not is_split and tongue.context is context:
        filters = [(name, parameters[name]) for name in _FILTERS if name in parameters]
    for (_, names), (ids, asked_types, any_type) in groups.items():
        types = asked_types
        if any_type:
            types = set() if ids else _types_at(match.registration)
        plain = [("type", ",".join(sorted(tongue.name(kind) for kind in types)))] if types else []
        if not ids and "idPattern" in parameters:
            plain.append(("idPattern", parameters["idPattern"]))
        if names is not None:
            plain.append(("attrs", _joined(names, tongue)))
        plain += [*filters, ("options", "sysAttrs")]
        listed = list(ids)
        for start in range(0, max(1, len(listed)), MOST_IDS):
            some = listed[start : start + MOST_IDS]
            yield [*plain, ("id", ",".join(some))] if some else plain


def _types_at(registration: Registration) -> set[str]:
    return {kind for piece in registration.information for one in piece.entities for kind in one.types}


def _is_split(parameters: Mapping[str, str], matches: list[Match]) -> bool:
    """Say whether one entity may be told by several sources, each a part, so that filters must wait.

    The standard leaves it to the deployment where splitEntities is not given (clause 5.7.2.4). Here entities
    are taken to be split where a registration names attributes: then its source has a part of them.
    """
    given = parameters.get("splitEntities")
    if given is not None:
        return given == "true"
    return any(piece.attributes is not None for one in matches for piece in one.registration.information)


def asked_by(
    parameters: Mapping[str, str], context: Context, names: frozenset[str] | None
) -> tuple[Asked, Where | None]:
    """Return what query parameters ask for, of which the attributes `names` (None for all), and of whom."""
    ids, wanted, csf = parameters.get("id"), parameters.get("idPattern"), parameters.get("csf")
    asked = Asked(
        tuple(dict.fromkeys(ids.split(","))) if ids else None,
        pattern(wanted) if wanted else None,
        _types_of(parameters.get("type"), context),
        names,
    )
    if not csf:
        return asked, None
    holds = compiled(csf, context).holds
    return asked, lambda registration: holds(registration.described)


def _types_of(given: str | None, context: Context) -> frozenset[str] | None:
    names = [one.strip() for one in _TYPE_SIGNS.split(given or "") if one.strip()]
    return frozenset(context.terms.expand(one) for one in names) if names else None


def _names_of(parameters: Mapping[str, str], context: Context) -> frozenset[str] | None:
    """Return the attributes that the answer needs, None if that may be all."""
    given = parameters.get("attrs") or parameters.get("pick")
    if not given or any(name in parameters for name in _NEEDS_MORE) or not _PLAIN_NAMES.fullmatch(given):
        return None
    names = [one for one in given.split(",") if one not in {"id", "type", "scope"}]
    return frozenset(expand(one, context.terms) for one in names) or None


_PLAIN_NAMES: Final = re.compile(r"[^{}()\[\].|;]+")


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
        matches = sources.unasked(sources.registry.matching("queryEntity", asked))
        await all_of(
            *(_query_from(sources, match, {}, context, gathering, is_split=True) for match in matches)
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


def _joined(names: frozenset[str], tongue: Tongue) -> str:
    return ",".join(sorted(tongue.name(one) for one in names))


def _over(exchange: Exchange, mix: Any) -> Exchange:
    """Return the exchange with the mix in the place of the tenant's own entities."""
    tenant = copy.copy(exchange.tenant)
    tenant.store = mix
    return in_place_of(exchange, tenant=tenant)
