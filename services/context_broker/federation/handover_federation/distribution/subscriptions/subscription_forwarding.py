"""Forwards subscriptions to context sources, and their notifications to subscribers (clause 5.8).

Whenever subscriptions or registrations change, the subscriptions that should be forwarded are compared with
those that are, and the difference is carried out at the sources. Failures are retried. Notifications of
sources come in here and go to the subscriber through the outbox, as the broker's own do.
"""

import asyncio
import time
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final
from uuid import uuid4

from handover.errors import Problem
from handover.network.http_client import HttpResponse
from handover.runtime.background_tasks import BackgroundTasks
from handover.runtime.retry import Backoff
from handover.telemetry import get_logger
from handover_broker.contexts.context_resolver import ContextResolver
from handover_broker.delivery.notification import change_data, notification
from handover_broker.delivery.subscription import Subscription
from handover_broker.delivery.subscription_documents import CAME_BY
from handover_broker.delivery.triggers import EntityChange
from handover_broker.model.context import Context
from handover_broker.model.problems import bad_request_data, not_found, not_stored
from handover_broker.model.stored_documents import isolated
from handover_broker.model.validation import shown
from handover_broker.request.request_context import (
    JSON,
    RequestContext,
    Response,
)
from handover_broker.request.routing import Operation
from handover_broker.storage.database import NotStored
from handover_broker.storage.entries import DocumentKind, Entries, PendingNotification
from handover_broker.storage.journal import Journal
from handover_broker.tenants import Tenant, Tenants
from handover_federation.distribution.distributed_operations import (
    Handler,
    Perform,
    Sources,
    gather_all,
)
from handover_federation.distribution.forwarding.forwarder import (
    SILENT,
    Forwarder,
    RequestOrigin,
    SourceError,
    SourceRequest,
    quoted,
)
from handover_federation.distribution.forwarding.via import chain
from handover_federation.distribution.query_targets import source_filter
from handover_federation.distribution.subscriptions.forwarded_subscriptions import (
    PATH,
    ForwardedSubscription,
    digest,
    forwarded_document,
    questions,
    restored,
    with_endpoint,
)
from handover_federation.distribution.subscriptions.source_notifications import change_of_notification
from handover_federation.registrations.admission import Admission
from handover_federation.registrations.coverage import CoverageQuery
from handover_federation.registrations.registration import Registration
from handover_federation.tenant_state import federated

log = get_logger(__name__)

SETTLE_S: Final = 0.05
"""Pause after a change of registrations, so that several changes are handled together."""
INITIAL_RETRY_S: Final = 5.0
MAX_RETRY_S: Final = 60.0
"""Limits of the pause before failed forwardings and deletions of a tenant are retried."""


