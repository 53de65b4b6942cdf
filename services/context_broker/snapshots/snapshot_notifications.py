"""Who wants to know how a snapshot is, is told when it is made, changed or gone (5.3.4 and 5.16.6).

What is to be told is written in the same commit as what it tells of, and struck out once it is told: a
restart tells what was not. So an endpoint may be told twice, never not at all.
"""

import asyncio
import time
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final
from uuid import uuid4

import orjson

from handover.retry import Backoff
from handover.telemetry import get_logger
from services.context_broker.delivery.delivery_worker import DROPPED
from services.context_broker.model.validation import tenant_headers, timestamp_now
from services.context_broker.network.http_client import SendError
from services.context_broker.snapshots.snapshot import Snapshot
from services.context_broker.storage.entries import DocumentKey, Entries, Kind

if TYPE_CHECKING:
    from services.context_broker.tenants import Tenants

log = get_logger(__name__)

INITIAL_BACKOFF_S: Final = 0.5
MAX_BACKOFF_S: Final = 60.0
MAX_PENDING: Final = 1000
"""Notifications that wait for one endpoint; the oldest are given up for newer ones."""
_TOLD_AS: Final = (
    ("snapshotQueriesDetails", "snapshotQueriesDetails"),
    ("temporalSnapshotQueriesDetails", "snapshotTemporalQueriesDetails"),
)
"""Members of a notification, and what they are called in a snapshot (table 5.3.4-1)."""


@dataclass(frozen=True, slots=True)
class SnapshotNotification:
    """One notification that is owed; `at` is when it came to be, in seconds since 1970."""

    tenant: str
    id: str
    endpoint: str
    headers: tuple[tuple[str, str], ...]
    body: bytes
    at: float

    @property
    def key(self) -> DocumentKey:
        """Return what it is kept under."""
        return Kind.SNAPSHOT_NOTIFICATION, self.tenant, self.id

    def stored(self) -> bytes:
        """Return it as the journal keeps it."""
        return orjson.dumps([self.endpoint, self.headers, self.body.decode(), self.at])


def restored(tenant: str, notification_id: str, stored: bytes) -> SnapshotNotification:
    """Return the notification that `stored` had been."""
    endpoint, headers, body, at = orjson.loads(stored)
    return SnapshotNotification(
        tenant, notification_id, endpoint, tuple((name, value) for name, value in headers), body.encode(), at
    )


def notification_of(tenant: str, one: Snapshot) -> SnapshotNotification | None:
    """Return the notification that tells how a snapshot is, None if nobody wants it.

    Of one that is gone, expiresAt is past.
    """
    document = one.document
    if document.get("endpoint") is None:
        return None
    notification_id = f"urn:ngsi-ld:SnapshotNotification:{uuid4()}"
    body: dict[str, Any] = {
        "id": notification_id,
        "type": "SnapshotNotification",
        "notifiedAt": timestamp_now(),
        "snapshotId": one.id,
        **{name: document[name] for name in ("snapshotPriority", "snapshotStatus", "expiresAt")},
        **{name: document[source] for name, source in _TOLD_AS if source in document},
    }
    headers = [("Content-Type", "application/json"), *tenant_headers(tenant)]
    headers += [(pair["key"], pair["value"]) for pair in document.get("receiverInfo") or ()]
    return SnapshotNotification(
        tenant, notification_id, document["endpoint"], tuple(headers), orjson.dumps(body), time.time()
    )


class SnapshotNotifier:
    """All that is to be told of snapshots: to each endpoint one after the other."""

    def __init__(self, tenants: "Tenants") -> None:
        self._tenants = tenants
        self._waiting: dict[str, deque[SnapshotNotification]] = {}
        self._tasks: dict[str, asyncio.Task[None]] = {}

    def add(self, one: SnapshotNotification) -> None:
        """Take what is to be told; it is on disk already."""
        waiting = self._waiting.setdefault(one.endpoint, deque())
        waiting.append(one)
        while len(waiting) > MAX_PENDING:
            self._fail(waiting.popleft(), "too many")
        self._ensure_running_worker(one.endpoint)

    def stop(self) -> None:
        """End; what is owed stays on disk."""
        for task in self._tasks.values():
            task.cancel()
        self._tasks.clear()

    def _ensure_running_worker(self, endpoint: str) -> None:
        if endpoint not in self._tasks:
            task = self._tasks[endpoint] = asyncio.get_running_loop().create_task(self._work(endpoint))
            task.add_done_callback(lambda done: self._on_end(endpoint, done))

    def _on_end(self, endpoint: str, task: asyncio.Task[None]) -> None:
        if self._tasks.get(endpoint) is task:
            del self._tasks[endpoint]
        if not task.cancelled() and (error := task.exception()) is not None:
            log.error("telling of snapshots failed", endpoint=endpoint, exc_info=error)

    async def _work(self, endpoint: str) -> None:
        waiting, backoff = self._waiting[endpoint], Backoff(INITIAL_BACKOFF_S, MAX_BACKOFF_S)
        while waiting:
            one = waiting[0]
            status = await self._send(one)
            if status is None or status >= 500:
                if time.time() - one.at <= self._tenants.outbound.keep_s:
                    await backoff.wait()
                    continue
                self._fail(one, "too old")
            elif status >= 300:
                self._fail(one, "refused")
            else:
                backoff.reset()
                self._delete(one)
            if waiting and waiting[0] is one:
                waiting.popleft()
        del self._waiting[endpoint]

    async def _send(self, one: SnapshotNotification) -> int | None:
        """Return what the endpoint answers, None if it does not."""
        outbound = self._tenants.outbound
        try:
            return await outbound.sender.post(one.endpoint, one.headers, one.body, outbound.timeout_s)
        except SendError as error:
            log.info("a snapshot cannot be told of", endpoint=one.endpoint, error=str(error))
            return None

    def _fail(self, one: SnapshotNotification, why: str) -> None:
        DROPPED.labels(why).inc()
        log.warning("nobody was told of a snapshot", endpoint=one.endpoint, why=why)
        self._delete(one)

    def _delete(self, one: SnapshotNotification) -> None:
        self._tenants.commits_of(one.tenant).store_later(Entries(documents={one.key: None}))
