"""The notifier: tells subscribers of changes, each at its own pace.

Every subscription has a courier of its own, so that a dead or slow subscriber delays nobody else and the
order is kept. What is owed stands in the outbox, written in the same commit as the change, and is struck out
once delivered: a restart sends what was not. So a subscriber may be told twice, never not at all. Memory
holds a window of what is owed; the rest waits on disk.
"""

import asyncio
import random
import time
from collections import deque
from collections.abc import Iterable
from dataclasses import KW_ONLY, dataclass
from datetime import UTC, datetime
from typing import Final
from uuid import uuid4

import orjson
from prometheus_client import Counter, Gauge

from handover.telemetry import get_logger
from services.context_broker.commits import Commits
from services.context_broker.destinations import Destinations
from services.context_broker.entity import Entity, Event
from services.context_broker.http_sender import HttpSender, SendError
from services.context_broker.journal import Entries, Journal, Kind, Notice, NotStored
from services.context_broker.leadership import Leadership
from services.context_broker.rendering import rendered, with_context
from services.context_broker.store import Store
from services.context_broker.subscriptions import JSON_LD, Subscription
from services.context_broker.words import timestamp, timestamp_now

log = get_logger(__name__)

WINDOW: Final = 256
"""Notifications owed to one subscription that are held in memory."""
FIRST_RETRY_S: Final = 0.1
LAST_RETRY_S: Final = 15.0
_TRY_AGAIN: Final = frozenset({408, 425, 429})
"""Refusals that are about the moment, not about the notification."""

SENT = Counter("handover_broker_notifications_sent_total", "Notifications delivered")
FAILED = Counter("handover_broker_notifications_failed_total", "Attempts to notify that failed")
GIVEN_UP = Counter("handover_broker_notifications_given_up_total", "Notifications given up", ["reason"])
WAITING = Gauge("handover_broker_notifications_waiting", "Notifications held in memory to be sent")


