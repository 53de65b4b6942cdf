"""Tenants: each has entities, subscriptions and registrations of its own (clauses 4.14 and 6.3.14).

A tenant is created with the first thing that is stored for it. The tenant without a name always exists.
"""

import itertools
from collections.abc import Callable, Iterator
from typing import Final
from uuid import uuid4

from handover.network.http_client import PooledHttpClient
from handover_broker.delivery.disclosure import Receivers
from handover_broker.delivery.mqtt_sender import MqttSender
from handover_broker.delivery.notifier import Notifier
from handover_broker.delivery.outbound import Outbound
from handover_broker.model.entity import Entity
from handover_broker.model.problems import bad_request_data, no_such_tenant
from handover_broker.model.validation import MAX_TENANT_LENGTH, TENANT, inside, outside, shown
from handover_broker.settings import BrokerSettings
from handover_broker.storage.commits import CommitQueue, Commits, Failed, stored
from handover_broker.storage.entries import DocumentKind, Entries
from handover_broker.storage.expiry_queue import ExpiryQueue
from handover_broker.storage.journal import Journal
from handover_broker.storage.store import Store
from handover_broker.temporal.history import HistoryRecorder
from handover_broker.tenant_extensions import LocalTenant, TenantFederation

DEFAULT: Final = ""


class Tenant:
    """The state of one tenant."""

    def __init__(self, name: str, tenants: "Tenants", *, is_kept: bool) -> None:
        self.name = name
        self.active_requests = 0
        self._tenants = tenants
        self.commits = _TenantCommits(name, tenants.commits, is_kept=is_kept)
        self.notifier = Notifier(name, self.commits, tenants.outbound, tenants.receivers)
        self.store = Store(
            name,
            self.commits,
            tenants.places,
            self.notifier.announce,
            self.notifier.deliver,
            recorder=tenants.recorder,
            ends=tenants.ends,
            on_deletion=lambda entity: tenants.on_deletion(name, entity),
        )
        self.notifier.store = self.store
        self.federation = tenants.federation_of(self)

    @property
    def alias(self) -> str:
        """Return the name of this broker in Via when it asks on behalf of the tenant (clause 5.2.40)."""
        return self._tenants.alias_of(outside(self.name)[0])

    @property
    def receivers(self) -> Receivers:
        """The owners of subscriptions and registrations, to whom the broker sends on its own."""
        return self._tenants.receivers

    @property
    def is_kept(self) -> bool:
        """Return whether anything has ever been stored for this tenant."""
        return self.commits.is_kept


class _TenantCommits:
    """The commits of one tenant: the first one also stores the tenant."""

    def __init__(self, name: str, commits: CommitQueue, *, is_kept: bool) -> None:
        self._name = name
        self._commits = commits
        self.is_kept = is_kept

    def submit(self, entries: Entries, done: Callable[[], None], failed: Failed) -> None:
        """Queue a write."""
        if self.is_kept:
            self._commits.submit(entries, done, failed)
            return
        entries.documents[DocumentKind.TENANT, DEFAULT, self._name] = b"{}"

        def kept() -> None:
            self.is_kept = True
            done()

        self._commits.submit(entries, kept, failed)

    async def store(self, entries: Entries) -> None:
        """Write `entries` and return when they are durable."""
        await stored(self, entries)

    def store_later(self, entries: Entries, within_s: float = 0.2) -> None:
        """Write `entries` with the next commit, or after `within_s`."""
        self._commits.store_later(entries, within_s)


