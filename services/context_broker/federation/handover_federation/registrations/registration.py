"""A context source registration, ready for matching (clauses 5.2.8 to 5.2.11 and 5.2.34).

`registration_parser` reads and validates documents, `registry` finds the registrations that match a target.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Any, Final

from handover_broker.model.context import Context
from handover_broker.model.entity import Entity
from handover_broker.model.owner import OWNER, Owner
from handover_broker.model.secrets import hidden_members, without_secrets
from handover_broker.query.patterns import Pattern, fits
from handover_federation.registrations.operation_names import DEFAULT_GROUP, TEMPORAL

API_ROOT: Final = "/ngsi-ld/v1"
TYPE: Final = "ContextSourceRegistration"
SECRETS: Final = ("endpoint", "contextSourceInfo")
"""Where a registration has secrets: its address first."""
PROPERTIES: Final = "properties"
"""The member of the stored document with the registration's own properties, by IRI."""


class Mode(IntEnum):
    """How a source and the broker share entities (clause 4.3.6), in the order of priority.

    EXCLUSIVE: only the source has the attributes of one entity; REDIRECT: only sources have the matching
    entities; INCLUSIVE: both may have them; AUXILIARY: the source only fills gaps.
    """

    EXCLUSIVE = 0
    REDIRECT = 1
    INCLUSIVE = 2
    AUXILIARY = 3

    @property
    def is_proxied(self) -> bool:
        """Return whether the broker stores nothing that the source has (clause 4.3.6.3)."""
        return self <= Mode.REDIRECT


@dataclass(frozen=True, slots=True)
class EntityTarget:
    """The entities and attributes of an operation; None stands for all. Types and attributes are IRIs.

    `types` are all types in a type selection: a source with any of them may have matches. `ids` take
    precedence over `id_pattern`.
    """

    ids: tuple[str, ...] | None = None
    id_pattern: Pattern | None = None
    types: frozenset[str] | None = None
    attributes: frozenset[str] | None = None


@dataclass(frozen=True, slots=True)
class MatchedPart:
    """The part of a target that matches one EntityInfo of a registration; None stands for the whole target.

    `types` are the registered types among those of the target, or all registered types if it has none.
    """

    ids: tuple[str, ...] | None
    types: frozenset[str] | None
    attributes: frozenset[str] | None


@dataclass(frozen=True, slots=True)
class EntityInfo:
    """Entities of a source (clause 5.2.8): of one of `types`, with the id or a matching id."""

    types: frozenset[str]
    id: str | None = None
    id_pattern: Pattern | None = None

    def has(self, entity_id: str) -> bool:
        """Return whether an entity with this id matches."""
        if self.id is not None:
            return self.id == entity_id
        return self.id_pattern is None or fits(self.id_pattern, entity_id)

    def served(self, target: EntityTarget) -> tuple[tuple[str, ...] | None, frozenset[str]] | None:
        """Return the ids and types of the target that match; None if nothing does."""
        types = self.types if target.types is None else target.types & self.types
        if not types:
            return None
        if target.ids is not None:
            ids = tuple(entity_id for entity_id in target.ids if self.has(entity_id))
            return (ids, types) if ids else None
        if self.id is None:  # two patterns are not compared; they may have a common match
            return None, types
        if target.id_pattern is not None and not fits(target.id_pattern, self.id):
            return None
        return (self.id,), types


@dataclass(frozen=True, slots=True)
class Information:
    """One piece of registration information (clause 5.2.10).

    Without `entities` it is about any entity; without `attributes` (IRIs) about all attributes.
    """

    entities: tuple[EntityInfo, ...] = ()
    attributes: frozenset[str] | None = None

    def served(self, target: EntityTarget) -> tuple[MatchedPart, ...]:
        """Return the matching parts of the target, one for each EntityInfo."""
        attributes = self.attributes
        if attributes is not None and target.attributes is not None:
            attributes = attributes & target.attributes
            if not attributes:
                return ()
        elif attributes is None:
            attributes = target.attributes
        if not self.entities:
            return (MatchedPart(target.ids, target.types, attributes),)
        parts = (entity.served(target) for entity in self.entities)
        return tuple(MatchedPart(*part, attributes) for part in parts if part is not None)

    def is_about(self, entity: Entity) -> bool:
        """Return whether the information is about an entity."""
        return not self.entities or any(
            selector.has(entity.id) and not selector.types.isdisjoint(entity.types)
            for selector in self.entities
        )


