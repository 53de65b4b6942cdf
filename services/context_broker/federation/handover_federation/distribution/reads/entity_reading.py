"""Retrieves and queries entities at several sources (clauses 5.7.1.4, 5.7.2.4 and 4.5.5.3).

All matching sources are queried for plain data, and the fragments are merged to entities. The local operation
then runs on a store with the merged entities: filters, pages and representations are applied once, to whole
entities.
"""

import copy
from collections import Counter
from collections.abc import Iterable
from typing import Any, Final

from handover.errors import Problem
from handover_broker.model.context import Context
from handover_broker.model.entity import Entity
from handover_broker.model.validation import require_uri
from handover_broker.query.type_selection import of_types
from handover_broker.request.derived_request import derived
from handover_broker.request.query_parameters import datasets_of
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
from handover_federation.distribution.query_targets import (
    may_be_split,
    names_of,
    refuse_order,
    selector_parameters,
    source_filter,
    target_of,
    types_of,
)
from handover_federation.distribution.reads.entity_fetching import (
    ONE,
    fetch_entities,
    fetch_entity,
    queryable_matches,
)
from handover_federation.distribution.reads.entity_map_collection import (
    CREATE_ENTITY_MAP,
    EntityMapCollector,
)
from handover_federation.distribution.reads.fragment_collector import FragmentCollector
from handover_federation.entity_maps.mapped_request import listed_of, with_map
from handover_federation.registrations.coverage import CoverageQuery
from handover_federation.registrations.registration import EntityTarget, Match

MAX_LINKING_ENTITIES: Final = 1000
"""The broker's own entities whose links are followed to other sources."""
MAX_LEVELS: Final = 10
"""Levels of linked entities that sources are queried for."""


async def retrieve(sources: Sources, request: RequestContext, perform: Perform) -> Response:
    """GET entities/{id}, from all matching sources."""
    context = await request.reader_context()
    entity_id = require_uri(request.names[0], "the entity id in the path")
    own = request.tenant.store.get(entity_id)
    types = types_of(request.parameter("type"), context)
    if types is None and own is not None:
        types = frozenset(own.types)
    target = EntityTarget((entity_id,), None, types, names_of(request.parameters, context))
    datasets = CoverageQuery(datasets=datasets_of(request.parameter("datasetId")))
    matches = sources.unvisited(
        sources.registry.matching(ONE, target, source_filter(None, context, datasets))
    )
    if not matches and (own is None or not _wants_links(request)):
        return await perform(request)
    collector = FragmentCollector(sources.admission)
    await gather_all(*(fetch_entity(sources, match, entity_id, context, collector) for match in matches))
    if (listed := listed_of(request)) is not None:
        listed.entities = collector.origins(request.tenant.store)
    proxied = [match.registration for match in matches if match.registration.mode.is_proxied]
    others = {entity_id: collector.entity(own, entity_id, proxied)}
    await _add_linked(sources, request, context, others)
    overlay_store = request.tenant.store.overlay((entity_id,), None, others)
    try:
        return await perform(_over(request, overlay_store))
    except Problem as problem:
        silent = [error for error in sources.source_errors if error.registration.mode.is_proxied]
        if problem.status == 404 and silent:  # the source that failed may have the entity
            return problem_response(gateway_problem(silent[0]))
        raise


async def query(sources: Sources, request: RequestContext, perform: Perform) -> Response:
    """GET entities, from all matching sources."""
    context = await request.reader_context()
    return await _query(sources, request, perform, context, [dict(request.parameters)])


async def query_batch(sources: Sources, request: RequestContext, perform: Perform) -> Response:
    """POST entityOperations/query."""
    document, context = await request.body()
    if not isinstance(document, dict):
        return await perform(request)
    return await _query(
        sources, request, perform, context, list(selector_parameters(document, request.parameters))
    )


async def map_entities(sources: Sources, request: RequestContext, perform: Perform) -> Response:
    """GET or POST entityMaps, which take the parameters of the two queries (clause 5.14.4)."""
    if request.method == "GET":
        context, questions = await request.reader_context(), [dict(request.parameters)]
    else:
        document, context = await request.body()
        if not isinstance(document, dict):
            return await perform(request)
        questions = list(selector_parameters(document, request.parameters))
    map_collector = EntityMapCollector(sources, context, request.parameter("entityMapLifetime"))
    return await _query(sources, request, perform, context, questions, map_collector=map_collector)


