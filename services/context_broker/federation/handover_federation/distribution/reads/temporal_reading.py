"""Queries temporal evolutions at several sources (clause 5.7.4.4); `temporal_retrieval` retrieves one.

All sources are queried in the requested representation, and `temporal_merge` merges the results. Aggregated
values cannot be merged: if several sources have parts of one entity, they are queried again for the plain
values.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import orjson

from handover_broker.model.context import Context
from handover_broker.query.pages import Window
from handover_broker.query.parameters import FILTERS
from handover_broker.request.derived_request import derived
from handover_broker.request.query_parameters import (
    DEFAULT_LIMIT,
    MAX_LIMIT,
    page_links,
)
from handover_broker.request.request_context import (
    RequestContext,
    Response,
)
from handover_broker.temporal.operations import temporal_parameters
from handover_federation.distribution.distributed_operations import (
    Perform,
    Sources,
    gather_all,
)
from handover_federation.distribution.query_targets import (
    may_be_split,
    refuse_order,
    selector_parameters,
    target_of,
)
from handover_federation.distribution.reads import temporal_merge
from handover_federation.distribution.reads.split_temporal_queries import narrowed_to, split_hits
from handover_federation.distribution.reads.temporal_answers import (
    attributes_of,
    temporal_answer,
    temporal_request_of,
)
from handover_federation.distribution.reads.temporal_fetching import (
    SHOWING,
    TemporalPart,
    TemporalRequest,
    edge_of,
    fetch_from_source,
    fetch_values,
    own_fetcher,
    source_fetchers,
    without_context,
)
from handover_federation.distribution.reads.temporal_merge import Evolution
from handover_federation.registrations.registration import Match


async def query(sources: Sources, request: RequestContext, perform: Perform) -> Response:
    """GET temporal/entities."""
    context = await request.reader_context()
    parameters = dict(request.parameters)
    return await _query(sources, request, perform, _Query(context, parameters, [parameters]))


async def query_batch(sources: Sources, request: RequestContext, perform: Perform) -> Response:
    """POST temporal/entityOperations/query."""
    document, context = await request.body()
    if not isinstance(document, dict):
        return await perform(request)
    query_document = {
        name: value for name, value in document.items() if name not in {"temporalQ", "aggrParams"}
    }
    flat = {**request.parameters, **temporal_parameters(document)}
    return await _query(
        sources, request, perform, _Query(context, flat, list(selector_parameters(query_document, flat)))
    )


@dataclass(frozen=True, slots=True)
class _Query:
    """A query: all parameters, and the parameters of each of its selectors."""

    context: Context
    parameters: Mapping[str, str]
    selectors: list[dict[str, str]]


async def _query(sources: Sources, request: RequestContext, perform: Perform, temporal: _Query) -> Response:
    matched = _matches_of(sources, temporal)
    if not matched:
        return await perform(request)
    temporal_request = temporal_request_of(request, temporal.context, temporal.parameters)
    conditions = {name for name in FILTERS if name in temporal.parameters}
    if conditions and may_be_split(temporal.parameters, [match for match, _ in matched]):
        hits = await split_hits(sources, request, perform, matched, temporal_request)
        return await _page_of(hits, sources, request, perform, temporal)
    window = _window(request)
    collected = await _collect(sources, request, perform, matched, temporal_request, window)
    order = list(collected.evolutions)
    page = order[window.offset : window.offset + window.limit]
    if page and collected.full:
        await _add_rest(collected.evolutions, sources, collected.full, page, temporal_request)
    edge = temporal_merge.common_edge(collected.edges, temporal_request.query)
    if temporal_request.is_for_totals:
        edge = None
        documents = await _aggregated_page(
            sources, request, perform, matched, collected.evolutions, page, temporal_request
        )
    else:
        last = temporal_request.query.last
        documents = [
            temporal_merge.merge_evolutions(collected.evolutions[entity_id], temporal.context, last)
            for entity_id in page
        ]
    result = temporal_answer(request, temporal_request, documents, edge)
    result.headers += [
        (name, str(int(value) + len(order) - collected.own_count).encode())
        for name, value in collected.own_headers
        if name == b"ngsild-results-count"
    ]
    if request.method == "GET":
        more = len(order) > window.offset + window.limit
        result.headers += page_links(request, window, request.accept(), more=more)
    return result


def _matches_of(sources: Sources, temporal: _Query) -> list[tuple[Match, dict[str, str]]]:
    """Return the sources to query, each with the parameters of the selector that it matches."""
    matched: list[tuple[Match, dict[str, str]]] = []
    for parameters in temporal.selectors:
        target, where = target_of(parameters, temporal.context, attributes_of(parameters, temporal.context))
        matches = sources.registry.matching("queryTemporal", target, where)
        refuse_order(parameters, sources.unvisited(matches, uses_map=False))
        matched += [(match, parameters) for match in sources.unvisited(matches)]
    return matched


@dataclass(frozen=True, slots=True)
class _Collected:
    """What the broker and the sources have of a query, from its start to the end of the requested page."""

    evolutions: dict[str, list[temporal_merge.SourceEvolution]]
    """By entity, in the order of the whole result."""
    edges: list[int | None]
    own_count: int
    own_headers: list[tuple[bytes, bytes]]
    full: list[tuple[Match, dict[str, str]]]
    """The sources that may have more than was requested."""


async def _collect(  # noqa: PLR0917 - the parts of one query
    sources: Sources,
    request: RequestContext,
    perform: Perform,
    matched: list[tuple[Match, dict[str, str]]],
    temporal_request: TemporalRequest,
    window: Window,
) -> _Collected:
    """Query the broker itself, then all sources at once."""
    context, view = temporal_request.context, temporal_request.view
    most = min(window.offset + window.limit, MAX_LIMIT) if not window.count else MAX_LIMIT
    paged = {"offset": "0", "limit": str(most)}
    own = await perform(_for_all_members(request, paged))
    parts: list[TemporalPart] = await gather_all(
        *(
            fetch_from_source(sources, match, "temporal/entities", {**parameters, **paged}, context)
            for match, parameters in matched
        )
    )
    evolutions: dict[str, list[temporal_merge.SourceEvolution]] = {
        evolution["id"]: [(None, temporal_merge.shown(without_context(evolution), view, context))]
        for evolution in orjson.loads(own.body)
    }
    own_count = len(evolutions)
    _add_in_order(evolutions, matched, parts, temporal_request)
    return _Collected(
        evolutions,
        edges=[edge_of(own), *(part.edge for part in parts)],
        own_count=own_count,
        own_headers=own.headers,
        full=[match for match, part in zip(matched, parts, strict=True) if len(part.documents) >= most],
    )


async def _aggregated_page(  # noqa: PLR0917 - the parts of one query
    sources: Sources,
    request: RequestContext,
    perform: Perform,
    matched: list[tuple[Match, dict[str, str]]],
    evolutions: dict[str, list[temporal_merge.SourceEvolution]],
    page: list[str],
    temporal_request: TemporalRequest,
) -> list[Evolution]:
    """Return the aggregated entities of a page; those split over several sources are read again by value."""
    documents = [evolutions[entity_id][0][1] for entity_id in page]
    split = tuple(entity_id for entity_id in page if len(evolutions[entity_id]) > 1)
    if not split:
        return documents
    context, query = temporal_request.context, temporal_request.query
    fetchers = source_fetchers(sources, matched, context, split)
    fetchers.insert(0, (None, own_fetcher(request, perform, split)))
    by_entity: dict[str, list[temporal_merge.SourceEvolution]] = {entity_id: [] for entity_id in split}
    for part in await fetch_values(fetchers, temporal_request):
        if part[1]["id"] in by_entity:
            by_entity[part[1]["id"]].append(part)
    aggregated = {
        entity_id: temporal_merge.aggregated(
            temporal_merge.merge_evolutions(parts, context, query.last), query
        )
        for entity_id, parts in by_entity.items()
    }
    return [aggregated.get(document["id"], document) for document in documents]


def _add_in_order(
    evolutions: dict[str, list[temporal_merge.SourceEvolution]],
    matched: list[tuple[Match, dict[str, str]]],
    parts: list[TemporalPart],
    temporal_request: TemporalRequest,
) -> None:
    """Add the results of the sources in order: the next source is added once the previous one is exhausted.

    So pages neither repeat nor skip entities, although each page is read from the start.
    """
    for (match, _), part in zip(matched, parts, strict=True):
        for document in part.documents:
            collected = evolutions.setdefault(document["id"], [])
            if not any(source is match.registration for source, _ in collected):
                collected.append(
                    (
                        match.registration,
                        temporal_merge.shown(document, temporal_request.view, temporal_request.context),
                    )
                )


async def _add_rest(
    evolutions: dict[str, list[temporal_merge.SourceEvolution]],
    sources: Sources,
    full: list[tuple[Match, dict[str, str]]],
    page: list[str],
    temporal_request: TemporalRequest,
) -> None:
    """Add what the sources with more results than requested have of the entities on a page."""
    asking = source_fetchers(sources, full, temporal_request.context, tuple(page))
    parts = await gather_all(*(ask(temporal_request.parameters) for _, ask in asking))
    for (registration, _), part in zip(asking, parts, strict=True):
        for document in part.documents:
            collected = evolutions.get(document["id"])
            if collected is not None and not any(source is registration for source, _ in collected):
                collected.append(
                    (
                        registration,
                        temporal_merge.shown(document, temporal_request.view, temporal_request.context),
                    )
                )


async def _page_of(
    hits: list[str], sources: Sources, request: RequestContext, perform: Perform, temporal: _Query
) -> Response:
    """Return a page of the entities that match all filters, in the requested representation."""
    window = _window(request)
    some = hits[window.offset : window.offset + window.limit]
    narrowed = narrowed_to(request, some or [_NO_ENTITY])
    gone = {*FILTERS, "idPattern", "count", "offset", "limit"}
    shape = {"id": ",".join(some or [_NO_ENTITY]), "limit": str(max(1, len(some)))}

    def without(parameters: Mapping[str, str]) -> dict[str, str]:
        return {**{name: value for name, value in parameters.items() if name not in gone}, **shape}

    target = _Query(
        temporal.context, without(temporal.parameters), [without(selector) for selector in temporal.selectors]
    )
    result = await _query(sources, narrowed, perform, target)
    headers = [header for header in result.headers if header[0] != b"link" or b"json-ld#context" in header[1]]
    if window.count:
        headers.append((b"ngsild-results-count", str(len(hits)).encode()))
    if request.method == "GET":
        more = window.offset + window.limit < len(hits)
        headers += page_links(request, window, request.accept(), more=more)
    return Response(result.status, result.body, headers)


_NO_ENTITY: Final = "urn:ngsi-ld:Entity:none"
"""Requested for an empty page, so that its response has the requested representation."""


def _for_all_members(request: RequestContext, window: Mapping[str, str]) -> RequestContext:
    """Return the query without projections, which would hide members that the merge needs."""
    parameters = {name: value for name, value in request.parameters.items() if name not in SHOWING}
    result = derived(request, parameters={**parameters, **window})
    if request.method == "POST" and not set(SHOWING).isdisjoint(document := request.document()):
        result.raw = orjson.dumps({name: value for name, value in document.items() if name not in SHOWING})
    return result


def _window(request: RequestContext) -> Window:
    def number(name: str, default: int) -> int:
        text = request.parameter(name) or ""
        return int(text) if text.isascii() and text.isdecimal() and len(text) < 10 else default

    options = (request.parameter("options") or "").split(",")
    counts = request.parameter("count") == "true" or "count" in options
    return Window(number("offset", 0), number("limit", DEFAULT_LIMIT), counts)
