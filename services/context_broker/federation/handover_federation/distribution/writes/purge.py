"""Purges entities at several sources (clause 5.6.21).

A source purges no more than its registration covers: entities of the registered types, and where attributes
are registered, these attributes instead of the entities. If an entity may be split over several sources, the
ids of the matching entities are determined first, because a single part may match where the whole entity does
not.
"""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any, Final

import orjson

from handover.errors import Problem
from handover_broker.model.context import Context
from handover_broker.operations.purge import selection_to_purge
from handover_broker.query.parameters import FILTERS, FORWARDED
from handover_broker.query.selection import hits_of
from handover_broker.request.derived_request import derived
from handover_broker.request.query_parameters import selection_of
from handover_broker.request.request_context import RequestContext, Response
from handover_federation.distribution.distributed_operations import (
    Perform,
    Sources,
    gather_all,
)
from handover_federation.distribution.forwarding.forwarder import (
    SILENT,
    SourceDialect,
    SourceError,
    SourceRequest,
)
from handover_federation.distribution.query_targets import may_be_split, target_of
from handover_federation.distribution.reads import entity_reading as reading
from handover_federation.distribution.reads.entity_fetching import MAX_CONCURRENT_REQUESTS, MAX_IDS
from handover_federation.distribution.writes import outcomes
from handover_federation.distribution.writes.outcomes import Outcome
from handover_federation.registrations.registration import EntityTarget, Match

_NAMING: Final = frozenset({"q", "geoproperty"})


async def purge(sources: Sources, request: RequestContext, perform: Perform) -> Response:
    """DELETE entities: the broker's own first, then those of all sources at the same time."""
    context = await request.reader_context()
    target, where = target_of(request.parameters, context, None)
    matches = sources.unvisited(sources.registry.matching("purgeEntity", target, where), changes=True)
    conditions = any(name in request.parameters for name in (*FILTERS, "attrs"))
    if conditions and may_be_split(request.parameters, matches):
        hits = await _whole_hits(sources, request, context)
        if not hits:
            return Response(204)
        gone = {name: request.parameters[name] for name in ("drop", "keep") if name in request.parameters}
        request = derived(request, parameters={**gone, "id": ",".join(hits), "local": "true"})
        named = EntityTarget(tuple(hits), None, target.types)
        matches = sources.unvisited(sources.registry.matching("purgeEntity", named, where), changes=True)
    own = await perform(request)
    pieces = [piece for match in matches for piece in match.split_by_ids(MAX_IDS)]
    results: list[Outcome] = []
    for start in range(0, len(pieces), MAX_CONCURRENT_REQUESTS):
        some = pieces[start : start + MAX_CONCURRENT_REQUESTS]
        results += await gather_all(
            *(_purge_at(sources, match, request.parameters, context) for match in some)
        )
    failed = [outcome for outcome in results if outcome.problem is not None and outcome.status != 404]
    if not failed:
        return own
    body: dict[str, Any] = {"success": [], "errors": []}
    if own.status == 207:
        body |= orjson.loads(own.body)
    for outcome in failed:
        # A source that purged in part says which entities it has purged, and which not.
        result = outcome.problem if outcome.is_partial else None
        body["success"] += outcomes.success_in(result)
        if result is None:
            body["errors"] += outcomes.entity_errors(None, [outcome])
            continue
        for entity_id, problem in outcomes.errors_in(result):
            body["errors"] += outcomes.entity_errors(entity_id, [replace(outcome, problem=problem)])
    return outcomes.multi_status(body)


async def _whole_hits(sources: Sources, request: RequestContext, context: Context) -> list[str]:
    """Return the ids of the merged entities that match the filters."""
    selection_to_purge(request, context)
    asking = {name: value for name, value in request.parameters.items() if name not in {"drop", "keep"}}
    ids: list[str] = []

    async def collect(over: RequestContext) -> Response:
        selection = selection_of({**over.parameters, "local": "true"}, context)
        ids.extend(entity.id for entity in await hits_of(over.tenant.store, selection))
        return Response(200)

    await reading.query(sources, derived(request, parameters=asking), collect)
    return ids


async def _purge_at(
    sources: Sources, match: Match, parameters: Mapping[str, str], context: Context
) -> Outcome:
    source, nothing = match.registration, frozenset[str]()
    try:
        dialect = await sources.forwarder.dialect(source, context, body=None)
        if dialect.context is not context and not _NAMING.isdisjoint(parameters):
            return outcomes.of_refusal(
                source, nothing, "conditions on attributes in names that are not its own"
            )
        wanted = _narrowed(match, parameters, context, dialect)
        if wanted is None:
            return Outcome(source, nothing, 204)
        source_request = SourceRequest("DELETE", "entities", dialect, tuple(wanted))
        response, _ = await sources.forwarder.send(source, source_request, sources.origin)
        if sources.is_loop_answer(source, response.status):
            return Outcome(source, nothing, 204)
    except SourceError as error:
        return outcomes.of_source_error(error, nothing)
    except Problem as problem:  # the @context of the source
        return outcomes.of_source_error(SourceError(source, SILENT, 502, problem.detail), nothing)
    outcome = outcomes.of_response(source, nothing, response)
    result = outcomes.document_in(response) if response.status == 207 else None
    return replace(outcome, problem=result, is_partial=True) if outcomes.errors_in(result) else outcome


def _narrowed(
    match: Match, parameters: Mapping[str, str], context: Context, dialect: SourceDialect
) -> list[tuple[str, str]] | None:
    """Return the query parameters for a source, None if its registration covers nothing to purge."""
    source = match.registration
    types = {kind for part in match.parts for kind in part.types or ()} or {
        kind for piece in source.information for entity in piece.entities for kind in entity.types
    }
    wanted = [("type", _joined(types, dialect))] if types else []
    if match.ids:
        wanted.append(("id", ",".join(match.ids)))
    wanted += [(name, parameters[name]) for name in FORWARDED if name in parameters]
    gone = _attributes(parameters.get("drop"), context)
    keep = _attributes(parameters.get("keep"), context)
    if all(piece.attributes is not None for piece in source.information):
        names = {name for piece in source.information for name in piece.attributes or ()}
        gone = (names if gone is None else names & gone) - (keep or set())
        if not gone:
            return None
        keep = None
    if gone is not None:
        wanted.append(("drop", _joined(gone, dialect)))
    if keep is not None:
        wanted.append(("keep", _joined(keep, dialect)))
    return wanted


def _attributes(text: str | None, context: Context) -> set[str] | None:
    return None if text is None else {context.terms.expand(name) for name in text.split(",") if name}


def _joined(names: Iterable[str], dialect: SourceDialect) -> str:
    return ",".join(sorted(dialect.name(name) for name in names))
