"""Operations that retrieve and query temporal evolutions (clauses 5.7.3, 5.7.4, 6.18, 6.19 and 6.24)."""

import asyncio
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any, Final, TypeVar

import orjson

from handover_broker.model.context import Context
from handover_broker.model.problems import bad_request_data, not_read
from handover_broker.model.representation.rendering import with_context
from handover_broker.model.validation import require_uri, shown
from handover_broker.operations.entity_operations import absent, nothing_left
from handover_broker.query.earlier_names import with_earlier_names
from handover_broker.query.ordering import Ordering, ordering
from handover_broker.query.pages import PLACE
from handover_broker.query.query_document import query_parameters, selectors_of
from handover_broker.query.selection import Selection
from handover_broker.request.query_parameters import (
    LINK_PARAMETERS,
    MAP_PARAMETERS,
    QUERY_PARAMETERS,
    VIEW_PARAMETERS,
    json_headers,
    page_links,
    selection_of,
)
from handover_broker.request.request_context import (
    JSON_LD,
    RequestContext,
    Response,
)
from handover_broker.request.routing import Operation
from handover_broker.storage.database import NotStored
from handover_broker.storage.history_archive import Archive
from handover_broker.temporal.history_reader import (
    EvolutionPage,
    HistoryRequest,
    read_evolution,
    read_evolutions,
)
from handover_broker.temporal.query import (
    AGGREGATION_PARAMETERS,
    TIME_PARAMETERS,
    Representation,
    TemporalQuery,
    TemporalView,
    temporal_query,
    temporal_view,
    temporal_window,
)
from handover_broker.temporal.rendering import content_range, render_evolution
from handover_broker.temporal.subjects import subjects_of

READER_THREADS: Final = 2
"""Threads that read the history: long reads wait for one another and delay no other request."""

_OF_THE_PRESENT: Final = LINK_PARAMETERS | {PLACE, "geometryProperty", "orderFrom", "orderGeometry"}
"""Parameters for current entities only."""
_REPRESENTATION_PARAMETERS: Final = (
    (VIEW_PARAMETERS - _OF_THE_PRESENT) | TIME_PARAMETERS | AGGREGATION_PARAMETERS
)
QUERYING: Final = (QUERY_PARAMETERS - _OF_THE_PRESENT) | _REPRESENTATION_PARAMETERS

Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class _ReadOptions:
    """The time range, representation and media type of a request."""

    context: Context
    query: TemporalQuery
    view: TemporalView
    accept: str


class TemporalOperations:
    """Operations that read temporal evolutions."""

    def __init__(self, archive: Archive) -> None:
        self._archive = archive
        self._readers = ThreadPoolExecutor(READER_THREADS, "past")

    def operations(self) -> tuple[Operation, ...]:
        """Return the operations."""
        at, query = "temporal/entities", "temporal/entityOperations/query"
        return (
            Operation("GET", at, "queryTemporal", "6.18.3.2", self.query, QUERYING | MAP_PARAMETERS),
            Operation(
                "GET",
                f"{at}/{{id}}",
                "retrieveTemporal",
                "6.19.3.1",
                self.retrieve,
                _REPRESENTATION_PARAMETERS | MAP_PARAMETERS,
            ),
            Operation("POST", query, "queryTemporalBatch", "6.24.3.1", self.query_by_document, QUERYING),
        )

    async def retrieve(self, request: RequestContext) -> Response:
        """GET temporal/entities/{id}."""
        options = await self._read_options(request, await request.reader_context())
        entity_id = require_uri(request.names[0], "the entity id in the path")
        live = request.tenant.store.get(entity_id)
        history_request = HistoryRequest(options.query, options.view.wants, None, options.view.view.datasets)
        shows = request.tenant.store.shows

        def look() -> tuple[EvolutionPage, list[bytes]] | None:
            temporal_only = self._archive.temporal_only_entities(request.tenant.name, entity_id)
            subjects = [
                subject
                for subject in subjects_of(() if live is None else (live,), temporal_only)
                if shows(subject.with_all_types())
            ]
            if not subjects:
                return None
            page = read_evolution(self._archive, subjects[0], history_request)
            return page, _texts(page, options)

        answered = await self._looked(look)
        if answered is None:
            raise absent(entity_id)
        page, (text,) = answered
        _note_read(request, page)
        if text in {b"{}", with_context(b"{}", options.context)}:
            raise nothing_left(entity_id)
        return _answer(text, page, options)

    async def query(self, request: RequestContext) -> Response:
        """GET temporal/entities."""
        return await self._queried(request, await request.reader_context())

    async def query_by_document(self, request: RequestContext) -> Response:
        """POST temporal/entityOperations/query with a Query document (clause 5.2.23)."""
        document, context = await request.body()
        request.parameters = {**request.parameters, **temporal_parameters(document)}
        return await self._queried(request, context, selectors_of(document, context))

    async def _read_options(self, request: RequestContext, context: Context) -> _ReadOptions:
        accept = request.accept()
        view = temporal_view(request, context)
        query = temporal_query(
            request.parameters, aggregates=view.representation is Representation.AGGREGATED
        )
        return _ReadOptions(context, query, view, accept)

    async def _queried(
        self, request: RequestContext, context: Context, any_of: tuple[Selection, ...] = ()
    ) -> Response:
        context = with_earlier_names(context, request.parameter("type"))
        options = await self._read_options(request, context)
        if options.query.relation is None:
            raise bad_request_data(
                "a temporal query needs a time range: timerel and timeAt; add them, such as "
                "timerel=after&timeAt=1970-01-01T00:00:00Z for all the time"
            )
        window, order = temporal_window(request), _order_of(request, context)
        selection = selection_of(request.parameters, context, any_of)
        if selection.query is not None and selection.query.hops:
            raise bad_request_data(
                "q follows a link to another entity, which temporal queries cannot follow; leave it out"
            )
        narrowing = replace(selection, attributes=None, query=None, places=None, scopes=None)
        by_values = selection.query is not None or selection.places is not None
        history_request = HistoryRequest(
            options.query,
            options.view.wants,
            selection.attributes,
            options.view.view.datasets,
            replace(selection, scopes=None).wants if by_values else None,
            selection.scopes,
        )
        live = request.tenant.store.candidates(selection.ids, selection.types)
        name, shows = request.tenant.name, request.tenant.store.shows

        def look() -> tuple[EvolutionPage, list[bytes]]:
            ids: tuple[str | None, ...] = (
                (None,) if selection.ids is None else tuple(dict.fromkeys(selection.ids))
            )
            subjects = subjects_of(
                live,
                chain.from_iterable(
                    self._archive.temporal_only_entities(name, entity_id) for entity_id in ids
                ),
            )
            wanted = [
                subject
                for subject in subjects
                if narrowing.wants(subject.as_entity()) and shows(subject.with_all_types())
            ]
            if order is not None:
                wanted.sort(key=lambda subject: order.place_of(subject.as_entity()))
            page = read_evolutions(
                self._archive, wanted, history_request, window.offset, window.limit, count=window.count
            )
            return page, _texts(page, options)

        page, texts = await self._looked(look)
        _note_read(request, page)
        answer = _answer(b"[" + b",".join(texts) + b"]", page, options)
        if window.count:
            answer.headers.append((b"ngsild-results-count", str(page.total).encode()))
        if request.method == "GET":
            answer.headers += page_links(request, window, options.accept, more=page.more)
        return answer

    async def _looked(self, look: Callable[[], Result]) -> Result:
        """Read the database in a thread; raise a problem (503) when it cannot be read."""
        try:
            return await asyncio.get_running_loop().run_in_executor(self._readers, look)
        except NotStored as error:
            raise not_read(str(error)) from error


