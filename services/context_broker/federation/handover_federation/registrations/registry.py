"""The registry: all registrations of a tenant, indexed for matching.

Every request is matched with the registrations, of which there are few. They are indexed by type and by id
when they change. An empty registry (the usual case) costs a request one look at `is_empty`.
"""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Final

import orjson

from handover_broker.model.entity import Entity, dataset_of
from handover_broker.model.validation import timestamp_now
from handover_broker.storage.commits import Commits
from handover_broker.storage.entries import DocumentKind, Entries
from handover_federation.registrations.coverage import may_hold
from handover_federation.registrations.registration import (
    Attempts,
    EntityTarget,
    Information,
    Match,
    Mode,
    Registration,
    SourceFilter,
)

Watcher = Callable[[Registration | None, Registration | None], None]
"""Called with a registration before and after a committed change; None where there is none."""

ANY: Final = EntityTarget()


class Registry:
    """The registrations of one tenant, in memory. The caller stores them."""

    def __init__(self, tenant: str, commits: Commits) -> None:
        self.tenant = tenant
        self.is_empty = True
        """Whether no request can concern a context source; check this first."""
        self.watchers: list[Watcher] = []
        """Called on the event loop after each change, except while loading."""
        self.unusable: dict[str, str] = {}
        """Stored registrations that cannot be used, with the reasons."""
        self._commits = commits
        self._all: dict[str, Registration] = {}
        self._places: dict[str, int] = {}
        self._added_count = 0
        self._by_type: dict[str, dict[str, Registration]] = {}
        self._by_id: dict[str, dict[str, Registration]] = {}
        self._of_groups: dict[str, Registration] = {}
        self._of_anything: dict[str, Registration] = {}

    def __len__(self) -> int:
        return len(self._all)

    def __iter__(self) -> Iterator[Registration]:
        """Yield all registrations, the oldest first, including expired ones."""
        return iter(list(self._all.values()))

    def get(self, registration_id: str) -> Registration | None:
        """Return a registration unless it has expired."""
        registration = self._all.get(registration_id)
        return None if registration is None or registration.has_expired(time.time()) else registration

    def holds(self, registration: Registration) -> bool:
        """Return whether this version of a registration is current, neither changed nor deleted since."""
        return self._all.get(registration.id) is registration

    def load(self, registration: Registration) -> None:
        """Add a stored registration without notifying watchers."""
        self._index(registration)

    def put(self, registration: Registration) -> None:
        """Add or replace a registration; a replaced one keeps its place in the order."""
        before = self._all.get(registration.id)
        if before is not None:
            self._unindex(before)
        self._index(registration)
        self._notify_watchers(before, registration)

    def remove(self, registration_id: str) -> None:
        """Remove a registration."""
        before = self._all.pop(registration_id)
        del self._places[registration_id]
        self._unindex(before)
        self.is_empty = not self._all
        self._notify_watchers(before, None)

    def remove_if_held(self, registration: Registration) -> None:
        """Remove a registration unless it was changed or deleted meanwhile."""
        if self.holds(registration):
            self.remove(registration.id)

    def matching(
        self, operation: str | tuple[str, ...], target: EntityTarget = ANY, where: SourceFilter | None = None
    ) -> list[Match]:
        """Return the registrations whose source takes `operation` and that match the `target`, with their
        parts.

        `operation` is named as in table 4.20-1; of several, any is enough. The matches come in the order of
        `Mode` (exclusive, redirect, inclusive, auxiliary), within a mode in the order of creation. Parts of
        exclusive and redirect sources are not removed from the others: the caller does that, as it depends on
        the operation (clause 4.3.6.3).
        """
        if self.is_empty:
            return []
        now_s = time.time()
        names = (operation,) if isinstance(operation, str) else operation
        matches = [
            Match(candidate, parts)
            for candidate in self._candidates(target)
            if any(candidate.takes(name) for name in names)
            and not candidate.has_expired(now_s)
            and (parts := candidate.parts(target))
            and (where is None or where(candidate))
        ]
        return sorted(
            matches, key=lambda match: (match.registration.mode, self._places[match.registration.id])
        )

    def matching_any(
        self, targets: Sequence[EntityTarget], where: SourceFilter | None = None
    ) -> list[Registration]:
        """Return the registrations that match any of the targets, whatever operations they take; oldest
        first."""
        now_s = time.time()
        matching_any = {
            candidate.id
            for target in targets
            for candidate in self._candidates(target)
            if candidate.parts(target)
        }
        return [
            registration
            for registration in self._all.values()
            if registration.id in matching_any
            and not registration.has_expired(now_s)
            and (where is None or where(registration))
        ]

    def conflicting_with(self, registration: Registration) -> Registration | None:
        """Return a registration that conflicts with a proxied one because either is exclusive (clause
        4.3.6.3).

        An exclusive registration excludes other exclusive and redirect ones for the same entity and
        attribute; a redirect one excludes later exclusive ones.
        """
        if not registration.mode.is_proxied:
            return None
        now_s = time.time()
        for piece in registration.information:
            for other in self._all.values():
                if (
                    other.id != registration.id
                    and other.mode.is_proxied
                    and Mode.EXCLUSIVE in (other.mode, registration.mode)
                    and not other.has_expired(now_s)
                    and _overlaps(piece, other)
                ):
                    return other
        return None

    def record_attempt(self, registration: Registration, *, succeeded: bool) -> None:
        """Count a request to a source; the counts are stored with the next commit.

        A failure starts the cooldown that the registration sets.
        """
        attempts, at = registration.attempts, timestamp_now()
        attempts.sent += 1
        if succeeded:
            attempts.last_success = at
            attempts.cooldown_until_s = float("-inf")
        else:
            attempts.failed += 1
            attempts.last_failure = at
            attempts.cooldown_until_s = time.monotonic() + registration.management.cooldown_s
        if registration.id in self._all:  # it may have been deleted during the request
            self._store_attempts(registration)

    def reset_attempts(self, registration: Registration) -> None:
        """Count requests to a source from the start, as for a new owner."""
        registration.attempts.reset()
        self._store_attempts(registration)

    def _store_attempts(self, registration: Registration) -> None:
        key = (DocumentKind.ATTEMPTS, self.tenant, registration.id)
        self._commits.store_later(Entries(documents={key: stored_attempts(registration.attempts)}))

    def restore_attempts(self, registration_id: str, stored: bytes) -> None:
        """Restore the stored counts of a registration."""
        registration = self._all.get(registration_id)
        if registration is not None:
            attempts, fields = registration.attempts, orjson.loads(stored)
            attempts.sent, attempts.failed = fields["sent"], fields["failed"]
            attempts.last_success, attempts.last_failure = fields["lastSuccess"], fields["lastFailure"]

    @staticmethod
    def is_cooling_down(registration: Registration) -> bool:
        """Return whether the source is in its cooldown after a failure."""
        return time.monotonic() < registration.attempts.cooldown_until_s

    def _candidates(self, target: EntityTarget) -> Iterable[Registration]:
        candidates: dict[str, Registration] = dict(self._of_anything)
        if target.types is not None:
            for kind in target.types:
                candidates.update(self._by_type.get(kind, {}))
        elif target.ids is not None:
            for entity_id in target.ids:
                candidates.update(self._by_id.get(entity_id, {}))
            candidates.update(self._of_groups)
        else:
            return self._all.values()
        return candidates.values()

    def _index(self, registration: Registration) -> None:
        self._all[registration.id] = registration
        if registration.id not in self._places:
            self._added_count += 1
            self._places[registration.id] = self._added_count
        self.is_empty = False
        for index, key in self._index_entries(registration):
            index.setdefault(key, {})[registration.id] = registration
        if any(not piece.entities for piece in registration.information):
            self._of_anything[registration.id] = registration
        if any(entity.id is None for piece in registration.information for entity in piece.entities):
            self._of_groups[registration.id] = registration

    def _unindex(self, registration: Registration) -> None:
        for index, key in self._index_entries(registration):
            entries = index.get(key, {})
            entries.pop(registration.id, None)
            if not entries:
                index.pop(key, None)
        self._of_anything.pop(registration.id, None)
        self._of_groups.pop(registration.id, None)

    def _index_entries(
        self, registration: Registration
    ) -> Iterator[tuple[dict[str, dict[str, Registration]], str]]:
        for piece in registration.information:
            for selector in piece.entities:
                for kind in selector.types:
                    yield self._by_type, kind
                if selector.id is not None:
                    yield self._by_id, selector.id

    def _notify_watchers(self, before: Registration | None, after: Registration | None) -> None:
        for watcher in list(self.watchers):
            watcher(before, after)


