"""Operations on subscriptions (clauses 5.8.1 to 5.8.5, 6.10 and 6.11)."""

import asyncio
import time
from collections.abc import Iterable
from dataclasses import replace
from typing import Any, Final
from urllib.parse import quote
from uuid import uuid4

import orjson

from handover.errors import Problem
from handover.telemetry import get_logger
from handover_broker.contexts.context_resolver import ContextResolver
from handover_broker.delivery.subscription import Counts, Subscription, subscription
from handover_broker.delivery.subscription_dispatcher import SubscriptionDispatcher
from handover_broker.delivery.subscription_documents import (
    CAME_BY,
    NAMES_IN,
    kept_document,
    names_things,
    refuse_hidden,
    shown_document,
    updated_document,
)
from handover_broker.model.context import Context
from handover_broker.model.owner import OWNER
from handover_broker.model.problems import already_exists, bad_request_data, not_found, not_stored
from handover_broker.model.stored_documents import (
    is_unusable,
    isolated,
    require_id,
    unusable_document,
    without_null,
)
from handover_broker.model.validation import require_uri, timestamp_now
from handover_broker.network.endpoints import require_allowed
from handover_broker.request.ownership import (
    has_new_owner,
    may_see_document,
    owner_of,
    require_changeable,
    require_deletable,
    shows_results,
)
from handover_broker.request.query_parameters import (
    PAGE_PARAMETERS,
    json_headers,
    options_of,
    page_links,
    window_of,
)
from handover_broker.request.request_context import JSON_LD, RequestContext, Response
from handover_broker.request.routing import Operation
from handover_broker.storage.entries import DocumentKind, Entries
from handover_broker.storage.journal import NotStored
from handover_broker.tenants import Tenant

log = get_logger(__name__)

DONE: Final = Response(204)
_LOCAL: Final = frozenset({"local"})
_VIEW: Final = frozenset({"options"})
_SYS_ATTRS: Final = frozenset({"sysAttrs", "count"})