class Courier:
    """Delivers the notifications of one subscription, one after the other."""

    def __init__(self, subscription: Subscription, notifier: "Notifier") -> None:
        self.subscription = subscription
        self._notifier = notifier
        self._queue: deque[Notice] = deque()
        self._throttled: dict[str, list[int]] = {}
        self._last_sent_s = float("-inf")
        self._more_on_disk = False
        self._loading = False
        self._last_seq = 0
        self._something_new = asyncio.Event()
        self._task: asyncio.Task[None] | None = None

    def start(self, *, from_disk: bool) -> None:
        """Begin; `from_disk` also takes what is owed since before."""
        self._more_on_disk = from_disk
        if from_disk:
            self._wake()

    def add(self, notice: Notice) -> None:
        """Take what is owed; it is in the outbox already."""
        if self._loading or self._more_on_disk or len(self._queue) >= WINDOW:
            self._more_on_disk = True
        else:
            self._take(notice)
        self._wake()

    def stop(self) -> None:
        """End at once; what is owed stays in the outbox."""
        if self._task is not None:
            self._task.cancel()
        WAITING.dec(len(self._queue))
        self._queue.clear()

    def leave(self) -> None:
        """Leave all that is owed to another broker."""
        self.stop()
        self._task = None
        self._throttled.clear()
        self._last_seq = 0

    def change(self, subscription: Subscription) -> None:
        """Go on with a changed subscription, at once even if a retry was due later."""
        self.subscription = subscription
        self._something_new.set()

    def _take(self, notice: Notice) -> None:
        self._last_seq = notice.seq
        if notice.body is None:
            self._throttled.setdefault(notice.entity, []).append(notice.seq)
        else:
            self._queue.append(notice)
            WAITING.inc()

    def _wake(self) -> None:
        self._something_new.set()
        if self._task is None or self._task.done():
            self._task = asyncio.get_running_loop().create_task(self._work())
            self._task.add_done_callback(self._on_end)

    def _on_end(self, task: asyncio.Task[None]) -> None:
        """Tell of an end that nobody wanted; what is owed is in the outbox and is sent after a restart."""
        if not task.cancelled() and (error := task.exception()) is not None:
            log.error("courier failed", subscription=self.subscription.id, exc_info=error)

    async def _work(self) -> None:
        """Deliver until nothing is owed; a new notice starts it again."""
        while True:
            if not self._queue and self._more_on_disk:
                await self._load()
            if self._queue:
                await self._deliver(self._queue[0])
                self._queue.popleft()
                WAITING.dec()
            elif self._throttled:
                await self._wait(self._throttle_left_s())
                if self._throttle_left_s() <= 0:
                    await self._tell_throttled()
            elif not self._more_on_disk:
                return

    async def _load(self) -> None:
        outbound = self._notifier.outbound
        self._loading, self._more_on_disk = True, False
        try:
            found = await asyncio.to_thread(
                outbound.journal.owed, self._notifier.tenant, self.subscription.id, self._last_seq, WINDOW
            )
        except NotStored as error:
            log.warning("what is owed cannot be read", subscription=self.subscription.id, error=str(error))
            found = []
            self._more_on_disk = True
            await self._wait(FIRST_RETRY_S)
        finally:
            self._loading = False
        for notice in found:
            self._take(notice)
        self._more_on_disk = self._more_on_disk or len(found) == WINDOW

    async def _deliver(self, notice: Notice) -> None:
        assert notice.body is not None  # noqa: S101 - those without one wait apart
        await self._send(notice.body, notice.at)
        self._notifier.settle(self.subscription, [notice.seq])

    async def _tell_throttled(self) -> None:
        """Tell in one notification how all that changed while throttled is now."""
        throttled, self._throttled = self._throttled, {}
        now_s = time.time()
        entities = [entity for one in throttled if (entity := self._notifier.store.get(one)) is not None]
        wanted = [entity for entity in entities if self.subscription.query.wants(entity)]
        if wanted:
            await self._send(notification(self.subscription, wanted), now_s)
        self._notifier.settle(self.subscription, [seq for seqs in throttled.values() for seq in seqs])

    def _throttle_left_s(self) -> float:
        return self._last_sent_s + self.subscription.throttling_s - time.monotonic()

    async def _send(self, body: bytes, at: float) -> None:
        """Send until it is delivered, refused for good, or too old."""
        retry_s = FIRST_RETRY_S
        while True:
            why, again = await self._attempt(body)
            if why is None:
                self._last_sent_s = time.monotonic()
                return
            if not again or time.time() - at > self._notifier.outbound.keep_s:
                GIVEN_UP.labels("too old" if again else "refused").inc()
                log.warning("notification given up", subscription=self.subscription.id, why=why)
                return
            await self._wait(retry_s * random.uniform(0.8, 1.2))  # noqa: S311 - jitter
            retry_s = min(2 * retry_s, LAST_RETRY_S)

    async def _attempt(self, body: bytes) -> tuple[str | None, bool]:
        """Send once; return why it failed (None if it did not) and whether trying again may help."""
        subscription, endpoint = self.subscription, self.subscription.endpoint
        counts, outbound = subscription.counts, self._notifier.outbound
        try:
            status = await outbound.sender.post(
                endpoint.uri,
                headers(subscription, self._notifier.tenant),
                body,
                endpoint.timeout_s or outbound.timeout_s,
            )
            why = None if 200 <= status < 300 else f"{endpoint.uri} answers {status}"
            again = status >= 500 or status in _TRY_AGAIN
        except SendError as error:
            why, again = f"{endpoint.uri}: {error}", True
        at = timestamp_now()
        counts.last_notification = at
        if why is None:
            counts.sent += 1
            counts.last_success = at
            SENT.inc()
        else:
            counts.failed += 1
            counts.last_failure = at
            FAILED.inc()
            log.info("notification failed", subscription=subscription.id, why=why)
        return why, again

    async def _wait(self, seconds: float) -> None:
        """Wait, or less if the subscription was changed."""
        if seconds <= 0:
            return
        before = self.subscription
        deadline_s = time.monotonic() + seconds
        while self.subscription is before and (left_s := deadline_s - time.monotonic()) > 0:
            self._something_new.clear()
            try:
                async with asyncio.timeout(left_s):
                    await self._something_new.wait()
            except TimeoutError:
                return


@dataclass(frozen=True, slots=True)
class Outbound:
    """What the notifiers of all tenants share: the outbox, the way out, and the numbers of notices."""

    journal: Journal
    sender: HttpSender
    destinations: Destinations
    leadership: Leadership
    _: KW_ONLY
    timeout_s: float
    keep_s: float


