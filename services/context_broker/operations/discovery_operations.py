"""Discovery: types, attributes and their details (clauses 5.7.5 to 5.7.10), and the identity of the broker.

Stored entities are counted as they change (`type_statistics.py`). Registered types and attributes of context
sources are added, unless `local=true` excludes them.
"""

import time
from collections.abc import Iterator
from hashlib import sha256
from typing import Any, Final

import orjson

from services.context_broker.model.conformance import OURS
from services.context_broker.model.context import Context
from services.context_broker.model.problems import not_found
from services.context_broker.model.validation import require_name, shown, timestamp_now
from services.context_broker.request.query_parameters import json_headers
from services.context_broker.request.request_context import JSON_LD, RequestContext, Response
from services.context_broker.request.routing import Operation, brief
from services.context_broker.tenant_extensions import Announced

_LIST: Final = frozenset({"details", "count", "local"})
_ONE: Final = frozenset({"local"})


class DiscoveryOperations:
    """Operations on the broker's content as a whole."""

    def __init__(self) -> None:
        self._since_s = time.monotonic()

    def operations(self) -> tuple[Operation, ...]:
        """Return the operations."""
        identity, attribute = "info/sourceIdentity", "attributes/{attrId}"
        return brief(
            Operation("GET", "types", "retrieveEntityTypes", "6.25.3.1", self.types, _LIST),
            Operation("GET", "types/{type}", "retrieveEntityTypeInfo", "6.26.3.1", self.type_details, _ONE),
            Operation("GET", "attributes", "retrieveAttrTypes", "6.27.3.1", self.attributes, _LIST),
            Operation("GET", attribute, "retrieveAttrTypeInfo", "6.28.3.1", self.attribute_details, _ONE),
            Operation(
                "GET",
                identity,
                "retrieveContextSourceIdentity",
                "6.33.3.1",
                self.source_identity,
                makes_tenant=True,  # a client that registers a tenant here asks for its alias first
            ),
        )

    async def types(self, request: RequestContext) -> Response:
        """GET types; with details=true the attributes of each (clauses 5.7.5 and 5.7.6)."""
        context = await request.reader_context()
        compact, census = context.terms.compact, request.tenant.store.census
        registered = list(_registered(request))
        kinds = sorted({*census.types(), *(kind for _, types in registered for kind in types)})
        if not request.flag("details"):
            return _answer(request, context, _listed("EntityTypeList", "typeList", kinds, context), kinds)
        body = [
            {
                "id": kind,
                "type": "EntityType",
                "typeName": compact(kind),
                "attributeNames": [compact(name) for name in _names(request, kind, registered)],
            }
            for kind in kinds
        ]
        return _answer(request, context, body, kinds)

    async def type_details(self, request: RequestContext) -> Response:
        """GET types/{type} (clause 5.7.7)."""
        context = await request.reader_context()
        kind = context.terms.expand(require_name(request.names[0], "the type in the path"))
        compact, census = context.terms.compact, request.tenant.store.census
        registered = [one for one in _registered(request) if kind in one[1]]
        count = census.entities_of(kind)
        if not count and not registered:
            raise not_found(f"there is no entity of the type {shown(request.names[0])} ({kind})")
        known = census.attributes_of(kind)
        body = {
            "id": kind,
            "type": "EntityTypeInfo",
            "typeName": compact(kind),
            "entityCount": count,
            "attributeDetails": [
                {
                    "id": name,
                    "type": "Attribute",
                    "attributeName": compact(name),
                    "attributeTypes": sorted(known.get(name, ())),
                }
                for name in _names(request, kind, registered)
            ],
        }
        return _answer(request, context, body)

    async def attributes(self, request: RequestContext) -> Response:
        """GET attributes; with details=true the types that have each (clauses 5.7.8 and 5.7.9)."""
        context = await request.reader_context()
        compact, census = context.terms.compact, request.tenant.store.census
        registered = list(_registered(request))
        names = sorted({*census.attributes(), *(name for one, _ in registered for name in one)})
        if not request.flag("details"):
            body: Any = _listed("AttributeList", "attributeList", names, context)
            return _answer(request, context, body, names)
        body = [
            {
                "id": name,
                "type": "Attribute",
                "attributeName": compact(name),
                "typeNames": [compact(kind) for kind in _types_with(request, name, registered)],
            }
            for name in names
        ]
        return _answer(request, context, body, names)

    async def attribute_details(self, request: RequestContext) -> Response:
        """GET attributes/{attrId} (clause 5.7.10)."""
        context = await request.reader_context()
        name = context.terms.expand(require_name(request.names[0], "the attribute in the path"))
        kinds = request.tenant.store.census.kinds_of(name)
        registered = [one for one in _registered(request) if name in one[0]]
        if not kinds and not registered:
            raise not_found(f"no entity has the attribute {shown(request.names[0])} ({name})")
        compact = context.terms.compact
        body = {
            "id": name,
            "type": "Attribute",
            "attributeName": compact(name),
            "attributeCount": sum(kinds.values()),
            "attributeTypes": sorted(kinds),
            "typeNames": [compact(kind) for kind in _types_with(request, name, registered)],
        }
        return _answer(request, context, body)

    async def source_identity(self, request: RequestContext) -> Response:
        """GET info/sourceIdentity (clause 5.15): the identity of the broker for a tenant."""
        context = await request.reader_context()
        alias = request.tenant.alias
        body = {
            "id": f"urn:ngsi-ld:ContextSourceIdentity:{alias}",
            "type": "ContextSourceIdentity",
            "contextSourceAlias": alias,
            "contextSourceTimeAt": timestamp_now(),
            "contextSourceUptime": f"PT{time.monotonic() - self._since_s:.3f}S",
            "contextSourceExtras": {"ngsildConformance": "{}.{}".format(*OURS)},
        }
        return _answer(request, context, body)


def _registered(request: RequestContext) -> Iterator[Announced]:
    """Yield what sources have registered for the tenant; nothing for a local request."""
    if request.flag("local"):
        return
    yield from request.tenant.federation.announced()


def _names(request: RequestContext, kind: str, registered: list[Announced]) -> list[str]:
    """Return the attributes of a type, stored ones first."""
    stored = request.tenant.store.census.attributes_of(kind)
    others = (name for names, types in registered if kind in types for name in sorted(names))
    return list(dict.fromkeys((*stored, *others)))


def _types_with(request: RequestContext, name: str, registered: list[Announced]) -> list[str]:
    """Return the types that have an attribute."""
    stored = request.tenant.store.census.types_with(name)
    return sorted({*stored, *(kind for names, types in registered if name in names for kind in types)})


def _listed(kind: str, member: str, found: list[str], context: Context) -> dict[str, Any]:
    digest = sha256("\n".join(found).encode()).hexdigest()[:16]
    return {
        "id": f"urn:ngsi-ld:{kind}:{digest}",
        "type": kind,
        member: [context.terms.compact(one) for one in found],
    }


def _answer(request: RequestContext, context: Context, body: Any, found: list[str] | None = None) -> Response:
    if request.accept() == JSON_LD:
        documents = body if isinstance(body, list) else [body]
        written = [{"@context": context.document, **document} for document in documents]
        body = written if isinstance(body, list) else written[0]
        headers = [(b"content-type", JSON_LD.encode())]
    else:
        headers = json_headers(context)
    if found is not None and request.flag("count"):
        headers.append((b"ngsild-results-count", str(len(found)).encode()))
    return Response(200, orjson.dumps(body), headers)
