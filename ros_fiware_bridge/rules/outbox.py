"""The outbox: what is on its way to the broker, entity by entity.

Of each entity at most one request is under way; what comes meanwhile waits: of each rule the newest, or the
last so many if the rule says `keep`. So nothing grows without end, however long the broker is away. Pure.
"""

from collections import Counter, OrderedDict, deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

MOST_IN_A_BATCH = 200
MOST_VERSIONS = 50
"""Of one entity so many go in one request, in order; only rules that `keep` several have more than one."""


@dataclass(frozen=True, slots=True)
class Letter:
    """What one rule has to say of one entity; `create`: whether the entity is made if it is not there."""

    rule: str
    entity_id: str
    entity_type: str
    attributes: Mapping[str, Any]
    keep: int = 1
    create: bool = True
    put_at_s: float = 0.0
    shown: Mapping[str, Any] | None = None
    """The values by attribute, where the rule counts what the broker has taken."""


@dataclass(frozen=True, slots=True)
class Parcel:
    """Letters about one entity that go together: its versions in order, each of letters of several rules."""

    versions: tuple[tuple[Letter, ...], ...]

    @property
    def letters(self) -> tuple[Letter, ...]:
        """Return all letters, the oldest first."""
        return tuple(letter for version in self.versions for letter in version)

    @property
    def entity_id(self) -> str:
        """Return the entity that it is about."""
        return self.versions[0][0].entity_id

    @property
    def create(self) -> bool:
        """Say whether the entity may be made."""
        return any(letter.create for letter in self.letters)

    def one_by_one(self) -> "list[Parcel]":
        """Return a parcel for each version."""
        return [Parcel((version,)) for version in self.versions]

    def entities(self) -> list[dict[str, Any]]:
        """Return the versions as the broker takes them."""
        return [
            {
                "id": self.entity_id,
                "type": version[0].entity_type,
                **{name: value for letter in version for name, value in letter.attributes.items()},
            }
            for version in self.versions
        ]


@dataclass(slots=True)
class _Pigeonhole:
    waiting: dict[str, deque[Letter]] = field(default_factory=dict)
    under_way: bool = False


class Outbox:
    """Letters by entity and rule."""

    def __init__(self) -> None:
        self._holes: dict[str, _Pigeonhole] = {}
        self._ready: OrderedDict[str, None] = OrderedDict()
        self.under_way = 0

    def put(self, letter: Letter) -> int:
        """Take a letter; return how many older ones had to go for it (a newest one is never lost)."""
        hole = self._holes.setdefault(letter.entity_id, _Pigeonhole())
        queue = hole.waiting.setdefault(letter.rule, deque())
        queue.append(letter)
        gone = 0
        while len(queue) > letter.keep:
            queue.popleft()
            gone += 1
        if not hole.under_way:
            self._ready[letter.entity_id] = None
        return gone

    def take(self, most: int = MOST_IN_A_BATCH) -> list[Parcel]:
        """Return what may go now, the longest waiting first."""
        parcels: list[Parcel] = []
        while self._ready and len(parcels) < most:
            entity_id, _ = self._ready.popitem(last=False)
            hole = self._holes[entity_id]
            versions: list[tuple[Letter, ...]] = []
            while len(versions) < MOST_VERSIONS and (
                letters := tuple(queue.popleft() for queue in hole.waiting.values() if queue)
            ):
                versions.append(letters)
            if versions:
                hole.under_way = True
                self.under_way += 1
                parcels.append(Parcel(tuple(versions)))
        return parcels

    def arrived(self, parcels: Iterable[Parcel]) -> None:
        """Take notice that the broker has them, or has refused them for good."""
        for parcel in parcels:
            self._landed(parcel)

    def came_back(self, parcels: Iterable[Parcel]) -> Counter[str]:
        """Put back what the broker could not take now; return how many letters of each rule had to go."""
        gone: Counter[str] = Counter()
        for parcel in parcels:
            hole = self._holes[parcel.entity_id]
            for letter in reversed(parcel.letters):
                queue = hole.waiting.setdefault(letter.rule, deque())
                if len(queue) < letter.keep:
                    queue.appendleft(letter)
                else:
                    gone[letter.rule] += 1
            self._landed(parcel)
        return gone

    def __len__(self) -> int:
        return sum(len(queue) for hole in self._holes.values() for queue in hole.waiting.values())

    def _landed(self, parcel: Parcel) -> None:
        hole = self._holes[parcel.entity_id]
        hole.under_way = False
        self.under_way -= 1
        hole.waiting = {rule: queue for rule, queue in hole.waiting.items() if queue}
        if hole.waiting:
            self._ready[parcel.entity_id] = None
        else:
            del self._holes[parcel.entity_id]
