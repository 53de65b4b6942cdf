"""Limits on the requests that are proxied at the same time.

A request whose body is still being received is an upload; all others are reads. Each kind has a limit per
client and per service. When a limit is reached, the oldest request is ended, so requests that never finish
cannot block others. If the oldest is younger than `MIN_EVICTION_AGE_S`, the new request is rejected instead.
"""

import asyncio
from dataclasses import dataclass
from typing import Any, Final

from handover.errors import Problem
from handover_web.metrics import ACTIVE_REQUESTS, EVICTED_REQUESTS, REJECTED_REQUESTS

MIN_EVICTION_AGE_S: Final = 5.0


@dataclass(frozen=True, slots=True)
class Limits:
    """The highest number of active requests of one kind."""

    per_client: int
    per_service: int


UPLOADS: Final = Limits(per_client=16, per_service=64)
"""Below the number of unfinished requests that a service accepts from one address, which is this server's."""
READS: Final = Limits(per_client=128, per_service=256)


@dataclass(eq=False, slots=True)
class ActiveRequest:
    """A request that `task` is proxying."""

    client: str
    service: str
    limits: Limits
    task: asyncio.Task[Any] | None
    since_s: float
    is_evicted: bool = False


class ActiveRequests:
    """All requests that this server is proxying."""

    def __init__(self) -> None:
        self._active: set[ActiveRequest] = set()

    def admit(self, client: str, service: str, limits: Limits) -> ActiveRequest:
        """Register a request of the current task; raise `Problem` 429 or 503 when a limit is reached."""
        now_s = asyncio.get_running_loop().time()
        same_kind = [active for active in self._active if active.limits is limits and not active.is_evicted]
        of_client = [active for active in same_kind if active.client == client]
        of_service = [active for active in same_kind if active.service == service]
        if len(of_client) >= limits.per_client and not _evict_oldest(of_client, now_s):
            REJECTED_REQUESTS.labels("client").inc()
            raise Problem(
                429,
                "Too many requests",
                f"{client} has {len(of_client)} active requests; wait until some of them have finished",
            )
        if len(of_service) >= limits.per_service and not _evict_oldest(of_service, now_s):
            REJECTED_REQUESTS.labels("service").inc()
            raise Problem(
                503,
                "Too many requests",
                f"{service} has {len(of_service)} active requests; try again in a moment",
            )
        request = ActiveRequest(client, service, limits, asyncio.current_task(), now_s)
        self._active.add(request)
        ACTIVE_REQUESTS.set(len(self._active))
        return request

    def release(self, request: ActiveRequest) -> None:
        """Unregister a request that has ended."""
        self._active.discard(request)
        ACTIVE_REQUESTS.set(len(self._active))


def _evict_oldest(requests: list[ActiveRequest], now_s: float) -> bool:
    """Cancel the oldest of `requests` if it is old enough; return whether it was."""
    oldest = min(requests, key=lambda request: request.since_s)
    if oldest.task is None or now_s - oldest.since_s < MIN_EVICTION_AGE_S:
        return False
    oldest.is_evicted = True
    oldest.task.cancel()
    EVICTED_REQUESTS.inc()
    return True