class Tenants:
    """All tenants, and what they share."""

    def __init__(self, journal: Journal, settings: BrokerSettings, receivers: Receivers) -> None:
        self.receivers = receivers
        self.ends = ExpiryQueue()
        self.commits = CommitQueue(journal, self._forget_staged)
        self.places: Iterator[int]
        self.outbound: Outbound
        self.recorder = HistoryRecorder() if settings.broker_history else None
        self._journal = journal
        self._settings = settings
        self._tenants: dict[str, Tenant] = {}
        self.federation_of: Callable[[Tenant], TenantFederation] = lambda _: LocalTenant()
        """Creates the federation state of a new tenant."""
        self.on_deletion: Callable[[str, Entity], None] = lambda *_: None
        """Called with the tenant's name and an entity that was deleted."""
        self._identity = ""

    def alias_of(self, tenant: str) -> str:
        """Return the broker's alias for one tenant: a token that no other broker has (clause 5.2.40).

        It differs between tenants, so that one tenant can be a source of another without a loop.
        """
        return f"{self._identity}.{tenant}" if tenant else self._identity

    def load(self) -> None:
        """Load the content of the journal."""
        journal, settings = self._journal, self._settings
        identities = [body for _, _, body in journal.documents(DocumentKind.IDENTITY)]
        self.identify(identities[0] if identities else uuid4().hex[:12].encode())
        policy, ca_files = settings.outbound_policy(), settings.ca_files
        self.places = itertools.count(journal.last_sequence() + 1)
        self.outbound = Outbound(
            journal,
            PooledHttpClient(policy, ca_files),
            MqttSender(policy, ca_files),
            policy,
            timeout_s=settings.broker_notification_timeout_s,
            keep_s=settings.broker_notification_keep_h * 3600,
            keep_bytes=settings.broker_notification_keep_mb * 1024 * 1024,
        )
        self._tenants[DEFAULT] = Tenant(DEFAULT, self, is_kept=True)
        for _, name, _ in journal.documents(DocumentKind.TENANT):
            self._tenants[name] = Tenant(name, self, is_kept=True)
        for tenant, body in journal.entities():
            self._tenants[tenant].store.take(Entity.restored(body))

    async def keep_identity(self) -> None:
        """Store the identity of this broker, if there is none yet."""
        if not any(self._journal.documents(DocumentKind.IDENTITY)):
            suffix = self._identity.rpartition("-")[2].encode()
            await self.commits.store(Entries(documents={(DocumentKind.IDENTITY, DEFAULT, "broker"): suffix}))

    def identify(self, identity: bytes) -> None:
        """Set the identity of this broker, which stays with its database."""
        self._identity = f"handover-{self._settings.factory}-{identity.decode()}"

    def __iter__(self) -> Iterator[Tenant]:
        """Yield all tenants."""
        return iter(list(self._tenants.values()))

    def named(self) -> list[str]:
        """Return the names of the tenants that something was stored for, without the default one."""
        return [
            tenant.name
            for tenant in self
            if tenant.name and tenant.is_kept and outside(tenant.name)[1] is None
        ]

    def of(self, header: bytes, *, makes: bool) -> Tenant:
        """Return the tenant that a request names; `makes` allows the request to create it.

        Raises a problem: 404 for an unknown tenant, 400 for an invalid name.
        """
        name = header.decode("latin-1").strip() if header else DEFAULT
        tenant = self._tenants.get(name)
        if tenant is not None:
            tenant.active_requests += 1
            return tenant
        if not TENANT.fullmatch(name):
            raise bad_request_data(
                f"NGSILD-Tenant {shown(name)} is not a valid tenant name: A-Z, a-z, 0-9, _ - and . "
                f"({MAX_TENANT_LENGTH} at most)"
            )
        if not makes:
            raise no_such_tenant(
                f"there is no tenant {shown(name)}; it is created with the first entity, subscription "
                "or registration that is created in it"
            )
        tenant = self._tenants[name] = Tenant(name, self, is_kept=False)
        tenant.active_requests = 1
        return tenant

    def inside(self, tenant: Tenant, snapshot_id: str) -> Tenant:
        """Return the tenant with the content of a snapshot; created if needed."""
        name = inside(tenant.name, snapshot_id)
        existing = self._tenants.get(name)
        if existing is None:
            existing = self._tenants[name] = Tenant(name, self, is_kept=False)
        return existing

    def drop(self, name: str) -> None:
        """Remove the content of a deleted snapshot."""
        gone = self._tenants.pop(name, None)
        if gone is not None:
            gone.notifier.stop()
            gone.federation.stop()

    def commits_of(self, name: str) -> Commits:
        """Return where the writes of a tenant go; those of an unknown tenant go to the common queue."""
        tenant = self._tenants.get(name)
        return self.commits if tenant is None else tenant.commits

    def leave(self, tenant: Tenant) -> None:
        """Count the end of a request; a tenant without stored data is removed."""
        tenant.active_requests -= 1
        if not tenant.is_kept and not tenant.active_requests:
            self._tenants.pop(tenant.name, None)

    def kept(self, name: str) -> Tenant:
        """Return a tenant that has stored data."""
        tenant = self._tenants.get(name)
        if tenant is None:
            tenant = self._tenants[name] = Tenant(name, self, is_kept=True)
        tenant.commits.is_kept = True
        return tenant

    def entities(self) -> int:
        """Return the number of entities of all tenants."""
        return sum(len(tenant.store) for tenant in self._tenants.values())

    def _forget_staged(self) -> None:
        for tenant in self._tenants.values():
            tenant.store.forget_staged()