@dataclass(frozen=True, slots=True)
class Management:
    """Management of a source (clause 5.2.34).

    `local_only`: its requests carry local=true. `cache_s`: lifetime of a cached response. `timeout_s`:
    timeout of a response, None for the broker's default. `cooldown_s`: pause after a failure.
    """

    local_only: bool = False
    cache_s: float = 0.0
    timeout_s: float | None = None
    cooldown_s: float = 0.0


@dataclass(slots=True)
class Attempts:
    """Counts of the requests to a source; times as text."""

    sent: int = 0
    failed: int = 0
    last_success: str | None = None
    last_failure: str | None = None
    cooldown_until_s: float = float("-inf")
    """End of the cooldown on the monotonic clock. Not stored."""

    def reset(self) -> None:
        """Count from the start."""
        self.sent = self.failed = 0
        self.last_success = self.last_failure = None

    def members(self) -> dict[str, Any]:
        """Return the members for a reader of the registration; none before the first attempt."""
        if not self.sent:
            return {}
        shown = {
            "status": "failed" if (self.last_failure or "") > (self.last_success or "") else "ok",
            "timesSent": self.sent,
            "timesFailed": self.failed,
            "lastSuccess": self.last_success,
            "lastFailure": self.last_failure,
        }
        return {name: value for name, value in shown.items() if value is not None}


Interval = tuple[float, float]
"""Start and end in seconds since 1970; an open end is infinite."""


@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """A context source registration (clause 5.2.9). `document` is stored, with expanded names.

    `endpoint` is the root of the source without the path of the API, `tenant` the tenant at the source (""
    for none), `alias` its name in Via. `operations` are single operations, with groups resolved.
    `source_info` has the pairs of contextSourceInfo in their order. `places` maps location, observationSpace
    and operationSpace to geometries. `described` is the registration as an entity, for filters. `datasets`
    are the datasetIds of the source, None for default instances; None as a whole if it may have any.
    The right of the `owner` decides what the source receives, and which of its answers count. `attempts` is
    the only mutable part.
    """

    id: str
    document: Mapping[str, Any]
    context: Context
    information: tuple[Information, ...]
    mode: Mode
    operations: frozenset[str]
    endpoint: str
    tenant: str
    alias: str | None
    source_info: tuple[tuple[str, str], ...]
    scopes: tuple[str, ...]
    places: Mapping[str, Mapping[str, Any]]
    observed: Interval | None
    managed: Interval | None
    datasets: frozenset[str | None] | None
    management: Management
    expires_at_s: float
    described: Entity
    attempts: Attempts = field(default_factory=Attempts)
    owner: Owner | None = None

    def with_attempts_of(self, before: "Registration | None") -> "Registration":
        """Return the changed registration with the counts of the one before; its cooldown ends.

        Both share the counts from then on, because running requests still use the one before.
        """
        if before is None:
            return self
        before.attempts.cooldown_until_s = float("-inf")
        return replace(self, attempts=before.attempts)

    @property
    def shown(self) -> str:
        """The address of the source without secrets, for logs, warnings and records."""
        return without_secrets(self.endpoint)

    def url(self, path: str) -> str:
        """Return the URL of a path (such as "entities/urn:x:1") at the source.

        Endpoints may be registered with /ngsi-ld/v1 at their end or without.
        """
        return f"{self.endpoint}{API_ROOT}/{path}"

    @property
    def is_temporal(self) -> bool:
        """Return whether it is about temporal data (it has an interval), not about current data."""
        return self.observed is not None or self.managed is not None

    def takes(self, operation: str) -> bool:
        """Return whether the source takes an operation, named as in table 4.20-1.

        A registration with an interval takes temporal operations only (clause 5.2.9).
        """
        return operation in self.operations and (operation in TEMPORAL or not self.is_temporal)

    def has_expired(self, now_s: float) -> bool:
        """Return whether it has expired."""
        return self.expires_at_s <= now_s

    def parts(self, target: EntityTarget) -> tuple[MatchedPart, ...]:
        """Return the parts of a target that match the registration."""
        return tuple(part for piece in self.information for part in piece.served(target))

    def relevant(self, targets: Iterable[EntityTarget]) -> list[int]:
        """Return the indexes of the pieces of information that match any of the targets (5.10.2.5)."""
        return [
            place
            for place, piece in enumerate(self.information)
            if any(piece.served(target) for target in targets)
        ]