@dataclass(frozen=True, slots=True)
class _Wanted:
    """A subscription that a source should have, as it is sent there, without the endpoint."""

    subscription: Subscription
    source: Registration
    document: dict[str, Any]
    digest: str


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
        self._tasks = BackgroundTasks("subscription forwarding")
        self._scheduled: set[str] = set()
        """Tenants that are aligned soon, because something changed."""
        self._retries: set[str] = set()
        """Tenants that are aligned again later, because something failed."""
        self._backoffs: dict[str, Backoff] = {}
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
        """Load the forwarded subscriptions, and align those of all tenants in the background."""
        await self._tasks.__aenter__()
        self._base = self._contexts.base({})
        for name, token, stored in journal.documents(DocumentKind.FORWARDED_SUBSCRIPTION):
            await self._restore(name, token, stored)
        for forwarded in self._forwarded.values():
            self._base = self._public_url or forwarded.base
        for tenant in self._tenants:
            if not tenant.federation.is_empty or self._of(tenant):
                self.schedule_alignment(tenant)

    async def stop(self) -> None:
        """Stop the background tasks; forwarded subscriptions stay."""
        await self._tasks.__aexit__()

    async def _restore(self, tenant: str, token: str, stored: bytes) -> None:
        """Load a forwarded subscription."""
        with isolated(DocumentKind.FORWARDED_SUBSCRIPTION.value, tenant, token, {}):
            self._forwarded[token] = await restored(token, tenant, stored, self._contexts)

    def schedule_alignment(self, tenant: Tenant) -> None:
        """Schedule an alignment of a tenant; changes in a row share one."""
        if tenant.name not in self._scheduled:
            self._scheduled.add(tenant.name)
            self._tasks.start(self._align_after, tenant, SETTLE_S, self._scheduled)

    def _schedule_retry(self, tenant: Tenant) -> None:
        if tenant.name not in self._retries:
            self._retries.add(tenant.name)
            backoff = self._backoffs.setdefault(tenant.name, Backoff(INITIAL_RETRY_S, MAX_RETRY_S))
            self._tasks.start(self._align_after, tenant, backoff.next_delay_s(), self._retries)

    async def _align_after(self, tenant: Tenant, delay_s: float, waiting: set[str]) -> None:
        await asyncio.sleep(delay_s)
        waiting.discard(tenant.name)  # before: a change meanwhile schedules another alignment
        await self.align(tenant)

    async def _after_change(self, sources: Sources, request: RequestContext, perform: Perform) -> Response:
        response = await perform(request)
        self._base = self._contexts.base(request.headers)
        for failure in await self.align(request.tenant):
            sources.add_warning(SILENT, failure)
        return response

    # Forwarding and deleting

    async def align(self, tenant: Tenant) -> list[str]:
        """Forward missing subscriptions and delete obsolete ones at the sources; return the failures."""
        async with self._locks.setdefault(tenant.name, asyncio.Lock()):
            wanted = await self._wanted(tenant)
            current = {forwarded.key: forwarded for forwarded in self._of(tenant)}
            obsolete = {
                key: forwarded
                for key, forwarded in current.items()
                if key not in wanted or self._is_outdated(forwarded, wanted[key].digest)
            }
            deletions = [self._delete_at_source(tenant, forwarded) for forwarded in obsolete.values()]
            failures = [failure for failure in await gather_all(*deletions) if failure]
            confirmed = {
                key for key, forwarded in current.items() if key not in obsolete and forwarded.is_confirmed
            }
            missing = [self._forward(tenant, wanted[key]) for key in wanted if key not in confirmed]
            failures += [failure for failure in await gather_all(*missing) if failure]
        if failures:
            self._schedule_retry(tenant)
        else:
            self._backoffs.pop(tenant.name, None)
        return failures

    def _is_outdated(self, forwarded: ForwardedSubscription, document_digest: str) -> bool:
        return forwarded.document_digest != document_digest or (
            self._public_url is not None and forwarded.base != self._public_url
        )

    async def _wanted(self, tenant: Tenant) -> dict[tuple[str, str], _Wanted]:
        wanted: dict[tuple[str, str], _Wanted] = {}
        if tenant.federation.is_empty:
            return wanted
        for subscription in tenant.notifier.all():
            if not subscription.is_active(time.time()) or subscription.document.get("localOnly"):
                continue
            for source in self._sources_of(tenant, subscription):
                try:
                    dialect = await self._forwarder.dialect(source, subscription.names, body=JSON)
                    document = forwarded_document(subscription, source, dialect)
                except Problem as problem:
                    log.warning(
                        "@context of a source cannot be loaded", registration=source.id, why=problem.detail
                    )
                    continue
                except Exception:  # the other subscriptions are forwarded
                    log.exception(
                        "a subscription is not forwarded",
                        subscription=subscription.id,
                        registration=source.id,
                    )
                    continue
                wanted[subscription.id, source.id] = _Wanted(subscription, source, document, digest(document))
        return wanted

    def _sources_of(self, tenant: Tenant, subscription: Subscription) -> Iterable[Registration]:
        """Return the registrations to which a subscription is to be forwarded."""
        coverage = CoverageQuery(subscription.places, subscription.scopes, None, subscription.view.datasets)
        where = source_filter(subscription.document.get("csf"), subscription.names, coverage)
        passed = frozenset(chain(_came_by(subscription)))
        sources: dict[str, Registration] = {}
        admission = Admission(tenant.receivers, tenant.name, tenant.store)
        for target in questions(subscription):
            for match in federated(tenant).registry.matching("createSubscription", target, where):
                source = match.registration
                if admission.narrowed(match) is None:
                    continue
                if self._forwarder.alias_of(source) not in passed and not self._forwarder.is_ourselves(
                    source, federated(tenant).registry, tenant.alias
                ):
                    sources[source.id] = source
        return sources.values()

    async def _forward(self, tenant: Tenant, wanted: _Wanted) -> str | None:
        """Return why forwarding failed; None if it succeeded or the source will never take the
        subscription."""
        subscription, source = wanted.subscription, wanted.source
        key = (subscription.id, source.id)
        if self._refused.get((tenant.name, *key)) == wanted.digest:
            return None
        current = next((forwarded for forwarded in self._of(tenant) if forwarded.key == key), None)
        forwarded = current or ForwardedSubscription(
            uuid4().hex, tenant.name, subscription.id, source, wanted.digest, self._base, is_confirmed=False
        )
        try:
            if current is None:
                await self._store(tenant, forwarded)
            dialect = await self._forwarder.dialect(source, subscription.names, body=JSON)
            body = with_endpoint(wanted.document, forwarded.base, forwarded.token)
            source_request = SourceRequest("POST", "subscriptions", dialect, (), body)
            origin = self._origin_of(tenant, subscription)
            response, _ = await self._forwarder.send(source, source_request, origin)
        except SourceError as error:
            return error.why
        except (NotStored, Problem) as error:
            return str(error)
        if response.status in {201, 409}:  # 409: it exists, an earlier response was lost
            await self._store(tenant, forwarded.confirmed())
            return None
        if response.status >= 500 and response.status != 508:
            return f"{source.shown} returns {response.status} for a subscription"
        log.warning("source refused a subscription", registration=source.id, status=response.status)
        self._refused[(tenant.name, *key)] = wanted.digest
        await self._remove(tenant, forwarded)
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
                return f"{forwarded.registration.shown} returns {response.status}"
            await self._remove(tenant, forwarded)
        except SourceError as error:
            return error.why
        except (NotStored, Problem) as error:
            return str(error)
        return None

    def _origin_of(self, tenant: Tenant, subscription: Subscription) -> RequestOrigin:
        came_by = _came_by(subscription)
        return RequestOrigin({b"via": came_by} if came_by else {}, tenant.alias, federated(tenant).registry)

    def _of(self, tenant: Tenant) -> list[ForwardedSubscription]:
        return [forwarded for forwarded in self._forwarded.values() if forwarded.tenant == tenant.name]

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
        admission = Admission(tenant.receivers, tenant.name, tenant.store)
        await admission.prepare((forwarded.registration,))
        subscription = tenant.notifier.get(forwarded.subscription)
        if subscription is None or not subscription.is_active(time.time()):
            return Response(200)
        disclosure = tenant.notifier.disclosure(subscription)
        entities = []
        for entity in data:
            change = _change_of(entity, forwarded, subscription, tenant, context)
            if (
                change is not None
                and admission.admits(forwarded.registration, change.entity.id, change.entity.types)
                and (
                    disclosure is None
                    or (disclosure.admits(change.before) and disclosure.admits(change.after))
                )
            ):
                entities.append((change.entity.id, change_data(subscription, change)))
        note = None if disclosure is None else disclosure.note(None)
        notifications = list(_notifications(tenant.name, subscription, entities, note))
        if notifications:
            try:
                await tenant.commits.store(Entries(pending=notifications))
            except NotStored as error:
                raise not_stored(str(error), is_away=error.is_away) from error
            tenant.notifier.deliver(notifications)
        return Response(200)


