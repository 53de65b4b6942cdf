"""Fetching: entities read from one source, by whichever operation it takes (clauses 4.20, 5.7.1.4, 5.7.2.4).

A source is asked for those entities and attributes that it is registered for. What goes wrong is noted, for
those who get an answer all the same.
"""

import re
import time
from collections.abc import AsyncIterator, Iterable, Mapping
from dataclasses import replace
from typing import Any, Final

import orjson

from handover.errors import Problem
from services.context_broker.federation.distribution.distributed_operations import Sources, gather_all
from services.context_broker.federation.distribution.forwarding import (
    SILENT,
    SourceDialect,
    SourceError,
    SourceRequest,
    quoted,
)
from services.context_broker.federation.distribution.fragment_collector import FragmentCollector
from services.context_broker.federation.distribution.query_targets import FILTERS
from services.context_broker.federation.distribution.source_responses import query_source, read_entities
from services.context_broker.federation.registrations.registration import (
    EntityTarget,
    Match,
    Registration,
    SourceFilter,
)
from services.context_broker.model.context import Context
from services.context_broker.model.entity import Entity
from services.context_broker.network.http_client import HttpResponse
from services.context_broker.request.request_context import JSON

ONE: Final = ("retrieveEntity", "queryEntity", "queryBatch")
"""Operations by which one entity can be read, the best first."""
MANY: Final = ("queryEntity", "queryBatch", "retrieveEntity")
"""Operations by which many can be read; the last only where it is known which."""
PAGE: Final = 1000
"""Entities that a source is asked for at once."""
SMALL_PAGE: Final = 100
"""The same for a source that refuses so many."""
MAX_ENTITIES: Final = 20_000
"""Entities of one source that are read for one query; what goes beyond is warned of."""
MAX_TIMEOUTS: Final = 5
"""All pages of a source together may take so many times what one may."""
MAX_IDS: Final = 50
"""Ids that fit into one question."""
MAX_CONCURRENT_REQUESTS: Final = 16
"""Requests under way to one source that takes them one by one."""
_NEXT: Final = re.compile(r'rel\s*=\s*"?next\b')
_GEO: Final = ("georel", "geometry", "geoproperty")


def queryable_matches(
    sources: Sources,
    target: EntityTarget,
    where: SourceFilter | None = None,
    *,
    uses_map: bool = True,
    or_takes: str | None = None,
) -> list[Match]:
    """Return the matches whose sources can be asked for entities, or take another operation that will do."""
    operations = MANY if or_takes is None else (*MANY, or_takes)
    found = sources.unvisited(sources.registry.matching(operations, target, where), uses_map=uses_map)
    return [
        one
        for one in found
        if is_queryable(one) or (or_takes is not None and one.registration.takes(or_takes))
    ]


def is_queryable(match: Match) -> bool:
    """Say whether a source takes an operation by which what is asked for can be read."""
    takes = match.registration.takes
    return takes(MANY[0]) or takes(MANY[1]) or (takes(MANY[2]) and match.ids is not None)


async def fetch_entity(
    sources: Sources, match: Match, entity_id: str, context: Context, into: FragmentCollector
) -> None:
    """Read what a source has of one entity."""
    registration = match.registration
    if not registration.takes("retrieveEntity"):
        found = Match(registration, tuple(replace(part, ids=(entity_id,)) for part in match.parts))
        await fetch_entities(sources, found, {}, context, into, is_split=True)
        return
    try:
        dialect = await sources.forwarder.dialect(registration, context, body=None)
        names = match.attributes_for(entity_id)
        parameters = [("attrs", joined_names(names, dialect))] if names is not None else []
        parameters.append(("options", "sysAttrs"))
        request = SourceRequest("GET", f"entities/{quoted(entity_id)}", dialect, tuple(parameters))
        response = await _query_source_by_map(sources, registration, request)
        if response is not None:
            into.add(registration, await read_entities(sources, registration, response, dialect, single=True))
    except SourceError as error:
        sources.add_error(error)
    except Problem as problem:  # its @context
        sources.add_error(SourceError(registration, SILENT, 502, problem.detail))


async def fetch_entities(
    sources: Sources,
    match: Match,
    parameters: Mapping[str, str],
    context: Context,
    into: FragmentCollector,
    *,
    is_split: bool,
) -> None:
    """Read what a source has of many entities. `is_split`: conditions wait until they are put together."""
    registration = match.registration
    operation = next(name for name in MANY if registration.takes(name))
    if operation == "retrieveEntity":
        for start in range(0, len(match.ids or ()), MAX_CONCURRENT_REQUESTS):
            some = (match.ids or ())[start : start + MAX_CONCURRENT_REQUESTS]
            await gather_all(*(fetch_entity(sources, match, one, context, into) for one in some))
        return
    body = JSON if operation == "queryBatch" else None
    try:
        dialect = await sources.forwarder.dialect(registration, context, body=body)
        for given in narrowed(match, parameters, context, dialect, is_split=is_split):
            async for entities in _pages(sources, registration, dialect, given, operation):
                into.add(registration, entities)
    except SourceError as error:
        sources.add_error(error)
    except Problem as problem:
        sources.add_error(SourceError(registration, SILENT, 502, problem.detail))


