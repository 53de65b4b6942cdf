"""Reads temporal evolutions from one source, or from the broker itself.

A source is queried for what its registration covers, in the requested representation. For aggregations over
several sources the plain values are read instead, part by part.
"""

import time
from collections.abc import Awaitable, Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Final

import orjson

from handover.errors import Problem
from handover.network.http_client import HttpResponse
from handover_broker.model.context import Context
from handover_broker.model.entity import Entity
from handover_broker.model.problems import too_many_results
from handover_broker.model.validation import written_time
from handover_broker.request.derived_request import derived
from handover_broker.request.request_context import RequestContext, Response
from handover_broker.temporal.query import (
    AGGREGATION_PARAMETERS,
    TIME_PARAMETERS,
    Representation,
    TemporalQuery,
    TemporalView,
)
from handover_federation.distribution.distributed_operations import (
    Perform,
    Sources,
    gather_all,
)
from handover_federation.distribution.forwarding.forwarder import (
    INVALID,
    SILENT,
    SourceDialect,
    SourceError,
    SourceRequest,
)
from handover_federation.distribution.forwarding.translation import translated
from handover_federation.distribution.instances import types_in
from handover_federation.distribution.reads import temporal_merge
from handover_federation.distribution.reads.entity_fetching import MAX_IDS
from handover_federation.distribution.reads.source_responses import answered_context, query_source
from handover_federation.distribution.reads.temporal_merge import Evolution
from handover_federation.registrations.registration import Match, Registration

SHOWING: Final = ("pick", "omit")
"""Projection parameters; they apply to merged evolutions."""
MAX_PARTS: Final = 100
"""Parts in which the values of one source are read, each with at most a thousand per attribute."""
READ_TIMEOUT_S: Final = 30.0
"""Time limit for reading the values for an aggregation, about as long as clients wait for a response."""
_NOT_PASSED_ON: Final = frozenset(
    {"local", "id", "idPattern", "type", "attrs", "pick", "omit", "limit", "offset", "count", "csf",
     "splitEntities", "entities", "temporalQ", "aggrParams", "entityMapLifetime"}
)  # fmt: skip
_NAMING: Final = frozenset({"q", "geoproperty"})
_FORMS: Final = frozenset({"options", "format", *AGGREGATION_PARAMETERS, *SHOWING})


@dataclass(frozen=True, slots=True)
class TemporalRequest:
    """A temporal query: its parameters, its time range, and the requested representation."""

    context: Context
    parameters: Mapping[str, str]
    query: TemporalQuery
    view: TemporalView

    @property
    def is_for_totals(self) -> bool:
        """Return whether aggregated values are requested."""
        return self.view.representation is Representation.AGGREGATED

    def for_values(self) -> dict[str, str]:
        """Return the parameters of a query for the plain values to aggregate."""
        parameters = {name: value for name, value in self.parameters.items() if name not in _FORMS}
        return {**parameters, "options": "sysAttrs"}


@dataclass(frozen=True, slots=True)
class TemporalPart:
    """Evolutions of one source in the names of the client; `edge` is where they end if there are more."""

    documents: list[Evolution]
    edge: int | None = None


_NOTHING: Final = TemporalPart([])
FetchPart = Callable[[Mapping[str, str]], Awaitable[TemporalPart]]
"""Reads a part with these parameters."""


async def fetch_values(
    readers: Iterable[tuple[Registration | None, FetchPart]],
    temporal_request: TemporalRequest,
    timeout_s: float = READ_TIMEOUT_S,
) -> list[temporal_merge.SourceEvolution]:
    """Return all values with their times, read part by part.

    Raises a problem (403) when there are too many, or reading them takes longer than `timeout_s`.
    """

    async def read(registration: Registration | None, ask: FetchPart) -> list[temporal_merge.SourceEvolution]:
        by_id: dict[str, Evolution] = {}
        parameters: dict[str, str] | None = temporal_request.for_values()
        parts, until_s = 0, time.monotonic() + timeout_s
        while parameters is not None:
            part = await ask(parameters)
            for document in part.documents:
                value = temporal_merge.shown(document, temporal_request.view, temporal_request.context)
                entity_id = document["id"]
                by_id[entity_id] = (
                    temporal_merge.merge_evolutions(
                        [(None, by_id[entity_id]), (None, value)], temporal_request.context, None
                    )
                    if entity_id in by_id
                    else value
                )
            parts += 1
            parameters = None if part.edge is None else _after(parameters, part.edge, temporal_request.query)
            if parameters is not None and (parts >= MAX_PARTS or time.monotonic() > until_s):
                raise _too_many()
        return [(registration, document) for document in by_id.values()]

    return [pair for some in await gather_all(*(read(*teller) for teller in readers)) for pair in some]


