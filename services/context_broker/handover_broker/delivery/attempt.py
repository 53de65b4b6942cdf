"""One attempt to send a notification, and its result. Every attempt is counted."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final, Protocol

from prometheus_client import Counter

from handover.network.http_client import SendError
from handover.telemetry import get_logger
from handover_broker.delivery.endpoint_queue import EndpointQueue
from handover_broker.delivery.subscription import Subscription
from handover_broker.model.validation import timestamp_now
from handover_broker.storage.entries import PendingNotification
from handover_broker.storage.journal import Journal

log = get_logger(__name__)

_TRY_AGAIN: Final = frozenset({408, 425, 429})
"""Status codes after which the same notification is sent again."""

NOTIFICATIONS: Final = Counter(
    "handover_broker_notifications_total", "Attempts to send a notification, by their outcome", ["outcome"]
)
_DELIVERED: Final = NOTIFICATIONS.labels("delivered")
_FAILED: Final = NOTIFICATIONS.labels("failed")


class DeliveryContext(Protocol):
    """What a delivery worker needs of the notifier of its tenant."""

    tenant: str

    @property
    def journal(self) -> Journal:
        """The journal with the outbox."""

    @property
    def keep_s(self) -> float:
        """How long a notification is retried, in seconds."""

    def endpoint_queue(self, subscription: Subscription) -> EndpointQueue:
        """Return the queue of the endpoint of a subscription."""

    async def post(self, subscription: Subscription, body: bytes, taken: bytes | None) -> int:
        """Send a notification and return the status of the response; raise `SendError` if there is none.

        `taken` are headers of the request that made the change, as JSON.
        """

    def together(self, notices: Mapping[str, PendingNotification]) -> dict[str, PendingNotification]:
        """Return the first of the notifications (by entity, at least one) that fit into one message."""

    async def release(
        self, subscription: Subscription, notices: Mapping[str, PendingNotification]
    ) -> bytes | None:
        """Return the message that may be sent now for notices (by entity); None if nothing may.

        Raises `Unverified` to try again later.
        """

    def settle(self, subscription: Subscription, seqs: Iterable[int]) -> None:
        """Delete notifications from the outbox by number, and write the counts of the subscription."""


@dataclass(frozen=True, slots=True)
class DeliveryResult:
    """The result of an attempt: why it failed (None if it did not), and whether to retry.

    `is_there` is true if the endpoint answered.
    """

    why: str | None
    again: bool
    is_there: bool


async def attempt(
    context: DeliveryContext, subscription: Subscription, body: bytes, taken: bytes | None, *, is_first: bool
) -> DeliveryResult:
    """Send a notification once; `taken` are headers of the request that made the change, as JSON.

    The first attempt counts as sent (clause 5.8.6); each attempt that fails counts as failed.
    """
    counts, is_there = subscription.counts, True
    try:
        status = await context.post(subscription, body, taken)
        why = None if 200 <= status < 300 else f"{subscription.endpoint.shown} answers {status}"
        again = status >= 500 or status in _TRY_AGAIN
    except SendError as error:
        why, again, is_there = f"{subscription.endpoint.shown}: {error}", True, False
    at = timestamp_now()
    counts.sent += is_first
    counts.last_notification = at
    if why is None:
        counts.last_success = at
        _DELIVERED.inc()
    else:
        counts.failed += 1
        counts.last_failure = at
        _FAILED.inc()
        context.settle(subscription, ())
        log.info("notification failed", subscription=subscription.id, why=why)
    return DeliveryResult(why, again, is_there)
