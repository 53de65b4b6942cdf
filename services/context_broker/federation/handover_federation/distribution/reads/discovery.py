"""Entity types and attributes of all context sources (clauses 5.7.5 to 5.7.11).

The local operation lists what registrations announce. Here the sources are queried, and the types and
attributes within their registrations are added.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import orjson

from handover.errors import Problem
from handover_broker.model.context import Context
from handover_broker.operations.discovery_operations import is_listed
from handover_broker.request.discovery_documents import (
    ATTRIBUTES,
    TYPES,
    Listing,
    attribute_detail,
    attribute_info,
    discovery_response,
    entry_document,
    type_info,
)
from handover_broker.request.request_context import RequestContext, Response
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
    quoted,
)
from handover_federation.distribution.reads.source_responses import query_source
from handover_federation.registrations.registration import EntityTarget, Registration

SourceDocument = tuple[Registration, SourceDialect, Any]
"""A source, the dialect of the request, and the document in its response."""
_EVERYTHING: Final = EntityTarget()
_LISTS: Final = ("typeList", "attributeList", "attributeDetails", "attributeTypes", "typeNames")
"""A response with a single document has at least one of these members."""


@dataclass(frozen=True, slots=True)
class _SourceListing:
    """How types or attributes are listed at sources."""

    names: Listing
    path: str
    operation: str
    details_operation: str
    is_registered: Callable[[Registration, str], bool]
    is_related_registered: Callable[[Registration, str], bool]


async def types(sources: Sources, request: RequestContext, perform: Perform) -> Response:
    """GET types."""
    return await _list(sources, request, perform, _TYPES)


async def attributes(sources: Sources, request: RequestContext, perform: Perform) -> Response:
    """GET attributes."""
    return await _list(sources, request, perform, _ATTRIBUTES)


async def type_details(sources: Sources, request: RequestContext, perform: Perform) -> Response:
    """GET types/{type}."""
    context = await request.reader_context()
    kind = context.terms.expand(request.names[0])
    if not is_listed(request, kind):
        return await perform(request)
    target = EntityTarget(types=frozenset({kind}))
    documents = await _query_sources(
        sources,
        "retrieveEntityTypeInfo",
        target,
        context,
        lambda dialect: f"types/{quoted(dialect.name(kind))}",
    )
    empty = type_info(kind, context)
    response = await _own(request, perform, empty if documents else None, context)
    body = orjson.loads(response.body)
    if not documents or not isinstance(body, dict):
        return response
    details = {attribute["id"]: attribute for attribute in body["attributeDetails"]}
    for registration, dialect, document in documents:
        body["entityCount"] += _count(document, "entityCount")
        details_there = document.get("attributeDetails")
        for detail in details_there if isinstance(details_there, list) else ():
            name = _iri(detail, "attributeName", dialect)
            if name is not None and _has_attribute(registration, name):
                own = details.setdefault(name, attribute_detail(name, context))
                own["attributeTypes"] = _union(own["attributeTypes"], detail.get("attributeTypes"))
    body["attributeDetails"] = list(details.values())
    return Response(response.status, orjson.dumps(body), response.headers)


async def attribute_details(sources: Sources, request: RequestContext, perform: Perform) -> Response:
    """GET attributes/{attrId}."""
    context = await request.reader_context()
    name = context.terms.expand(request.names[0])
    target = EntityTarget(attributes=frozenset({name}))
    documents = await _query_sources(
        sources,
        "retrieveAttrTypeInfo",
        target,
        context,
        lambda dialect: f"attributes/{quoted(dialect.name(name))}",
    )
    empty = attribute_info(name, context)
    response = await _own(request, perform, empty if documents else None, context)
    body = orjson.loads(response.body)
    if not documents or not isinstance(body, dict):
        return response
    for registration, dialect, document in documents:
        if not all(
            is_listed(request, dialect.context.terms.expand(text))
            for text in _texts(document.get("typeNames"))
        ):
            continue  # it counts entities that the client may not see
        body["attributeCount"] += _count(document, "attributeCount")
        body["attributeTypes"] = _union(body["attributeTypes"], document.get("attributeTypes"))
        kinds = [dialect.context.terms.expand(text) for text in _texts(document.get("typeNames"))]
        there = [context.terms.compact(kind) for kind in kinds if _has_type(registration, kind)]
        body["typeNames"] = _union(body["typeNames"], there)
    return Response(response.status, orjson.dumps(body), response.headers)


async def _list(
    sources: Sources, request: RequestContext, perform: Perform, listed: _SourceListing
) -> Response:
    shows_details = request.parameter("details") == "true"
    # Only details show which attributes belong to types that the client may see.
    has_details = shows_details or not request.tenant.store.may_see_private(somewhere=False)
    operation = listed.details_operation if has_details else listed.operation
    context = await request.reader_context()
    documents = await _query_sources(
        sources, operation, _EVERYTHING, context, lambda _: listed.path, details=has_details
    )
    response = await perform(request)
    documents = [_visible(request, listed, document) for document in documents] if has_details else documents
    if not documents:
        return response
    if shows_details:
        return _add_entries(response, listed, documents, context)
    if has_details:
        documents = [_as_list(listed, document) for document in documents]
    return _add_names(response, listed, documents, context)


def _visible(request: RequestContext, listed: _SourceListing, answer: SourceDocument) -> SourceDocument:
    """Return the entries of a source (with details) without the types that the client may not see."""
    registration, dialect, document = answer
    if request.tenant.store.may_see_private(somewhere=False):
        return answer
    expand, names = dialect.context.terms.expand, listed.names
    if names is TYPES:
        entries = [
            detail for detail in document if is_listed(request, _iri(detail, names.name, dialect) or "")
        ]
        return registration, dialect, entries
    entries = []
    for entry in document:
        there = _texts(entry.get(names.related))
        some = [name for name in there if is_listed(request, expand(name))]
        if some:
            entries.append({**entry, names.related: some})
    return registration, dialect, entries


def _as_list(listed: _SourceListing, answer: SourceDocument) -> SourceDocument:
    """Return the plain list of names in the entries of a source."""
    registration, dialect, entries = answer
    return registration, dialect, {listed.names.member: [detail.get(listed.names.name) for detail in entries]}


async def _query_sources(
    sources: Sources,
    operation: str,
    target: EntityTarget,
    context: Context,
    path: Callable[[SourceDialect], str],
    *,
    details: bool = False,
) -> list[SourceDocument]:
    async def ask(registration: Registration) -> SourceDocument | None:
        try:
            dialect = await sources.forwarder.dialect(registration, context, body=None)
            parameters = (("details", "true"),) if details else ()
            response = await query_source(
                sources, registration, SourceRequest("GET", path(dialect), dialect, parameters)
            )
            if response is None:
                return None
            document = orjson.loads(response.body)
        except SourceError as error:
            sources.add_error(error)
        except orjson.JSONDecodeError as error:
            sources.add_error(
                SourceError(registration, INVALID, 502, f"{registration.shown} returns invalid JSON: {error}")
            )
        except Problem as problem:
            sources.add_error(SourceError(registration, SILENT, 502, problem.detail))
        else:
            if _has_expected_shape(document, details=details):
                return registration, dialect, document
            sources.add_warning(INVALID, f"{registration.shown} returns something other than was requested")
        return None

    matches = sources.unvisited(sources.registry.matching(operation, target))
    documents = await gather_all(*(ask(match.registration) for match in matches))
    return [document for document in documents if document is not None]


def _has_expected_shape(document: Any, *, details: bool) -> bool:
    """Return whether a document has the shape of a discovery response."""
    if details:
        return isinstance(document, list) and all(isinstance(detail, dict) for detail in document)
    return isinstance(document, dict) and any(isinstance(document.get(name), list) for name in _LISTS)


async def _own(
    request: RequestContext, perform: Perform, empty: dict[str, Any] | None, context: Context
) -> Response:
    """Return the broker's own response, or an empty one if only context sources have results."""
    try:
        return await perform(request)
    except Problem as problem:
        if problem.status != 404 or empty is None:
            raise
    return discovery_response(request, context, empty)


