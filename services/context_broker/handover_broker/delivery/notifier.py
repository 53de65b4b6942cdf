"""The notifier matches changes with subscriptions.

A change is matched when it is made, and its notifications are written in the same commit. Delivery workers
send them (`delivery_worker.py`), so a dead or slow endpoint delays nobody else.
"""

import asyncio
import time
from collections.abc import Iterable, Mapping
from contextvars import ContextVar
from dataclasses import replace
from functools import partial
from itertools import islice
from typing import Final

import orjson

from handover.security.resource_patterns import ANY_RESOURCE
from handover.telemetry import get_logger
from handover_broker.delivery.combining import MAX_ITEMS_PER_NOTIFICATION
from handover_broker.delivery.disclosure import Disclosure, Receivers, private_in
from handover_broker.delivery.endpoint import CREDENTIALS
from handover_broker.delivery.notification import change_data, entity_data, notification
from handover_broker.delivery.outbound import Outbound
from handover_broker.delivery.periodic import PeriodicNotifications
from handover_broker.delivery.subscription import Subscription
from handover_broker.delivery.subscription_dispatcher import SubscriptionDispatcher
from handover_broker.delivery.triggers import EntityChange, entity_change
from handover_broker.model.entity import Entity, Event
from handover_broker.query.q_match import Lookup
from handover_broker.query.type_selection import of_types
from handover_broker.storage.commits import Commits
from handover_broker.storage.entries import PendingNotification
from handover_broker.storage.store import Store

log = get_logger(__name__)

REQUEST_HEADERS: Final[ContextVar[Mapping[bytes, bytes]]] = ContextVar("REQUEST_HEADERS")
"""The headers of the current request; set while `Notifier.passes_headers_on`."""
REQUEST_TIME: Final[ContextVar[float | None]] = ContextVar("REQUEST_TIME", default=None)
"""When the current request began, in seconds since 1970: its changes are notified together."""
CHUNK: Final = 500
"""Entities of a periodic notification that are examined before other tasks run."""


