"""Operations on snapshots (clauses 5.16, 6.36 to 6.38), and operations inside of them (6.3.22).

A snapshot stores the results of queries at one moment. How it works:

1. POST snapshots stores the document with the status `preparing` and answers (`operations`).
2. A background task carries out the queries, context sources included (`snapshot_creation`,
   `history_copy`).
3. The results are written as the content of a tenant whose name no header can give (`content`), and become
   visible all at once.
4. The status becomes `success`, `partial`, `empty` or `failure`, and the endpoint of the snapshot is notified
   (`snapshot_store`, `snapshot_notifications`).
5. A request with NGSILD-Snapshot runs the usual operations on that tenant.
6. When the snapshot expires, is deleted, or is evicted for a new one, the tenant's content is deleted.

A tenant of its own needs no second implementation of queries, subscriptions or history. Every change of a
snapshot and its notification are one commit, so that a crash leaves either both or none. A crash during
creation leaves the status `preparing`; the next start changes it to `failure` and deletes the content.
"""

import time
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any, Final
from urllib.parse import quote
from uuid import uuid4

from handover.security.authentication import not_allowed
from handover.security.permissions import Permission
from handover_broker.extensions.plugins import CarryOut, PerformByName
from handover_broker.extensions.snapshots import SNAPSHOT_HEADER
from handover_broker.model.owner import OWNER
from handover_broker.model.problems import already_exists, not_found
from handover_broker.model.secrets import kept_members, require_secrets_again
from handover_broker.model.stored_documents import is_unusable, isolated
from handover_broker.model.validation import inside, moment, outside, require_uri
from handover_broker.network.endpoints import require_allowed
from handover_broker.request.document_responses import document_response, in_media_type
from handover_broker.request.ownership import owner_of, shows_results
from handover_broker.request.request_context import (
    PREFIX,
    RequestContext,
    Response,
)
from handover_broker.request.routing import Operation
from handover_broker.storage.entries import DocumentKind
from handover_broker.storage.journal import Journal
from handover_broker.tenants import Tenant, Tenants
from handover_federation.snapshots.purge import purge_filter
from handover_federation.snapshots.snapshot import (
    QUERIES,
    SECRETS,
    Snapshot,
    expiry_of,
    new_snapshot,
    require_valid,
    require_valid_change,
)
from handover_federation.snapshots.snapshot_creation import SnapshotCreator
from handover_federation.snapshots.snapshot_notifications import SnapshotNotifier, restored
from handover_federation.snapshots.snapshot_store import SnapshotStore, entries

USE_WRITE_INTERVAL_S: Final = 10.0
"""Minimum interval between two writes of the time of last use."""
_DONE: Final = Response(204)
_PURGE: Final = frozenset({"q"})


