"""Retrieves the temporal evolution of one entity at several sources (clause 5.7.3.4)."""

from collections.abc import Mapping
from dataclasses import dataclass

import orjson

from handover.errors import Problem
from handover_broker.model.validation import require_uri
from handover_broker.request.derived_request import derived
from handover_broker.request.request_context import (
    RequestContext,
    Response,
    problem_response,
)
from handover_federation.distribution.distributed_operations import (
    Perform,
    Sources,
    gateway_problem,
    gather_all,
)
from handover_federation.distribution.forwarding.forwarder import quoted
from handover_federation.distribution.query_targets import (
    coverage_of,
    source_filter,
)
from handover_federation.distribution.reads import temporal_merge
from handover_federation.distribution.reads.temporal_answers import (
    attributes_of,
    temporal_answer,
    temporal_request_of,
)
from handover_federation.distribution.reads.temporal_fetching import (
    FetchPart,
    TemporalPart,
    TemporalRequest,
    edge_of,
    fetch_from_source,
    fetch_values,
    without_context,
)
from handover_federation.entity_maps.entity_map import OWN
from handover_federation.entity_maps.mapped_request import listed_of
from handover_federation.registrations.registration import EntityTarget, Match, Registration


@dataclass(frozen=True, slots=True)
class _SourcePart:
    """A source that has the entity, and its part in the requested representation."""

    registration: Registration
    fetch: FetchPart
    part: TemporalPart


async def retrieve(sources: Sources, request: RequestContext, perform: Perform) -> Response:
    """GET temporal/entities/{id}."""
    context = await request.reader_context()
    entity_id = require_uri(request.names[0], "the entity id in the path")
    target = EntityTarget((entity_id,), None, None, attributes_of(request.parameters, context))
    where = source_filter(None, context, coverage_of(request.parameters, context.terms.expand))
    matches = sources.unvisited(sources.registry.matching("retrieveTemporal", target, where))
    if not matches:
        return await perform(request)
    temporal_request = temporal_request_of(request, context, request.parameters)
    parts = await _find(sources, matches, entity_id, temporal_request)
    if not parts:
        return await _retrieve_own(sources, request, perform)
    try:
        own: Response | None = await perform(request)
    except Problem as problem:
        if problem.status != 404:
            raise
        own = None
    if (listed := listed_of(request)) is not None:
        own_name = [] if own is None else [OWN]
        listed.entities = {entity_id: own_name + [part.registration.id for part in parts]}
    if temporal_request.is_for_totals and (own is not None or len(parts) > 1):
        readers: list[tuple[Registration | None, FetchPart]] = [
            (part.registration, part.fetch) for part in parts
        ]
        if own is not None:
            readers.insert(0, (None, _own_fetcher(request, perform)))
        return await _aggregate(request, temporal_request, readers)
    return _merge(request, temporal_request, own, parts)


async def _find(
    sources: Sources, matches: list[Match], entity_id: str, temporal_request: TemporalRequest
) -> list[_SourcePart]:
    """Return the sources that have the entity."""
    context, path = temporal_request.context, f"temporal/entities/{quoted(entity_id)}"

    def fetcher(match: Match) -> FetchPart:
        return lambda parameters: fetch_from_source(sources, match, path, parameters, context, single=True)

    fetchers = [fetcher(match) for match in matches]
    parts = await gather_all(*(fetch(temporal_request.parameters) for fetch in fetchers))
    return [
        _SourcePart(match.registration, fetch, part)
        for match, fetch, part in zip(matches, fetchers, parts, strict=True)
        if part.documents
    ]


async def _retrieve_own(sources: Sources, request: RequestContext, perform: Perform) -> Response:
    """Return the broker's own response. If it has none, and a source did not answer, that is the error."""
    try:
        return await perform(request)
    except Problem as problem:
        errors = [error for error in sources.source_errors if error.registration.mode.is_proxied]
        if problem.status == 404 and errors:
            return problem_response(gateway_problem(errors[0]))
        raise


def _own_fetcher(request: RequestContext, perform: Perform) -> FetchPart:
    async def fetch(parameters: Mapping[str, str]) -> TemporalPart:
        response = await perform(derived(request, parameters=parameters))
        return TemporalPart([without_context(orjson.loads(response.body))], edge_of(response))

    return fetch


async def _aggregate(
    request: RequestContext,
    temporal_request: TemporalRequest,
    readers: list[tuple[Registration | None, FetchPart]],
) -> Response:
    """Return the aggregated values of an entity of which several sources have a part."""
    values = await fetch_values(readers, temporal_request)
    query = temporal_request.query
    merged = temporal_merge.merge_evolutions(values, temporal_request.context, query.last)
    document = temporal_merge.aggregated(merged, query)
    return temporal_answer(request, temporal_request, [document], None, single=True)


def _merge(
    request: RequestContext, temporal_request: TemporalRequest, own: Response | None, parts: list[_SourcePart]
) -> Response:
    """Return the entity of all sources, up to the instant to which all parts are complete."""
    context, query = temporal_request.context, temporal_request.query
    evolutions: list[temporal_merge.SourceEvolution] = [
        (part.registration, temporal_merge.shown(document, temporal_request.view, context))
        for part in parts
        for document in part.part.documents
    ]
    edges = [part.part.edge for part in parts]
    if own is not None:
        evolutions.insert(0, (None, without_context(orjson.loads(own.body))))
        edges.append(edge_of(own))
    last = None if temporal_request.is_for_totals else query.last
    document = temporal_merge.merge_evolutions(evolutions, context, last)
    edge = temporal_merge.common_edge(edges, query)
    return temporal_answer(request, temporal_request, [document], edge, single=True)