async def _pages(
    sources: Sources,
    registration: Registration,
    dialect: SourceDialect,
    given: list[tuple[str, str]],
    operation: str,
) -> AsyncIterator[list[Entity]]:
    """Yield all that a source answers to one question, page by page."""
    small = sources.forwarder.small_pages
    offset, seen = 0, set[str]()
    until_s = time.monotonic() + MAX_TIMEOUTS * sources.forwarder.patience_s(registration)
    while offset < MAX_ENTITIES:
        if time.monotonic() > until_s:
            sources.add_warning(SILENT, f"{registration.endpoint} takes too long to tell of all its entities")
            return
        limit = SMALL_PAGE if registration.endpoint in small else PAGE
        paged = [*given, ("limit", str(limit))] + ([("offset", str(offset))] if offset else [])
        try:
            request = _question(operation, dialect, paged)
            response = await _query_source_by_map(sources, registration, request)
        except SourceError as error:
            if error.answered not in {400, 403} or offset or limit == SMALL_PAGE:
                raise
            small.add(registration.endpoint)
            continue
        if response is None:
            return
        entities = await read_entities(sources, registration, response, dialect)
        yield entities
        known = len(seen)
        seen.update(one.id for one in entities)
        if len(seen) == known:  # one that does not know pages begins again and again
            return
        if len(entities) < limit and not _NEXT.search(response.headers.get("link", "")):
            return
        offset += len(entities)
    sources.add_warning(SILENT, f"{registration.endpoint} has more than {MAX_ENTITIES} entities of these")


def narrowed(
    match: Match, parameters: Mapping[str, str], context: Context, dialect: SourceDialect, *, is_split: bool
) -> Iterable[list[tuple[str, str]]]:
    """Yield the questions to ask a source: for those entities and attributes that it is registered for."""
    groups: dict[tuple[bool, frozenset[str] | None], tuple[dict[str, None], set[str], bool]] = {}
    for part in match.parts:
        ids, types, any_type = groups.get((part.ids is None, part.attributes), ({}, set(), False))
        ids.update(dict.fromkeys(part.ids or ()))
        types |= part.types or set()
        groups[part.ids is None, part.attributes] = ids, types, any_type or part.types is None
    filters: list[tuple[str, str]] = []
    if not is_split and dialect.context is context:
        filters = [(name, parameters[name]) for name in FILTERS if name in parameters]
    for (_, names), (ids, asked_types, any_type) in groups.items():
        types = asked_types
        if any_type:
            types = set() if ids else _types_at(match.registration)
        plain = [("type", ",".join(sorted(dialect.name(kind) for kind in types)))] if types else []
        if not ids and "idPattern" in parameters:
            plain.append(("idPattern", parameters["idPattern"]))
        if names is not None:
            plain.append(("attrs", joined_names(names, dialect)))
        plain += [*filters, ("options", "sysAttrs")]
        listed = list(ids)
        for start in range(0, max(1, len(listed)), MAX_IDS):
            some = listed[start : start + MAX_IDS]
            yield [*plain, ("id", ",".join(some))] if some else plain


def _types_at(registration: Registration) -> set[str]:
    return {kind for piece in registration.information for one in piece.entities for kind in one.types}


async def _query_source_by_map(
    sources: Sources, registration: Registration, request: SourceRequest
) -> HttpResponse | None:
    """Ask a source by its own entity map if it has one; without, if it does not know the map any more."""
    headers = sources.map_headers(registration)
    if headers:
        response = await query_source(sources, registration, replace(request, headers=headers))
        if response is not None:
            return response
    return await query_source(sources, registration, request)


def _question(operation: str, dialect: SourceDialect, parameters: list[tuple[str, str]]) -> SourceRequest:
    """Return the question that parameters of a query are, as the source takes it."""
    if operation == "queryEntity":
        return SourceRequest("GET", "entities", dialect, tuple(parameters))
    given = dict(parameters)
    selector = {name: given[name] for name in ("type", "idPattern") if name in given}
    ids = given["id"].split(",") if "id" in given else []
    entities = [{"id": one, **selector} for one in ids] or ([selector] if selector else [])
    document: dict[str, Any] = {"type": "Query", **({"entities": entities} if entities else {})}
    for name in ("attrs", "expandValues", "jsonKeys"):
        if name in given:
            document[name] = given[name].split(",")
    document |= {name: given[name] for name in ("q", "scopeQ") if name in given}
    if "georel" in given:
        coordinates = orjson.loads(given["coordinates"])
        document["geoQ"] = {"coordinates": coordinates, **{one: given[one] for one in _GEO if one in given}}
    rest = tuple((name, given[name]) for name in ("options", "limit", "offset") if name in given)
    return SourceRequest("POST", "entityOperations/query", dialect, rest, document)


def joined_names(names: frozenset[str], dialect: SourceDialect) -> str:
    """Return names of attributes as a parameter has them for a source."""
    return ",".join(sorted(dialect.name(one) for one in names))