def _after(parameters: dict[str, str], edge: int, query: TemporalQuery) -> dict[str, str] | None:
    """Return the parameters for what follows the edge; None if nothing does."""
    if query.last is not None or query.time_property is None:
        raise _too_many()
    if query.end is None:
        return {**parameters, "timerel": "after", "timeAt": written_time(edge)}
    if edge + 1 >= query.end:
        return None
    between = {"timerel": "between", "timeAt": written_time(edge + 1), "endTimeAt": written_time(query.end)}
    return {**parameters, **between}


def _too_many() -> Problem:
    return too_many_results(
        "several sources have values of one entity, and more than can be aggregated together; ask "
        "for a shorter time with timerel, timeAt and endTimeAt"
    )


def source_fetchers(
    sources: Sources,
    matched: Iterable[tuple[Match, Mapping[str, str]]],
    context: Context,
    ids: tuple[str, ...],
) -> list[tuple[Registration | None, FetchPart]]:
    """Return functions that read some entities from the sources."""

    def of_source(match: Match) -> FetchPart:
        def ask(parameters: Mapping[str, str]) -> Awaitable[TemporalPart]:
            wanted = {**parameters, "limit": str(len(ids))}
            return fetch_from_source(sources, match, "temporal/entities", wanted, context)

        return ask

    readers: list[tuple[Registration | None, FetchPart]] = []
    for match, _ in matched:
        parts = tuple(
            replace(part, ids=some)
            for part in match.parts
            if (some := tuple(entity_id for entity_id in ids if part.ids is None or entity_id in part.ids))
        )
        if parts:
            readers.append((match.registration, of_source(Match(match.registration, parts))))
    return readers


def own_fetcher(request: RequestContext, perform: Perform, ids: tuple[str, ...]) -> FetchPart:
    """Return a function that reads some of the broker's own entities."""
    narrowed = {"offset": "0", "limit": str(len(ids))}
    hidden = {"aggrParams", *SHOWING}

    async def ask(parameters: Mapping[str, str]) -> TemporalPart:
        rest = {name: value for name, value in parameters.items() if name != "count"}
        if request.method == "GET":
            wanted = derived(request, parameters={**rest, **narrowed, "id": ",".join(ids)})
        else:
            document = {name: value for name, value in request.document().items() if name not in hidden}
            selectors = document.get("entities") or [{}]
            document["entities"] = [{**selector, "id": list(ids)} for selector in selectors]
            times = {name: rest[name] for name in TIME_PARAMETERS if name in rest}
            document["temporalQ"] = {**times, **({"lastN": int(times["lastN"])} if "lastN" in times else {})}
            forms = {name: rest[name] for name in ("options", "lang") if name in rest}
            raw = orjson.dumps(document)
            wanted = derived(request, parameters={**forms, **narrowed}, raw=raw)
        answer = await perform(wanted)
        return TemporalPart(
            [without_context(evolution) for evolution in orjson.loads(answer.body)], edge_of(answer)
        )

    return ask


async def fetch_from_source(
    sources: Sources,
    match: Match,
    path: str,
    parameters: Mapping[str, str],
    context: Context,
    *,
    single: bool = False,
) -> TemporalPart:
    """Return the evolutions of a source in the names of `context`."""
    pieces = [match] if single else list(match.split_by_ids(MAX_IDS))
    if len(pieces) == 1:
        return await _fetch_once(sources, match, path, parameters, context, single=single)
    parts = await gather_all(*(_fetch_once(sources, piece, path, parameters, context) for piece in pieces))
    edges = [part.edge for part in parts if part.edge is not None]
    edge = None if not edges else max(edges) if "lastN" in parameters else min(edges)
    return TemporalPart([document for part in parts for document in part.documents], edge)


