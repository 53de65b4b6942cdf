"""Entity maps: the ids that match a query and the sources that have them, kept for its pages.

A map (clauses 4.5.25, 5.2.39 and 5.5.14) lists the ids of all matches, each with the registrations whose
sources returned it, and `@none` for the broker itself. A query that names a map is answered from its ids,
page by page (`pages`). Of the sources only what a page needs is requested, by the source's own map if it
creates some. Entities that no longer match are removed from the map.
"""

import time
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from typing import Any, Final
from uuid import uuid4

import orjson

from handover.errors import Problem
from handover_broker.model.problems import bad_request_data, not_found, too_many_results
from handover_broker.model.validation import (
    duration_s,
    has_expired,
    moment,
    require_future,
    require_uri,
    shown,
    timestamp,
)
from handover_broker.storage.commits import Commits
from handover_broker.storage.entries import DocumentKind, Entries

OWN: Final = "@none"
"""Stands for the broker itself among the sources of an entity."""
TYPE: Final = "EntityMap"
DEFAULT_LIFETIME_S: Final = 3600.0
MAX_LIFETIME_S: Final = 86400.0
"""A map is for walking through pages, which takes no longer than a day."""
MAX_ENTITIES: Final = 100_000
"""Entities in one map."""
MAX_TOTAL_ENTITIES: Final = 1_000_000
"""Entities in all maps of a tenant; the maps that expire first are deleted for new ones."""


@dataclass(slots=True)
class Listed:
    """Contents of the maps of sources: entities with their registrations, and map ids by registration."""

    entities: dict[str, list[str]] = field(default_factory=dict)
    linked: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class EntityMap:
    """The ids of the entities that match a query, in order, each with its sources.

    `linked` has the ids of the maps that sources created for the same query, by registration. `query` is the
    digest of the query. `is_private`: its `creator` (a subject) may see entities about the bodies of persons,
    so that the map is visible to those who may see them all, and to the creator.
    """

    id: str
    entities: Mapping[str, list[str]]
    expires_at: str
    linked: Mapping[str, str] = field(default_factory=dict)
    query: str = ""
    creator: str = ""
    is_private: bool = True

    def has_expired_at(self, now_s: float) -> bool:
        """Return whether it has expired."""
        return has_expired(self.expires_at, now_s)

    def document(self) -> dict[str, Any]:
        """Return the map for a reader."""
        return {
            "id": self.id,
            "type": TYPE,
            "expiresAt": self.expires_at,
            "entityMap": self.entities,
            "linkedMaps": self.linked,
        }

    def stored(self) -> bytes:
        """Return the map for the journal."""
        return orjson.dumps(
            {
                **self.document(),
                "query": self.query,
                "creator": self.creator,
                "isPrivate": self.is_private,
            }
        )


