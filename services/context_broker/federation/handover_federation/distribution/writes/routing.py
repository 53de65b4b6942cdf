"""Routes the parts of a write to the sources and to the broker itself (clauses 4.3.6.2 and 4.3.6.3).

1. Instances of an exclusive source go to that source only.
2. Of the rest, instances of redirect sources go to each of them.
3. What remains is written by the broker itself, and by inclusive sources as well.

Example: an entity has a, b and c. An exclusive source has a, an inclusive one has b. The exclusive source
gets a, the inclusive one b, the broker b and c.
"""

from collections.abc import Iterable
from dataclasses import dataclass

from handover_broker.model.entity import Entity
from handover_federation.distribution.distributed_operations import Sources
from handover_federation.distribution.instances import ANY, Instances, instances_of_source
from handover_federation.registrations.operation_names import TEMPORAL
from handover_federation.registrations.registration import (
    EntityTarget,
    Mode,
    Registration,
    SourceFilter,
)

Names = frozenset[str]


@dataclass(frozen=True, slots=True)
class WriteRoute:
    """The part of a write for one source.

    `operation` is the one that the source takes, None if it takes none that fits: then this part fails.
    """

    registration: Registration
    instances: Instances
    operation: str | None

    @property
    def names(self) -> Names:
        """Return the attributes (IRIs) of the instances."""
        return frozenset(iri for iri, _ in self.instances)


@dataclass(frozen=True, slots=True)
class WriteRouting:
    """The parts of a write; `own` are the instances that the broker writes, None if it writes nothing."""

    others: tuple[WriteRoute, ...]
    own: Instances | None

    @property
    def own_names(self) -> Names:
        """Return the attributes (IRIs) that the broker writes."""
        return frozenset(iri for iri, _ in self.own or ())


def route_write(
    sources: Sources,
    operations: tuple[str, ...],
    target: EntityTarget,
    instances: Instances | None,
    where: SourceFilter | None = None,
) -> WriteRouting:
    """Return the parts of a write of one entity.

    `operations` are the names under which a source may take it, the preferred first. `instances` are those
    that are written, None for a write of the entity as a whole (a deletion). `where` filters the sources.
    Raises a problem (403) if the client may not see the entity.
    """
    matches = _matching_sources(sources, operations, target, where)
    remaining, is_elsewhere, others = instances or frozenset(), False, list[WriteRoute]()
    for mode in (Mode.EXCLUSIVE, Mode.REDIRECT, Mode.INCLUSIVE):
        taken: set[tuple[str, str | None]] = set()
        for source, theirs, operation in matches:
            if source.mode is not mode or (operation is None and not mode.is_proxied):
                continue
            part = instances_of_source(source, remaining, theirs)
            if instances is not None and not part and (instances or theirs is not None):
                continue
            others.append(WriteRoute(source, part, operation))
            if mode.is_proxied:
                taken |= {slot for slot in part if slot[1] != ANY or source.datasets is None}
                is_elsewhere = is_elsewhere or (theirs is None and source.datasets is None)
        remaining -= taken
    if instances is None:
        return WriteRouting(tuple(others), frozenset())
    proxied = any(match.registration.mode.is_proxied for match in others)
    stays = bool(remaining) or (not is_elsewhere and not (instances and proxied))
    return WriteRouting(tuple(others), remaining if stays else None)


def _matching_sources(
    sources: Sources, operations: tuple[str, ...], target: EntityTarget, where: SourceFilter | None
) -> Iterable[tuple[Registration, Names | None, str | None]]:
    """Return the matching sources with their attributes (None: all) and the operation that they take."""
    matches = []
    (entity_id,), types = target.ids or (), target.types or frozenset()
    store = sources.request.tenant.store
    store.latest(entity_id)  # it refuses a change of what the client may not see
    store.require_shown(Entity(entity_id, tuple(types), {}, "", ""))
    for match in sources.registry.matching_any((target,), where):
        if match.mode is Mode.AUXILIARY or sources.has_visited(match):
            continue
        if not sources.admission.admits(match, entity_id, types):
            continue
        names: set[str] | None = set()
        for part in match.parts(target):
            names = None if names is None or part.attributes is None else names | part.attributes
        operation = next((name for name in operations if match.takes(name)), None)
        if operation is None and (match.is_temporal or not TEMPORAL.isdisjoint(operations)):
            continue  # a registration for current data does not claim temporal data, nor the other way round
        matches.append((match, None if names is None else frozenset(names), operation))
    return matches
