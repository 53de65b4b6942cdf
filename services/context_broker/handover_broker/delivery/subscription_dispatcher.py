"""The subscriptions of one tenant, with a delivery worker for each."""

from collections.abc import Callable, Iterable, Mapping
from itertools import islice

from handover_broker.delivery.combining import MAX_ITEMS_PER_NOTIFICATION, combined
from handover_broker.delivery.delivery_worker import DeliveryWorker
from handover_broker.delivery.endpoint_queue import EndpointQueue
from handover_broker.delivery.outbound import Outbound
from handover_broker.delivery.subscription import Subscription
from handover_broker.storage.commits import Commits
from handover_broker.storage.entries import DocumentKey, DocumentKind, Entries, PendingNotification
from handover_broker.storage.journal import Journal

Compose = Callable[[Subscription, Mapping[str, PendingNotification]], bytes | None]
"""Returns one message for the present state of entities (by id)."""


class SubscriptionDispatcher:
    """Manages the subscriptions of a tenant and passes their notifications to delivery workers."""

    counts_kind = DocumentKind.COUNTS
    """The kind of document that stores the counts of the subscriptions."""

    def __init__(self, tenant: str, commits: Commits, outbound: Outbound) -> None:
        self.tenant = tenant
        self.outbound = outbound
        self._commits = commits
        self._workers: dict[str, DeliveryWorker] = {}
        self.unusable: dict[str, str] = {}
        """Stored subscriptions that cannot be used, with the reasons."""

    # Subscriptions

    def start(self, subscriptions: Iterable[Subscription]) -> None:
        """Start with the stored subscriptions; their pending notifications are sent now."""
        for subscription in subscriptions:
            self._add_worker(subscription)
        if self._workers:
            for name in self.journal.pending_subscriptions(self.tenant):
                if name in self._workers:
                    self._workers[name].start()
        self.update_index()

    def stop(self) -> None:
        """Stop; pending notifications stay in the outbox."""
        for worker in self._workers.values():
            worker.stop()

    def put(self, subscription: Subscription) -> None:
        """Add or replace a subscription."""
        worker = self._workers.get(subscription.id)
        if worker is None:
            self._add_worker(subscription)
        else:
            subscription.counts = worker.subscription.counts
            worker.change(subscription)
        self.update_index(subscription.id)

    def remove(self, subscription_id: str) -> None:
        """Remove a subscription and its pending notifications."""
        self._workers.pop(subscription_id).end()
        self.update_index(subscription_id)

    def reset_counts(self, subscription_id: str) -> None:
        """Count from the start, as for a new owner."""
        subscription = self._workers[subscription_id].subscription
        subscription.counts.reset()
        self.settle(subscription, ())

    def get(self, subscription_id: str) -> Subscription | None:
        """Return a subscription."""
        worker = self._workers.get(subscription_id)
        return None if worker is None else worker.subscription

    def all(self) -> list[Subscription]:
        """Return all subscriptions in a stable order."""
        return [worker.subscription for worker in self._workers.values()]

    def update_index(self, changed: str | None = None) -> None:
        """Update after a subscription was added, changed or deleted; without an id, after all changed."""

    # Notifications

    def deliver(self, notices: list[PendingNotification]) -> None:
        """Pass committed notifications to their delivery workers."""
        for notice in notices:
            worker = self._workers.get(notice.subscription)
            if worker is not None:
                worker.add(notice)

    # For delivery workers

    @property
    def journal(self) -> Journal:
        """The journal with the outbox."""
        return self.outbound.journal

    @property
    def keep_s(self) -> float:
        """How long a notification is retried, in seconds."""
        return self.outbound.keep_s

    def endpoint_queue(self, subscription: Subscription) -> EndpointQueue:
        """Return the queue of the endpoint of a subscription."""
        return self.outbound.endpoint_queue(subscription.endpoint)

    async def post(self, subscription: Subscription, body: bytes, taken: bytes | None) -> int:
        """Send a notification; see `Outbound.post`."""
        return await self.outbound.post(subscription, self.tenant, body, taken)

    def together(self, notices: Mapping[str, PendingNotification]) -> dict[str, PendingNotification]:
        """Return the first of the notifications (by entity) that fit into one message."""
        return dict(islice(notices.items(), MAX_ITEMS_PER_NOTIFICATION))

    async def release(
        self, subscription: Subscription, notices: Mapping[str, PendingNotification]
    ) -> bytes | None:
        """Return the message that may be sent now for notices (by entity); None if nothing may.

        A notice that was throttled is composed now. Raises `Unverified` to try again later.
        """
        return self.message_of(subscription, notices, self.notification_of)

    @staticmethod
    def message_of(
        subscription: Subscription, notices: Mapping[str, PendingNotification], compose: Compose
    ) -> bytes | None:
        """Return one message for notices (by entity); None if there is nothing to send.

        `compose` makes the part of those that were throttled, or that the owner may see in part only.
        """
        bodies = [
            notice.body
            for notice in notices.values()
            if notice.body is not None and not notice.waits_for_throttling
        ]
        if len(bodies) < len(notices):
            waiting = {
                name: notice
                for name, notice in notices.items()
                if notice.body is None or notice.waits_for_throttling
            }
            composed = compose(subscription, waiting)
            bodies += [] if composed is None else [composed]
        return combined(bodies) if bodies else None

    def notification_of(
        self, subscription: Subscription, notices: Mapping[str, PendingNotification]
    ) -> bytes | None:
        """Return one message for entities (by id) that changed while throttled; None if there is nothing
        to send."""
        raise NotImplementedError

    def settle(self, subscription: Subscription, seqs: Iterable[int]) -> None:
        """Delete notifications from the outbox and write the counts, with the next commit."""
        if subscription.id in self._workers:
            documents: dict[DocumentKey, bytes | None] = {
                (self.counts_kind, self.tenant, subscription.id): subscription.counts.stored()
            }
            self._commits.store_later(Entries(settled=list(seqs), documents=documents))

    def _add_worker(self, subscription: Subscription) -> DeliveryWorker:
        worker = self._workers[subscription.id] = DeliveryWorker(subscription, self)
        return worker
