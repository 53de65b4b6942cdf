"""The documents of discovery: lists of types and attributes, and their details (clauses 5.2.24 to 5.2.28).

The broker's own operations create them; those of context sources extend them.
"""

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from hashlib import sha256
from typing import Any, Final

import orjson

from handover_broker.model.context import Context
from handover_broker.request.query_parameters import json_headers
from handover_broker.request.request_context import JSON_LD, RequestContext, Response

Document = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Listing:
    """The names in the documents of a list: of entity types, or of attributes."""

    type: str
    member: str
    """The member of the plain list."""
    entry_type: str
    name: str
    related: str
    """The member of an entry that names the attributes of a type, or the types with an attribute."""


TYPES: Final = Listing("EntityTypeList", "typeList", "EntityType", "typeName", "attributeNames")
ATTRIBUTES: Final = Listing("AttributeList", "attributeList", "Attribute", "attributeName", "typeNames")


def list_document(listing: Listing, iris: Collection[str], context: Context) -> Document:
    """Return the plain list of types or attributes."""
    digest = sha256("\n".join(iris).encode()).hexdigest()[:16]
    return {
        "id": f"urn:ngsi-ld:{listing.type}:{digest}",
        "type": listing.type,
        listing.member: [context.terms.compact(iri) for iri in iris],
    }


def entry_document(listing: Listing, iri: str, related: Iterable[str], context: Context) -> Document:
    """Return the entry of a type or attribute in a detailed list."""
    return {
        "id": iri,
        "type": listing.entry_type,
        listing.name: context.terms.compact(iri),
        listing.related: [context.terms.compact(name) for name in related],
    }


def type_info(iri: str, context: Context, count: int = 0, attributes: Iterable[Document] = ()) -> Document:
    """Return the details of a type; `attributes` are `attribute_detail` documents."""
    return {
        "id": iri,
        "type": "EntityTypeInfo",
        "typeName": context.terms.compact(iri),
        "entityCount": count,
        "attributeDetails": list(attributes),
    }


def attribute_detail(iri: str, context: Context, attribute_types: Iterable[str] = ()) -> Document:
    """Return an attribute in the details of a type; `attribute_types` are Property and the like."""
    return {
        "id": iri,
        "type": "Attribute",
        "attributeName": context.terms.compact(iri),
        "attributeTypes": sorted(attribute_types),
    }


def attribute_info(
    iri: str,
    context: Context,
    attribute_types: Collection[str] = (),
    count: int = 0,
    types: Iterable[str] = (),
) -> Document:
    """Return the details of an attribute, which `count` instances of entities have."""
    return {
        **attribute_detail(iri, context, attribute_types),
        "attributeCount": count,
        "typeNames": [context.terms.compact(kind) for kind in types],
    }


def discovery_response(
    request: RequestContext, context: Context, body: Document | list[Document], count: int | None = None
) -> Response:
    """Return the response with a document or several, and with their number if it was requested."""
    if request.accept() == JSON_LD:
        documents = body if isinstance(body, list) else [body]
        written = [{"@context": context.document, **document} for document in documents]
        body = written if isinstance(body, list) else written[0]
        headers = [(b"content-type", JSON_LD.encode())]
    else:
        headers = json_headers(context)
    if count is not None and request.flag("count"):
        headers.append((b"ngsild-results-count", str(count).encode()))
    return Response(200, orjson.dumps(body), headers)
