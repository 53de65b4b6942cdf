"""Operations on context source registrations: provision (clauses 5.9 and 6.8) and discovery (5.10).

Changes are rare and serialized. An expired registration is no longer visible; it is deleted from the disk
when it expires, or at the next start.
"""

import asyncio
import time
from collections.abc import Iterable
from typing import Any, Final
from urllib.parse import quote
from uuid import uuid4

import orjson

from handover.errors import Problem
from handover.security.authentication import not_allowed
from handover.security.permissions import Permission
from handover.telemetry import get_logger
from handover_broker.contexts.context_resolver import ContextResolver
from handover_broker.model.context import Context
from handover_broker.model.owner import OWNER
from handover_broker.model.problems import (
    already_exists,
    bad_request_data,
    conflict,
    not_found,
    not_stored,
)
from handover_broker.model.secrets import kept_members
from handover_broker.model.stored_documents import (
    is_unusable,
    isolated,
    require_id,
    unusable_document,
    without_null,
)
from handover_broker.model.validation import require_uri, timestamp_now
from handover_broker.network.endpoints import require_allowed
from handover_broker.query.type_selection import of_types
from handover_broker.request.document_responses import document_response, in_media_type
from handover_broker.request.ownership import (
    has_new_owner,
    owner_of,
    require_changeable,
    require_deletable,
    shows_results,
)
from handover_broker.request.query_parameters import (
    PAGE_PARAMETERS,
    options_of,
    page_links,
    window_of,
)
from handover_broker.request.request_context import (
    PREFIX,
    RequestContext,
    Response,
)
from handover_broker.request.routing import Operation
from handover_broker.storage.database import NotStored
from handover_broker.storage.entries import DocumentKey, DocumentKind, Entries
from handover_broker.tenants import Tenant
from handover_federation.registrations.registration import (
    SECRETS,
    TYPE,
    Mode,
    Registration,
    shown_document,
)
from handover_federation.registrations.registration_parser import (
    kept_document,
    refuse_past,
    registration,
    updated_document,
)
from handover_federation.registrations.registration_search import SEARCH_PARAMETERS, search_of
from handover_federation.registrations.registry import claims
from handover_federation.registrations.source_subscriptions import notices_of_change
from handover_federation.tenant_state import federated

log = get_logger(__name__)

DONE: Final = Response(204)
MAX_TIMER_S: Final = 86400.0
"""Longest timer: asyncio's timers are floats, and some registrations expire in a century."""
_VIEW: Final = frozenset({"options"})
_SYS_ATTRS: Final = frozenset({"sysAttrs", "count"})