class Notifier(SubscriptionDispatcher):
    """All subscriptions of a tenant, with indexes that find those of a change."""

    store: Store

    def __init__(self, tenant: str, commits: Commits, outbound: Outbound, receivers: Receivers) -> None:
        super().__init__(tenant, commits, outbound)
        self._receivers = receivers
        self._faulty: set[str] = set()
        self.passes_headers_on = False
        self._by_type: dict[str | None, list[Subscription]] = {}
        self._by_id: dict[str, list[Subscription]] = {}
        self._is_sorted = True
        self._periodic = PeriodicNotifications(self._notify_all)

    def stop(self) -> None:
        """Stop; pending notifications stay in the outbox."""
        self._periodic.stop()
        super().stop()

    def update_index(self, changed: str | None = None) -> None:
        """Update the indexes after a subscription was added, changed or deleted; without an id, after all
        changed."""
        self._is_sorted = False
        self._faulty.discard(changed or "")
        subscription = None if changed is None else self.get(changed)
        if subscription is not None and subscription.endpoint.taken:
            self.passes_headers_on = True
        if self._periodic.is_affected(changed, subscription):
            self._periodic.schedule(self.all())

    def _sort(self) -> None:
        """Index the subscriptions by their ids and types, so that a change is compared with few."""
        by_type: dict[str | None, list[Subscription]] = {}
        by_id: dict[str, list[Subscription]] = {}
        subscriptions = self.all()
        for subscription in subscriptions:
            if subscription.interval_s is not None:
                continue
            kinds: set[str | None] = set()
            ids: set[str] = set()
            for selector in subscription.selectors:
                if selector.ids is None:
                    kinds.update(selector.kinds() or (None,))
                else:
                    ids.update(selector.ids)
            if None in kinds or not (kinds or ids):
                kinds, ids = {None}, set()
            for kind in kinds:
                by_type.setdefault(kind, []).append(subscription)
            for name in ids:
                by_id.setdefault(name, []).append(subscription)
        self._by_type, self._by_id = by_type, by_id
        self.passes_headers_on = any(candidate.endpoint.taken for candidate in subscriptions)
        self._is_sorted = True

    def announce(self, event: Event) -> list[PendingNotification]:
        """Return the notifications of a change."""
        entity = event.after or event.before
        if not self._is_sorted:
            self._sort()
        if entity is None or not (self._by_type or self._by_id):
            return []
        named = self._by_id.get(entity.id)
        interested = list(self._by_type.get(None, ()))
        for kind in entity.types:
            interested += self._by_type.get(kind, ())
        if named is not None:
            interested += named
        if not interested:
            return []
        if named is not None or len(entity.types) > 1:
            interested = list(dict.fromkeys(interested))
        change, now_s = entity_change(event), REQUEST_TIME.get() or time.time()
        notices = [self._notice(subscription, change, now_s) for subscription in interested]
        return [notice for notice in notices if notice is not None]

    def disclosure(self, subscription: Subscription) -> Disclosure | None:
        """Return the selection for a notification that is composed now; None if its owner sees everything."""
        receiver = self._receivers.known(subscription.owner, self.tenant)
        return None if receiver is None else Disclosure(receiver)

    async def release(
        self, subscription: Subscription, notices: Mapping[str, PendingNotification]
    ) -> bytes | None:
        """Return the message of what the owner may see now; see `disclosure`."""
        receiver = await self._receivers.verified(subscription.owner, self.tenant)
        if receiver is None:
            return await super().release(subscription, notices)
        disclosure = Disclosure(receiver)
        usable: dict[str, PendingNotification] = {}
        for entity_id, notice in notices.items():
            note = private_in(notice.headers)
            if notice.body is None:
                usable[entity_id] = notice
            elif (
                note is not None
                and receiver.may_see(notice.entity, is_private=False)
                and all(receiver.may_see(private_id, is_private=True) for private_id in note)
            ):
                usable[entity_id] = notice
                disclosure.private.update(note)
            else:
                usable[entity_id] = replace(notice, body=None)
        body = self.message_of(subscription, usable, partial(self.notification_of, disclosure=disclosure))
        if body is not None and disclosure.private:
            address = subscription.endpoint.shown
            await self._receivers.record(
                subscription.owner, "notification", address, disclosure.private.values()
            )
        return body

    def notification_of(
        self,
        subscription: Subscription,
        notices: Mapping[str, PendingNotification],
        disclosure: Disclosure | None = None,
    ) -> bytes | None:
        """Return one message for entities (by id) that changed while throttled; None if there is nothing
        to send."""
        lookup = self.store.get if disclosure is None else disclosure.lookup(self.store.get)
        data: list[bytes] = []
        for entity_id, notice in notices.items():
            if notice.body is not None:
                data.append(notice.body[1:-1])
                continue
            entity = lookup(entity_id)
            if entity is not None and subscription.admits(entity, lookup):
                data.append(entity_data(subscription, entity, lookup))
        return notification(subscription, data) if data else None

    def _notice(
        self, subscription: Subscription, change: EntityChange, now_s: float
    ) -> PendingNotification | None:
        """Return the notification of a change; None if it is not to be notified."""
        entity_id = change.entity.id
        lookup: Lookup = self.store.latest
        try:
            disclosure = self.disclosure(subscription)
            if disclosure is not None:
                if not (disclosure.admits(change.before) and disclosure.admits(change.after)):
                    return None
                lookup = disclosure.lookup(lookup)
            if not subscription.wants(change, now_s, lookup):
                return None
            body: bytes | None
            if not subscription.throttling_s:
                body = notification(subscription, [change_data(subscription, change, lookup)])
            elif change.after is None or subscription.shows_changes or change.lost:
                body = b"[" + change_data(subscription, change, lookup) + b"]"
            else:
                body = None
            taken = self._taken(subscription.endpoint.taken) if subscription.endpoint.taken else None
            if disclosure is not None:
                taken = disclosure.note(taken)
        except Exception:  # a faulty subscription must not fail a write of another client
            if subscription.id not in self._faulty:
                self._faulty.add(subscription.id)
                log.exception("notification failed", subscription=subscription.id, entity=entity_id)
            return None
        return PendingNotification(self.tenant, subscription.id, entity_id, now_s, body, headers=taken)

    def _taken(self, names: Iterable[str]) -> bytes | None:
        """Return the named headers of the current request as JSON; None if it has none of them."""
        sent, passes_credentials_on = REQUEST_HEADERS.get({}), self._receivers.passes_credentials_on()
        headers = [
            (name, value.decode("latin-1"))
            for name in names
            if (value := sent.get(name.lower().encode())) is not None
            and (passes_credentials_on or name.lower() not in CREDENTIALS)
        ]
        return orjson.dumps(headers) if headers else None

    # Periodic notifications

    async def _notify_all(self, subscription: Subscription) -> None:
        """Send the present state of all entities of a subscription, in chunks; nothing if there are none."""
        worker = self._workers.get(subscription.id)
        data: list[bytes] = []
        notices: list[PendingNotification] = []
        disclosure = self.disclosure(subscription)
        lookup = self.store.get if disclosure is None else disclosure.lookup(self.store.get)

        def notice() -> PendingNotification:
            note = None if disclosure is None else disclosure.note(None)
            body = notification(subscription, data)
            return PendingNotification(
                self.tenant, subscription.id, ANY_RESOURCE, time.time(), body, headers=note
            )

        candidates = iter(self._candidates(subscription))
        while some := list(islice(candidates, CHUNK)):
            data += [
                entity_data(subscription, entity, lookup)
                for entity in some
                if (disclosure is None or disclosure.admits(entity)) and subscription.selects(entity, lookup)
            ]
            if len(data) >= MAX_ITEMS_PER_NOTIFICATION:
                notices.append(notice())
                data = []
            await asyncio.sleep(0)
        if data:
            notices.append(notice())
        if worker is not None and notices:
            worker.offer(notices)

    def _candidates(self, subscription: Subscription) -> Iterable[Entity]:
        """Return entities among which all entities of a subscription are."""
        if not subscription.selectors:
            return self.store.candidates()
        kinds: dict[str, None] = {}
        ids: dict[str, None] = {}
        for selector in subscription.selectors:
            if selector.ids is not None:
                ids.update(dict.fromkeys(sorted(selector.ids)))
            elif (of := selector.kinds()) is not None:
                kinds.update(dict.fromkeys(of))
            else:
                return self.store.candidates()
        by_id = self.store.candidates(ids) if ids else []
        by_type = self.store.candidates(types=of_types(kinds)) if kinds else []
        return dict.fromkeys([*by_id, *by_type])
