"""Streams: the requests that are being passed on to services, and how many there may be.

A request whose body is still being sent is an upload; any other one reads. Each kind has a limit for a client
and for a service. Where it is reached the oldest gives way, so requests that never end keep nobody out; those
that are young are let be, and the newcomer is refused.
"""

import asyncio
from dataclasses import dataclass
from typing import Any, Final

from handover.errors import Problem
from webui.metrics import ENDED, REFUSED, STREAMS

MIN_AGE_TO_END_S: Final = 5.0


@dataclass(frozen=True, slots=True)
class Limits:
    """How many streams of a kind there may be."""

    per_client: int
    per_service: int


UPLOADS: Final = Limits(per_client=16, per_service=64)
"""Fewer than the unfinished requests that a service takes from one address, which is ours."""
READS: Final = Limits(per_client=128, per_service=256)


@dataclass(eq=False, slots=True)
class Stream:
    """A request that is being passed on, by `task`."""

    client: str
    service: str
    limits: Limits
    task: asyncio.Task[Any] | None
    since_s: float
    is_ended: bool = False


class Streams:
    """All streams of this server."""

    def __init__(self) -> None:
        self._open: set[Stream] = set()

    def admit(self, client: str, service: str, limits: Limits) -> Stream:
        """Take note of a request of this task; raise `Problem` 429 or 503 when there are too many."""
        now_s = asyncio.get_running_loop().time()
        alike = [one for one in self._open if one.limits is limits and not one.is_ended]
        of_client = [one for one in alike if one.client == client]
        of_service = [one for one in alike if one.service == service]
        if len(of_client) >= limits.per_client and not _end_oldest(of_client, now_s):
            REFUSED.labels("client").inc()
            raise Problem(
                429,
                "Too many requests",
                f"{len(of_client)} requests of {client} are under way; wait for some to end",
            )
        if len(of_service) >= limits.per_service and not _end_oldest(of_service, now_s):
            REFUSED.labels("service").inc()
            raise Problem(
                503,
                "Too many requests",
                f"{len(of_service)} requests to {service} are under way; try again in a moment",
            )
        stream = Stream(client, service, limits, asyncio.current_task(), now_s)
        self._open.add(stream)
        STREAMS.set(len(self._open))
        return stream

    def leave(self, stream: Stream) -> None:
        """Take note that a request has come to its end."""
        self._open.discard(stream)
        STREAMS.set(len(self._open))


def _end_oldest(streams: list[Stream], now_s: float) -> bool:
    """End the oldest of `streams`, if it is old enough; say whether it was."""
    oldest = min(streams, key=lambda one: one.since_s)
    if oldest.task is None or now_s - oldest.since_s < MIN_AGE_TO_END_S:
        return False
    oldest.is_ended = True
    oldest.task.cancel()
    ENDED.inc()
    return True