async def _fetch_once(
    sources: Sources,
    match: Match,
    path: str,
    parameters: Mapping[str, str],
    context: Context,
    *,
    single: bool = False,
) -> TemporalPart:
    registration = match.registration
    try:
        dialect = await sources.forwarder.dialect(registration, context, body=None)
        wanted = [] if single else entity_parameters(match, parameters, dialect.name)
        wanted += temporal_parameters_of(match, parameters, dialect, same=dialect.context is context)
        if not single:
            wanted += [
                (name, parameters[name]) for name in ("limit", "offset") if parameters.get(name, "0") != "0"
            ]
        headers = sources.map_headers(registration)
        source_request = SourceRequest("GET", path, dialect, tuple(wanted), headers=headers)
        response = await query_source(sources, registration, source_request)
        if response is None:
            return _NOTHING
        documents = _documents(registration, response, single=single)
        there = await answered_context(sources, response, dialect)
    except SourceError as error:
        sources.add_error(error)
        return _NOTHING
    except Problem as problem:
        sources.add_error(SourceError(registration, SILENT, 502, problem.detail))
        return _NOTHING
    in_ours = (
        translated(without_context(document), there.terms, context.terms)
        for document in documents
        if _is_admitted(sources, registration, document, there)
    )
    edge = temporal_merge.edge_in(response.headers.get("content-range")) if response.status == 206 else None
    return TemporalPart([_limited(document, match.attributes, context) for document in in_ours], edge)


def _is_admitted(sources: Sources, registration: Registration, document: Evolution, there: Context) -> bool:
    """Return whether an evolution of a source counts and the client may see it; note that it is read."""
    types = types_in(document, there) or frozenset()
    entity_id, store = document["id"], sources.request.tenant.store
    if not sources.admission.admits(registration, entity_id, types) or store.hides(entity_id, types):
        return False
    store.note_read((store.get(entity_id) or Entity(entity_id, tuple(types), {}, "", ""),))
    return True


def temporal_parameters_of(
    match: Match, parameters: Mapping[str, str], dialect: SourceDialect, *, same: bool
) -> list[tuple[str, str]]:
    """Return the query parameters for a source, without those that select entities.

    `same`: its dialect uses the names of the request.
    """
    names = match.attributes
    wanted = [] if names is None else [("attrs", ",".join(sorted(dialect.name(name) for name in names)))]
    return wanted + [
        (name, value)
        for name, value in parameters.items()
        if name not in _NOT_PASSED_ON and (same or name not in _NAMING)
    ]


def entity_parameters(
    match: Match, parameters: Mapping[str, str], name: Callable[[str], str]
) -> list[tuple[str, str]]:
    """Return the query parameters that select the entities of a source."""
    types = {kind for part in match.parts for kind in part.types or ()} or {
        kind for piece in match.registration.information for entity in piece.entities for kind in entity.types
    }
    wanted = [("type", ",".join(sorted(name(kind) for kind in types)))] if types else []
    ids = match.ids
    if ids:
        wanted.append(("id", ",".join(ids)))
    elif "idPattern" in parameters:
        wanted.append(("idPattern", parameters["idPattern"]))
    return wanted


def _documents(registration: Registration, response: HttpResponse, *, single: bool) -> list[Evolution]:
    try:
        body = orjson.loads(response.body) if response.body else ({} if single else [])
    except orjson.JSONDecodeError as error:
        why = f"{registration.shown} returns invalid JSON: {error}"
        raise SourceError(registration, INVALID, 502, why) from None
    documents = [body] if single and body else body
    if documents == {} and single:
        return []
    if not isinstance(documents, list) or not all(
        isinstance(document, dict) and isinstance(document.get("id"), str) for document in documents
    ):
        raise SourceError(registration, INVALID, 502, f"{registration.shown} returns no temporal entities")
    return documents


def without_context(document: Evolution) -> Evolution:
    """Return an evolution without its @context."""
    return {name: value for name, value in document.items() if name != "@context"}


def _limited(document: Evolution, names: frozenset[str] | None, context: Context) -> Evolution:
    if names is None:
        return document
    return {
        name: value
        for name, value in document.items()
        if name in temporal_merge.MEMBERS or context.terms.expand(name) in names
    }


def edge_of(answer: Response) -> int | None:
    """Return where the broker's own response ends; None for a complete one."""
    content_range = next((value for name, value in answer.headers if name == b"content-range"), b"")
    return temporal_merge.edge_in(content_range.decode())
