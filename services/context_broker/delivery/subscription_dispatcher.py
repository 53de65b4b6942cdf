"""The office of the couriers of one tenant: a courier for each subscription, and what is handed to them."""

from collections.abc import Iterable, Mapping
from itertools import islice
from typing import Final

import orjson

from services.context_broker.delivery.delivery_worker import Courier
from services.context_broker.delivery.endpoint_queue import Line
from services.context_broker.delivery.outbound import Outbound
from services.context_broker.delivery.subscription import Subscription
from services.context_broker.storage.commits import Commits
from services.context_broker.storage.entries import DocumentKey, Entries, Kind, Notice
from services.context_broker.storage.journal import Journal

MOST_TOLD_AT_ONCE: Final = 1000
"""Entities, or registrations, in one notification; more come in several."""


class CourierOffice:
    """Keeps the subscriptions of a tenant, and has what they are owed delivered."""

    counts_kind = Kind.COUNTS
    """Under which kind of document the counts of the subscriptions are kept."""

    def __init__(self, tenant: str, commits: Commits, outbound: Outbound) -> None:
        self.tenant = tenant
        self.outbound = outbound
        self._commits = commits
        self._couriers: dict[str, Courier] = {}

    # What happens to subscriptions

    def start(self, subscriptions: Iterable[Subscription]) -> None:
        """Begin with the subscriptions of before; what is owed to them is sent now."""
        for subscription in subscriptions:
            self._hire(subscription)
        if self._couriers:
            for one in self.journal.owed_to(self.tenant):
                if one in self._couriers:
                    self._couriers[one].start()
        self.rearrange()

    def stop(self) -> None:
        """End; what is owed stays in the outbox."""
        for courier in self._couriers.values():
            courier.stop()

    def put(self, subscription: Subscription) -> None:
        """Heed a new or a changed subscription from now on."""
        courier = self._couriers.get(subscription.id)
        if courier is None:
            self._hire(subscription)
        else:
            subscription.counts = courier.subscription.counts
            courier.change(subscription)
        self.rearrange(subscription.id)

    def remove(self, subscription_id: str) -> None:
        """Forget a subscription and what is owed to it."""
        self._couriers.pop(subscription_id).end()
        self.rearrange(subscription_id)

    def get(self, subscription_id: str) -> Subscription | None:
        """Return a subscription."""
        courier = self._couriers.get(subscription_id)
        return None if courier is None else courier.subscription

    def all(self) -> list[Subscription]:
        """Return all subscriptions in a stable order."""
        return [courier.subscription for courier in self._couriers.values()]

    def rearrange(self, changed: str | None = None) -> None:
        """Take note that a subscription came, changed or went, or that all are others now."""

    # What is to be delivered

    def deliver(self, notices: list[Notice]) -> None:
        """Hand notifications that are committed to their couriers."""
        for notice in notices:
            courier = self._couriers.get(notice.subscription)
            if courier is not None:
                courier.add(notice)

    # What couriers need

    @property
    def journal(self) -> Journal:
        """Where what is owed waits."""
        return self.outbound.journal

    @property
    def keep_s(self) -> float:
        """How long a notification is tried again."""
        return self.outbound.keep_s

    def line(self, subscription: Subscription) -> Line:
        """Return the way to the endpoint of a subscription."""
        return self.outbound.line(subscription.endpoint)

    async def post(self, subscription: Subscription, body: bytes, taken: bytes | None) -> int:
        """Send a notification; see `Outbound.post`."""
        return await self.outbound.post(subscription, self.tenant, body, taken)

    def together(self, notices: Mapping[str, Notice]) -> dict[str, Notice]:
        """Return those of the notices (by entity) that one notification can tell of: the first ones."""
        return dict(islice(notices.items(), MOST_TOLD_AT_ONCE))

    def notification_of(self, subscription: Subscription, notices: Mapping[str, Notice]) -> bytes | None:
        """Return what to tell of entities (by id) that changed while throttled; None if there is nothing."""
        raise NotImplementedError

    def settle(self, subscription: Subscription, seqs: Iterable[int]) -> None:
        """Strike out what is no longer owed and write the counts, in passing: with the next commit."""
        counts = subscription.counts
        told = [
            counts.sent,
            counts.failed,
            counts.last_notification,
            counts.last_success,
            counts.last_failure,
        ]
        if subscription.id in self._couriers:
            documents: dict[DocumentKey, bytes | None] = {
                (self.counts_kind, self.tenant, subscription.id): orjson.dumps(told)
            }
            self._commits.store_later(Entries(settled=list(seqs), documents=documents))

    def _hire(self, subscription: Subscription) -> Courier:
        courier = self._couriers[subscription.id] = Courier(subscription, self)
        return courier
