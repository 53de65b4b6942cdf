"""Discovery: types, attributes and their details (clauses 5.7.5 to 5.7.10), and the identity of the broker.

Stored entities are counted as they change (`type_statistics.py`). Registered types and attributes of context
sources are added, unless `local=true` excludes them.
"""

import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any, Final

from handover.security.permissions import Permission
from handover_broker.model.context import Context
from handover_broker.model.problems import not_found
from handover_broker.model.representation.conformance import OURS
from handover_broker.model.validation import require_name, shown, timestamp_now
from handover_broker.request.discovery_documents import (
    ATTRIBUTES,
    TYPES,
    Listing,
    attribute_detail,
    attribute_info,
    discovery_response,
    entry_document,
    list_document,
    type_info,
)
from handover_broker.request.request_context import RequestContext, Response
from handover_broker.request.routing import Operation, brief
from handover_broker.tenant_extensions import Announced

_LIST: Final = frozenset({"details", "count", "local"})
_ONE: Final = frozenset({"local"})


class DiscoveryOperations:
    """Operations on the broker's content as a whole."""

    def __init__(self, tenants: Callable[[], Iterable[str]]) -> None:
        """`tenants` returns the names of all tenants that clients can name."""
        self._since_s = time.monotonic()
        self._tenants = tenants

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
        registered = list(_registered(request))
        stored = request.tenant.store.statistics().types()
        types = sorted({*stored, *(kind for _, types in registered for kind in types)})
        return _list(request, context, TYPES, types, lambda kind: _attributes_of(request, kind, registered))

    async def attributes(self, request: RequestContext) -> Response:
        """GET attributes; with details=true the types that have each (clauses 5.7.8 and 5.7.9)."""
        context = await request.reader_context()
        registered = list(_registered(request))
        stored = request.tenant.store.statistics().attributes()
        names = sorted({*stored, *(name for names, _ in registered for name in names)})
        return _list(request, context, ATTRIBUTES, names, lambda name: _types_with(request, name, registered))

    async def type_details(self, request: RequestContext) -> Response:
        """GET types/{type} (clause 5.7.7)."""
        context = await request.reader_context()
        kind = context.terms.expand(require_name(request.names[0], "the type in the path"))
        type_statistics = request.tenant.store.statistics()
        registered = [names for names in _registered(request) if kind in names[1]]
        count = type_statistics.entities_of(kind)
        if not count and not registered:
            raise not_found(f"there is no entity of the type {shown(request.names[0])} ({kind})")
        stored = type_statistics.attributes_of(kind)
        details = [
            attribute_detail(name, context, stored.get(name, ()))
            for name in _attributes_of(request, kind, registered)
        ]
        return discovery_response(request, context, type_info(kind, context, count, details))

    async def attribute_details(self, request: RequestContext) -> Response:
        """GET attributes/{attrId} (clause 5.7.10)."""
        context = await request.reader_context()
        name = context.terms.expand(require_name(request.names[0], "the attribute in the path"))
        kinds = request.tenant.store.statistics().kinds_of(name)
        registered = [names for names in _registered(request) if name in names[0]]
        if not kinds and not registered:
            raise not_found(f"no entity has the attribute {shown(request.names[0])} ({name})")
        types = _types_with(request, name, registered)
        body = attribute_info(name, context, kinds, sum(kinds.values()), types)
        return discovery_response(request, context, body)

    async def source_identity(self, request: RequestContext) -> Response:
        """GET info/sourceIdentity (clause 5.15): the identity of the broker for a tenant.

        The standard has no list of tenants. A caller with the rights for all of them sees it here, in the
        default tenant.
        """
        context = await request.reader_context()
        alias = request.tenant.alias
        extras: dict[str, Any] = {"ngsildConformance": "{}.{}".format(*OURS)}
        if not request.tenant.name and request.caller.may(Permission.WRITE_ENTITIES):
            extras["tenants"] = sorted(self._tenants())
        body = {
            "id": f"urn:ngsi-ld:ContextSourceIdentity:{alias}",
            "type": "ContextSourceIdentity",
            "contextSourceAlias": alias,
            "contextSourceTimeAt": timestamp_now(),
            "contextSourceUptime": f"PT{time.monotonic() - self._since_s:.3f}S",
            "contextSourceExtras": extras,
        }
        return discovery_response(request, context, body)


def _list(
    request: RequestContext,
    context: Context,
    listing: Listing,
    iris: list[str],
    related: Callable[[str], Iterable[str]],
) -> Response:
    if request.flag("details"):
        entries = [entry_document(listing, iri, related(iri), context) for iri in iris]
        return discovery_response(request, context, entries, len(iris))
    return discovery_response(request, context, list_document(listing, iris, context), len(iris))


def _registered(request: RequestContext) -> Iterator[Announced]:
    """Yield what sources have registered for the tenant; nothing for a local request."""
    if request.flag("local"):
        return
    for names, types in request.tenant.federation.announced():
        visible = {kind for kind in types if is_listed(request, kind)}
        if visible or not types:
            yield names, visible


def is_listed(request: RequestContext, kind: str) -> bool:
    """Return whether the client may know of entities of a type (an IRI)."""
    tenant = request.tenant
    return tenant.store.may_see_private(somewhere=False) or not tenant.receivers.is_private("", (kind,))


def _attributes_of(request: RequestContext, kind: str, registered: list[Announced]) -> list[str]:
    """Return the attributes of a type, stored ones first."""
    stored = request.tenant.store.statistics().attributes_of(kind)
    others = (name for names, types in registered if kind in types for name in sorted(names))
    return list(dict.fromkeys((*stored, *others)))


def _types_with(request: RequestContext, name: str, registered: list[Announced]) -> list[str]:
    """Return the types that have an attribute."""
    stored = request.tenant.store.statistics().types_with(name)
    return sorted({*stored, *(kind for names, types in registered if name in names for kind in types)})
