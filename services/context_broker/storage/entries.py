"""What a commit writes: entities, documents, what subscribers are owed, and what has been."""

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Final, NamedTuple

from services.context_broker.storage.history_archive import DepartedRow, HistoryRow

OVERHEAD_BYTES: Final = 200
"""What a notice takes besides its body."""


class Kind(StrEnum):
    """What a document is. Documents of a tenant go with it; those of no tenant have the tenant ""."""

    TENANT = "tenant"
    CONTEXT = "context"
    """An @context: by its URL if it was fetched, else by its local identifier, of the tenant that gave it."""
    CONTEXT_USAGE = "contextUsage"
    """How the @context of the same id was used."""
    SUBSCRIPTION = "subscription"
    FORWARDED_SUBSCRIPTION = "forwarded subscription"
    """A subscription that was passed on to a context source."""
    COUNTS = "counts"
    """What became of the notifications of the subscription of the same id."""
    ENTITY_MAP = "entity map"
    IDENTITY = "identity"
    """What tells this broker from all others, made at its first start."""
    SOURCE_SUBSCRIPTION = "source subscription"
    """To registrations of context sources; its counts are kept as those of other subscriptions."""
    SNAPSHOT = "snapshot"
    SNAPSHOT_NOTIFICATION = "snapshot notification"
    """A notification of how a snapshot is that is owed to somebody."""
    REGISTRATION = "registration"
    ATTEMPTS = "attempts"
    """What became of the operations passed on to the source of the registration of the same id."""


DocumentKey = tuple[Kind, str, str]
"""Kind, tenant and id."""


class EntityRow(NamedTuple):
    """An entity as it is kept; without `body` it is gone."""

    tenant: str
    id: str
    body: bytes | None


@dataclass(slots=True, eq=False)
class PendingNotification:
    """A notification that is owed.

    Without `body`, or with one that is a list of entities instead of a notification, it waits for its
    throttling to end, to be told then: how the entity is by then, or that list. `headers` (JSON) are those of
    the request that the subscriber wants passed on. `seq` is its place in the outbox, which the journal gives
    it in the commit.
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
        """Say whether it is told together with others once the throttling ends."""
        return self.body is None or self.body.startswith(b"[")

    @property
    def size(self) -> int:
        """How many bytes it takes, about."""
        return OVERHEAD_BYTES + (0 if self.body is None else len(self.body))


@dataclass(slots=True)
class Entries:
    """What is to be written in one commit; None as a body deletes."""

    entities: dict[int, EntityRow] = field(default_factory=dict)
    """By place in the order of creation."""
    documents: dict[DocumentKey, bytes | None] = field(default_factory=dict)
    pending: list[PendingNotification] = field(default_factory=list)
    settled: list[int] = field(default_factory=list)
    history: list[HistoryRow] = field(default_factory=list)
    cleared: list[tuple[int, int]] = field(default_factory=list)
    """Places, each with the seq below which its history is cleared away."""
    departed: dict[int, DepartedRow] = field(default_factory=dict)
    """By place in the order of creation."""

    def add(self, later: "Entries") -> None:
        """Put what comes later into the same commit."""
        self.entities.update(later.entities)
        self.history.extend(later.history)
        if later.pending:
            self.pending.extend(later.pending)
        if later.settled:
            self.settled.extend(later.settled)
        if later.documents:
            self.documents.update(later.documents)
        if later.departed:
            self.departed.update(later.departed)
        if later.cleared:
            self.cleared.extend(later.cleared)
