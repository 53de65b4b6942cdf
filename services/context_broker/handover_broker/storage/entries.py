"""What a commit writes: entities, documents, pending notifications and history."""

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final, NamedTuple

from handover_broker.storage.history_archive import HistoryRow, TemporalOnlyRow

OVERHEAD_BYTES: Final = 200
"""Memory that a notification takes besides its body."""


class DocumentKind(StrEnum):
    """The kind of a document. Documents of a tenant are deleted with it; those of no tenant have the
    tenant ""."""

    TENANT = "tenant"
    CONTEXT = "context"
    """An @context: by its URL if it was fetched, else by its local identifier, with the tenant that added
    it."""
    CONTEXT_USAGE = "contextUsage"
    """How the @context of the same id was used."""
    SUBSCRIPTION = "subscription"
    FORWARDED_SUBSCRIPTION = "forwarded subscription"
    """A subscription that was forwarded to a context source."""
    COUNTS = "counts"
    """Statistics of the notifications of the subscription of the same id."""
    ENTITY_MAP = "entity map"
    IDENTITY = "identity"
    """What distinguishes this broker from all others, created at its first start."""
    SOURCE_SUBSCRIPTION = "source subscription"
    """To context source registrations; its counts are stored as those of other subscriptions."""
    SNAPSHOT = "snapshot"
    SNAPSHOT_NOTIFICATION = "snapshot notification"
    """A pending notification about a snapshot."""
    REGISTRATION = "registration"
    ATTEMPTS = "attempts"
    """Statistics of the operations forwarded to the source of the registration of the same id."""


DocumentKey = tuple[DocumentKind, str, str]
"""Kind, tenant and id."""


class EntityRow(NamedTuple):
    """A stored entity; without `body` it is deleted."""

    tenant: str
    id: str
    body: bytes | None


@dataclass(slots=True, eq=False)
class PendingNotification:
    """A pending notification.

    Without `body`, or with a list of entities as its body, it waits until its throttling ends. Then the state
    of the entity at that time, or the list, is sent. `headers` (JSON) are those of the request that the
    subscriber asked for. `seq` is its number in the outbox, which the journal assigns in the commit.
    """

    tenant: str
    subscription: str
    entity: str
    at: float
    body: bytes | None
    seq: int = 0
    headers: bytes | None = None

    @property
    def waits_for_throttling(self) -> bool:
        """Return whether it is sent with others once the throttling ends."""
        return self.body is None or self.body.startswith(b"[")

    @property
    def size(self) -> int:
        """Its approximate size in memory."""
        return OVERHEAD_BYTES + (0 if self.body is None else len(self.body))


@dataclass(slots=True)
class Entries:
    """What one commit writes; None as a body deletes."""

    entities: dict[int, EntityRow] = field(default_factory=dict)
    """By sequence number."""
    documents: dict[DocumentKey, bytes | None] = field(default_factory=dict)
    pending: list[PendingNotification] = field(default_factory=list)
    settled: list[int] = field(default_factory=list)
    history: list[HistoryRow] = field(default_factory=list)
    cleared: list[tuple[int, int]] = field(default_factory=list)
    """Sequence numbers, each with the seq below which its history is deleted."""
    temporal_only: dict[int, TemporalOnlyRow] = field(default_factory=dict)
    """By sequence number."""

    def add(self, later: "Entries") -> None:
        """Add later entries to the same commit."""
        self.entities.update(later.entities)
        self.history.extend(later.history)
        if later.pending:
            self.pending.extend(later.pending)
        if later.settled:
            self.settled.extend(later.settled)
        if later.documents:
            self.documents.update(later.documents)
        if later.temporal_only:
            self.temporal_only.update(later.temporal_only)
        if later.cleared:
            self.cleared.extend(later.cleared)