def _add_names(
    response: Response, listed: _SourceListing, documents: list[SourceDocument], context: Context
) -> Response:
    """Add the types or attributes of sources to a plain list."""
    member = listed.names.member
    body = orjson.loads(response.body)
    listed_iris = {context.terms.expand(name) for name in body[member]}
    there = {
        iri
        for registration, dialect, document in documents
        for iri in map(dialect.context.terms.expand, _texts(document.get(member)))
        if listed.is_registered(registration, iri)
    }
    iris = sorted(listed_iris | there)
    body[member] = [context.terms.compact(iri) for iri in iris]
    return _counted(response, body, len(iris))


def _add_entries(
    response: Response, listed: _SourceListing, documents: list[SourceDocument], context: Context
) -> Response:
    """Add the entries of sources to a detailed list."""
    body = orjson.loads(response.body)
    by_id = {detail["id"]: detail for detail in body}
    shape = {"@context": context.document} if body and "@context" in body[0] else {}
    related = listed.names.related
    for source_document in documents:
        for iri, others in _entries(source_document, listed):
            fresh = {**shape, **entry_document(listed.names, iri, (), context)}
            own = by_id.setdefault(iri, fresh)
            own[related] = _union(own[related], [context.terms.compact(name) for name in others])
    return _counted(response, [by_id[iri] for iri in sorted(by_id)], len(by_id))


