"""A registration: which other broker or device knows what, and how it is to be asked.

A context source registers what it can tell or take (clauses 5.2.8 to 5.2.11 and 5.2.34). This is a
registration made ready for matching; `registration_intake` reads what is sent, `registry` finds it.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Any, Final

from services.context_broker.federation.registrations.operation_names import DEFAULT_GROUP, TEMPORAL
from services.context_broker.model.context import Context
from services.context_broker.model.entity import Entity
from services.context_broker.query.patterns import Pattern, fits

API_ROOT: Final = "/ngsi-ld/v1"
TYPE: Final = "ContextSourceRegistration"
PROPERTIES: Final = "properties"
"""Where the kept document has the registration's own properties, by IRI as they were given."""


class Mode(IntEnum):
    """How a source and the broker share entities (clause 4.3.6), in the order in which sources have a say.

    EXCLUSIVE: the source alone has the attributes of one entity; REDIRECT: sources have all that matches and
    the broker has nothing; INCLUSIVE: both may have it; AUXILIARY: the source only fills gaps.
    """

    EXCLUSIVE = 0
    REDIRECT = 1
    INCLUSIVE = 2
    AUXILIARY = 3

    @property
    def is_proxied(self) -> bool:
        """Say whether the broker keeps nothing of what the source has (clause 4.3.6.3)."""
        return self <= Mode.REDIRECT


@dataclass(frozen=True, slots=True)
class EntityTarget:
    """What an operation is about; an absent part (None) stands for all. Types and attributes are IRIs.

    `types` are all types that a type selection names: a source with any of them may have hits. `ids` go
    before `id_pattern`.
    """

    ids: tuple[str, ...] | None = None
    id_pattern: Pattern | None = None
    types: frozenset[str] | None = None
    attributes: frozenset[str] | None = None


@dataclass(frozen=True, slots=True)
class MatchedPart:
    """What of the question one piece of a registration can serve; None stands for all that was asked.

    `types` are those out of the ones asked for that are registered, or those registered where none were.
    """

    ids: tuple[str, ...] | None
    types: frozenset[str] | None
    attributes: frozenset[str] | None


@dataclass(frozen=True, slots=True)
class EntityInfo:
    """Entities that a source has (clause 5.2.8): of one of `types`, with the id or an id that fits."""

    types: frozenset[str]
    id: str | None = None
    id_pattern: Pattern | None = None

    def has(self, entity_id: str) -> bool:
        """Say whether an entity with this id can be among them."""
        if self.id is not None:
            return self.id == entity_id
        return self.id_pattern is None or fits(self.id_pattern, entity_id)

    def served(self, target: EntityTarget) -> tuple[tuple[str, ...] | None, frozenset[str]] | None:
        """Return the ids and types out of those asked for that can be here; None if nothing can."""
        types = self.types if target.types is None else target.types & self.types
        if not types:
            return None
        if target.ids is not None:
            ids = tuple(one for one in target.ids if self.has(one))
            return (ids, types) if ids else None
        if self.id is None:  # whether two patterns have a text in common is not asked: they may
            return None, types
        if target.id_pattern is not None and not fits(target.id_pattern, self.id):
            return None
        return (self.id,), types


@dataclass(frozen=True, slots=True)
class Information:
    """One piece of what a source has (clause 5.2.10).

    Without `entities` it is about any entity; without `attributes` (IRIs) about all their attributes.
    """

    entities: tuple[EntityInfo, ...] = ()
    attributes: frozenset[str] | None = None

    def served(self, target: EntityTarget) -> tuple[MatchedPart, ...]:
        """Return what of the question can be served here, a part for each EntityInfo that can."""
        attributes = self.attributes
        if attributes is not None and target.attributes is not None:
            attributes = attributes & target.attributes
            if not attributes:
                return ()
        elif attributes is None:
            attributes = target.attributes
        if not self.entities:
            return (MatchedPart(target.ids, target.types, attributes),)
        found = (one.served(target) for one in self.entities)
        return tuple(MatchedPart(*one, attributes) for one in found if one is not None)

    def is_about(self, entity: Entity) -> bool:
        """Say whether an entity is one of those that are meant."""
        return not self.entities or any(
            one.has(entity.id) and not one.types.isdisjoint(entity.types) for one in self.entities
        )


@dataclass(frozen=True, slots=True)
class Management:
    """How a source is to be treated (clause 5.2.34).

    `local_only`: it is asked for what it has itself. `cache_s`: an answer may be used again for so long.
    `timeout_s`: how long its answer is waited for, None for the broker's own patience. `cooldown_s`: after a
    failure it is left alone for so long.
    """

    local_only: bool = False
    cache_s: float = 0.0
    timeout_s: float | None = None
    cooldown_s: float = 0.0