class SubscriptionOperations:
    """Operations on subscriptions. Changes are rare and serialized.

    Subscriptions to context source registrations are a subclass with another dispatcher.
    """

    KIND = DocumentKind.SUBSCRIPTION
    EXTRA_MEMBERS: frozenset[str] = frozenset()
    """Additional members of a subclass's subscriptions."""

    def __init__(self, contexts: ContextResolver) -> None:
        self._contexts = contexts
        self._one_at_a_time = asyncio.Lock()

    def operations(self) -> tuple[Operation, ...]:
        """Return the operations."""
        all_of_them, by_id = "subscriptions", "subscriptions/{id}"
        name = "createSubscription"
        return (
            Operation("POST", all_of_them, name, "6.10.3.1", self.create, _LOCAL, True),
            Operation("GET", all_of_them, "querySubscription", "6.10.3.2", self.list, PAGE_PARAMETERS),
            Operation("GET", by_id, "retrieveSubscription", "6.11.3.1", self.retrieve, _VIEW),
            Operation("PATCH", by_id, "updateSubscription", "6.11.3.2", self.update, _LOCAL),
            Operation("DELETE", by_id, "deleteSubscription", "6.11.3.3", self.delete, _LOCAL),
        )

    def dispatcher(self, tenant: Tenant) -> SubscriptionDispatcher:
        """Return the dispatcher of a tenant's subscriptions."""
        return tenant.notifier

    async def restore(self, tenant: Tenant, stored: Iterable[tuple[str, bytes, bytes | None]]) -> None:
        """Load the stored subscriptions, each with its counts; their contexts are kept."""
        subscriptions: list[Subscription] = []
        for subscription_id, body, counts in stored:
            with isolated(self.KIND.value, tenant.name, subscription_id, self.dispatcher(tenant).unusable):
                restored = await self._restored(body)
                _require_readable(restored)
                require_id(restored.id, subscription_id)
                if counts is not None:
                    restored.counts = Counts.restored(counts)
                subscriptions.append(restored)
        self.dispatcher(tenant).start(subscriptions)

    async def _restored(self, body: bytes) -> Subscription:
        document = without_null(orjson.loads(body))  # an earlier version stored null
        names = document.get(NAMES_IN)
        return subscription(
            document,
            await self._contexts.as_before(document["context"]),
            None if names is None else await self._contexts.as_before(names),
        )

    async def renew(self, tenant: Tenant, context_id: str) -> None:
        """Compile subscriptions again whose context has changed.

        Stored types and attributes stay expanded as they are; filters and notifications use the new names.
        """
        async with self._one_at_a_time:
            dispatcher = self.dispatcher(tenant)
            for before in dispatcher.all():
                if before.context.is_made_of(context_id) or before.names.is_made_of(context_id):
                    try:
                        dispatcher.put(await self._restored(orjson.dumps(before.document)))
                    except Exception:  # it continues with its present context
                        log.exception("a subscription keeps its context", subscription=before.id)

    async def create(self, request: RequestContext) -> Response:
        """POST subscriptions."""
        body, context = await request.body()
        document = kept_document(body, context, self.EXTRA_MEMBERS)
        document["id"] = require_uri(
            document.get("id", f"urn:ngsi-ld:Subscription:{uuid4()}"), "the subscription id"
        )
        if request.flag("local"):
            document["localOnly"] = True
        if via := request.headers.get(b"via"):
            document[CAME_BY] = via.decode("latin-1")
        refuse_hidden(document)
        document[OWNER] = owner_of(request)
        at = timestamp_now()
        created = await self._made({**document, "createdAt": at, "modifiedAt": at}, context)
        await self._require_open(request.tenant, created)
        created = await self._with_link(request, created)
        async with self._one_at_a_time:
            tenant = request.tenant
            is_known = created.id in self.dispatcher(tenant).unusable
            if (
                is_known
                or tenant.notifier.get(created.id) is not None
                or tenant.federation.has_subscription(created.id)
            ):
                raise already_exists(
                    f"there is a subscription {created.id} already; update it, or choose another id"
                )
            await self.keep(request.tenant, created)
        location = f"{request.path.rstrip('/')}/{quote(created.id, safe=':')}".encode()
        return Response(201, b"", [(b"location", location)])

    async def update(self, request: RequestContext) -> Response:
        """PATCH subscriptions/{id}."""
        body, context = await request.body()
        change = kept_document(body, context, self.EXTRA_MEMBERS, is_change=True)
        async with self._one_at_a_time:
            before = self._existing(request)
            names = context if names_things(change) else before.names
            require_changeable(request, before.id, before.owner, "subscription")
            document = {
                **updated_document(before.document, change),
                OWNER: owner_of(request),
                "modifiedAt": timestamp_now(),
            }
            updated = await self._made(document, names)
            if "notification" in change:
                await self._require_open(request.tenant, updated)
            updated = await self._with_link(request, updated)
            is_another_owner = has_new_owner(request, before.owner)
            updated.counts = Counts() if is_another_owner else before.counts
            await self.keep(request.tenant, updated)
            if is_another_owner:
                self.dispatcher(request.tenant).reset_counts(updated.id)
        return DONE

    async def delete(self, request: RequestContext) -> Response:
        """DELETE subscriptions/{id}."""
        async with self._one_at_a_time:
            dispatcher, named = self.dispatcher(request.tenant), request.names[0]
            if named not in dispatcher.unusable or not may_see_document(request, None):
                before = self._existing(request)
                require_deletable(request, before.id, before.owner, "subscription")
            gone = (self.KIND, request.tenant.name, named)
            counts = (DocumentKind.COUNTS, request.tenant.name, named)
            await self.write(request.tenant, Entries(documents={gone: None, counts: None}))
            if dispatcher.unusable.pop(named, None) is None:
                dispatcher.remove(named)
        return DONE

    async def retrieve(self, request: RequestContext) -> Response:
        """GET subscriptions/{id}."""
        media_type, context = request.accept(), await request.reader_context()
        reason = self.dispatcher(request.tenant).unusable.get(request.names[0])
        if not may_see_document(request, None):
            reason = None
        document = (
            await self._shown(self._existing(request), request, context)
            if reason is None
            else unusable_document("Subscription", request.names[0], reason)
        )
        return _answer(_with_context(document, media_type, context), media_type, context)

    async def list(self, request: RequestContext) -> Response:
        """GET subscriptions."""
        media_type, context = request.accept(), await request.reader_context()
        window = window_of(request)
        dispatcher = self.dispatcher(request.tenant)
        subscriptions: list[Subscription | str] = [
            *(candidate for candidate in dispatcher.all() if may_see_document(request, candidate.owner)),
            *(subscription_id for subscription_id in dispatcher.unusable if may_see_document(request, None)),
        ]
        page = subscriptions[window.offset : window.offset + window.limit]
        shown = [
            unusable_document("Subscription", listed, dispatcher.unusable[listed])
            if isinstance(listed, str)
            else await self._shown(listed, request, context)
            for listed in page
        ]
        documents = [_with_context(document, media_type, context) for document in shown]
        answer = _answer(documents, media_type, context)
        if window.count:
            answer.headers.append((b"ngsild-results-count", str(len(subscriptions)).encode()))
        more = window.offset + window.limit < len(subscriptions)
        answer.headers += page_links(request, window, media_type, more=more)
        return answer

    def _existing(self, request: RequestContext) -> Subscription:
        subscription_id = require_uri(request.names[0], "the subscription id in the path")
        reason = self.dispatcher(request.tenant).unusable.get(subscription_id)
        if reason is not None and may_see_document(request, None):
            raise is_unusable("subscription", subscription_id, reason)
        existing = self.dispatcher(request.tenant).get(subscription_id)
        if existing is None or not may_see_document(request, existing.owner):
            raise _absent(subscription_id)
        return existing

    async def _made(self, document: dict[str, Any], names: Context) -> Subscription:
        """Return the subscription of a document whose names are in `names`.

        Notifications use `jsonldContext` if it is set, else the same context.
        """
        named = document.get("jsonldContext")
        used = names if named is None else await self._contexts.of(require_uri(named, '"jsonldContext"'))
        stored = {**document, "context": used.document}
        stored.pop(NAMES_IN, None)
        if names.key != used.key:
            stored[NAMES_IN] = names.document
        made = subscription(stored, used, names)
        _require_readable(made)
        return made

    async def _with_link(self, request: RequestContext, created: Subscription) -> Subscription:
        """Return the subscription with a context that has a URL for a Link header."""
        base = self._contexts.base(request.headers)
        linked = await self._contexts.linked(created.context, request.tenant.name, base)
        if linked is created.context:
            return created
        return replace(created, context=linked, document={**created.document, "context": linked.document})

    @staticmethod
    async def _require_open(tenant: Tenant, candidate: Subscription) -> None:
        policy = tenant.notifier.outbound.policy
        await require_allowed(policy, candidate.endpoint.uri, "notification.endpoint.uri")

    async def keep(self, tenant: Tenant, current: Subscription) -> None:
        """Store a new or changed subscription, and activate it once it is durable."""
        await self.write(tenant, self.entries_of(tenant, current))
        self.dispatcher(tenant).put(current)

    def entries_of(self, tenant: Tenant, current: Subscription) -> Entries:
        """Return what is to be written for a subscription."""
        dispatcher = self.dispatcher(tenant)
        counts = (dispatcher.counts_kind, tenant.name, current.id)
        return Entries(
            documents={
                (self.KIND, tenant.name, current.id): orjson.dumps(current.document),
                **({} if dispatcher.get(current.id) is None else {counts: current.counts.stored()}),
            }
        )

    @staticmethod
    async def write(tenant: Tenant, entries: Entries) -> None:
        """Write `entries`; raise a problem (507) if the disk refuses."""
        try:
            await tenant.commits.store(entries)
        except NotStored as error:
            raise not_stored(str(error), is_away=error.is_away) from error

    @staticmethod
    async def _shown(stored: Subscription, request: RequestContext, context: Context) -> dict[str, Any]:
        sys_attrs = "sysAttrs" in options_of(request, _SYS_ATTRS)
        has_counts = await shows_results(request, stored.owner)
        try:
            return shown_document(
                stored,
                context,
                time.time(),
                sys_attrs=sys_attrs,
                has_counts=has_counts,
            )
        except Exception as error:  # the others of a list are shown
            log.exception("a subscription cannot be shown", subscription=stored.id)
            return unusable_document("Subscription", stored.id, str(error))


def _require_readable(made: Subscription) -> None:
    """Raise a problem (400) for a subscription that could not be shown to its readers."""
    try:
        orjson.dumps(shown_document(made, made.context, time.time(), sys_attrs=True))
    except (TypeError, ValueError, KeyError, AttributeError) as error:
        raise bad_request_data(f"the subscription cannot be used: {error}; correct its members") from None


def _with_context(document: dict[str, Any], media_type: str, context: Context) -> dict[str, Any]:
    return {"@context": context.document, **document} if media_type == JSON_LD else document


def _answer(body: Any, media_type: str, context: Context) -> Response:
    headers = json_headers(context)
    if media_type == JSON_LD:
        headers = [(b"content-type", JSON_LD.encode())]
    return Response(200, orjson.dumps(body), headers)


def _absent(subscription_id: str) -> Problem:
    return not_found(f"there is no subscription {subscription_id}; GET subscriptions lists those there are")
