"""Periodic subscriptions: told of all their entities every so often, whatever changed (`timeInterval`)."""

import asyncio
import time
from collections.abc import Awaitable, Callable

from handover.telemetry import get_logger
from services.context_broker.delivery.subscription import Subscription
from services.context_broker.model.validation import moment

log = get_logger(__name__)

Notify = Callable[[Subscription], Awaitable[None]]
"""Has a subscriber told how all its entities are now."""


class PeriodicNotifications:
    """The rounds of one tenant: when which subscription is to be told."""

    def __init__(self, tell: Notify) -> None:
        self._notify = tell
        self._tasks: dict[str, tuple[Subscription, asyncio.Task[None]]] = {}

    def schedule(self, subscriptions: list[Subscription]) -> None:
        """Go the rounds of these subscriptions, and of no others, from now on."""
        wanted = {one.id: one for one in subscriptions if one.interval_s is not None}
        for one in [one for one, (known, _) in self._tasks.items() if wanted.get(one) is not known]:
            _, task = self._tasks.pop(one)
            task.cancel()
        loop = asyncio.get_running_loop() if wanted else None
        for one, subscription in wanted.items():
            if one not in self._tasks and loop is not None:
                self._tasks[one] = (subscription, loop.create_task(self._go(subscription)))

    def is_affected(self, changed: str | None, now: Subscription | None) -> bool:
        """Say whether the rounds are others once a subscription is as it is `now`; or all are, without id."""
        return changed is None or changed in self._tasks or (now is not None and now.interval_s is not None)

    def stop(self) -> None:
        """Go no more rounds."""
        self.schedule([])

    async def _go(self, subscription: Subscription) -> None:
        assert subscription.interval_s is not None  # noqa: S101 - only those come here
        due_s = first_s(subscription, time.time())
        while True:
            await asyncio.sleep(max(0.0, due_s - time.time()))
            now_s = time.time()
            due_s = max(due_s + subscription.interval_s, now_s)
            if not subscription.is_active(now_s):
                continue
            try:
                await self._notify(subscription)
            except Exception:  # one that cannot be told now is told the next time
                log.exception("periodic notification failed", subscription=subscription.id)


def first_s(subscription: Subscription, now_s: float) -> float:
    """Return when (seconds since 1970) a subscription is due first: a period after it was told last, or made.

    What was missed while the broker was away is made up for once, at once.
    """
    assert subscription.interval_s is not None  # noqa: S101 - only those come here
    began = subscription.counts.last_notification or subscription.document.get("createdAt", "")
    began_s = moment(began) or now_s
    return min(max(began_s + subscription.interval_s, now_s), now_s + subscription.interval_s)
