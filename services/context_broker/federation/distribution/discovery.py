"""Entity types and attributes of all context sources (clauses 5.7.5 to 5.7.11).

The local operation lists what registrations announce. Here the sources are queried, and the types and
attributes within their registrations are added.
"""

from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final

import orjson

from handover.errors import Problem
from services.context_broker.federation.distribution.distributed_operations import (
    Perform,
    Sources,
    gather_all,
)
from services.context_broker.federation.distribution.forwarding import (
    INVALID,
    SILENT,
    SourceDialect,
    SourceError,
    SourceRequest,
    quoted,
)
from services.context_broker.federation.distribution.source_responses import query_source
from services.context_broker.federation.registrations.registration import EntityTarget, Registration
from services.context_broker.model.context import Context
from services.context_broker.request.query_parameters import json_headers
from services.context_broker.request.request_context import (
    JSON_LD,
    RequestContext,
    Response,
)

SourceDocument = tuple[Registration, SourceDialect, Any]
"""A source, the dialect of the request, and the document in its response."""
_EVERYTHING: Final = EntityTarget()
_LISTS: Final = ("typeList", "attributeList", "attributeDetails", "attributeTypes", "typeNames")
"""A response with a single document has at least one of these members."""


async def types(sources: Sources, request: RequestContext, perform: Perform) -> Response:
    """GET types."""
    has_details = request.parameter("details") == "true"
    operation = "retrieveEntityTypeDetails" if has_details else "retrieveEntityTypes"
    context = await request.reader_context()
    documents = await _query_sources(
        sources, operation, _EVERYTHING, context, lambda _: "types", details=has_details
    )
    answer = await perform(request)
    if not documents:
        return answer
    if not has_details:
        found = {name for one in documents for name in _iris(one, "typeList") if _has_type(one[0], name)}
        return _with_list(answer, "typeList", found, context)
    entries = [entry for one in documents for entry in _entries(one, "attributeNames", _has_type)]
    return _with_entries(answer, "EntityType", ("typeName", "attributeNames"), entries, context)


async def attributes(sources: Sources, request: RequestContext, perform: Perform) -> Response:
    """GET attributes."""
    has_details = request.parameter("details") == "true"
    operation = "retrieveAttrTypeDetails" if has_details else "retrieveAttrTypes"
    context = await request.reader_context()
    documents = await _query_sources(
        sources, operation, _EVERYTHING, context, lambda _: "attributes", details=has_details
    )
    answer = await perform(request)
    if not documents:
        return answer
    if not has_details:
        found = {
            name for one in documents for name in _iris(one, "attributeList") if _has_attribute(one[0], name)
        }
        return _with_list(answer, "attributeList", found, context)
    entries = [entry for one in documents for entry in _entries(one, "typeNames", _has_attribute)]
    return _with_entries(answer, "Attribute", ("attributeName", "typeNames"), entries, context)


async def type_details(sources: Sources, request: RequestContext, perform: Perform) -> Response:
    """GET types/{type}."""
    context = await request.reader_context()
    kind = context.terms.expand(request.names[0])
    target = EntityTarget(types=frozenset({kind}))
    documents = await _query_sources(
        sources,
        "retrieveEntityTypeInfo",
        target,
        context,
        lambda dialect: f"types/{quoted(dialect.name(kind))}",
    )
    empty = {
        "id": kind,
        "type": "EntityTypeInfo",
        "typeName": context.terms.compact(kind),
        "entityCount": 0,
        "attributeDetails": [],
    }
    answer = await _own(request, perform, empty if documents else None, context)
    body = orjson.loads(answer.body)
    if not documents or not isinstance(body, dict):
        return answer
    details = {one["id"]: one for one in body["attributeDetails"]}
    for registration, dialect, document in documents:
        body["entityCount"] += _count(document, "entityCount")
        details_there = document.get("attributeDetails")
        for one in details_there if isinstance(details_there, list) else ():
            name = _iri(one, "attributeName", dialect)
            if name is not None and _has_attribute(registration, name):
                own = details.setdefault(name, {"id": name, "type": "Attribute", "attributeTypes": []})
                own["attributeName"] = context.terms.compact(name)
                own["attributeTypes"] = _union(own["attributeTypes"], one.get("attributeTypes"))
    body["attributeDetails"] = list(details.values())
    return Response(answer.status, orjson.dumps(body), answer.headers)


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
    empty = {
        "id": name,
        "type": "Attribute",
        "attributeName": context.terms.compact(name),
        "attributeCount": 0,
        "attributeTypes": [],
        "typeNames": [],
    }
    answer = await _own(request, perform, empty if documents else None, context)
    body = orjson.loads(answer.body)
    if not documents or not isinstance(body, dict):
        return answer
    for registration, dialect, document in documents:
        body["attributeCount"] += _count(document, "attributeCount")
        body["attributeTypes"] = _union(body["attributeTypes"], document.get("attributeTypes"))
        kinds = [dialect.context.terms.expand(one) for one in _texts(document.get("typeNames"))]
        there = [context.terms.compact(one) for one in kinds if _has_type(registration, one)]
        body["typeNames"] = _union(body["typeNames"], there)
    return Response(answer.status, orjson.dumps(body), answer.headers)


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
                SourceError(
                    registration, INVALID, 502, f"{registration.endpoint} returns invalid JSON: {error}"
                )
            )
        except Problem as problem:
            sources.add_error(SourceError(registration, SILENT, 502, problem.detail))
        else:
            if _is_answer(document, details=details):
                return registration, dialect, document
            sources.add_warning(
                INVALID, f"{registration.endpoint} returns something other than was requested"
            )
        return None

    matches = sources.unvisited(sources.registry.matching(operation, target))
    found = await gather_all(*(ask(one.registration) for one in matches))
    return [one for one in found if one is not None]


