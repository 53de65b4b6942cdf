"""Shares: which part of a change goes to which source, and which stays here (clauses 4.3.6.2 and 4.3.6.3).

What an exclusive source has goes there and nowhere else; of the rest, what redirect sources have goes to all
of these; what then remains is the broker's own and goes to inclusive sources besides.
"""

from collections.abc import Iterable
from dataclasses import dataclass

from services.context_broker.federation.distribution.distributed_operations import Sources
from services.context_broker.federation.distribution.instances import ANY, Instances, had_by
from services.context_broker.federation.registrations.operation_names import TEMPORAL
from services.context_broker.federation.registrations.registration import (
    EntityTarget,
    Mode,
    Registration,
    SourceFilter,
)

Names = frozenset[str]


@dataclass(frozen=True, slots=True)
class WriteRoute:
    """What one source is to do, with which instances of attributes.

    `operation` is what it takes, None if it takes nothing that would do: then its part cannot be done.
    """

    registration: Registration
    instances: Instances
    operation: str | None

    @property
    def names(self) -> Names:
        """Return the attributes (IRIs) that it is about."""
        return frozenset(iri for iri, _ in self.instances)


@dataclass(frozen=True, slots=True)
class WriteRouting:
    """How a change is shared; `own` are the instances that stay, None if nothing is to be done here."""

    others: tuple[WriteRoute, ...]
    own: Instances | None

    @property
    def own_names(self) -> Names:
        """Return the attributes (IRIs) of which instances stay."""
        return frozenset(iri for iri, _ in self.own or ())


def route_write(
    sources: Sources,
    operations: tuple[str, ...],
    target: EntityTarget,
    instances: Instances | None,
    where: SourceFilter | None = None,
) -> WriteRouting:
    """Return who does what of a change of one entity.

    `operations` are the names under which a source may take it, the best first. `instances` are those of
    attributes that the change is about, None if it is about the entity as such (its end). `where` says which
    sources may have it at all.
    """
    found = _concerned(sources, operations, target, where)
    remaining, is_elsewhere, others = instances or frozenset(), False, list[WriteRoute]()
    for mode in (Mode.EXCLUSIVE, Mode.REDIRECT, Mode.INCLUSIVE):
        taken: set[tuple[str, str | None]] = set()
        for one, theirs, operation in found:
            if one.mode is not mode or (operation is None and not mode.is_proxied):
                continue
            part = had_by(one, remaining, theirs)
            if instances is not None and not part and (instances or theirs is not None):
                continue
            others.append(WriteRoute(one, part, operation))
            if mode.is_proxied:
                taken |= {each for each in part if each[1] != ANY or one.datasets is None}
                is_elsewhere = is_elsewhere or (theirs is None and one.datasets is None)
        remaining -= taken
    if instances is None:
        return WriteRouting(tuple(others), frozenset())
    proxied = any(one.registration.mode.is_proxied for one in others)
    stays = bool(remaining) or (not is_elsewhere and not (instances and proxied))
    return WriteRouting(tuple(others), remaining if stays else None)


def _concerned(
    sources: Sources, operations: tuple[str, ...], target: EntityTarget, where: SourceFilter | None
) -> Iterable[tuple[Registration, Names | None, str | None]]:
    """Return the sources that a change concerns, the attributes they have (None: all), and what they take."""
    found = []
    for one in sources.registry.concerned((target,), where):
        if one.mode is Mode.AUXILIARY or sources.has_visited(one):
            continue
        names: set[str] | None = set()
        for part in one.parts(target):
            names = None if names is None or part.attributes is None else names | part.attributes
        operation = next((name for name in operations if one.takes(name)), None)
        if operation is None and (one.is_temporal or not TEMPORAL.isdisjoint(operations)):
            continue  # who has the present does not have the past to itself, nor the other way round
        found.append((one, None if names is None else frozenset(names), operation))
    return found