async def _query(
    sources: Sources,
    request: RequestContext,
    perform: Perform,
    context: Context,
    questions: list[dict[str, str]],
    *,
    map_collector: EntityMapCollector | None = None,
) -> Response:
    collector = FragmentCollector(sources.admission)
    matched: list[tuple[Match, dict[str, str], bool]] = []
    wanted: list[EntityTarget] = []
    for parameters in questions:
        target, where = target_of(parameters, context, names_of(parameters, context))
        wanted.append(target)
        or_takes = None if map_collector is None else CREATE_ENTITY_MAP
        if "orderBy" in parameters:
            refuse_order(
                parameters, queryable_matches(sources, target, where, uses_map=False, or_takes=or_takes)
            )
        matches = queryable_matches(sources, target, where, or_takes=or_takes)
        is_split = may_be_split(parameters, matches)
        matched += [(match, parameters, is_split) for match in matches]
    times = Counter(match.registration.id for match, _, _ in matched)
    registrations = {match.registration.id: match.registration for match, _, _ in matched}
    requests: list[Any] = [
        map_collector.collect(match, parameters, collector, is_split=is_split)
        if map_collector is not None
        and times[match.registration.id] == 1  # only one map per source can be linked
        else fetch_entities(sources, match, parameters, context, collector, is_split=is_split)
        for match, parameters, is_split in matched
    ]
    wants_links = _wants_links(request)
    if not requests and not wants_links:
        return await perform(request)
    await gather_all(*requests)
    ids = None if any(part.ids is None for part in wanted) else [i for part in wanted for i in part.ids or ()]
    types = (
        None
        if any(part.types is None for part in wanted)
        else [t for part in wanted for t in part.types or ()]
    )
    store = request.tenant.store
    claims = [registration for registration in registrations.values() if registration.mode.is_proxied]
    touched = set(collector.fragments)
    if claims or wants_links:
        own = store.candidates(ids, None if types is None else of_types(types))
        touched |= {entity_id.id for entity_id in (own if claims else own[:MAX_LINKING_ENTITIES])}
    others = {entity_id: collector.entity(store.get(entity_id), entity_id, claims) for entity_id in touched}
    await _add_linked(sources, request, context, others)
    overlay_store = store.overlay(ids, None if ids is not None else types, others)
    overlay_store.origins = collector.origins(store)
    overlay = _over(request, overlay_store)
    if map_collector is not None:
        overlay = with_map(overlay, listed=map_collector.listed)
    return await perform(overlay)


def _wants_links(request: RequestContext) -> bool:
    return request.parameter("join") in {"inline", "flat"}


async def _add_linked(
    sources: Sources, request: RequestContext, context: Context, others: dict[str, Entity | None]
) -> None:
    """Add the linked entities that the client wants joined and that other sources may have (clause
    4.5.23)."""
    if not _wants_links(request):
        return
    level = request.parameter("joinLevel") or "1"
    levels = min(int(level), MAX_LEVELS) if level.isascii() and level.isdecimal() else 1
    store = request.tenant.store
    edge = [entity for entity in others.values() if entity is not None]
    for _ in range(levels):
        ids = [entity_id for entity_id in dict.fromkeys(_objects(edge)) if entity_id not in others]
        if not ids:
            return
        collector = FragmentCollector(sources.admission)
        target = EntityTarget(ids=tuple(ids))
        matches = queryable_matches(sources, target, uses_map=False)
        await gather_all(
            *(fetch_entities(sources, match, {}, context, collector, is_split=True) for match in matches)
        )
        proxied = [match.registration for match in matches if match.registration.mode.is_proxied]
        collected = {
            entity_id: collector.entity(store.get(entity_id), entity_id, proxied) for entity_id in ids
        }
        edge = [entity for entity in collected.values() if entity is not None]
        others.update({entity.id: entity for entity in edge})


def _objects(entities: Iterable[Entity]) -> Iterable[str]:
    for entity in entities:
        for instances in entity.attributes.values():
            for instance in instances:
                value = instance.get("object")
                yield from value if isinstance(value, list) else [value] if isinstance(value, str) else ()
                for target in instance.get("objectList") or ():
                    if isinstance(target, dict) and isinstance(target.get("object"), str):
                        yield target["object"]


def _over(request: RequestContext, overlay_store: Any) -> RequestContext:
    """Return the request with the merged entities in place of the tenant's own."""
    tenant = copy.copy(request.tenant)
    tenant.store = overlay_store
    return derived(request, tenant=tenant)
