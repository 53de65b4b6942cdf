"""Notifications of created, changed and deleted snapshots (clauses 5.3.4 and 5.16.6).

A notification is stored in the same commit as the change, and deleted once it is delivered; the next start
sends the remaining ones. So an endpoint may receive a notification twice, but none is lost. Each endpoint has
one worker, which sends in order and retries with exponential backoff.
"""

import asyncio
import time
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final
from uuid import uuid4

import orjson

from handover.network.http_client import SendError
from handover.runtime.retry import Backoff
from handover.telemetry import get_logger
from handover_broker.delivery.delivery_worker import DROPPED
from handover_broker.model.secrets import without_secrets
from handover_broker.model.validation import tenant_headers, timestamp_now
from handover_broker.storage.entries import DocumentKey, DocumentKind, Entries
from handover_federation.snapshots.snapshot import Snapshot

if TYPE_CHECKING:
    from handover_broker.tenants import Tenants

log = get_logger(__name__)

INITIAL_BACKOFF_S: Final = 0.5
MAX_BACKOFF_S: Final = 60.0
MAX_PENDING: Final = 1000
"""Pending notifications of one endpoint; beyond that the oldest are dropped."""
_DETAILS_MEMBERS: Final = (
    ("snapshotQueriesDetails", "snapshotQueriesDetails"),
    ("temporalSnapshotQueriesDetails", "snapshotTemporalQueriesDetails"),
)
"""Members of a notification with their names in a snapshot (table 5.3.4-1)."""


@dataclass(frozen=True, slots=True)
class SnapshotNotification:
    """One pending notification; `at` is its time of creation in seconds since 1970."""

    tenant: str
    id: str
    endpoint: str
    headers: tuple[tuple[str, str], ...]
    body: bytes
    at: float

    @property
    def key(self) -> DocumentKey:
        """Return the key of the stored document."""
        return DocumentKind.SNAPSHOT_NOTIFICATION, self.tenant, self.id

    def stored(self) -> bytes:
        """Return the document for the journal."""
        return orjson.dumps(
            {
                "endpoint": self.endpoint,
                "headers": self.headers,
                "body": self.body.decode(),
                "at": self.at,
            }
        )


def restored(tenant: str, notification_id: str, stored: bytes) -> SnapshotNotification:
    """Return the notification of a stored document."""
    fields = orjson.loads(stored)
    headers = tuple((name, value) for name, value in fields["headers"])
    return SnapshotNotification(
        tenant, notification_id, fields["endpoint"], headers, fields["body"].encode(), fields["at"]
    )


def notification_of(tenant: str, snapshot: Snapshot) -> SnapshotNotification | None:
    """Return the notification of a snapshot's state, None if it has no endpoint.

    For a deleted snapshot, expiresAt is in the past.
    """
    document = snapshot.document
    if document.get("endpoint") is None:
        return None
    notification_id = f"urn:ngsi-ld:SnapshotNotification:{uuid4()}"
    body: dict[str, Any] = {
        "id": notification_id,
        "type": "SnapshotNotification",
        "notifiedAt": timestamp_now(),
        "snapshotId": snapshot.id,
        **{name: document[name] for name in ("snapshotPriority", "snapshotStatus", "expiresAt")},
        **{name: document[source] for name, source in _DETAILS_MEMBERS if source in document},
    }
    headers = [("Content-Type", "application/json"), *tenant_headers(tenant)]
    headers += [(pair["key"], pair["value"]) for pair in document.get("receiverInfo") or ()]
    return SnapshotNotification(
        tenant, notification_id, document["endpoint"], tuple(headers), orjson.dumps(body), time.time()
    )


class SnapshotNotifier:
    """Delivers the notifications of snapshots, to each endpoint in order."""

    def __init__(self, tenants: "Tenants") -> None:
        self._tenants = tenants
        self._waiting: dict[str, deque[SnapshotNotification]] = {}
        self._tasks: dict[str, asyncio.Task[None]] = {}

    def add(self, notification: SnapshotNotification) -> None:
        """Add a notification that is already stored."""
        waiting = self._waiting.setdefault(notification.endpoint, deque())
        waiting.append(notification)
        while len(waiting) > MAX_PENDING:
            self._drop(waiting.popleft(), "too many")
        self._ensure_running_worker(notification.endpoint)

    def stop(self) -> None:
        """Stop; pending notifications stay stored."""
        for task in self._tasks.values():
            task.cancel()
        self._tasks.clear()

    def _ensure_running_worker(self, endpoint: str) -> None:
        if endpoint not in self._tasks:
            task = self._tasks[endpoint] = asyncio.get_running_loop().create_task(self._work(endpoint))
            task.add_done_callback(lambda done: self._worker_ended(endpoint, done))

    def _worker_ended(self, endpoint: str, task: asyncio.Task[None]) -> None:
        if self._tasks.get(endpoint) is task:
            del self._tasks[endpoint]
        if not task.cancelled() and (error := task.exception()) is not None:
            log.error(
                "snapshot notification worker failed", endpoint=without_secrets(endpoint), exc_info=error
            )

    async def _work(self, endpoint: str) -> None:
        waiting, backoff = self._waiting[endpoint], Backoff(INITIAL_BACKOFF_S, MAX_BACKOFF_S)
        while waiting:
            notification = waiting[0]
            status = await self._send(notification)
            if status is None or status >= 500:
                if time.time() - notification.at <= self._tenants.outbound.keep_s:
                    await backoff.wait()
                    continue
                self._drop(notification, "too old")
            elif status >= 300:
                self._drop(notification, "refused")
            else:
                backoff.reset()
                self._delete(notification)
            if waiting and waiting[0] is notification:
                waiting.popleft()
        del self._waiting[endpoint]

    async def _send(self, notification: SnapshotNotification) -> int | None:
        """Return the status of the endpoint's response, None without a response."""
        outbound = self._tenants.outbound
        try:
            return await outbound.sender.post(
                notification.endpoint, notification.headers, notification.body, outbound.timeout_s
            )
        except SendError as error:
            log.info(
                "snapshot notification failed",
                endpoint=without_secrets(notification.endpoint),
                error=str(error),
            )
            return None

    def _drop(self, notification: SnapshotNotification, why: str) -> None:
        DROPPED.labels(why).inc()
        log.warning(
            "snapshot notification dropped", endpoint=without_secrets(notification.endpoint), reason=why
        )
        self._delete(notification)

    def _delete(self, notification: SnapshotNotification) -> None:
        self._tenants.commits_of(notification.tenant).store_later(Entries(documents={notification.key: None}))