class RegistrationOperations:
    """Operations on registrations."""

    def __init__(self, contexts: ContextResolver) -> None:
        self._contexts = contexts
        self._lock = asyncio.Lock()

    def operations(self) -> tuple[Operation, ...]:
        """Return the operations."""
        all_of_them, by_id = "csourceRegistrations", "csourceRegistrations/{id}"
        searching = PAGE_PARAMETERS | SEARCH_PARAMETERS
        return (
            Operation("POST", all_of_them, "createCSR", "6.8.3.1", self.create, makes_tenant=True),
            Operation("GET", all_of_them, "queryCSR", "6.8.3.2", self.search, searching),
            Operation("GET", by_id, "retrieveCSR", "6.9.3.1", self.retrieve, _VIEW),
            Operation("PATCH", by_id, "updateCSR", "6.9.3.2", self.update),
            Operation("DELETE", by_id, "deleteCSR", "6.9.3.3", self.delete),
        )

    async def restore(self, tenant: Tenant, stored: Iterable[tuple[str, bytes, bytes | None]]) -> None:
        """Load the stored registrations with their counts, in the order of their creation."""
        registry, kind = federated(tenant).registry, DocumentKind.REGISTRATION.value
        loaded: list[tuple[Registration, bytes | None]] = []
        for registration_id, body, counts in stored:
            with isolated(kind, tenant.name, registration_id, registry.unusable):
                document = without_null(orjson.loads(body))
                restored = registration(document, await self._contexts.as_before(document["context"]))
                _require_readable(restored)
                require_id(restored.id, registration_id)
                loaded.append((restored, counts))
        for restored, counts in sorted(loaded, key=lambda pair: str(pair[0].document.get("createdAt"))):
            registry.load(restored)
            if counts is not None:
                registry.restore_attempts(restored.id, counts)
            self._schedule_expiry(tenant, restored)

    async def renew(self, tenant: Tenant, context_id: str) -> None:
        """Recompute the registrations of a changed @context."""
        async with self._lock:
            for before in list(federated(tenant).registry):
                if before.context.is_made_of(context_id):
                    context = await self._contexts.as_before(before.document["context"])
                    try:
                        renewed = registration(before.document, context).with_attempts_of(before)
                    except Exception:  # it continues with its present context
                        log.exception("a registration keeps its context", registration=before.id)
                        continue
                    federated(tenant).registry.put(renewed)
                    self._schedule_expiry(tenant, renewed)

    async def create(self, request: RequestContext) -> Response:
        """POST csourceRegistrations."""
        body, context = await request.body()
        document = kept_members(kept_document(body, context), {}, *SECRETS)
        named = document.get("id") or f"urn:ngsi-ld:ContextSourceRegistration:{uuid4()}"
        at = timestamp_now()
        created = registration(
            {
                **{name: value for name, value in document.items() if value is not None},
                "id": require_uri(named, "the registration id"),
                "createdAt": at,
                "modifiedAt": at,
                "context": context.document,
                OWNER: owner_of(request),
            },
            context,
        )
        refuse_past(created.document)
        _require_readable(created)
        _require_types(request, created)
        await _require_open(request.tenant, created)
        async with self._lock:
            registry = federated(request.tenant).registry
            if registry.get(created.id) is not None or created.id in registry.unusable:
                raise already_exists(
                    f"there is a registration {created.id} already; update it, or choose another id"
                )
            _refuse_conflicts(request.tenant, created)
            await self._keep(request.tenant, None, created)
        location = f"{PREFIX}csourceRegistrations/{quote(created.id, safe=':')}".encode()
        return Response(201, b"", [(b"location", location)])

    async def update(self, request: RequestContext) -> Response:
        """PATCH csourceRegistrations/{id}."""
        body, context = await request.body()
        change = kept_document(body, context, is_change=True)
        async with self._lock:
            before = _existing(request)
            require_changeable(request, before.id, before.owner, "registration")
            document = {
                **updated_document(before.document, change),
                OWNER: owner_of(request),
                "modifiedAt": timestamp_now(),
            }
            updated = registration(document, before.context).with_attempts_of(before)
            _require_types(request, updated)
            _require_readable(updated)
            if "expiresAt" in change:
                refuse_past(document)
            if "endpoint" in change:
                await _require_open(request.tenant, updated)
            if {"mode", "information"} & change.keys():
                _refuse_conflicts(request.tenant, updated)
            is_another_owner = has_new_owner(request, before.owner)
            await self._keep(request.tenant, before, updated, keeps_counts=not is_another_owner)
            if is_another_owner:
                federated(request.tenant).registry.reset_attempts(updated)
        return DONE

    async def delete(self, request: RequestContext) -> Response:
        """DELETE csourceRegistrations/{id}."""
        async with self._lock:
            tenant, registry = request.tenant, federated(request.tenant).registry
            if request.names[0] in registry.unusable:
                key = (DocumentKind.REGISTRATION, tenant.name, request.names[0])
                await _write(tenant, Entries(documents={key: None}))
                del registry.unusable[request.names[0]]
                return DONE
            before = _existing(request)
            require_deletable(request, before.id, before.owner, "registration")
            gone = _deletion_of(tenant, before)
            await _write(tenant, gone)
            federated(tenant).registry.remove(before.id)
            federated(tenant).source_notifier.deliver(gone.pending)
        return DONE

    async def retrieve(self, request: RequestContext) -> Response:
        """GET csourceRegistrations/{id}."""
        media_type, context = request.accept(), await request.reader_context()
        sys_attrs = "sysAttrs" in options_of(request, _SYS_ATTRS)
        reason = federated(request.tenant).registry.unusable.get(request.names[0])
        document = (
            await _shown(request, _existing(request), context, sys_attrs=sys_attrs)
            if reason is None
            else unusable_document(TYPE, request.names[0], reason)
        )
        return document_response(in_media_type(document, media_type, context), media_type, context)

    async def search(self, request: RequestContext) -> Response:
        """GET csourceRegistrations (clause 5.10.2): the matching ones, each with its matching information."""
        media_type, context = request.accept(), await request.reader_context()
        window = window_of(request)
        sys_attrs = "sysAttrs" in options_of(request, _SYS_ATTRS)
        search = search_of(request.parameters, context)
        registrations = federated(request.tenant).registry.matching_any(search.targets, search.wants)
        page = registrations[window.offset : window.offset + window.limit]
        documents = [
            await _shown(
                request, listed, context, sys_attrs=sys_attrs, pieces=listed.relevant(search.targets)
            )
            for listed in page
        ]
        result = document_response(
            [in_media_type(document, media_type, context) for document in documents], media_type, context
        )
        if window.count:
            result.headers.append((b"ngsild-results-count", str(len(registrations)).encode()))
        more = window.offset + window.limit < len(registrations)
        result.headers += page_links(request, window, media_type, more=more)
        return result

    async def _keep(
        self, tenant: Tenant, before: Registration | None, after: Registration, *, keeps_counts: bool = True
    ) -> None:
        documents: dict[DocumentKey, bytes | None] = {
            (DocumentKind.REGISTRATION, tenant.name, after.id): orjson.dumps(after.document)
        }
        if not keeps_counts:
            documents[DocumentKind.ATTEMPTS, tenant.name, after.id] = None
        pending = notices_of_change(federated(tenant).source_notifier, before, after)
        await _write(tenant, Entries(documents=documents, pending=pending))
        federated(tenant).registry.put(after)
        federated(tenant).source_notifier.deliver(pending)
        self._schedule_expiry(tenant, after)

    def _schedule_expiry(self, tenant: Tenant, stored: Registration) -> None:
        """Delete a registration when it expires, unless it was changed meanwhile."""
        left_s = stored.expires_at_s - time.time()
        if left_s == float("inf"):
            return
        loop = asyncio.get_running_loop()
        if left_s > 0:
            loop.call_later(min(left_s, MAX_TIMER_S), self._schedule_expiry, tenant, stored)
        elif federated(tenant).registry.holds(stored):
            gone = _deletion_of(tenant, stored)

            def taken_away() -> None:
                federated(tenant).registry.remove_if_held(stored)
                federated(tenant).source_notifier.deliver(gone.pending)

            tenant.commits.submit(gone, taken_away, lambda _: None)