def _note_read(request: RequestContext, page: EvolutionPage) -> None:
    store = request.tenant.store
    subjects = (evolution.subject for evolution in page.evolutions)
    store.note_read(store.get(subject.id) or subject.as_entity() for subject in subjects)


def _texts(page: EvolutionPage, options: _ReadOptions) -> list[bytes]:
    terms = options.context.terms
    texts = [
        orjson.dumps(render_evolution(evolution, options.query, options.view, terms))
        for evolution in page.evolutions
    ]
    return [with_context(text, options.context) for text in texts] if options.accept == JSON_LD else texts


def _answer(body: bytes, page: EvolutionPage, options: _ReadOptions) -> Response:
    headers = (
        [(b"content-type", JSON_LD.encode())] if options.accept == JSON_LD else json_headers(options.context)
    )
    content = content_range(page, options.query)
    if content is None:
        return Response(200, body, headers)
    return Response(206, body, [*headers, (b"content-range", content)])


def _order_of(request: RequestContext, context: Context) -> Ordering | None:
    """Return the requested order; evolutions are ordered by id only (5.7.4.4)."""
    order = ordering(request.parameters, context.terms.expand)
    if order is not None and request.parameters["orderBy"].partition(";")[0] != "id":
        raise bad_request_data(
            "temporal queries are ordered by id only, because attributes change in the time range"
        )
    return order


def temporal_parameters(document: Any) -> dict[str, str]:
    """Return the query parameters equivalent to a Query document (clauses 5.2.21, 5.2.23, 5.2.44)."""
    if not isinstance(document, Mapping):
        raise bad_request_data(f'the body is an object with "type": "Query", not {shown(document)}')
    rest = {name: content for name, content in document.items() if name not in {"temporalQ", "aggrParams"}}
    parameters = query_parameters(rest)
    for name, members in (
        ("temporalQ", TIME_PARAMETERS | AGGREGATION_PARAMETERS),
        ("aggrParams", AGGREGATION_PARAMETERS),
    ):
        nested = document.get(name, {})
        if not isinstance(nested, Mapping) or not members.issuperset(nested):
            raise bad_request_data(f'"{name}" is an object with {", ".join(sorted(members))} at most')
        for member, value in nested.items():
            parameters[member] = _as_parameter(member, value)
    return parameters


def _as_parameter(name: str, value: Any) -> str:
    if name == "lastN" and isinstance(value, int) and not isinstance(value, bool):
        return str(value)
    if name == "aggrMethods" and isinstance(value, list) and all(isinstance(method, str) for method in value):
        return ",".join(value)
    if isinstance(value, str) and name != "lastN":
        return value
    raise bad_request_data(f'"{name}" in a temporal query cannot be {shown(value)}; see clause 5.2.21')