@dataclass(frozen=True, slots=True)
class Match:
    """A registration with the `parts` of a target that match it: what the source is queried for."""

    registration: Registration
    parts: tuple[MatchedPart, ...]

    @property
    def ids(self) -> tuple[str, ...] | None:
        """Return the distinct ids to query the source for; None if the target's own selection applies."""
        result: dict[str, None] = {}
        for part in self.parts:
            if part.ids is None:
                return None
            result.update(dict.fromkeys(part.ids))
        return tuple(result)

    @property
    def attributes(self) -> frozenset[str] | None:
        """Return the attributes (IRIs) to query the source for; None for all."""
        result: set[str] = set()
        for part in self.parts:
            if part.attributes is None:
                return None
            result |= part.attributes
        return frozenset(result)

    def attributes_for(self, entity_id: str) -> frozenset[str] | None:
        """Return the attributes (IRIs) of one entity to read from the source or to write to it; None for
        all."""
        result: set[str] = set()
        for part in self.parts:
            if part.ids is None or entity_id in part.ids:
                if part.attributes is None:
                    return None
                result |= part.attributes
        return frozenset(result)

    def split_by_ids(self, most_ids: int) -> Iterator["Match"]:
        """Yield matches with at most so many ids each; this match itself if it has no ids."""
        ids = self.ids
        if ids is None or len(ids) <= most_ids:
            yield self
            return
        for start in range(0, len(ids), most_ids):
            some = frozenset(ids[start : start + most_ids])
            parts = (
                replace(part, ids=tuple(filter(some.__contains__, part.ids or ()))) for part in self.parts
            )
            yield Match(self.registration, tuple(part for part in parts if part.ids))

    def among(self, holders: Mapping[str, Iterable[str]]) -> "Match":
        """Return the match limited to entities of which the registration is one of the `holders`."""
        mine = self.registration.id
        narrowed = (
            replace(
                part,
                ids=tuple(
                    entity_id for entity_id in part.ids or holders if mine in holders.get(entity_id, ())
                ),
            )
            for part in self.parts
        )
        return Match(self.registration, tuple(part for part in narrowed if part.ids))


SourceFilter = Callable[[Registration], bool]
"""A further condition on registrations, such as a context source filter."""


def root_of(endpoint: str) -> str:
    """Return the root of an endpoint: without the path of the API and without a trailing slash."""
    return endpoint.rstrip("/").removesuffix(API_ROOT).rstrip("/")


def shown_document(
    registration: Registration,
    context: Context,
    *,
    sys_attrs: bool,
    pieces: list[int] | None = None,
    has_counts: bool = True,
) -> dict[str, Any]:
    """Return a registration as a document in the reader's names and, unless it may not see them, its counts.

    `pieces` (indexes into its information) limits it to what matched a query; None shows all.
    """
    compact = context.terms.compact
    document: dict[str, Any] = {
        "id": registration.id,
        "type": TYPE,
        **hidden_members(registration.document, *SECRETS),
    }
    document.pop("context", None)
    document.pop(OWNER, None)
    properties = document.pop(PROPERTIES, {})
    if not sys_attrs:
        document.pop("createdAt", None)
        document.pop("modifiedAt", None)
    shown = document["information"] if pieces is None else [document["information"][at] for at in pieces]
    document["information"] = [_shown_information(piece, compact) for piece in shown]
    document.setdefault("mode", "inclusive")
    is_for_gaps = registration.mode is Mode.AUXILIARY
    document.setdefault("operations", ["retrieveOps" if is_for_gaps else DEFAULT_GROUP])
    if has_counts:
        document.update(registration.attempts.members())
    for name, value in properties.items():
        document[compact(name)] = value
    return document


def _shown_information(stored: Mapping[str, Any], compact: Callable[[str], str]) -> dict[str, Any]:
    piece: dict[str, Any] = {}
    for name, value in stored.items():
        if name == "entities":
            piece[name] = [_shown_entity_info(entity_info, compact) for entity_info in value]
        else:
            piece[name] = [compact(term) for term in value]
    return piece


def _shown_entity_info(stored: Mapping[str, Any], compact: Callable[[str], str]) -> dict[str, Any]:
    kinds = stored["type"]
    return {
        **stored,
        "type": [compact(kind) for kind in kinds] if isinstance(kinds, list) else compact(kinds),
    }
