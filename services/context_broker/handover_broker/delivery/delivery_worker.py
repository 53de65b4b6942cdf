"""A delivery worker sends the notifications of one subscription, one after the other, in order.

A pending notification is in the outbox, written in the same commit as its change, and is deleted once
delivered. After a restart the rest is sent: a notification may arrive twice, and is never lost. Memory holds
a window of the pending notifications; the others wait on disk.
"""

import asyncio
import time
from collections import deque
from collections.abc import Iterable, Mapping
from typing import Final

from prometheus_client import Counter

from handover.telemetry import get_logger
from handover_broker.delivery.attempt import DeliveryContext, attempt
from handover_broker.delivery.backlog import Backlog
from handover_broker.delivery.combining import first_together
from handover_broker.delivery.disclosure import Unverified
from handover_broker.delivery.endpoint_queue import (
    INITIAL_BACKOFF_S,
    SHED,
    WINDOW,
    EndpointQueue,
    backoff_s,
)
from handover_broker.delivery.subscription import Subscription
from handover_broker.model.validation import timestamp_now
from handover_broker.storage.entries import PendingNotification
from handover_broker.storage.journal import NotStored

log = get_logger(__name__)

RIGHTS_RETRY_S: Final = 2.0
"""Pause before the rights of an owner are verified again."""

RETRIES: Final = Counter("handover_broker_notification_retries_total", "Attempts after one that failed")
DROPPED: Final = Counter(
    "handover_broker_notifications_dropped_total", "Notifications that were dropped", ["reason"]
)


