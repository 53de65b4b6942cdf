"""Subscriptions to registrations: notifications of newly matching, updated and no longer matching ones.

Such a subscription (clause 5.11) is delivered like one to entities, and matches like a search for
registrations. Its notifications are stored in the same commit as the change of the registration.
"""

import time
from collections.abc import Mapping
from enum import StrEnum
from itertools import islice, takewhile
from typing import Any
from uuid import uuid4

import orjson

from handover.telemetry import get_logger
from handover_broker.delivery.combining import MAX_ITEMS_PER_NOTIFICATION
from handover_broker.delivery.outbound import Outbound
from handover_broker.delivery.periodic import PeriodicNotifications
from handover_broker.delivery.subscription import Subscription
from handover_broker.delivery.subscription_dispatcher import SubscriptionDispatcher
from handover_broker.model.negotiation import JSON_LD
from handover_broker.model.representation.rendering import with_context
from handover_broker.model.validation import timestamp_now
from handover_broker.query.geo_query import geo_query_document
from handover_broker.query.scope_query import scope_query
from handover_broker.query.selection import Selection, compiled
from handover_broker.storage.commits import Commits
from handover_broker.storage.entries import PendingNotification
from handover_federation.registrations.coverage import period_of
from handover_federation.registrations.registration import (
    EntityTarget,
    Registration,
    shown_document,
)
from handover_federation.registrations.registration_search import Search, target_for
from handover_federation.registrations.registry import Registry

log = get_logger(__name__)


class Reason(StrEnum):
    """Why a subscriber is notified of a registration (clause 5.3.3)."""

    NEWLY_MATCHING = "newlyMatching"
    UPDATED = "updated"
    NO_LONGER_MATCHING = "noLongerMatching"


class SourceNotifier(SubscriptionDispatcher):
    """Keeps a tenant's subscriptions to registrations; those with a timeInterval are notified
    periodically."""

    def __init__(self, tenant: str, commits: Commits, outbound: Outbound, registry: Registry) -> None:
        super().__init__(tenant, commits, outbound)
        self._registry = registry
        self._periodic = PeriodicNotifications(self._notify_all)

    def stop(self) -> None:
        """Stop delivering; pending notifications stay in the outbox."""
        self._periodic.stop()
        super().stop()

    def update_index(self, changed: str | None = None) -> None:
        """Restart the periodic notifications after a change of subscriptions."""
        subscription = None if changed is None else self.get(changed)
        if self._periodic.is_affected(changed, subscription):
            self._periodic.schedule(self.all())

    def together(self, notices: Mapping[str, PendingNotification]) -> dict[str, PendingNotification]:
        """Return the first notices with the same reason, because a notification has one reason for all its
        data."""
        reason = _reason_in(next(iter(notices)))
        alike = takewhile(lambda keyed_notice: _reason_in(keyed_notice[0]) == reason, notices.items())
        return dict(islice(alike, MAX_ITEMS_PER_NOTIFICATION))

    def notification_of(
        self, subscription: Subscription, notices: Mapping[str, PendingNotification]
    ) -> bytes | None:
        """Return a notification of the registrations that changed while throttled, each in its last state."""
        documents = [
            orjson.Fragment(notice.body[1:-1]) for notice in notices.values() if notice.body is not None
        ]
        return _notification(subscription, documents, _reason_in(next(iter(notices))))

    async def _notify_all(self, subscription: Subscription) -> None:
        worker = self._workers.get(subscription.id)
        notices = notices_of_all(self, self._registry, subscription)
        if worker is not None and notices:
            worker.offer(notices)