def _change_of(
    document: Any,
    forwarded: ForwardedSubscription,
    subscription: Subscription,
    tenant: Tenant,
    context: Context,
) -> EntityChange | None:
    """Return the change of an entity in a notification; None if the subscription does not match."""
    if not isinstance(document, dict):
        raise bad_request_data(f"an entity is a JSON object, not {shown(document)}")
    entity_id = document.get("id")
    own = tenant.store.get(entity_id) if isinstance(entity_id, str) else None
    change = change_of_notification(document, forwarded.registration, own, context.terms)
    if change is None or (change.after is not None and not subscription.selects(change.after)):
        return None
    return change


def _refusal(source: Registration, response: HttpResponse) -> str:
    return f"{source.shown} does not take the subscription ({response.status})"


def _came_by(subscription: Subscription) -> bytes:
    """Return the Via header of the request that created a subscription."""
    return str(subscription.document.get(CAME_BY, "")).encode("latin-1", "replace")


def _notifications(
    tenant: str, subscription: Subscription, entities: list[tuple[str, bytes]], note: bytes | None
) -> Iterable[PendingNotification]:
    now_s = time.time()
    if subscription.throttling_s:
        for entity_id, body in entities:
            yield PendingNotification(
                tenant, subscription.id, entity_id, now_s, b"[" + body + b"]", headers=note
            )
    elif entities:
        document = notification(subscription, [body for _, body in entities])
        yield PendingNotification(tenant, subscription.id, entities[0][0], now_s, document, headers=note)