class DeliveryWorker:
    """Sends the notifications of one subscription."""

    def __init__(self, subscription: Subscription, context: DeliveryContext) -> None:
        self.subscription = subscription
        self.pending = 0
        self.pending_bytes = 0
        self._context = context
        self._endpoint_queue = context.endpoint_queue(subscription)
        self._backlog = Backlog(context.journal, context.tenant, subscription.id)
        self._endpoint_queue.join(self)
        self._queue: deque[PendingNotification] = deque()
        self._throttled: dict[str, PendingNotification] = {}
        self._periodic: deque[PendingNotification] = deque()
        self._last_sent_s = float("-inf")
        self._failures = 0
        self._backoff_until_s = 0.0
        self._has_more_on_disk = False
        self._is_loading = False
        self._last_seq = 0
        self._sending: list[PendingNotification] = []
        """The notifications of the message that is sent, or is to be sent again."""
        self._is_sending = False
        self._was_tried = False
        self._is_uncounted = False
        self._is_unverified = False
        self._something_new = asyncio.Event()
        self._task: asyncio.Task[None] | None = None

    @property
    def on_disk(self) -> int:
        """How many notifications are on disk only."""
        return max(0, self.pending - len(self._queue) - len(self._throttled))

    @property
    def held(self) -> int:
        """How many notifications are in memory, ready to be sent."""
        return len(self._queue)

    @property
    def throttled(self) -> int:
        """How many entities wait for the end of their throttling."""
        return len(self._throttled)

    def start(self) -> None:
        """Load the notifications that are in the outbox already."""
        self._has_more_on_disk = self._is_uncounted = True
        if not self.pending:
            self._count_pending(
                1, 1
            )  # at least one, as a placeholder; the number is known after the first page
        self._ensure_running()

    def add(self, notice: PendingNotification) -> None:
        """Accept a notification that is in the outbox already."""
        self._count_pending(1, notice.size)
        if notice.seq <= self._last_seq:
            return  # it was loaded from the outbox meanwhile
        if self._is_loading or self._has_more_on_disk or self._endpoint_queue.room <= 0:
            self._has_more_on_disk = True
            if not self._endpoint_queue.is_shedding and self._endpoint_queue.has_too_much:
                self._start_shedding()
        else:
            self._enqueue(notice)
        self._ensure_running()

    def offer(self, notices: Iterable[PendingNotification]) -> None:
        """Accept the notifications of a period; those left of the period before are dropped."""
        if self._periodic:
            self._count_dropped("outdated", "the next period has begun", len(self._periodic))
        self._periodic = deque(notices)
        self._ensure_running()

    def stop(self) -> None:
        """Stop at once; pending notifications stay in the outbox until the next start."""
        if self._task is not None:
            self._task.cancel()
            self._task = None
        for notice in self._queue:
            self._endpoint_queue.release(notice.size)
        self._queue.clear()
        self._throttled.clear()
        self._periodic.clear()
        self._has_more_on_disk = False
        self._last_seq = 0
        self._count_pending(-self.pending, -self.pending_bytes)
        self._endpoint_queue.leave(self)

    def end(self) -> None:
        """Stop because the subscription was deleted."""
        self.stop()
        self._endpoint_queue.part(self)

    def change(self, subscription: Subscription) -> None:
        """Continue with a changed subscription, at once even if a retry was due later."""
        self.subscription = subscription
        endpoint_queue = self._context.endpoint_queue(subscription)
        if endpoint_queue is not self._endpoint_queue:
            for notice in self._queue:
                self._endpoint_queue.release(notice.size)
                endpoint_queue.take(notice.size)
            self._endpoint_queue.part(self)
            self._endpoint_queue = endpoint_queue
            endpoint_queue.join(self)
        self._endpoint_queue.leave(self)
        self._failures, self._backoff_until_s = 0, 0.0
        self.wake()
        if self.pending:
            self._ensure_running()

    def wake(self) -> None:
        """Check again whether there is something to do."""
        self._something_new.set()

    def _enqueue(self, notice: PendingNotification) -> None:
        self._last_seq = notice.seq
        if notice.waits_for_throttling:
            earlier = self._throttled.pop(
                notice.entity, None
            )  # throttled entities are sent in the order of their last change
            self._throttled[notice.entity] = notice
            if earlier is not None:  # the newer one contains this change
                self._settle([earlier])
        else:
            self._queue.append(notice)
            self._endpoint_queue.take(notice.size)

    def _count_pending(self, many: int, size: int) -> None:
        self.pending += many
        self.pending_bytes += size
        self._endpoint_queue.pending_bytes += size

    def _settle(self, notices: Iterable[PendingNotification]) -> None:
        """Record that notifications are not pending any more."""
        seqs = []
        for notice in notices:
            seqs.append(notice.seq)
            self._count_pending(-1, -notice.size)
        self._context.settle(self.subscription, seqs)

    def _ensure_running(self) -> None:
        if self._task is None or self._task.done():
            self._task = asyncio.get_running_loop().create_task(self._work())
            self._task.add_done_callback(self._on_end)

    def _on_end(self, task: asyncio.Task[None]) -> None:
        """Log an unexpected end; pending notifications are in the outbox and are sent after a restart."""
        if not task.cancelled() and (error := task.exception()) is not None:
            log.error("delivery worker failed", subscription=self.subscription.id, exc_info=error)

    async def _work(self) -> None:
        """Deliver until nothing is pending or nothing may be sent; a notification or a change starts it
        again."""
        try:
            while self._queue or self._throttled or self._has_more_on_disk or self._periodic:
                status = self.subscription.status(time.time())
                if status == "paused":
                    return
                if status == "expired":
                    await self._drop_all()
                else:
                    await self._work_on()
            self._count_pending(-self.pending, -self.pending_bytes)
        finally:
            self._endpoint_queue.leave(self)

    async def _work_on(self) -> None:
        """Do the next step."""
        if self._queue:
            await self._deliver(self._queue[0])
        elif self._has_more_on_disk:
            await self._load()
        elif self._periodic:
            await self._send_periodic(self._periodic[0])
        elif (left_s := self._last_sent_s + self.subscription.throttling_s - time.monotonic()) > 0:
            await self._pause(left_s)
        else:
            await self._send_throttled()

    async def _deliver(self, notice: PendingNotification) -> None:
        """Try to send the first notification of the queue, with those of the same request; they stay there
        until they are delivered or dropped."""
        if not (self._sending and self._sending[0] is notice):  # a retry has the same content
            self._sending = first_together(self._queue)
        some, self._is_sending = self._sending, True
        try:
            is_done = await self._send_released({pending.entity: pending for pending in some}, notice)
        finally:
            self._is_sending = False
        if is_done:
            self._sending = []
            sent: list[PendingNotification] = []
            for pending in some:  # those that were dropped, or moved with the subscription, are not first
                if self._queue and self._queue[0] is pending:
                    sent.append(self._queue.popleft())
                    self._endpoint_queue.release(pending.size)
            self._settle(sent)

    async def _send_periodic(self, notice: PendingNotification) -> None:
        """Try to send a notification of a period."""
        if await self._send_released({notice.entity: notice}, notice):
            if self._periodic and self._periodic[0] is notice:
                self._periodic.popleft()
            self._context.settle(self.subscription, ())

    async def _send_throttled(self) -> None:
        """Send one notification with the present state of everything that changed while throttled."""
        some = self._context.together(self._throttled)
        if await self._send_released(some, next(reversed(some.values()))):
            sent = [notice for entity_id, notice in some.items() if self._throttled.get(entity_id) is notice]
            for notice in sent:
                del self._throttled[notice.entity]
            self._settle(sent)

    async def _send_released(
        self, notices: Mapping[str, PendingNotification], latest: PendingNotification
    ) -> bool:
        """Send what the owner may see now, once; return whether it is finished.

        `latest` has the headers and the time of the message.
        """
        try:
            body = await self._context.release(self.subscription, notices)
        except Unverified as error:
            if time.time() - latest.at > self._context.keep_s:
                self._count_dropped("unverified", str(error), len(notices))
                return True
            if not self._is_unverified:
                log.warning("notifications wait", subscription=self.subscription.id, reason=str(error))
            self._is_unverified = True
            await self._pause(RIGHTS_RETRY_S)
            return False
        self._is_unverified = False
        if body is None:
            return True
        at = time.time() if latest.waits_for_throttling else latest.at
        return await self._send(body, latest.headers, at)

    async def _send(self, body: bytes, taken: bytes | None, at: float) -> bool:
        """Send when it is due, once; return whether it is finished: delivered, refused or too old."""
        before, endpoint_queue = self.subscription, self._endpoint_queue
        is_too_old = time.time() - at > self._context.keep_s
        if endpoint_queue.failures or self._failures:
            if is_too_old:
                self.subscription.counts.failed += not self._was_tried
                self._was_tried = False
                self._count_dropped("too old", "it could not be delivered in time")
                return True
            rest_left_s = self._backoff_until_s - time.monotonic()
            wait_s = rest_left_s if rest_left_s > 0 else endpoint_queue.wait_s(self)
            if wait_s != 0:
                await self._pause(wait_s)
                return False
            RETRIES.inc()
        is_first, self._was_tried = not self._was_tried, True
        started_s = time.monotonic()
        result = await attempt(self._context, before, body, taken, is_first=is_first)
        self._was_tried = result.why is not None and result.again
        if result.why is None:
            self._last_sent_s = time.monotonic()
            self._failures = 0
            endpoint_queue.succeeded()
            return True
        if not result.again:
            endpoint_queue.succeeded()  # the endpoint answered, so others may be sent
            self._count_dropped("refused", result.why)
            return True
        cooldown_s = before.endpoint.cooldown_s
        if self.subscription is before:
            self._failures += 1
            # The endpoint answers, so it may refuse this notification only: others are sent first.
            own_s = backoff_s(self._failures) if result.is_there and self._failures > 1 else 0.0
            self._backoff_until_s = time.monotonic() + max(own_s, cooldown_s)
        endpoint_queue.failed(self, started_s, cooldown_s)
        return False

    def _count_dropped(self, reason: str, why: str, many: int = 1) -> None:
        DROPPED.labels(reason).inc(many)
        log.warning("notifications dropped", subscription=self.subscription.id, why=why, many=many)

    async def _pause(self, seconds: float | None) -> None:
        """Wait until there is something new, at most so many seconds (None: without limit)."""
        self._something_new.clear()
        try:
            async with asyncio.timeout(seconds):
                await self._something_new.wait()
        except TimeoutError:
            return

    # Notifications on disk

    async def _load(self) -> None:
        self._is_loading, self._has_more_on_disk = True, False
        sharing = sum(1 for worker in self._endpoint_queue.workers if worker.pending_bytes)
        limit = max(1, min(WINDOW // max(1, sharing), self._endpoint_queue.room))
        try:
            page = await self._backlog.page(self._last_seq, limit, count=self._is_uncounted)
        except NotStored as error:
            self._has_more_on_disk = True
            await self._wait_after_read_error(error)
            return
        finally:
            self._is_loading = False
        if page.pending is not None:
            self._count_pending(page.pending[0] - self.pending, page.pending[1] - self.pending_bytes)
            self._is_uncounted = False
        for notice in page.notices:
            self._enqueue(notice)
        self._has_more_on_disk = self._has_more_on_disk or page.has_more

    async def _wait_after_read_error(self, error: NotStored) -> None:
        log.warning(
            "pending notifications cannot be read", subscription=self.subscription.id, error=str(error)
        )
        await self._pause(INITIAL_BACKOFF_S)

    def _start_shedding(self) -> None:
        """Start to drop notifications of the endpoint in the background."""
        self._endpoint_queue.is_shedding = True
        task = asyncio.get_running_loop().create_task(self._shed(self._endpoint_queue))
        task.add_done_callback(self._on_end)

    async def _shed(self, endpoint_queue: EndpointQueue) -> None:
        """Drop the oldest notifications of the largest subscription until the endpoint is within its
        limit."""
        try:
            while endpoint_queue.has_too_much:
                most = max(endpoint_queue.workers, key=lambda worker: worker.pending_bytes)
                assert isinstance(most, DeliveryWorker)  # noqa: S101 - only workers are put there
                wanted_bytes = endpoint_queue.pending_bytes - int(
                    endpoint_queue.max_pending_bytes * (1 - SHED)
                )
                if not await most._drop_oldest(
                    wanted_bytes,
                    "too many",
                    "more notifications are pending for the endpoint than is allowed",
                ):
                    return
        finally:
            endpoint_queue.is_shedding = False

    async def _drop_all(self) -> None:
        """Drop everything: the subscription has expired."""
        self._endpoint_queue.leave(self)
        self._periodic.clear()
        self._has_more_on_disk = False
        if await self._drop_oldest(None, "expired", "the subscription has expired") is None:
            self._has_more_on_disk = True

    async def _drop_oldest(self, wanted_bytes: int | None, reason: str, why: str) -> int | None:
        """Drop the oldest, so many bytes of them or all; return how many, None if none could be read."""
        dropped_count, left_bytes = 0, float("inf") if wanted_bytes is None else wanted_bytes
        try:
            async for page in self._backlog.sizes():
                gone: dict[int, int] = {}
                sending = {notice.seq for notice in self._sending} if self._is_sending else set()
                for seq, size in page:
                    if left_bytes > 0 and seq not in sending:
                        gone[seq] = size
                        left_bytes -= size
                self._remove(gone)
                dropped_count += len(gone)
                if left_bytes <= 0:
                    break
        except NotStored as error:
            await self._wait_after_read_error(error)
            return None
        finally:
            if dropped_count:
                self.subscription.counts.failed += dropped_count
                self.subscription.counts.last_failure = timestamp_now()
                self._count_dropped(reason, why, dropped_count)
            self._context.settle(self.subscription, ())
        return dropped_count

    def _remove(self, gone: Mapping[int, int]) -> None:
        """Remove notifications (number and size in bytes) from memory and from the outbox."""
        dropped = [notice for notice in self._queue if notice.seq in gone]
        if dropped and dropped[0] is self._queue[0]:
            self._was_tried = False
        for notice in dropped:
            self._endpoint_queue.release(notice.size)
        if dropped:
            self._queue = deque(notice for notice in self._queue if notice.seq not in gone)
        self._sending = [notice for notice in self._sending if notice.seq not in gone]
        for entity in [entity_id for entity_id, notice in self._throttled.items() if notice.seq in gone]:
            del self._throttled[entity]
        self._last_seq = max(self._last_seq, *gone) if gone else self._last_seq
        self._count_pending(-len(gone), -sum(gone.values()))
        self._context.settle(self.subscription, gone)