class Notifier:
    """Knows all subscriptions of a tenant, tells what a change owes them, and has it delivered."""

    def __init__(self, tenant: str, commits: Commits, outbound: Outbound) -> None:
        self.tenant = tenant
        self.outbound = outbound
        self.store: Store
        self._commits = commits
        self._couriers: dict[str, Courier] = {}
        self._by_type: dict[str | None, list[Subscription]] = {}

    def start(self, subscriptions: Iterable[Subscription]) -> None:
        """Begin with the subscriptions of before; what is owed to them is sent now."""
        for subscription in subscriptions:
            self.put(subscription, from_disk=True)

    def stop(self) -> None:
        """End; what is owed stays in the outbox."""
        for courier in self._couriers.values():
            courier.stop()

    def put(self, subscription: Subscription, *, from_disk: bool = False) -> None:
        """Heed a new or a changed subscription from now on."""
        courier = self._couriers.get(subscription.id)
        if courier is None:
            courier = self._couriers[subscription.id] = Courier(subscription, self)
            if self.outbound.leadership.leads:
                courier.start(from_disk=from_disk)
        else:
            subscription.counts = courier.subscription.counts
            courier.change(subscription)
        self._sort()

    def remove(self, subscription_id: str) -> None:
        """Forget a subscription and what is owed to it."""
        self._couriers.pop(subscription_id).stop()
        self._sort()

    def get(self, subscription_id: str) -> Subscription | None:
        """Return a subscription."""
        courier = self._couriers.get(subscription_id)
        return None if courier is None else courier.subscription

    def all(self) -> list[Subscription]:
        """Return all subscriptions in a stable order."""
        return [courier.subscription for courier in self._couriers.values()]

    def announce(self, event: Event) -> list[Notice]:
        """Return the notifications that a change owes; the entity's end owes none."""
        after, touched = event.after, event.written
        if after is None or not touched:
            return []
        now_s = time.time()
        interested = list(self._by_type.get(None, ()))
        for kind in after.types:
            interested += self._by_type.get(kind, ())
        if len(after.types) > 1:
            interested = list(dict.fromkeys(interested))
        return [self._notice(one, after, now_s) for one in interested if one.wants(after, touched, now_s)]

    def deliver(self, notices: list[Notice]) -> None:
        """Hand notifications whose change is committed to their couriers, if this broker is to notify."""
        if not self.outbound.leadership.leads:
            return
        for notice in notices:
            courier = self._couriers.get(notice.subscription)
            if courier is not None:
                courier.add(notice)

    def owed_by_others(self, subscription_id: str) -> None:
        """Look into the outbox: another broker has put something there."""
        courier = self._couriers.get(subscription_id)
        if courier is not None and self.outbound.leadership.leads:
            courier.start(from_disk=True)

    def turn(self, *, leads: bool) -> None:
        """Begin with all that is owed, or leave it to another broker."""
        for courier in self._couriers.values():
            if leads:
                courier.start(from_disk=True)
            else:
                courier.leave()

    def settle(self, subscription: Subscription, seqs: list[int]) -> None:
        """Strike out what was delivered and write the counts, in passing: with the next commit."""
        counts = subscription.counts
        told = [
            counts.sent,
            counts.failed,
            counts.last_notification,
            counts.last_success,
            counts.last_failure,
        ]
        key = (Kind.COUNTS, self.tenant, subscription.id)
        self._commits.store_later(Entries(settled=seqs, documents={key: orjson.dumps(told)}))

    def _notice(self, subscription: Subscription, entity: Entity, now_s: float) -> Notice:
        body = None if subscription.throttling_s else notification(subscription, [entity])
        return Notice(self.tenant, subscription.id, entity.id, now_s, body)

    def _sort(self) -> None:
        """Sort the subscriptions by the types they want, so that a change looks at few."""
        self._by_type = {}
        for subscription in self.all():
            kinds: set[str | None] = set()
            for selector in subscription.selectors:
                kinds.update(selector.types or (None,))
            for kind in {None} if None in kinds or not kinds else kinds:
                self._by_type.setdefault(kind, []).append(subscription)


def notification(subscription: Subscription, entities: Iterable[Entity]) -> bytes:
    """Return the notification (clause 5.3.1) that tells how `entities` are."""
    now = datetime.now(UTC)
    head: dict[str, str] = {
        "id": f"urn:ngsi-ld:Notification:{uuid4()}",
        "type": "Notification",
        "subscriptionId": subscription.id,
        "notifiedAt": timestamp(now),
    }
    data = b",".join(rendered(entity, subscription.context, subscription.view) for entity in entities)
    body = orjson.dumps(head)[:-1] + b',"data":[' + data + b"]}"
    return with_context(body, subscription.context) if subscription.endpoint.accept == JSON_LD else body


def headers(subscription: Subscription, tenant: str) -> list[tuple[str, str]]:
    """Return the headers of a notification."""
    endpoint = subscription.endpoint
    result = [("Content-Type", endpoint.accept)]
    if tenant:
        result.append(("NGSILD-Tenant", tenant))
    if endpoint.accept != JSON_LD and subscription.context.link:
        result.append(("Link", link(subscription.context.link)))
    return [*result, *endpoint.headers]


def link(url: str) -> str:
    """Return the Link header that names an @context."""
    return f'<{url}>; rel="http://www.w3.org/ns/json-ld#context"; type="application/ld+json"'