class BrokerSnapshots:
    """Implements `Snapshots`. `carry_out` and `by_name` carry out operations, context sources included."""

    def __init__(self, tenants: Tenants, carry_out: CarryOut, by_name: PerformByName) -> None:
        self._tenants = tenants
        self._snapshots = SnapshotStore(tenants)
        self._creator = SnapshotCreator(tenants, self._snapshots, carry_out, by_name)

    @property
    def notifier(self) -> SnapshotNotifier:
        """Return the notifier of snapshots."""
        return self._snapshots.notifier

    def operations(self) -> tuple[Operation, ...]:
        """Return the operations."""
        all_of_them, by_id, clone = "snapshots", "snapshots/{id}", "snapshots/{id}/clone"
        return (
            Operation("POST", all_of_them, "createSnapshot", "6.36.3.1", self.create),
            Operation("DELETE", all_of_them, "purgeSnapshots", "6.36.3.2", self.purge, _PURGE),
            Operation("GET", by_id, "retrieveSnapshotStatus", "6.37.3.1", self.retrieve),
            Operation("PATCH", by_id, "updateSnapshotStatus", "6.37.3.2", self.update),
            Operation("DELETE", by_id, "deleteSnapshot", "6.37.3.3", self.delete),
            Operation("POST", clone, "cloneSnapshot", "6.38.3.1", self.clone),
        )

    async def start(self, journal: Journal) -> None:
        """Schedule the expiry of the loaded snapshots, and clean up after a crash.

        Pending notifications are sent, interrupted creations fail, and content without a snapshot is deleted.
        """
        await self._snapshots.start()
        kind, pending = DocumentKind.SNAPSHOT_NOTIFICATION, []
        for stored in journal.documents(kind):
            with isolated(kind.value, stored[0], stored[1], {}):
                pending.append(restored(*stored))
        for notification in sorted(pending, key=lambda pending_notification: pending_notification.at):
            self.notifier.add(notification)
        ids: set[str] = set()
        for tenant in self._tenants:
            ids.update(inside(tenant.name, snapshot_id) for snapshot_id in self._snapshots.of(tenant))
            for snapshot in self._snapshots.of(tenant).values():
                self._snapshots.schedule_expiry(tenant, snapshot)
        self._creator.fail_interrupted()
        for tenant in self._tenants:
            if outside(tenant.name)[1] is not None and tenant.name not in ids:
                self._snapshots.tasks.start(self._snapshots.delete_content, tenant)

    async def stop(self) -> None:
        """Stop all background tasks; unfinished snapshots fail at the next start."""
        await self._snapshots.stop()

    def restore(self, journal: Journal) -> None:
        """Load the stored snapshots."""
        for tenant, snapshot_id, body in journal.documents(DocumentKind.SNAPSHOT):
            self._snapshots.load(tenant, snapshot_id, body)

    async def answer(self, operation: Operation, request: RequestContext, carry_out: CarryOut) -> Response:
        """Carry out an operation inside the snapshot that NGSILD-Snapshot names (clause 6.3.22)."""
        named = request.headers[SNAPSHOT_HEADER]
        request.tenant = self._inside(request)
        answer = await carry_out(operation, request)
        return Response(answer.status, answer.body, [*answer.headers, (SNAPSHOT_HEADER, named)])

    def _inside(self, request: RequestContext) -> Tenant:
        """Return the tenant with the content of the requested snapshot; raise a problem (404)."""
        tenant = request.tenant
        snapshot = self._existing(tenant, request.headers[SNAPSHOT_HEADER].decode("latin-1").strip())
        snapshot.used()
        if time.monotonic() - snapshot.written_s > USE_WRITE_INTERVAL_S:
            snapshot.written_s = time.monotonic()
            tenant.commits.store_later(entries(tenant, snapshot))
        return self._tenants.inside(tenant, snapshot.id)

    async def create(self, request: RequestContext) -> Response:
        """POST snapshots."""
        document, _ = await request.body()
        snapshot = new_snapshot(_named(document), require_valid(document, has_queries=True))
        await self._start(request, snapshot)
        self._creator.start(request, snapshot, document.get("@context"))
        return _created(snapshot)

    async def clone(self, request: RequestContext) -> Response:
        """POST snapshots/{id}/clone: an independent copy with its own expiry (clause 5.16.2)."""
        original = await self._permitted(request)
        document = require_valid((await request.body())[0], has_queries=False)
        queries: dict[str, Any] = {
            name: original.document[name] for name in QUERIES if name in original.document
        }
        snapshot = new_snapshot(_named(document), {**document, **queries})
        await self._start(request, snapshot)
        self._creator.start_copy(request, original, snapshot)
        return _created(snapshot)

    async def retrieve(self, request: RequestContext) -> Response:
        """GET snapshots/{id}."""
        return await _snapshot_response(request, await self._permitted(request))

    async def update(self, request: RequestContext) -> Response:
        """PATCH snapshots/{id}: priority, lifetime and notification endpoint."""
        change = require_valid_change((await request.body())[0])
        members = {name: value for name, value in change.items() if name not in {"type", "@context"}}
        async with self._snapshots.lock:
            before = await self._permitted(request)
            members = kept_members(members, before.document, *SECRETS)
            require_secrets_again({**before.document, **members}, before.document, members, *SECRETS)
            if "endpoint" in members:
                await self._require_open(request.tenant, members)
            if "snapshotLifetime" in members:
                created_s = moment(before.document["createdAt"]) or time.time()
                start = datetime.fromtimestamp(created_s, UTC)
                members["expiresAt"] = expiry_of(start, members["snapshotLifetime"])
            after = before.changed(**members)
            if after.document.get("snapshotPriority") is None:
                after.document["snapshotPriority"] = before.document["snapshotPriority"]
            await self._snapshots.store(request.tenant, after, notify=True)
        return await _snapshot_response(request, after)

    async def delete(self, request: RequestContext) -> Response:
        """DELETE snapshots/{id}."""
        async with self._snapshots.lock:
            if request.names[0] in self._snapshots.unusable.get(request.tenant.name, {}):
                await self._snapshots.remove_unusable(request.tenant, request.names[0])
                return _DONE
            await self._snapshots.remove(request.tenant, await self._permitted(request))
        return _DONE

    async def purge(self, request: RequestContext) -> Response:
        """DELETE snapshots: those that match q (clause 5.16.7)."""
        context = await request.reader_context()
        wants = purge_filter(request.parameter("q"), context)
        async with self._snapshots.lock:
            for snapshot in [
                candidate for candidate in self._snapshots.of(request.tenant).values() if wants(candidate)
            ]:
                if await shows_results(request, snapshot.owner):
                    await self._snapshots.remove(request.tenant, snapshot)
        return _DONE

    async def _start(self, request: RequestContext, snapshot: Snapshot) -> None:
        tenant = request.tenant
        snapshot.document[OWNER] = owner_of(request)
        await self._require_open(tenant, snapshot.document)
        async with self._snapshots.lock:
            if snapshot.id in self._snapshots.of(tenant):
                raise already_exists(f"there is a snapshot {snapshot.id} already; choose another id")
            await self._snapshots.evict_for_one(tenant)
            await self._snapshots.store(tenant, snapshot)

    async def _require_open(self, tenant: Tenant, document: Mapping[str, Any]) -> None:
        if document.get("endpoint") is not None:
            await require_allowed(tenant.notifier.outbound.policy, document["endpoint"], '"endpoint"')

    async def _permitted(self, request: RequestContext) -> Snapshot:
        """Return the snapshot that is named; raise a problem (403) if its results are not for the caller."""
        snapshot = self._existing(request.tenant, request.names[0])
        if not await shows_results(request, snapshot.owner):
            raise not_allowed(request.caller, Permission.READ_HEALTH_DATA)
        return snapshot

    def _existing(self, tenant: Tenant, snapshot_id: str) -> Snapshot:
        require_uri(snapshot_id, "the id of a snapshot")
        reason = self._snapshots.unusable.get(tenant.name, {}).get(snapshot_id)
        if reason is not None:
            raise is_unusable("snapshot", snapshot_id, reason)
        snapshot = self._snapshots.of(tenant).get(snapshot_id)
        if snapshot is None or snapshot.expires_s <= time.time():
            raise not_found(
                f"there is no snapshot {snapshot_id}, or it has expired; create one with POST snapshots"
            )
        return snapshot


def _named(document: Any) -> str:
    named = document.get("id") if isinstance(document, Mapping) else None
    return named if isinstance(named, str) else f"urn:ngsi-ld:Snapshot:{uuid4()}"


def _created(snapshot: Snapshot) -> Response:
    return Response(201, b"", [(b"location", f"{PREFIX}snapshots/{quote(snapshot.id, safe=':')}".encode())])


async def _snapshot_response(request: RequestContext, snapshot: Snapshot) -> Response:
    media_type, context = request.accept(), await request.reader_context()
    return document_response(in_media_type(snapshot.shown(), media_type, context), media_type, context)
