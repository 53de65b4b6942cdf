"""Forwards subscriptions to context sources, and their notifications to subscribers (clause 5.8).

Whenever subscriptions or registrations change, the subscriptions that should be forwarded are compared with
those that are, and the difference is carried out at the sources. Failures are retried. Notifications of
sources come in here and go to the subscriber through the outbox, as the broker's own do.
"""

import asyncio
import time
from collections.abc import Iterable
from typing import Any, Final
from uuid import uuid4

from handover.errors import Problem
from handover.telemetry import get_logger
from services.context_broker.contexts.context_resolver import ContextResolver
from services.context_broker.delivery.notification import change_data, notification
from services.context_broker.delivery.subscription import Subscription
from services.context_broker.delivery.subscription_documents import CAME_BY
from services.context_broker.federation.distribution.distributed_operations import (
    Handler,
    Perform,
    Sources,
    gather_all,
)
from services.context_broker.federation.distribution.forwarded_subscriptions import (
    PATH,
    ForwardedSubscription,
    digest,
    forwarded_document,
    questions,
    restored,
    with_endpoint,
)
from services.context_broker.federation.distribution.forwarding import (
    SILENT,
    Forwarder,
    RequestOrigin,
    SourceError,
    SourceRequest,
    quoted,
)
from services.context_broker.federation.distribution.query_targets import source_filter
from services.context_broker.federation.distribution.source_notifications import change_of_notification
from services.context_broker.federation.distribution.via import chain
from services.context_broker.federation.registrations.coverage import CoverageQuery
from services.context_broker.federation.registrations.registration import Registration
from services.context_broker.federation.tenant_state import federated
from services.context_broker.model.context import Context
from services.context_broker.model.problems import bad_request_data, not_found, not_stored
from services.context_broker.model.validation import shown
from services.context_broker.network.http_client import HttpResponse
from services.context_broker.request.request_context import (
    JSON,
    RequestContext,
    Response,
)
from services.context_broker.request.routing import Operation
from services.context_broker.storage.database import NotStored
from services.context_broker.storage.entries import DocumentKind, Entries, PendingNotification
from services.context_broker.storage.journal import Journal
from services.context_broker.tenants import Tenant, Tenants

log = get_logger(__name__)

SETTLE_S: Final = 0.05
"""Pause after a change of registrations, so that several changes are handled together."""
RETRY_S: Final = 10.0
"""Pause before a failed forwarding or deletion is retried."""


