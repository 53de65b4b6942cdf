"""Responses with one entity or a page of entities, in the accepted media type.

Clauses 6.3.4 to 6.3.7, 6.3.10 and 6.3.15.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple

import orjson

from handover_broker.model.context import Context, link_header
from handover_broker.model.entity import Entity
from handover_broker.model.negotiation import GEO_JSON, JSON_LD, WITH_GEO_JSON
from handover_broker.model.representation.geojson import collection_body, feature_body, feature_of, geometry
from handover_broker.model.representation.rendering import View, render, rendered, with_context
from handover_broker.query.linked import Join, joined
from handover_broker.query.pages import Window
from handover_broker.query.q_match import Lookup, no_lookup
from handover_broker.query.selection import Page
from handover_broker.request.geojson_parameters import has_context_in_body, place_of
from handover_broker.request.query_parameters import json_headers, page_link
from handover_broker.request.request_context import RequestContext, Response


class Showing(NamedTuple):
    """The representation of entities: names, form and linked entities; `lookup` finds these."""

    context: Context
    view: View
    join: Join | None = None
    lookup: Lookup = no_lookup


def entity_answer(request: RequestContext, entity: Entity, showing: Showing) -> Response:
    """Return a response with one entity; with flat linked ones it is a list, even of one (4.5.23.3)."""
    if showing.join is not None and showing.join.is_flat:
        return Response(200, *_list_body(request, [entity], showing))
    showing = _noted(request, [entity], showing)
    accept, context = request.accept(WITH_GEO_JSON), showing.context
    if accept == GEO_JSON:
        (feature,) = _features(request, [entity], showing)
        in_body = has_context_in_body(request)
        return Response(
            200, feature_body(feature, context, with_context=in_body), _geo_headers(context, in_body)
        )
    (text,) = _texts([entity], showing)
    if accept == JSON_LD:
        return Response(200, with_context(text, context), [(b"content-type", JSON_LD.encode())])
    return Response(200, text, json_headers(context))


def entities_answer(
    request: RequestContext, page: Page, window: Window, showing: Showing, mark: int = 0
) -> Response:
    """Return a response with a page of entities, and links to the previous and the next page.

    The links contain positions in the order that `mark` identifies. After a POST the same body is sent to
    them.
    """
    body, headers = _list_body(request, page.entities, showing)
    if page.total is not None:
        headers.append((b"ngsild-results-count", str(page.total).encode()))
    if window.limit == 0:
        return Response(200, body, headers)
    accept = request.accept(WITH_GEO_JSON)
    if page.before:
        place = None if page.first is None else page.first.written(mark)
        headers.append(page_link(request, max(0, window.offset - window.limit), "prev", accept, place))
    if page.more:
        place = None if page.last is None else page.last.written(mark)
        headers.append(page_link(request, window.offset + window.limit, "next", accept, place))
    return Response(200, body, headers)


def _list_body(
    request: RequestContext, entities: list[Entity], showing: Showing
) -> tuple[bytes, list[tuple[bytes, bytes]]]:
    showing = _noted(request, entities, showing)
    accept, context = request.accept(WITH_GEO_JSON), showing.context
    if accept == GEO_JSON:
        in_body = has_context_in_body(request)
        features = _features(request, entities, showing)
        return collection_body(features, context, with_context=in_body), _geo_headers(context, in_body)
    texts = _texts(entities, showing)
    headers = json_headers(context)
    if accept == JSON_LD:
        texts = (with_context(text, context) for text in texts)
        headers = [(b"content-type", JSON_LD.encode())]
    return b"[" + b",".join(texts) + b"]", headers


def _noted(request: RequestContext, entities: list[Entity], showing: Showing) -> Showing:
    """Note which entities the response contains, the linked ones as they are found."""
    store = request.tenant.store
    store.note_read(entities)
    if showing.join is None:
        return showing

    def lookup(entity_id: str) -> Entity | None:
        entity = showing.lookup(entity_id)
        if entity is not None:
            store.note_read((entity,))
        return entity

    return showing._replace(lookup=lookup)


def _texts(entities: list[Entity], showing: Showing) -> Iterable[bytes]:
    context, view, join = showing.context, showing.view, showing.join
    if join is None:
        return (rendered(entity, context, view) for entity in entities)
    return (
        orjson.dumps(document) for _, document in joined(entities, context.terms, view, join, showing.lookup)
    )


def _features(request: RequestContext, entities: list[Entity], showing: Showing) -> list[dict[str, Any]]:
    place, terms, view = place_of(request, showing.context), showing.context.terms, showing.view
    if showing.join is None:
        documents = [(entity, render(entity, terms, view)) for entity in entities]
    else:
        documents = joined(entities, terms, view, showing.join, showing.lookup)
    return [feature_of(document, geometry(entity, place, view.datasets)) for entity, document in documents]


def _geo_headers(context: Context, in_body: bool) -> list[tuple[bytes, bytes]]:
    headers = [(b"content-type", GEO_JSON.encode())]
    if not in_body and context.link is not None:
        headers.append((b"link", link_header(context.link).encode()))
    return headers
