"""What a temporal request asks for, and its answer from merged evolutions."""

from collections.abc import Mapping

import orjson

from handover_broker.model.context import Context
from handover_broker.model.entity_parser import expand
from handover_broker.request.derived_request import derived
from handover_broker.request.query_parameters import (
    json_headers,
)
from handover_broker.request.request_context import (
    JSON_LD,
    RequestContext,
    Response,
)
from handover_broker.temporal.query import Representation, temporal_query, temporal_view
from handover_federation.distribution.reads import temporal_merge
from handover_federation.distribution.reads.temporal_fetching import (
    TemporalRequest,
)
from handover_federation.distribution.reads.temporal_merge import Evolution


def temporal_request_of(
    request: RequestContext, context: Context, parameters: Mapping[str, str]
) -> TemporalRequest:
    """Return what a request with these parameters asks the sources for."""
    view = temporal_view(derived(request, parameters=parameters), context)
    target = temporal_query(parameters, aggregates=view.representation is Representation.AGGREGATED)
    return TemporalRequest(context, parameters, target, view)


def attributes_of(parameters: Mapping[str, str], context: Context) -> frozenset[str] | None:
    """Return the attributes (IRIs) that a request is limited to; None for all."""
    text = parameters.get("attrs")
    if not text or "q" in parameters:
        return None
    return frozenset(expand(name, context.terms) for name in text.split(",") if name) or None


def temporal_answer(
    request: RequestContext,
    temporal_request: TemporalRequest,
    documents: list[Evolution],
    edge: int | None,
    *,
    single: bool = False,
) -> Response:
    """Return the answer with evolutions that are complete up to `edge`, None for all of them."""
    context = temporal_request.context
    if edge is not None:
        documents = [temporal_merge.kept_to(document, edge, temporal_request.query) for document in documents]
    collected = (
        b"" if edge is None else temporal_merge.content_range_of(documents, edge, temporal_request.query)
    )
    documents = [
        temporal_merge.with_members(document, temporal_request.query, temporal_request.view)
        for document in documents
    ]
    headers = json_headers(context)
    if request.accept() == JSON_LD:
        documents = [{"@context": context.document, **document} for document in documents]
        headers = [(b"content-type", JSON_LD.encode())]
    body = orjson.dumps(documents[0] if single else documents)
    if edge is None:
        return Response(200, body, headers)
    return Response(206, body, [*headers, (b"content-range", collected)])
