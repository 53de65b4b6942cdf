"""Filters of temporal queries on entities that may be split over several sources (clause 5.7.4.4).

A filter on one attribute must not hide what another source has of the same entity. All sources are therefore
queried without filters, and the filters are applied to the merged evolutions.
"""

from collections.abc import Awaitable, Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any, Final

import orjson

from handover.errors import Problem
from handover_broker.model.entity import Entity, Instance
from handover_broker.model.entity_parser import expand, read_attribute
from handover_broker.query.parameters import FILTER_MEMBERS, FILTERS
from handover_broker.query.query_document import selectors_of
from handover_broker.query.selection import Selection
from handover_broker.request.derived_request import derived
from handover_broker.request.query_parameters import MAX_LIMIT, selection_of
from handover_broker.request.request_context import RequestContext
from handover_broker.temporal.query import TIME_PARAMETERS
from handover_federation.distribution.distributed_operations import Perform, Sources
from handover_federation.distribution.reads import temporal_merge
from handover_federation.distribution.reads.temporal_fetching import (
    SHOWING,
    FetchPart,
    TemporalPart,
    TemporalRequest,
    edge_of,
    fetch_from_source,
    fetch_values,
    without_context,
)
from handover_federation.distribution.reads.temporal_merge import Evolution
from handover_federation.registrations.registration import Match, Registration

MAX_PAGES: Final = 20
"""Pages of a thousand entities that are read from one source."""
_CONDITIONS: Final = frozenset(FILTER_MEMBERS)
"""Filter members of a Query document."""
_IN_DOCUMENTS: Final = _CONDITIONS | {"aggrParams", "attrs", "datasetId", "lang", *SHOWING}
_NOT_ASKED: Final = frozenset({*FILTERS, "lastN", "count", "offset", "limit", "attrs", "datasetId", "lang"})
"""Parameters that apply to merged evolutions, or to their representation."""
_NOT_SAID: Final = frozenset({"instanceId", "createdAt", "modifiedAt", "expiresAt"})
_TIMES: Final = ("createdAt", "modifiedAt")


async def split_hits(
    sources: Sources,
    request: RequestContext,
    perform: Perform,
    matched: Iterable[tuple[Match, Mapping[str, str]]],
    temporal_request: TemporalRequest,
) -> list[str]:
    """Return the ids of the entities whose merged evolution matches the filters, in order."""
    parameters = {
        name: value for name, value in temporal_request.parameters.items() if name not in _NOT_ASKED
    }
    everything = replace(temporal_request.view.view, attributes=None, projection=None, datasets=None)
    whole = TemporalRequest(
        temporal_request.context,
        parameters,
        replace(temporal_request.query, last=None),
        replace(temporal_request.view, view=everything),
    )
    readers: list[tuple[Registration | None, FetchPart]] = [
        (None, _pages_of_own(request, perform, temporal_request))
    ]
    readers += [(match.registration, _pages_of(sources, match, temporal_request)) for match, _ in matched]
    evolutions: dict[str, list[temporal_merge.SourceEvolution]] = {}
    for registration, document in await fetch_values(readers, whole):
        evolutions.setdefault(document["id"], []).append((registration, document))
    selection = _selection(request, temporal_request)
    return [
        entity_id
        for entity_id, parts in evolutions.items()
        if selection.wants(
            _as_entity(
                temporal_merge.merge_evolutions(parts, temporal_request.context, None), temporal_request
            )
        )
    ]


def narrowed_to(request: RequestContext, ids: list[str]) -> RequestContext:
    """Return the request for these entities only, without filters."""
    gone = {*FILTERS, "idPattern", "count", "offset", "limit"}
    parameters = {name: value for name, value in request.parameters.items() if name not in gone}
    shape = {"limit": str(len(ids))}
    if request.method == "GET":
        return derived(request, parameters={**parameters, **shape, "id": ",".join(ids)})
    document = {name: value for name, value in request.document().items() if name not in _CONDITIONS}
    document.pop("entityMap", None)
    document["entities"] = [
        {"id": ids, **({"type": selector["type"]} if "type" in selector else {})}
        for selector in document.get("entities") or [{}]
    ]
    return derived(request, parameters={**parameters, **shape}, raw=orjson.dumps(document))


def _selection(request: RequestContext, temporal_request: TemporalRequest) -> Selection:
    any_of = () if request.method == "GET" else selectors_of(request.document(), temporal_request.context)
    return selection_of(temporal_request.parameters, temporal_request.context, any_of)


def _pages_of(sources: Sources, match: Match, temporal_request: TemporalRequest) -> FetchPart:
    def of_source(parameters: Mapping[str, str]) -> Awaitable[TemporalPart]:
        return fetch_from_source(sources, match, "temporal/entities", parameters, temporal_request.context)

    return _all_pages(of_source, temporal_request)


def _pages_of_own(request: RequestContext, perform: Perform, temporal_request: TemporalRequest) -> FetchPart:
    async def of_own(parameters: Mapping[str, str]) -> TemporalPart:
        narrowed = derived(request, parameters=parameters)
        if request.method == "POST":
            document = {
                name: value for name, value in request.document().items() if name not in _IN_DOCUMENTS
            }
            times = {name: parameters[name] for name in TIME_PARAMETERS if name in parameters}
            narrowed.raw = orjson.dumps({**document, "temporalQ": times})
            narrowed.parameters = {name: parameters[name] for name in ("options", "offset", "limit")}
        parts = await perform(narrowed)
        return TemporalPart([without_context(load) for load in orjson.loads(parts.body)], edge_of(parts))

    return _all_pages(of_own, temporal_request)


def _all_pages(ask: FetchPart, temporal_request: TemporalRequest) -> FetchPart:
    """Return a function that reads all entities page by page."""

    async def all_of_them(parameters: Mapping[str, str]) -> TemporalPart:
        documents: dict[str, Evolution] = {}
        edges: list[int | None] = []
        for number in range(MAX_PAGES):
            window = {"offset": str(number * MAX_LIMIT), "limit": str(MAX_LIMIT)}
            part = await ask({**parameters, **window})
            before = len(documents)
            documents |= {document["id"]: document for document in part.documents}
            edges.append(part.edge)
            if len(part.documents) < MAX_LIMIT or len(documents) == before:
                break
        return TemporalPart(
            list(documents.values()), temporal_merge.common_edge(edges, temporal_request.query)
        )

    return all_of_them


def _as_entity(document: Evolution, temporal_request: TemporalRequest) -> Entity:
    """Return an entity with all instances of an evolution, to which filters can be applied."""
    terms = temporal_request.context.terms
    attributes: dict[str, list[Instance]] = {}
    for name in document.keys() - temporal_merge.MEMBERS:
        instances = document[name]
        for part in instances if isinstance(instances, list) else [instances]:
            if not isinstance(part, dict) or "deletedAt" in part:
                continue
            said = {member: value for member, value in part.items() if member not in _NOT_SAID}
            try:
                (instance,) = read_attribute(name, said, terms)
            except (Problem, ValueError):  # no filter can refer to it
                continue
            times = {member: part[member] for member in _TIMES if isinstance(part.get(member), str)}
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


def _scopes(value: Any) -> Iterator[str]:
    """Yield all scopes that the entity has had, from plain values or from instances."""
    for part in value if isinstance(value, list) else [value]:
        parts = part.get("value") if isinstance(part, dict) else part
        yield from (text for text in (parts if isinstance(parts, list) else [parts]) if isinstance(text, str))