def _is_answer(document: Any, *, details: bool) -> bool:
    """Return whether a document has the shape of a discovery response."""
    if details:
        return isinstance(document, list) and all(isinstance(one, dict) for one in document)
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
    if request.accept() == JSON_LD:
        body = orjson.dumps({"@context": context.document, **empty})
        return Response(200, body, [(b"content-type", JSON_LD.encode())])
    return Response(200, orjson.dumps(empty), json_headers(context))


def _with_list(answer: Response, member: str, found: Iterable[str], context: Context) -> Response:
    body = orjson.loads(answer.body)
    known = {context.terms.expand(one) for one in body[member]}
    names = sorted(known.union(found))
    body[member] = [context.terms.compact(one) for one in names]
    return _counted(answer, body, len(names))


def _with_entries(
    answer: Response,
    kind: str,
    members: tuple[str, str],
    entries: Iterable[tuple[str, list[str]]],
    context: Context,
) -> Response:
    body = orjson.loads(answer.body)
    known = {one["id"]: one for one in body}
    name, below = members
    shape = {"@context": context.document} if body and "@context" in body[0] else {}
    for iri, others in entries:
        fresh = {**shape, "id": iri, "type": kind, name: context.terms.compact(iri), below: []}
        own = known.setdefault(iri, fresh)
        own[below] = _union(own[below], [context.terms.compact(one) for one in others])
    return _counted(answer, [known[iri] for iri in sorted(known)], len(known))


def _counted(answer: Response, body: Any, count: int) -> Response:
    headers = [
        (name, str(count).encode() if name == b"ngsild-results-count" else value)
        for name, value in answer.headers
    ]
    return Response(answer.status, orjson.dumps(body), headers)


def _has_type(registration: Registration, kind: str) -> bool:
    return any(
        not piece.entities or any(kind in one.types for one in piece.entities)
        for piece in registration.information
    )


def _has_attribute(registration: Registration, name: str) -> bool:
    return any(piece.attributes is None or name in piece.attributes for piece in registration.information)


def _iris(documents: SourceDocument, member: str) -> list[str]:
    _, dialect, document = documents
    return [dialect.context.terms.expand(one) for one in _texts(document.get(member))]


def _entries(
    documents: SourceDocument, member: str, has: Callable[[Registration, str], bool]
) -> Iterable[tuple[str, list[str]]]:
    registration, dialect, document = documents
    name = "typeName" if member == "attributeNames" else "attributeName"
    below = _has_attribute if member == "attributeNames" else _has_type
    for one in document:
        iri = _iri(one, name, dialect)
        if iri is not None and has(registration, iri):
            others = [dialect.context.terms.expand(other) for other in _texts(one.get(member))]
            yield iri, [other for other in others if below(registration, other)]


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


def _texts(given: Any) -> list[str]:
    return [one for one in given if isinstance(one, str)] if isinstance(given, list) else []


def _union(own: list[str], others: Any) -> list[str]:
    return sorted({*own, *_texts(others)})