class SubscriptionForwarder:
    """Keeps forwarded subscriptions in step with subscriptions and registrations, for all tenants.

    Sources send notifications to `public_url`, or else to the address at which a subscriber last called the
    broker.
    """

    def __init__(
        self, tenants: Tenants, contexts: ContextResolver, forwarder: Forwarder, public_url: str | None
    ) -> None:
        self._public_url = public_url
        self._tenants = tenants
        self._contexts = contexts
        self._forwarder = forwarder
        self._forwarded: dict[str, ForwardedSubscription] = {}
        self._refused: dict[tuple[str, str, str], str] = {}
        self._locks: dict[str, asyncio.Lock] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._aligning: set[str] = set()
        self._retrying: set[str] = set()
        self._base = ""

    def operations(self) -> tuple[Operation, ...]:
        """Return the operation that receives notifications of sources."""
        path = f"{PATH}/{{token}}"
        name = "receiveSourceNotification"
        return (Operation("POST", path, name, "6.3.8", self.receive, frozenset(), of_no_tenant=True),)

    def handlers(self) -> dict[str, Handler]:
        """Return the handlers of operations that change subscriptions."""
        names = ("createSubscription", "updateSubscription", "deleteSubscription")
        return dict.fromkeys(names, self._after_change)

    async def start(self, journal: Journal) -> None:
        """Load the forwarded subscriptions and bring them in step."""
        self._base = self._contexts.base({})
        for tenant, token, stored in journal.documents(DocumentKind.FORWARDED_SUBSCRIPTION):
            await self._restore(tenant, token, stored)
        for forwarded in self._forwarded.values():
            self._base = self._public_url or forwarded.base
        for one in self._tenants:
            if not one.federation.is_empty or self._of(one):
                self.schedule_alignment(one)

    def stop(self) -> None:
        """Stop the background tasks; forwarded subscriptions stay."""
        for task in self._tasks:
            task.cancel()

    async def _restore(self, tenant: str, token: str, stored: bytes) -> None:
        """Load a forwarded subscription."""
        try:
            self._forwarded[token] = await restored(token, tenant, stored, self._contexts)
        except Problem as problem:
            log.exception("forwarded subscription cannot be loaded", token=token, why=problem.detail)

    def schedule_alignment(self, tenant: Tenant) -> None:
        """Schedule an alignment of a tenant; changes in a row share one."""
        self._align_after(tenant, SETTLE_S, self._aligning)

    def _align_after(self, tenant: Tenant, after_s: float, waiting: set[str]) -> None:
        if tenant.name in waiting:
            return
        waiting.add(tenant.name)

        async def later() -> None:
            await asyncio.sleep(after_s)
            waiting.discard(tenant.name)
            await self.align(tenant)

        task = asyncio.get_running_loop().create_task(later())
        self._tasks.add(task)
        task.add_done_callback(self._done)

    def _done(self, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            log.error("subscription forwarding failed", exc_info=error)

    async def _after_change(self, sources: Sources, request: RequestContext, perform: Perform) -> Response:
        answer = await perform(request)
        self._base = self._contexts.base(request.headers)
        for why in await self.align(request.tenant):
            sources.add_warning(SILENT, why)
        return answer

    # Forwarding and deleting

    async def align(self, tenant: Tenant) -> list[str]:
        """Forward missing subscriptions and delete obsolete ones at the sources; return the failures."""
        async with self._locks.setdefault(tenant.name, asyncio.Lock()):
            wanted = await self._wanted(tenant)
            held = {one.key: one for one in self._of(tenant)}
            gone = [
                one
                for key, one in held.items()
                if key not in wanted or self._is_outdated(one, wanted[key][3])
            ]
            kept = [one for one in held.values() if one not in gone]
            failed = [
                why for why in await gather_all(*(self._delete_at_source(tenant, one) for one in gone)) if why
            ]
            fresh = [
                self._forward(tenant, *wanted[key])
                for key in wanted
                if not any(one.key == key and one.is_confirmed for one in kept)
            ]
            failed += [why for why in await gather_all(*fresh) if why]
        if failed:
            self._retry_later(tenant)
        return failed

    def _retry_later(self, tenant: Tenant) -> None:
        self._align_after(tenant, RETRY_S, self._retrying)

    def _is_outdated(self, forwarded: ForwardedSubscription, document_digest: str) -> bool:
        return forwarded.document_digest != document_digest or (
            self._public_url is not None and forwarded.base != self._public_url
        )

    async def _wanted(
        self, tenant: Tenant
    ) -> dict[tuple[str, str], tuple[Subscription, Registration, dict[str, Any], str]]:
        found: dict[tuple[str, str], tuple[Subscription, Registration, dict[str, Any], str]] = {}
        if tenant.federation.is_empty:
            return found
        for one in tenant.notifier.all():
            if not one.is_active(time.time()) or one.document.get("localOnly"):
                continue
            for source in self._sources_of(tenant, one):
                try:
                    dialect = await self._forwarder.dialect(source, one.names, body=JSON)
                except Problem as problem:
                    log.warning(
                        "@context of a source cannot be loaded", registration=source.id, why=problem.detail
                    )
                    continue
                document = forwarded_document(one, source, dialect)
                found[one.id, source.id] = (
                    one,
                    source,
                    document,
                    digest(document),
                )
        return found

    def _sources_of(self, tenant: Tenant, one: Subscription) -> Iterable[Registration]:
        """Return the registrations to which a subscription is to be forwarded."""
        coverage = CoverageQuery(one.places, one.scopes, None, one.view.datasets)
        where = source_filter(one.document.get("csf"), one.names, coverage)
        passed = frozenset(chain(str(one.document.get(CAME_BY, "")).encode("latin-1", "replace")))
        found: dict[str, Registration] = {}
        for target in questions(one):
            for match in federated(tenant).registry.matching("createSubscription", target, where):
                source = match.registration
                if self._forwarder.alias_of(source) not in passed and not self._forwarder.is_ourselves(
                    source, federated(tenant).registry, tenant.alias
                ):
                    found[source.id] = source
        return found.values()

    async def _forward(
        self,
        tenant: Tenant,
        one: Subscription,
        source: Registration,
        document: dict[str, Any],
        document_digest: str,
    ) -> str | None:
        """Return why forwarding failed; None if it succeeded or the source will never take the
        subscription."""
        refused = (tenant.name, one.id, source.id)
        if self._refused.get(refused) == document_digest:
            return None
        held = next(
            (forwarded for forwarded in self._of(tenant) if forwarded.key == (one.id, source.id)), None
        )
        made = held or ForwardedSubscription(
            uuid4().hex, tenant.name, one.id, source, document_digest, self._base, is_confirmed=False
        )
        try:
            if held is None:
                await self._store(tenant, made)
            dialect = await self._forwarder.dialect(source, one.names, body=JSON)
            body = with_endpoint(document, made.base, made.token)
            source_request = SourceRequest("POST", "subscriptions", dialect, (), body)
            response, _ = await self._forwarder.send(source, source_request, self._origin_of(tenant, one))
        except SourceError as error:
            return error.why
        except (NotStored, Problem) as error:
            return str(error)
        if response.status in {201, 409}:  # 409: it exists, an earlier response was lost
            await self._store(tenant, made.confirmed())
            return None
        if response.status >= 500 and response.status != 508:
            return f"{source.endpoint} returns {response.status} for a subscription"
        log.warning("source refused a subscription", registration=source.id, status=response.status)
        self._refused[refused] = document_digest
        await self._remove(tenant, made)
        return None if response.status == 508 else _refusal(source, response)

    async def _delete_at_source(self, tenant: Tenant, forwarded: ForwardedSubscription) -> str | None:
        try:
            source, path = forwarded.registration, f"subscriptions/{quoted(forwarded.id)}"
            dialect = await self._forwarder.dialect(source, await self._contexts.of(None), body=JSON)
            if source.takes("deleteSubscription"):
                source_request = SourceRequest("DELETE", path, dialect)
            elif source.takes("updateSubscription"):
                source_request = SourceRequest(
                    "PATCH", path, dialect, (), {"type": "Subscription", "isActive": False}
                )
            else:  # the source learns from the 404 to its next notification that the subscription has ended
                await self._remove(tenant, forwarded)
                return None
            origin = RequestOrigin({}, tenant.alias, federated(tenant).registry)
            response, _ = await self._forwarder.send(forwarded.registration, source_request, origin)
            if response.status >= 500:
                return f"{forwarded.registration.endpoint} returns {response.status}"
            await self._remove(tenant, forwarded)
        except SourceError as error:
            return error.why
        except (NotStored, Problem) as error:
            return str(error)
        return None

    def _origin_of(self, tenant: Tenant, one: Subscription) -> RequestOrigin:
        came_by = str(one.document.get(CAME_BY, "")).encode("latin-1", "replace")
        return RequestOrigin({b"via": came_by} if came_by else {}, tenant.alias, federated(tenant).registry)

    def _of(self, tenant: Tenant) -> list[ForwardedSubscription]:
        return [one for one in self._forwarded.values() if one.tenant == tenant.name]

    async def _store(self, tenant: Tenant, forwarded: ForwardedSubscription) -> None:
        key = (DocumentKind.FORWARDED_SUBSCRIPTION, tenant.name, forwarded.token)
        await tenant.commits.store(Entries(documents={key: forwarded.stored()}))
        self._forwarded[forwarded.token] = forwarded

    async def _remove(self, tenant: Tenant, forwarded: ForwardedSubscription) -> None:
        await tenant.commits.store(
            Entries(documents={(DocumentKind.FORWARDED_SUBSCRIPTION, tenant.name, forwarded.token): None})
        )
        self._forwarded.pop(forwarded.token, None)

    # Notifications of sources

    async def receive(self, request: RequestContext) -> Response:
        """POST sourceNotifications/{token}: a source notifies of changes."""
        forwarded = self._forwarded.get(request.names[0])
        if forwarded is None:
            raise not_found("this subscription has ended; delete it")
        document, context = await request.body()
        data = document.get("data") if isinstance(document, dict) else None
        if not isinstance(data, list):
            raise bad_request_data(f'a notification has "data", a list of entities, not {shown(data)}')
        tenant = self._tenants.kept(forwarded.tenant)
        one = tenant.notifier.get(forwarded.subscription)
        if one is None or not one.is_active(time.time()):
            return Response(200)
        entities = [
            (entity_id, said)
            for each in data
            if (said := self._notification_entity(each, forwarded, one, tenant, context)) is not None
            and (entity_id := str(each.get("id")))
        ]
        notices = list(_notices(tenant.name, one, entities))
        if notices:
            try:
                await tenant.commits.store(Entries(pending=notices))
            except NotStored as error:
                raise not_stored(str(error)) from error
            tenant.notifier.deliver(notices)
        return Response(200)

    @staticmethod
    def _notification_entity(
        given: Any, forwarded: ForwardedSubscription, one: Subscription, tenant: Tenant, context: Context
    ) -> bytes | None:
        """Return the entity for the subscriber's notification; None if the subscription does not match."""
        if not isinstance(given, dict):
            raise bad_request_data(f"an entity is a JSON object, not {shown(given)}")
        entity_id = given.get("id")
        own = tenant.store.get(entity_id) if isinstance(entity_id, str) else None
        change = change_of_notification(given, forwarded.registration, own, context.terms)
        if change is None or (change.after is not None and not one.selects(change.after)):
            return None
        return change_data(one, change)


def _refusal(source: Registration, response: HttpResponse) -> str:
    return f"{source.endpoint} does not take the subscription ({response.status})"


def _notices(
    tenant: str, one: Subscription, entities: list[tuple[str, bytes]]
) -> Iterable[PendingNotification]:
    now_s = time.time()
    if one.throttling_s:
        for entity_id, said in entities:
            yield PendingNotification(tenant, one.id, entity_id, now_s, b"[" + said + b"]")
    elif entities:
        body = notification(one, [said for _, said in entities])
        yield PendingNotification(tenant, one.id, entities[0][0], now_s, body)
