"""Disclosure: what may leave the broker for the owner of a subscription or of a registration.

The right of the owner counts, not that of the client whose request causes the message. How it works:

1. A notification is composed when a change is made, with what its owner may see as far as that is known then.
   A `Disclosure` notes the entities about the body of a person that were used: included, joined, or compared
   by `q`. The note is stored with the pending notification.
2. When it is sent, the present rights of the owner are verified. If the owner may not see an entity of the
   note, the notification is composed again from the present state without it; if nothing is left, it is
   dropped. If the rights cannot be verified, it waits.

Services of the cell and, without accounts, everybody receive everything: they have no `Receiver`, and their
notifications cost nothing here. `access.receivers` implements the protocols.
"""

from collections.abc import Iterable, Mapping
from typing import Any, Protocol

import orjson

from handover.security.caller import Caller
from handover_broker.model.entity import Entity
from handover_broker.model.owner import Owner
from handover_broker.query.q_match import Lookup


class Unverified(Exception):
    """The present rights of an owner cannot be verified now; try again later."""


class Receiver(Protocol):
    """What the owner of a subscription or registration may see in one tenant."""

    def shows(self, entity: Entity) -> bool:
        """Return whether the owner may see an entity."""

    def may_see(self, entity_id: str, *, is_private: bool) -> bool:
        """Return whether the owner may see the entity with an id, which is about the body of a person or
        not.
        """

    def may_see_private(self, *, somewhere: bool = False) -> bool:
        """Return whether the owner may see all entities about the bodies of persons, or else some of them."""

    def private_name(self, entity: Entity) -> str | None:
        """Return the resource of an entity about the body of a person in audit records, None for others."""


class Receivers(Protocol):
    """The rights of owners. None as a receiver stands for one that may see everything."""

    def note(self, caller: Caller) -> None:
        """Remember the grants of a caller that changes a subscription or a registration."""

    def passes_credentials_on(self) -> bool:
        """Return whether headers with credentials may be copied from a request: only without accounts."""

    def known(self, owner: Owner | None, tenant: str) -> Receiver | None:
        """Return an owner as far as its rights are known; with unknown rights it may see everything, and
        `verified` decides before anything is sent.
        """

    async def verified(self, owner: Owner | None, tenant: str) -> Receiver | None:
        """Return an owner with its present rights. Raises `Unverified`."""

    def strict(self, owner: Owner | None, tenant: str) -> Receiver | None:
        """Return an owner by its verified rights; with others it may see nothing private."""

    async def prepare(self, owners: Iterable[Owner | None]) -> None:
        """Verify owners where that is possible, so that `strict` knows their present rights."""

    def is_private(self, entity_id: str, types: Iterable[str]) -> bool:
        """Return whether an entity is about the body of a person, by its id or its types (IRIs)."""

    async def record(self, owner: Owner | None, action: str, address: str, resources: Iterable[str]) -> None:
        """Record that private entities are sent to an owner. Raises `Unverified` if that is impossible."""


class Disclosure:
    """Selects what one notification contains for its receiver. `private` are the entities about the body of a
    person that were used, each with its resource in audit records.
    """

    def __init__(self, receiver: Receiver) -> None:
        self._receiver = receiver
        self.private: dict[str, str] = {}

    def admits(self, entity: Entity | None) -> bool:
        """Return whether the receiver may see an entity, and note it if it is private."""
        if entity is None:
            return True
        if not self._receiver.shows(entity):
            return False
        name = self._receiver.private_name(entity)
        if name is not None:
            self.private[entity.id] = name
        return True

    def lookup(self, find: Lookup) -> Lookup:
        """Return `find` without the entities that the receiver may not see."""

        def visible(entity_id: str) -> Entity | None:
            entity = find(entity_id)
            return entity if entity is not None and self.admits(entity) else None

        return visible

    def note(self, taken: bytes | None) -> bytes:
        """Return what is stored with the notification: the note, and the headers `taken` (JSON)."""
        return orjson.dumps(
            {"private": self.private, "headers": None if taken is None else orjson.Fragment(taken)}
        )


def taken_headers(stored: bytes | None) -> list[list[str]]:
    """Return the headers that a pending notification copies from the request that made the change."""
    if stored is None:
        return []
    document: Any = orjson.loads(stored)
    headers = document["headers"] if isinstance(document, dict) else document
    return headers or []


def private_in(stored: bytes | None) -> Mapping[str, str] | None:
    """Return the note of a pending notification; None if it was composed without one."""
    document = None if stored is None else orjson.loads(stored)
    return document["private"] if isinstance(document, dict) else None
