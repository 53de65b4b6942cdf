"""The registry: all registrations of a tenant, and which of them can serve what.

Registrations are few and asked for at every request, so they are filed by type and by id when they come, and
an empty registry (the usual case) costs its asker one look at `is_empty`.
"""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Final

import orjson

from services.context_broker.federation.registrations.coverage import may_hold
from services.context_broker.federation.registrations.registration import (
    Attempts,
    EntityTarget,
    Information,
    Match,
    Mode,
    Registration,
    SourceFilter,
)
from services.context_broker.model.entity import Entity, dataset_of
from services.context_broker.model.validation import timestamp_now
from services.context_broker.storage.commits import Commits
from services.context_broker.storage.entries import Entries, Kind

Watcher = Callable[[Registration | None, Registration | None], None]
"""Is told how a registration was before and is after a change that is safe; None where there is none."""

ANY: Final = EntityTarget()


class Registry:
    """The registrations of one tenant. It is told what is kept already: writing them is not its task."""

    def __init__(self, tenant: str, commits: Commits) -> None:
        self.tenant = tenant
        self.is_empty = True
        """Whether no operation can have to do with another source: look here before anything else."""
        self.watchers: list[Watcher] = []
        """Called on the loop after each change, a restart's taking up aside."""
        self._commits = commits
        self._all: dict[str, Registration] = {}
        self._places: dict[str, int] = {}
        self._made = 0
        self._by_type: dict[str, dict[str, Registration]] = {}
        self._by_id: dict[str, dict[str, Registration]] = {}
        self._of_groups: dict[str, Registration] = {}
        self._of_anything: dict[str, Registration] = {}

    def __len__(self) -> int:
        return len(self._all)

    def __iter__(self) -> Iterator[Registration]:
        """Yield all registrations, the oldest first; expired ones too."""
        return iter(list(self._all.values()))

    def get(self, registration_id: str) -> Registration | None:
        """Return a registration; an expired one is not there any more."""
        found = self._all.get(registration_id)
        return None if found is None or found.has_expired(time.time()) else found

    def holds(self, registration: Registration) -> bool:
        """Say whether this very registration is in force, neither changed nor deleted since."""
        return self._all.get(registration.id) is registration

    def load(self, registration: Registration) -> None:
        """Take up what was kept before a restart; nobody is told."""
        self._index(registration)

    def put(self, registration: Registration) -> None:
        """Heed a new or a changed registration from now on; a changed one keeps its place."""
        before = self._all.get(registration.id)
        if before is not None:
            self._unindex(before)
        self._index(registration)
        self._notify_watchers(before, registration)

    def remove(self, registration_id: str) -> None:
        """Forget a registration."""
        before = self._all.pop(registration_id)
        del self._places[registration_id]
        self._unindex(before)
        self.is_empty = not self._all
        self._notify_watchers(before, None)

    def remove_if_held(self, registration: Registration) -> None:
        """Forget a registration unless it was changed or deleted meanwhile."""
        if self.holds(registration):
            self.remove(registration.id)

    def matching(
        self, operation: str | tuple[str, ...], target: EntityTarget = ANY, where: SourceFilter | None = None
    ) -> list[Match]:
        """Return the registrations whose source takes `operation` and may serve some of what is `asked`.

        `operation` is named as in table 4.20-1; of several, any will do. The matches come in the order of
        `Mode` (exclusive, redirect, inclusive, auxiliary), those of one mode in the order of creation. What
        an exclusive or redirect source has is not taken from the parts of the others: that is for the asker
        to do, who knows what the operation means (clause 4.3.6.3).
        """
        if self.is_empty:
            return []
        now_s = time.time()
        names = (operation,) if isinstance(operation, str) else operation
        found = [
            Match(one, parts)
            for one in self._candidates(target)
            if any(one.takes(name) for name in names)
            and not one.has_expired(now_s)
            and (parts := one.parts(target))
            and (where is None or where(one))
        ]
        return sorted(found, key=lambda match: (match.registration.mode, self._places[match.registration.id]))

    def concerned(
        self, targets: Sequence[EntityTarget], where: SourceFilter | None = None
    ) -> list[Registration]:
        """Return the registrations that any of the questions concerns, whatever they take; oldest first."""
        now_s = time.time()
        concerned = {one.id for target in targets for one in self._candidates(target) if one.parts(target)}
        return [
            one
            for one in self._all.values()
            if one.id in concerned and not one.has_expired(now_s) and (where is None or where(one))
        ]

    def conflicting_with(self, registration: Registration) -> Registration | None:
        """Return an exclusive registration that leaves no room for another proxied one (clause 4.3.6.3).

        An exclusive registration excludes others of the same entity and attribute: exclusive and redirect
        ones; a redirect one excludes exclusive ones that come later.
        """
        if not registration.mode.is_proxied:
            return None
        now_s = time.time()
        for piece in registration.information:
            for one in self._all.values():
                if (
                    one.id != registration.id
                    and one.mode.is_proxied
                    and Mode.EXCLUSIVE in (one.mode, registration.mode)
                    and not one.has_expired(now_s)
                    and _overlaps(piece, one)
                ):
                    return one
        return None

    def record_attempt(self, registration: Registration, *, succeeded: bool) -> None:
        """Count an operation that was passed on; the counts are written in passing.

        After a failure the source is to rest as long as its registration says: `rests` tells.
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
        if registration.id in self._all:  # it may have been deleted while its source was asked
            key = (Kind.ATTEMPTS, self.tenant, registration.id)
            self._commits.store_later(Entries(documents={key: stored_attempts(attempts)}))

    def restore_attempts(self, registration_id: str, kept: bytes) -> None:
        """Take the counts kept for a registration, from before a restart."""
        found = self._all.get(registration_id)
        if found is not None:
            attempts = found.attempts
            attempts.sent, attempts.failed, attempts.last_success, attempts.last_failure = orjson.loads(kept)

    @staticmethod
    def is_cooling_down(registration: Registration) -> bool:
        """Say whether the source has failed so lately that it is to be left alone."""
        return time.monotonic() < registration.attempts.cooldown_until_s

    def _candidates(self, target: EntityTarget) -> Iterable[Registration]:
        found: dict[str, Registration] = dict(self._of_anything)
        if target.types is not None:
            for kind in target.types:
                found.update(self._by_type.get(kind, {}))
        elif target.ids is not None:
            for one in target.ids:
                found.update(self._by_id.get(one, {}))
            found.update(self._of_groups)
        else:
            return self._all.values()
        return found.values()

    def _index(self, registration: Registration) -> None:
        self._all[registration.id] = registration
        if registration.id not in self._places:
            self._made += 1
            self._places[registration.id] = self._made
        self.is_empty = False
        for index, key in self._index_entries(registration):
            index.setdefault(key, {})[registration.id] = registration
        if any(not piece.entities for piece in registration.information):
            self._of_anything[registration.id] = registration
        if any(one.id is None for piece in registration.information for one in piece.entities):
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
            for one in piece.entities:
                for kind in one.types:
                    yield self._by_type, kind
                if one.id is not None:
                    yield self._by_id, one.id

    def _notify_watchers(self, before: Registration | None, after: Registration | None) -> None:
        for watcher in list(self.watchers):
            watcher(before, after)


def claims(registration: Registration, entity: Entity) -> bool:
    """Say whether an exclusive or redirect registration is about an entity as it is (clause 5.9.2.4).

    An exclusive one is if the entity has one of its attributes, a redirect one if the entity is one of those
    that it is about and has, where it names attributes, one of them. Where it names datasets, only instances
    of these count.
    """
    return may_hold(registration, entity) and any(
        piece.is_about(entity) and _has_some(entity, piece.attributes, registration.datasets)
        for piece in registration.information
    )


def _has_some(entity: Entity, names: frozenset[str] | None, datasets: frozenset[str | None] | None) -> bool:
    if datasets is None:
        return names is None or not names.isdisjoint(entity.attributes)
    return any(
        dataset_of(one) in datasets
        for name, instances in entity.attributes.items()
        if names is None or name in names
        for one in instances
    )


def stored_attempts(attempts: Attempts) -> bytes:
    """Return the counts as they are kept."""
    return orjson.dumps([attempts.sent, attempts.failed, attempts.last_success, attempts.last_failure])


def _overlaps(piece: Information, other: Registration) -> bool:
    """Say whether another registration is about some of the same entities and attributes."""
    for one in piece.entities or (None,):
        ids = None if one is None or one.id is None else (one.id,)
        pattern, types = (None, None) if one is None else (one.id_pattern, one.types)
        if other.parts(EntityTarget(ids, pattern, types, piece.attributes)):
            return True
    return False