def _counted(response: Response, body: Any, count: int) -> Response:
    headers = [
        (name, str(count).encode() if name == b"ngsild-results-count" else value)
        for name, value in response.headers
    ]
    return Response(response.status, orjson.dumps(body), headers)


def _has_type(registration: Registration, kind: str) -> bool:
    return any(
        not piece.entities or any(kind in entity.types for entity in piece.entities)
        for piece in registration.information
    )


def _has_attribute(registration: Registration, name: str) -> bool:
    return any(piece.attributes is None or name in piece.attributes for piece in registration.information)


def _entries(source_document: SourceDocument, listed: _SourceListing) -> Iterable[tuple[str, list[str]]]:
    """Yield the entries in the document of a source, as far as they are registered, each with what is
    related to it."""
    registration, dialect, document = source_document
    for entry in document:
        iri = _iri(entry, listed.names.name, dialect)
        if iri is not None and listed.is_registered(registration, iri):
            others = [dialect.context.terms.expand(text) for text in _texts(entry.get(listed.names.related))]
            yield iri, [name for name in others if listed.is_related_registered(registration, name)]


def _iri(document: Any, name: str, dialect: SourceDialect) -> str | None:
    if not isinstance(document, dict):
        return None
    documents = document.get(name)
    if isinstance(documents, str) and documents:
        return dialect.context.terms.expand(documents)
    documents = document.get("id")
    return documents if isinstance(documents, str) else None


def _count(document: Mapping[str, Any], member: str) -> int:
    documents = document.get(member)
    return documents if isinstance(documents, int) and not isinstance(documents, bool) else 0


def _texts(texts: Any) -> list[str]:
    return [text for text in texts if isinstance(text, str)] if isinstance(texts, list) else []


def _union(own: list[str], others: Any) -> list[str]:
    return sorted({*own, *_texts(others)})


_TYPES: Final = _SourceListing(
    TYPES, "types", "retrieveEntityTypes", "retrieveEntityTypeDetails", _has_type, _has_attribute
)
_ATTRIBUTES: Final = _SourceListing(
    ATTRIBUTES, "attributes", "retrieveAttrTypes", "retrieveAttrTypeDetails", _has_attribute, _has_type
)