def claims(registration: Registration, entity: Entity) -> bool:
    """Return whether an exclusive or redirect registration claims an entity in its current state (clause
    5.9.2.4).

    An exclusive one does if the entity has one of its attributes. A redirect one does if the entity matches
    and has one of its attributes, where it names attributes. Where it names datasets, only their instances
    count.
    """
    return may_hold(registration, entity) and any(
        piece.is_about(entity) and _has_some(entity, piece.attributes, registration.datasets)
        for piece in registration.information
    )


def _has_some(entity: Entity, names: frozenset[str] | None, datasets: frozenset[str | None] | None) -> bool:
    if datasets is None:
        return names is None or not names.isdisjoint(entity.attributes)
    return any(
        dataset_of(instance) in datasets
        for name, instances in entity.attributes.items()
        if names is None or name in names
        for instance in instances
    )


def stored_attempts(attempts: Attempts) -> bytes:
    """Return the counts for the journal."""
    return orjson.dumps(
        {
            "sent": attempts.sent,
            "failed": attempts.failed,
            "lastSuccess": attempts.last_success,
            "lastFailure": attempts.last_failure,
        }
    )


def _overlaps(piece: Information, other: Registration) -> bool:
    """Return whether another registration is about some of the same entities and attributes."""
    for entity in piece.entities or (None,):
        ids = None if entity is None or entity.id is None else (entity.id,)
        pattern, types = (None, None) if entity is None else (entity.id_pattern, entity.types)
        if other.parts(EntityTarget(ids, pattern, types, piece.attributes)):
            return True
    return False