async def _require_open(tenant: Tenant, candidate: Registration) -> None:
    """Raise a problem (400) if the outbound policy refuses the address of the source."""
    await require_allowed(tenant.notifier.outbound.policy, candidate.endpoint, '"endpoint"')


def _require_types(request: RequestContext, candidate: Registration) -> None:
    """Raise a problem (403) for a source of data about bodies of persons that the caller may not read.

    A registration without types is accepted: its source receives what its owner may see.
    """
    types = {kind for piece in candidate.information for entity in piece.entities for kind in entity.types}
    store = request.tenant.store
    if not store.may_see_private(somewhere=False) and request.tenant.receivers.is_private("", types):
        raise not_allowed(request.caller, Permission.READ_HEALTH_DATA)


async def _shown(
    request: RequestContext,
    stored: Registration,
    context: Context,
    *,
    sys_attrs: bool,
    pieces: list[int] | None = None,
) -> dict[str, Any]:
    has_counts = await shows_results(request, stored.owner)
    return shown_document(stored, context, sys_attrs=sys_attrs, pieces=pieces, has_counts=has_counts)


def _require_readable(made: Registration) -> None:
    """Raise a problem (400) for a registration that could not be shown to its readers."""
    try:
        orjson.dumps(shown_document(made, made.context, sys_attrs=True))
    except (TypeError, ValueError, KeyError, AttributeError) as error:
        raise bad_request_data(f"the registration cannot be used: {error}; correct its members") from None


def _existing(request: RequestContext) -> Registration:
    registration_id = require_uri(request.names[0], "the registration id in the path")
    reason = federated(request.tenant).registry.unusable.get(registration_id)
    if reason is not None:
        raise is_unusable("registration", registration_id, reason)
    existing = federated(request.tenant).registry.get(registration_id)
    if existing is None:
        raise _absent(registration_id)
    return existing


def _refuse_conflicts(tenant: Tenant, candidate: Registration) -> None:
    """Raise a problem (409) if a proxied registration would hide existing data (clauses 4.3.6.3, 5.9.2.4)."""
    other = federated(tenant).registry.conflicting_with(candidate)
    if other is not None:
        raise conflict(
            f"registration {other.id} ({other.mode.name.lower()}) has some of these entities and attributes; "
            "an exclusive source shares them with no other: delete it, or choose others"
        )
    if not candidate.mode.is_proxied:
        return
    for piece in candidate.information:
        ids = [selector.id for selector in piece.entities if selector.id is not None]
        types = {kind for selector in piece.entities for kind in selector.types}
        has_groups = not piece.entities or len(ids) < len(piece.entities)
        for entity in tenant.store.candidates(
            None if has_groups else ids, of_types(types) if types else None
        ):
            if claims(candidate, entity):
                has = "entity" if candidate.mode is Mode.REDIRECT else "one of these attributes of entity"
                raise conflict(
                    f"the broker has the {has} {entity.id} itself, which a source in mode "
                    f"{candidate.mode.name.lower()} would hide; delete it here first, or choose another mode"
                )


def _deletion_of(tenant: Tenant, deleted: Registration) -> Entries:
    registered = (DocumentKind.REGISTRATION, tenant.name, deleted.id)
    attempts = (DocumentKind.ATTEMPTS, tenant.name, deleted.id)
    pending = notices_of_change(federated(tenant).source_notifier, deleted, None)
    return Entries(documents={registered: None, attempts: None}, pending=pending)


async def _write(tenant: Tenant, entries: Entries) -> None:
    try:
        await tenant.commits.store(entries)
    except NotStored as error:
        raise not_stored(str(error), is_away=error.is_away) from error


def _absent(registration_id: str) -> Problem:
    return not_found(
        f"there is no registration {registration_id}; GET csourceRegistrations finds those there are"
    )
