"""The outbox: updates that wait for the broker or are on their way to it, by entity.

Each entity has at most one batch in flight. Meanwhile further updates wait: of each rule the newest, or the
last `keep`. So the memory in use is bounded, however long the broker is unavailable. Pure.
"""

from collections import Counter, OrderedDict, deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

MAX_ENTITIES_PER_REQUEST = 200
MAX_VERSIONS_PER_REQUEST = 50
"""Versions of one entity in one request, in order; only rules with `keep` over 1 have more than one."""


@dataclass(frozen=True, slots=True)
class Update:
    """A change of one entity by one rule; `create` is whether a missing entity is created."""

    rule: str
    entity_id: str
    entity_type: str
    attributes: Mapping[str, Any]
    keep: int = 1
    create: bool = True
    put_at_s: float = 0.0
    shown: Mapping[str, Any] | None = None
    """The values by attribute, if the rule counts accepted updates."""


@dataclass(frozen=True, slots=True)
class Batch:
    """The updates of one entity in one request: its versions in order, each with updates of several rules."""

    versions: tuple[tuple[Update, ...], ...]

    @property
    def updates(self) -> tuple[Update, ...]:
        """Return all updates, oldest first."""
        return tuple(update for version in self.versions for update in version)

    @property
    def entity_id(self) -> str:
        """Return the id of the entity."""
        return self.versions[0][0].entity_id

    @property
    def create(self) -> bool:
        """Return whether the entity may be created."""
        return any(update.create for update in self.updates)

    def split(self) -> "list[Batch]":
        """Return one batch for each version."""
        return [Batch((version,)) for version in self.versions]

    def entities(self) -> list[dict[str, Any]]:
        """Return the versions as NGSI-LD entities."""
        return [
            {
                "id": self.entity_id,
                "type": version[0].entity_type,
                **{name: value for update in version for name, value in update.attributes.items()},
            }
            for version in self.versions
        ]


@dataclass(slots=True)
class _EntityQueue:
    waiting: dict[str, deque[Update]] = field(default_factory=dict)
    in_flight: bool = False


class Outbox:
    """Updates by entity and rule."""

    def __init__(self) -> None:
        self._queues: dict[str, _EntityQueue] = {}
        self._ready: OrderedDict[str, None] = OrderedDict()
        self.in_flight = 0

    def put(self, update: Update) -> int:
        """Queue an update; return the number of older ones that it replaces (the newest is never lost)."""
        entity = self._queues.setdefault(update.entity_id, _EntityQueue())
        queue = entity.waiting.setdefault(update.rule, deque())
        queue.append(update)
        replaced = 0
        while len(queue) > update.keep:
            queue.popleft()
            replaced += 1
        if not entity.in_flight:
            self._ready[update.entity_id] = None
        return replaced

    def take(self, max_entities: int = MAX_ENTITIES_PER_REQUEST) -> list[Batch]:
        """Return the batches that may be sent now, the longest waiting first."""
        batches: list[Batch] = []
        while self._ready and len(batches) < max_entities:
            entity_id, _ = self._ready.popitem(last=False)
            entity = self._queues[entity_id]
            versions: list[tuple[Update, ...]] = []
            while len(versions) < MAX_VERSIONS_PER_REQUEST and (
                updates := tuple(queue.popleft() for queue in entity.waiting.values() if queue)
            ):
                versions.append(updates)
            if versions:
                entity.in_flight = True
                self.in_flight += 1
                batches.append(Batch(tuple(versions)))
        return batches

    def acknowledge(self, batches: Iterable[Batch]) -> None:
        """Release batches that the broker has accepted, or has refused permanently."""
        for batch in batches:
            self._release(batch)

    def requeue(self, batches: Iterable[Batch]) -> Counter[str]:
        """Queue batches again that were not sent; return the number of replaced updates by rule."""
        replaced: Counter[str] = Counter()
        for batch in batches:
            entity = self._queues[batch.entity_id]
            for update in reversed(batch.updates):
                queue = entity.waiting.setdefault(update.rule, deque())
                if len(queue) < update.keep:
                    queue.appendleft(update)
                else:
                    replaced[update.rule] += 1
            self._release(batch)
        return replaced

    def __len__(self) -> int:
        return sum(len(queue) for entity in self._queues.values() for queue in entity.waiting.values())

    def _release(self, batch: Batch) -> None:
        entity = self._queues[batch.entity_id]
        entity.in_flight = False
        self.in_flight -= 1
        entity.waiting = {rule: queue for rule, queue in entity.waiting.items() if queue}
        if entity.waiting:
            self._ready[batch.entity_id] = None
        else:
            del self._queues[batch.entity_id]