@dataclass(slots=True)
class Attempts:
    """What became of the operations that were passed on to a source; times as text."""

    sent: int = 0
    failed: int = 0
    last_success: str | None = None
    last_failure: str | None = None
    cooldown_until_s: float = float("-inf")
    """By the monotonic clock: until then the source is left alone. Not kept across a restart."""

    def members(self) -> dict[str, Any]:
        """Return the members that a reader of the registration gets; none before the first attempt."""
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
    """A context source registration (clause 5.2.9). `document` is what is kept, with expanded names.

    `endpoint` is the source's root without the path of the API, `tenant` the tenant to name there ("" for
    none), `alias` what it calls itself in Via. `operations` are single operations, groups are resolved.
    `source_info` are the pairs of contextSourceInfo in their order. `places` maps location, observationSpace
    and operationSpace to the geometries given. `described` is the registration as an entity, whose attributes
    (its own properties, plain members and places) filters can ask for. `datasets` are the datasetIds that the
    source has, with None for instances that have none; None where it may have any. `attempts` counts on.
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

    def with_attempts_of(self, before: "Registration | None") -> "Registration":
        """Return it with the counts of how it was before a change; its source need not rest any more.

        The counts are the same from then on, for those too that still ask its source as it was.
        """
        if before is None:
            return self
        before.attempts.cooldown_until_s = float("-inf")
        return replace(self, attempts=before.attempts)

    def url(self, path: str) -> str:
        """Return where the source has what is at `path` (such as "entities/urn:x:1") after the API's root.

        Both kinds of endpoints work: those registered with /ngsi-ld/v1 at their end and those without.
        """
        return f"{self.endpoint}{API_ROOT}/{path}"

    @property
    def is_temporal(self) -> bool:
        """Say whether it is about how things were (it has an interval), not about how they are."""
        return self.observed is not None or self.managed is not None

    def takes(self, operation: str) -> bool:
        """Say whether the source takes an operation, named as in table 4.20-1.

        A registration with an interval is about temporal operations alone (clause 5.2.9).
        """
        return operation in self.operations and (operation in TEMPORAL or not self.is_temporal)

    def has_expired(self, now_s: float) -> bool:
        """Say whether it has expired."""
        return self.expires_at_s <= now_s

    def parts(self, target: EntityTarget) -> tuple[MatchedPart, ...]:
        """Return what of a question the source may serve; nothing if it is not concerned."""
        return tuple(part for piece in self.information for part in piece.served(target))

    def relevant(self, targets: Iterable[EntityTarget]) -> list[int]:
        """Return which pieces of its information (by place) any of the questions concerns (5.10.2.5)."""
        return [
            place
            for place, piece in enumerate(self.information)
            if any(piece.served(target) for target in targets)
        ]


@dataclass(frozen=True, slots=True)
class Match:
    """A registration that can serve a question, and `parts` of the question that it can serve.

    The parts together are what the source may be asked for; each is narrower than the question where the
    registration is.
    """

    registration: Registration
    parts: tuple[MatchedPart, ...]

    @property
    def ids(self) -> tuple[str, ...] | None:
        """Return the ids to ask the source for, each once; None when the question's own selection stands."""
        found: dict[str, None] = {}
        for part in self.parts:
            if part.ids is None:
                return None
            found.update(dict.fromkeys(part.ids))
        return tuple(found)

    @property
    def attributes(self) -> frozenset[str] | None:
        """Return the attributes (IRIs) to ask the source for; None for all."""
        found: set[str] = set()
        for part in self.parts:
            if part.attributes is None:
                return None
            found |= part.attributes
        return frozenset(found)

    def attributes_for(self, entity_id: str) -> frozenset[str] | None:
        """Return the attributes (IRIs) of one entity to ask the source for or to send to it; None for all."""
        found: set[str] = set()
        for part in self.parts:
            if part.ids is None or entity_id in part.ids:
                if part.attributes is None:
                    return None
                found |= part.attributes
        return frozenset(found)

    def split_by_ids(self, most_ids: int) -> Iterator["Match"]:
        """Yield the match in pieces with so many ids at most; itself if it does not go by ids."""
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
        """Return the match narrowed to entities of which the registration is one of the `holders`."""
        mine = self.registration.id
        narrowed = (
            replace(part, ids=tuple(one for one in part.ids or holders if mine in holders.get(one, ())))
            for part in self.parts
        )
        return Match(self.registration, tuple(part for part in narrowed if part.ids))


SourceFilter = Callable[[Registration], bool]
"""A further condition on registrations, such as a context source filter."""


def root_of(endpoint: str) -> str:
    """Return the root of a source's endpoint: without the path of the API and without a slash at the end."""
    return endpoint.rstrip("/").removesuffix(API_ROOT).rstrip("/")


def shown_document(
    one: Registration, context: Context, *, sys_attrs: bool, pieces: list[int] | None = None
) -> dict[str, Any]:
    """Return a registration as a reader gets it, in the reader's names and with its counts.

    `pieces` (places in its information) limits it to what was asked for; None shows all.
    """
    compact = context.terms.compact
    document: dict[str, Any] = {"id": one.id, "type": TYPE, **one.document}
    document.pop("context", None)
    properties = document.pop(PROPERTIES, {})
    if not sys_attrs:
        document.pop("createdAt", None)
        document.pop("modifiedAt", None)
    shown = document["information"] if pieces is None else [document["information"][at] for at in pieces]
    document["information"] = [_shown_information(piece, compact) for piece in shown]
    document.setdefault("mode", "inclusive")
    is_for_gaps = one.mode is Mode.AUXILIARY
    document.setdefault("operations", ["retrieveOps" if is_for_gaps else DEFAULT_GROUP])
    document.update(one.attempts.members())
    for name, value in properties.items():
        document[compact(name)] = value
    return document


def _shown_information(kept: Mapping[str, Any], compact: Callable[[str], str]) -> dict[str, Any]:
    piece: dict[str, Any] = {}
    for name, value in kept.items():
        if name == "entities":
            piece[name] = [_shown_entity_info(one, compact) for one in value]
        else:
            piece[name] = [compact(one) for one in value]
    return piece


def _shown_entity_info(kept: Mapping[str, Any], compact: Callable[[str], str]) -> dict[str, Any]:
    kinds = kept["type"]
    return {**kept, "type": [compact(one) for one in kinds] if isinstance(kinds, list) else compact(kinds)}