class EntityMaps:
    """The entity maps of a tenant, stored on disk, with an expiry and a limit."""

    def __init__(self, tenant: str, commits: Commits) -> None:
        self._tenant = tenant
        self._commits = commits
        self._all: dict[str, EntityMap] = {}

    def __iter__(self) -> Iterator[str]:
        """Yield the ids of all maps."""
        return iter(list(self._all))

    def load(self, body: bytes) -> None:
        """Load a stored map."""
        document = orjson.loads(body)
        self._all[document["id"]] = EntityMap(
            document["id"],
            document["entityMap"],
            document["expiresAt"],
            document.get("linkedMaps", {}),
            document.get("query", ""),
            document.get("creator", ""),
            document.get("isPrivate", True),
        )

    def find(self, map_id: str) -> EntityMap | None:
        """Return a map; None if it does not exist or has expired."""
        require_uri(map_id, "the id of an entity map")
        entity_map = self._all.get(map_id)
        return None if entity_map is None or entity_map.has_expired_at(time.time()) else entity_map

    def get(self, map_id: str) -> EntityMap:
        """Return a map; raise a problem (404) if it does not exist or has expired."""
        entity_map = self.find(map_id)
        if entity_map is None:
            raise self.absent(map_id)
        return entity_map

    @staticmethod
    def absent(map_id: str) -> Problem:
        """Return the problem of a map that does not exist, or that the client may not see."""
        return not_found(
            f"there is no entity map {map_id}, or it has expired; make another with GET entityMaps"
        )

    async def make(
        self,
        entities: Mapping[str, list[str]],
        lifetime: str | None,
        linked: Mapping[str, str],
        query: str,
        creator: str,
        *,
        is_private: bool,
    ) -> EntityMap:
        """Store a new map; raises a problem (403) if it has too many entities, `NotStored` if the disk
        refuses."""
        if len(entities) > MAX_ENTITIES:
            raise too_many_results(
                f"{len(entities)} entities answer the query, a map has {MAX_ENTITIES} at most; ask for fewer"
            )
        expires_s = time.time() + lifetime_s(lifetime)
        created = EntityMap(
            f"urn:ngsi-ld:EntityMap:{uuid4()}",
            entities,
            timestamp(datetime.fromtimestamp(expires_s, UTC)),
            linked,
            query,
            creator,
            is_private,
        )
        entries = self._entries(created)
        for gone in self._in_excess_of(len(entities)):
            self._all.pop(gone, None)
            entries.documents[DocumentKind.ENTITY_MAP, self._tenant, gone] = None
        await self._commits.store(entries)
        self._all[created.id] = created
        return created

    async def update(self, map_id: str, document: Any) -> None:
        """Change the expiry of a map, its only mutable member (clauses 5.14.2 and 5.5.14)."""
        entity_map = self.get(map_id)
        if not isinstance(document, Mapping):
            raise bad_request_data(f"a change of an entity map is a JSON object, not {shown(document)}")
        if document.get("type", TYPE) != TYPE:
            raise bad_request_data(f'the type of an entity map is "{TYPE}", not {shown(document["type"])}')
        if "expiresAt" not in document:
            return  # other members are set by the broker and ignored
        wanted_s = moment(require_future(document["expiresAt"], '"expiresAt"')) or 0.0
        ends_s = min(wanted_s, time.time() + MAX_LIFETIME_S)
        changed = replace(entity_map, expires_at=timestamp(datetime.fromtimestamp(ends_s, UTC)))
        await self._commits.store(self._entries(changed))
        self._all[map_id] = changed

    async def drop(self, map_id: str, gone: Collection[str]) -> None:
        """Remove entities from a map if it still exists; readers see the change at once."""
        entity_map = self._all.get(map_id)
        if entity_map is not None:
            left = {
                entity_id: who_has
                for entity_id, who_has in entity_map.entities.items()
                if entity_id not in gone
            }
            self._all[map_id] = changed = replace(entity_map, entities=left)
            await self._commits.store(self._entries(changed))

    async def delete(self, map_id: str) -> None:
        """Delete a map."""
        self.get(map_id)
        await self._commits.store(Entries(documents={(DocumentKind.ENTITY_MAP, self._tenant, map_id): None}))
        self._all.pop(map_id, None)

    def _entries(self, entity_map: EntityMap) -> Entries:
        return Entries(
            documents={(DocumentKind.ENTITY_MAP, self._tenant, entity_map.id): entity_map.stored()}
        )

    def _in_excess_of(self, more: int) -> list[str]:
        """Return the maps to delete: expired ones, and those that expire next if there are too many."""
        now_s = time.time()
        ordered = sorted(self._all.values(), key=lambda other: other.expires_at)
        held = more + sum(1 + len(other.entities) for other in ordered)
        gone: list[str] = []
        for entity_map in ordered:
            if not entity_map.has_expired_at(now_s) and held <= MAX_TOTAL_ENTITIES:
                break
            held -= 1 + len(entity_map.entities)
            gone.append(entity_map.id)
        return gone


def lifetime_s(text: str | None) -> float:
    """Return the lifetime of a map: the requested one within the broker's limits."""
    if text is None:
        return DEFAULT_LIFETIME_S
    return min(max(duration_s(text, "entityMapLifetime"), 1.0), MAX_LIFETIME_S)
