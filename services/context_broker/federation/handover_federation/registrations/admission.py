"""Admission: what a context source receives, and which of its answers count, by the right of its owner.

The right of the owner is checked for each entity (`delivery.disclosure` explains owners). Entities that the
owner may not see are neither sent to its source nor taken from it, and such a source does not hide what the
broker stores itself. A client that asks is limited by its own store besides.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

from handover_broker.delivery.disclosure import Receiver, Receivers
from handover_broker.model.entity import Entity
from handover_broker.storage.store import Store
from handover_federation.registrations.registration import Match, MatchedPart, Registration


@dataclass(frozen=True, slots=True)
class Admission:
    """Decides for the sources of one tenant. `store` is the tenant's as the client of a request sees it."""

    receivers: Receivers
    tenant: str
    store: Store

    async def prepare(self, registrations: Iterable[Registration]) -> None:
        """Verify the rights of the owners, where that is possible; others may see nothing private."""
        await self.receivers.prepare(registration.owner for registration in registrations)

    async def record(self, registration: Registration, entity_id: str, types: Iterable[str] = ()) -> None:
        """Record that an entity is sent to a source, if it is private. Raises `Unverified` if it cannot."""
        receiver = self._receiver(registration)
        if receiver is None or not self.is_private(entity_id, types):
            return
        entity = self.store.get(entity_id) or Entity(entity_id, tuple(types), {}, "", "")
        name = receiver.private_name(entity) or entity_id
        await self.receivers.record(registration.owner, "forwarded request", registration.shown, (name,))

    def is_private(self, entity_id: str, types: Iterable[str] = ()) -> bool:
        """Return whether an entity is about the body of a person here, or with these types (IRIs)."""
        return self.receivers.is_private(entity_id, (*types, *self.store.types_of(entity_id)))

    def admits(self, registration: Registration, entity_id: str, types: Iterable[str] = ()) -> bool:
        """Return whether a source may receive an entity, and its answer about the entity counts."""
        receiver = self._receiver(registration)
        return receiver is None or receiver.may_see(entity_id, is_private=self.is_private(entity_id, types))

    def narrowed(self, match: Match, *, changes: bool = False) -> Match | None:
        """Return a match without what the owner or the client may not see; None if nothing is left.

        With `changes`, the client must be allowed to see everything that is matched.
        """
        receiver = self._receiver(match.registration)
        may_client = self.store.may_see_private(somewhere=not changes)
        if receiver is None and may_client and self.store.may_see_private(somewhere=False):
            return match
        may_all = may_client and (receiver is None or receiver.may_see_private())
        parts = [
            part
            for matched in match.parts
            if (part := self._part(match.registration, matched, may_all=may_all)) is not None
            and (may_all or not changes or part.types or part.ids is not None)
        ]
        return Match(match.registration, tuple(parts)) if parts else None

    def _part(self, registration: Registration, part: MatchedPart, *, may_all: bool) -> MatchedPart | None:
        kinds = part.types or frozenset()
        private = frozenset(kind for kind in kinds if self.receivers.is_private("", (kind,)))
        if part.ids is not None:
            types = kinds if kinds and private == kinds else ()
            ids = tuple(
                entity_id
                for entity_id in part.ids
                if self.admits(registration, entity_id, types) and not self.store.hides(entity_id, types)
            )
            return replace(part, ids=ids) if ids else None
        if may_all or not private:
            return part
        return None if private == kinds else replace(part, types=kinds - private)

    def _receiver(self, registration: Registration) -> Receiver | None:
        return self.receivers.strict(registration.owner, self.tenant)
