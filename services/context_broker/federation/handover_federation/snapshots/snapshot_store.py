"""Stores snapshots in memory and on disk until they expire or are evicted.

A change of a snapshot and its notification are one commit.
"""

import asyncio
import time
from collections.abc import Iterable
from typing import Final

from handover.runtime.background_tasks import BackgroundTasks
from handover_broker.model.problems import not_stored
from handover_broker.model.stored_documents import isolated
from handover_broker.model.validation import timestamp_now
from handover_broker.storage.database import NotStored
from handover_broker.storage.entries import DocumentKind, Entries
from handover_broker.tenants import DEFAULT, Tenant, Tenants
from handover_federation.snapshots.content import deletion_entries
from handover_federation.snapshots.snapshot import MAX_SNAPSHOTS, MAX_TOTAL_ENTITIES, Snapshot, restored
from handover_federation.snapshots.snapshot_notifications import SnapshotNotifier, notification_of

MAX_TIMER_S: Final = 86400.0


class SnapshotStore:
    """Stores the snapshots of all tenants. A caller that changes one holds `lock`."""

    def __init__(self, tenants: Tenants) -> None:
        self._tenants = tenants
        self.notifier = SnapshotNotifier(tenants)
        self.lock = asyncio.Lock()
        self._by_tenant: dict[str, dict[str, Snapshot]] = {}
        self.unusable: dict[str, dict[str, str]] = {}
        """Stored snapshots that cannot be used, by tenant and id, with the reasons."""
        self.tasks = BackgroundTasks("snapshots")

    def of(self, tenant: Tenant) -> dict[str, Snapshot]:
        """Return the snapshots of a tenant by their id."""
        return self._by_tenant.setdefault(tenant.name, {})

    def load(self, tenant: str, snapshot_id: str, body: bytes) -> None:
        """Load a stored snapshot."""
        with isolated("snapshot", tenant, snapshot_id, self.unusable.setdefault(tenant, {})):
            self._by_tenant.setdefault(tenant, {})[snapshot_id] = restored(snapshot_id, body)

    async def start(self) -> None:
        """Allow background tasks."""
        await self.tasks.__aenter__()

    async def stop(self) -> None:
        """Stop all background tasks; unfinished snapshots fail at the next start."""
        await self.tasks.__aexit__()
        self.notifier.stop()

    def schedule_expiry(self, tenant: Tenant, snapshot: Snapshot) -> None:
        """Delete a snapshot when it expires, unless it was changed meanwhile."""
        if self.of(tenant).get(snapshot.id) is not snapshot:
            return
        left_s = snapshot.expires_s - time.time()
        if left_s > 0:
            loop = asyncio.get_running_loop()
            loop.call_later(min(left_s, MAX_TIMER_S), self.schedule_expiry, tenant, snapshot)
        else:
            self.tasks.start(self._end, tenant, snapshot)

    async def store(self, tenant: Tenant, snapshot: Snapshot, *, notify: bool = False) -> None:
        """Store a snapshot in its current state. Raises a problem (507) if the disk refuses."""
        notification = notification_of(tenant.name, snapshot) if notify else None
        changes = entries(tenant, snapshot)
        if notification is not None:
            changes.documents[notification.key] = notification.stored()
        await _write(tenant, changes)
        self.publish(tenant, snapshot)
        if notification is not None:
            self.notifier.add(notification)

    def publish(self, tenant: Tenant, snapshot: Snapshot) -> None:
        """Make the current state of a snapshot visible to readers."""
        self.of(tenant)[snapshot.id] = snapshot
        self.schedule_expiry(tenant, snapshot)

    async def remove(self, tenant: Tenant, snapshot: Snapshot) -> None:
        """Delete a snapshot with its content and notify its endpoint (clause 5.16.6)."""
        gone = Entries(documents={(DocumentKind.SNAPSHOT, tenant.name, snapshot.id): None})
        notification = notification_of(tenant.name, snapshot.changed(expiresAt=timestamp_now()))
        if notification is not None:
            gone.documents[notification.key] = notification.stored()
        await _write(tenant, gone)
        self.of(tenant).pop(snapshot.id, None)
        await self.delete_content(self._tenants.inside(tenant, snapshot.id))
        if notification is not None:
            self.notifier.add(notification)

    async def remove_unusable(self, tenant: Tenant, snapshot_id: str) -> None:
        """Delete a stored snapshot that cannot be used."""
        await _write(tenant, Entries(documents={(DocumentKind.SNAPSHOT, tenant.name, snapshot_id): None}))
        del self.unusable[tenant.name][snapshot_id]

    async def delete_content(self, inner: Tenant) -> None:
        """Delete the content of a snapshot from the disk."""
        temporal_only = await asyncio.to_thread(
            lambda: list(inner.notifier.journal.archive.temporal_only_entities(inner.name))
        )
        for deletions in deletion_entries(
            inner, [(place, entity_id) for place, entity_id, _ in temporal_only]
        ):
            await _write(inner, deletions)
        if inner.is_kept:
            await _write(inner, Entries(documents={(DocumentKind.TENANT, DEFAULT, inner.name): None}))
        self._tenants.drop(inner.name)

    async def evict_for_one(self, tenant: Tenant) -> None:
        """Evict snapshots so that a tenant can have one more."""
        for snapshot in _by_worth(self.of(tenant).values())[
            : max(0, len(self.of(tenant)) + 1 - MAX_SNAPSHOTS)
        ]:
            await self.remove(tenant, snapshot)

    async def evict_for(self, tenant: Tenant, snapshot: Snapshot, more: int) -> None:
        """Evict snapshots so that another can have so many entities."""
        others = [
            candidate for candidate in _by_worth(self.of(tenant).values()) if candidate.id != snapshot.id
        ]
        sizes = [len(self._tenants.inside(tenant, candidate.id).store) for candidate in others]
        held, gone = more + sum(sizes), 0
        while held > MAX_TOTAL_ENTITIES and gone < len(others):
            held -= sizes[gone]
            gone += 1
        for other in others[:gone]:
            await self.remove(tenant, other)

    async def _end(self, tenant: Tenant, snapshot: Snapshot) -> None:
        async with self.lock:
            if self.of(tenant).get(snapshot.id) is snapshot:
                await self.remove(tenant, snapshot)


def entries(tenant: Tenant, snapshot: Snapshot) -> Entries:
    """Return the commit that stores a snapshot."""
    return Entries(documents={(DocumentKind.SNAPSHOT, tenant.name, snapshot.id): snapshot.stored()})


def _by_worth(snapshots: Iterable[Snapshot]) -> list[Snapshot]:
    """Return the snapshots in the order of eviction."""
    return sorted(
        snapshots,
        key=lambda snapshot: (snapshot.document["snapshotPriority"], snapshot.document["lastUsedAt"]),
    )


async def _write(tenant: Tenant, some: Entries) -> None:
    try:
        await tenant.commits.store(some)
    except NotStored as error:
        raise not_stored(str(error), is_away=error.is_away) from error
