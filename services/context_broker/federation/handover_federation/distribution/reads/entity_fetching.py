"""Reads entities from one context source with an operation that it takes (clauses 4.20, 5.7.1.4, 5.7.2.4).

A source is queried for the entities and attributes of its registration only. Failures become warnings: the
client still gets the results of the other sources.
"""

import re
import time
from collections.abc import AsyncIterator, Iterable, Mapping
from dataclasses import replace
from typing import Any, Final

import orjson

from handover.errors import Problem
from handover.network.http_client import HttpResponse
from handover_broker.model.context import Context
from handover_broker.model.entity import Entity
from handover_broker.query.parameters import FILTERS, FORWARDED_TEXTS
from handover_broker.request.request_context import JSON
from handover_federation.distribution.distributed_operations import Sources, gather_all
from handover_federation.distribution.forwarding.forwarder import (
    SILENT,
    SourceDialect,
    SourceError,
    SourceRequest,
    quoted,
)
from handover_federation.distribution.reads.fragment_collector import FragmentCollector
from handover_federation.distribution.reads.source_responses import query_source, read_entities
from handover_federation.registrations.registration import (
    EntityTarget,
    Match,
    Registration,
    SourceFilter,
)

ONE: Final = ("retrieveEntity", "queryEntity", "queryBatch")
"""Operations that read one entity, the preferred first."""
MANY: Final = ("queryEntity", "queryBatch", "retrieveEntity")
"""Operations that read many entities; the last needs known ids."""
PAGE: Final = 1000
"""Entities in one request."""
SMALL_PAGE: Final = 100
"""Entities in one request to a source that refuses larger pages."""
MAX_ENTITIES: Final = 20_000
"""Entities that are read from one source for one query; a warning reports any beyond it."""
MAX_TIMEOUTS: Final = 5
"""Total time for all pages of a source, as a multiple of the timeout of one response."""
MAX_IDS: Final = 50
"""Ids in one request."""
MAX_CONCURRENT_REQUESTS: Final = 16
"""Concurrent requests to one source that returns single entities only."""
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
    """Return the matches whose sources can be queried for entities, or take the operation `or_takes`."""
    operations = MANY if or_takes is None else (*MANY, or_takes)
    candidates = sources.unvisited(sources.registry.matching(operations, target, where), uses_map=uses_map)
    return [
        match
        for match in candidates
        if is_queryable(match) or (or_takes is not None and match.registration.takes(or_takes))
    ]


def is_queryable(match: Match) -> bool:
    """Return whether a source takes an operation that can read the matched entities."""
    takes = match.registration.takes
    return takes(MANY[0]) or takes(MANY[1]) or (takes(MANY[2]) and match.ids is not None)


async def fetch_entity(
    sources: Sources, match: Match, entity_id: str, context: Context, into: FragmentCollector
) -> None:
    """Read one entity from a source."""
    registration = match.registration
    if not registration.takes("retrieveEntity"):
        narrowed_match = Match(registration, tuple(replace(part, ids=(entity_id,)) for part in match.parts))
        await fetch_entities(sources, narrowed_match, {}, context, into, is_split=True)
        return
    try:
        dialect = await sources.forwarder.dialect(registration, context, body=None)
        names = match.attributes_for(entity_id)
        parameters = [("attrs", joined_names(names, dialect))] if names is not None else []
        parameters.append(("options", "sysAttrs"))
        source_request = SourceRequest("GET", f"entities/{quoted(entity_id)}", dialect, tuple(parameters))
        response = await _query_source_by_map(sources, registration, source_request)
        if response is not None:
            into.add(registration, await read_entities(sources, registration, response, dialect, single=True))
    except SourceError as error:
        sources.add_error(error)
    except Problem as problem:  # the @context of the source
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
    """Read many entities from a source. `is_split`: filters are applied later, to the merged entities."""
    registration = match.registration
    operation = next(name for name in MANY if registration.takes(name))
    if operation == "retrieveEntity":
        for start in range(0, len(match.ids or ()), MAX_CONCURRENT_REQUESTS):
            some = (match.ids or ())[start : start + MAX_CONCURRENT_REQUESTS]
            await gather_all(*(fetch_entity(sources, match, entity_id, context, into) for entity_id in some))
        return
    body = JSON if operation == "queryBatch" else None
    try:
        dialect = await sources.forwarder.dialect(registration, context, body=body)
        for piece in narrowed(match, parameters, context, dialect, is_split=is_split):
            async for entities in _pages(sources, registration, dialect, piece, operation):
                into.add(registration, entities)
    except SourceError as error:
        sources.add_error(error)
    except Problem as problem:
        sources.add_error(SourceError(registration, SILENT, 502, problem.detail))