def search_of(subscription: Subscription) -> Search:
    """Return the search for the registrations that match a subscription.

    `q` is about entities, which a registry does not have; `csf` filters by properties of registrations.
    Attributes restrict the search only if both watched and notified attributes are named (clauses 5.11.2.4
    and 5.12).
    """
    document, context = subscription.document, subscription.context
    watched, shown = document.get("watchedAttributes"), document["notification"].get("attributes")
    names = frozenset((*watched, *shown)) if watched and shown else None
    selectors: list[dict[str, Any]] = document.get("entities") or [{}]
    targets = [
        target_for(
            [selector["id"]] if isinstance(selector.get("id"), str) else selector.get("id"),
            selector.get("idPattern"),
            selector.get("type"),
            context,
        )
        for selector in selectors
    ]
    place = document.get("geoQ")
    return Search(
        tuple(EntityTarget(target.ids, target.id_pattern, target.types, names) for target in targets),
        (Selection(query=compiled(document["csf"], context)),) if "csf" in document else (),
        period_of(document.get("temporalQ") or {}),
        None if place is None else geo_query_document(place, context.terms.expand),
        scope_query(document["scopeQ"]) if "scopeQ" in document else None,
    )


def notices_of_change(
    book: SubscriptionDispatcher, before: Registration | None, after: Registration | None
) -> list[PendingNotification]:
    """Return the notices of a changed registration (clause 5.11.7)."""
    now_s = time.time()
    pending: list[PendingNotification] = []
    for subscription in book.all():
        if subscription.interval_s is not None or not subscription.is_active(now_s):
            continue
        try:
            search = search_of(subscription)
            matched = before is not None and search.finds(before)
            matches = after is not None and search.finds(after)
            reason = _reason(matched=matched, matches=matches)
            documents = after if matches else before
            if reason is not None and documents is not None:
                pending += _notices(book, subscription, search, [documents], reason)
        except Exception:  # a faulty subscription must not fail the registration of another client
            log.exception("notification failed", subscription=subscription.id)
    return pending


def notices_of_all(
    book: SubscriptionDispatcher, registry: Registry, subscription: Subscription
) -> list[PendingNotification]:
    """Return the notices for a new subscription: all matching registrations."""
    search = search_of(subscription)  # an invalid search is refused, also for a paused subscription
    if not subscription.is_active(time.time()):
        return []
    registrations = registry.matching_any(search.targets, search.wants)
    return _notices(book, subscription, search, registrations, Reason.NEWLY_MATCHING)


def _reason(*, matched: bool, matches: bool) -> Reason | None:
    if matches:
        return Reason.UPDATED if matched else Reason.NEWLY_MATCHING
    return Reason.NO_LONGER_MATCHING if matched else None


def _notices(
    book: SubscriptionDispatcher,
    subscription: Subscription,
    search: Search,
    registrations: list[Registration],
    reason: Reason,
) -> list[PendingNotification]:
    now_s = time.time()
    documents = [
        shown_document(
            registration,
            subscription.context,
            sys_attrs=subscription.view.sys_attrs,
            pieces=registration.relevant(search.targets),
            has_counts=False,  # they change without a notification, and not every subscriber may see them
        )
        for registration in registrations
    ]
    if subscription.throttling_s:
        return [
            PendingNotification(
                book.tenant,
                subscription.id,
                f"{reason.value} {registration.id}",
                now_s,
                orjson.dumps([document]),
            )
            for registration, document in zip(registrations, documents, strict=True)
        ]
    return [
        PendingNotification(
            book.tenant,
            subscription.id,
            subscription.id,
            now_s,
            _notification(subscription, documents[start : start + MAX_ITEMS_PER_NOTIFICATION], reason.value),
        )
        for start in range(0, len(documents), MAX_ITEMS_PER_NOTIFICATION)
    ]


def _reason_in(entity: str) -> str:
    """Return the reason in the key of a throttled notice, which precedes the registration's id."""
    return entity.partition(" ")[0]


def _notification(subscription: Subscription, data: list[Any], reason: str) -> bytes:
    """Return a notification (clause 5.3.2)."""
    body = orjson.dumps(
        {
            "id": f"urn:ngsi-ld:ContextSourceNotification:{uuid4()}",
            "type": "ContextSourceNotification",
            "subscriptionId": subscription.id,
            "notifiedAt": timestamp_now(),
            "triggerReason": reason,
            "data": data,
        }
    )
    return with_context(body, subscription.context) if subscription.endpoint.accept == JSON_LD else body
