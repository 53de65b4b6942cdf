"""Periodic subscriptions (`timeInterval`): all their entities are sent in intervals, changed or not."""

import asyncio
import time
from collections.abc import Awaitable, Callable

from handover.telemetry import get_logger
from handover_broker.delivery.subscription import Subscription
from handover_broker.model.validation import moment

log = get_logger(__name__)

Notify = Callable[[Subscription], Awaitable[None]]
"""Sends the present state of all entities of a subscription."""


class PeriodicNotifications:
    """The timers of the periodic subscriptions of one tenant."""

    def __init__(self, notify: Notify) -> None:
        self._notify = notify
        self._tasks: dict[str, tuple[Subscription, asyncio.Task[None]]] = {}

    def schedule(self, subscriptions: list[Subscription]) -> None:
        """Run timers for exactly these subscriptions from now on."""
        wanted = {candidate.id: candidate for candidate in subscriptions if candidate.interval_s is not None}
        for subscription_id in [
            subscription_id
            for subscription_id, (scheduled, _) in self._tasks.items()
            if wanted.get(subscription_id) is not scheduled
        ]:
            _, task = self._tasks.pop(subscription_id)
            task.cancel()
        loop = asyncio.get_running_loop() if wanted else None
        for subscription_id, subscription in wanted.items():
            if subscription_id not in self._tasks and loop is not None:
                self._tasks[subscription_id] = (subscription, loop.create_task(self._run(subscription)))

    def is_affected(self, changed: str | None, now: Subscription | None) -> bool:
        """Return whether the timers have to change with a subscription, which is `now` so; always without
        an id."""
        return changed is None or changed in self._tasks or (now is not None and now.interval_s is not None)

    def stop(self) -> None:
        """Cancel all timers."""
        self.schedule([])

    async def _run(self, subscription: Subscription) -> None:
        assert subscription.interval_s is not None  # noqa: S101 - only those come here
        due_s = first_due_s(subscription, time.time())
        while True:
            await asyncio.sleep(max(0.0, due_s - time.time()))
            now_s = time.time()
            due_s = max(due_s + subscription.interval_s, now_s)
            if not subscription.is_active(now_s):
                continue
            try:
                await self._notify(subscription)
            except Exception:  # the next interval tries again
                log.exception("periodic notification failed", subscription=subscription.id)


def first_due_s(subscription: Subscription, now_s: float) -> float:
    """Return when (seconds since 1970) a subscription is due first: one interval after its last notification.

    Intervals that were missed while the broker was down are made up for by one notification, at once.
    """
    assert subscription.interval_s is not None  # noqa: S101 - only those come here
    began = subscription.counts.last_notification or subscription.document.get("createdAt", "")
    began_s = moment(began) or now_s
    return min(max(began_s + subscription.interval_s, now_s), now_s + subscription.interval_s)