async def _pages(
    sources: Sources,
    registration: Registration,
    dialect: SourceDialect,
    parameters: list[tuple[str, str]],
    operation: str,
) -> AsyncIterator[list[Entity]]:
    """Yield the entities in all pages of a source's response."""
    small = sources.forwarder.small_pages
    offset, seen = 0, set[str]()
    until_s = time.monotonic() + MAX_TIMEOUTS * sources.forwarder.patience_s(registration)
    while offset < MAX_ENTITIES:
        if time.monotonic() > until_s:
            sources.add_warning(SILENT, f"{registration.shown} takes too long to return all its entities")
            return
        limit = SMALL_PAGE if registration.endpoint in small else PAGE
        paged = [*parameters, ("limit", str(limit))] + ([("offset", str(offset))] if offset else [])
        try:
            source_request = _question(operation, dialect, paged)
            response = await _query_source_by_map(sources, registration, source_request)
        except SourceError as error:
            if error.answered not in {400, 403} or offset or limit == SMALL_PAGE:
                raise
            small.add(registration.endpoint)
            continue
        if response is None:
            return
        entities = await read_entities(sources, registration, response, dialect)
        yield entities
        count_before = len(seen)
        seen.update(entity.id for entity in entities)
        if len(seen) == count_before:  # a source that ignores offset returns the same page again
            return
        if len(entities) < limit and not _NEXT.search(response.headers.get("link", "")):
            return
        offset += len(entities)
    sources.add_warning(SILENT, f"{registration.shown} has more than {MAX_ENTITIES} matching entities")


def narrowed(
    match: Match, parameters: Mapping[str, str], context: Context, dialect: SourceDialect, *, is_split: bool
) -> Iterable[list[tuple[str, str]]]:
    """Yield the query parameters for a source, limited to the entities and attributes of its registration."""
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
        selection = [("type", ",".join(sorted(dialect.name(kind) for kind in types)))] if types else []
        if not ids and "idPattern" in parameters:
            selection.append(("idPattern", parameters["idPattern"]))
        if names is not None:
            selection.append(("attrs", joined_names(names, dialect)))
        selection += [*filters, ("options", "sysAttrs")]
        listed = list(ids)
        for start in range(0, max(1, len(listed)), MAX_IDS):
            some = listed[start : start + MAX_IDS]
            yield [*selection, ("id", ",".join(some))] if some else selection


def _types_at(registration: Registration) -> set[str]:
    return {kind for piece in registration.information for entity in piece.entities for kind in entity.types}


async def _query_source_by_map(
    sources: Sources, registration: Registration, source_request: SourceRequest
) -> HttpResponse | None:
    """Query a source by its own entity map if it has one, and without it if the source has lost the map."""
    headers = sources.map_headers(registration)
    if headers:
        response = await query_source(sources, registration, replace(source_request, headers=headers))
        if response is not None:
            return response
    return await query_source(sources, registration, source_request)


def _question(operation: str, dialect: SourceDialect, parameters: list[tuple[str, str]]) -> SourceRequest:
    """Return query parameters as the request that the source takes."""
    if operation == "queryEntity":
        return SourceRequest("GET", "entities", dialect, tuple(parameters))
    texts = dict(parameters)
    selector = {name: texts[name] for name in ("type", "idPattern") if name in texts}
    ids = texts["id"].split(",") if "id" in texts else []
    entities = [{"id": entity_id, **selector} for entity_id in ids] or ([selector] if selector else [])
    document: dict[str, Any] = {"type": "Query", **({"entities": entities} if entities else {})}
    for name in ("attrs", "expandValues", "jsonKeys"):
        if name in texts:
            document[name] = texts[name].split(",")
    document |= {name: texts[name] for name in FORWARDED_TEXTS if name in texts}
    if "georel" in texts:
        coordinates = orjson.loads(texts["coordinates"])
        document["geoQ"] = {
            "coordinates": coordinates,
            **{member: texts[member] for member in _GEO if member in texts},
        }
    rest = tuple((name, texts[name]) for name in ("options", "limit", "offset") if name in texts)
    return SourceRequest("POST", "entityOperations/query", dialect, rest, document)


def joined_names(names: frozenset[str], dialect: SourceDialect) -> str:
    """Return attribute names as a query parameter in the dialect of a source."""
    return ",".join(sorted(dialect.name(name) for name in names))
