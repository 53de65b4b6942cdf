"""Gathering: what sources have told of the entities that one request is about (clauses 4.3.6.2 and 4.3.6.3).

Each tells what it is registered for; what an exclusive or redirect source has is taken from nobody else.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

from services.context_broker.federation.distribution.fragments import Fragment, merged
from services.context_broker.federation.registrations.coverage import may_hold
from services.context_broker.federation.registrations.registration import Mode, Registration
from services.context_broker.model.attribute_selection import select_attributes
from services.context_broker.model.entity import Entity, dataset_of
from services.context_broker.storage.store import Store


@dataclass(slots=True)
class FragmentCollector:
    """What is known of the entities that a request is about."""

    fragments: dict[str, list[Fragment]] = field(default_factory=dict)

    def add(self, registration: Registration, entities: Iterable[Entity]) -> None:
        """Take what a source has told, as far as its registration is about it."""
        for entity in entities:
            part = about(registration, entity)
            if part is not None:
                rank = (int(registration.mode) + 1, registration.id)
                fills_gaps = registration.mode is Mode.AUXILIARY
                self.fragments.setdefault(entity.id, []).append(Fragment(part, rank, fills_gaps))

    def origins(self, store: Store) -> dict[str, list[str]]:
        """Return who told of each entity, by registration; `@none` for the broker itself (clause 5.2.39)."""
        return {
            one: ([] if store.get(one) is None else ["@none"])
            + list(dict.fromkeys(fragment.rank[1] for fragment in fragments))
            for one, fragments in self.fragments.items()
        }

    def entity(self, own: Entity | None, entity_id: str, proxied: list[Registration]) -> Entity | None:
        """Return the entity that the broker's own fragment and the others are part of, None if there is none.

        What an exclusive or redirect source has is not taken from anybody else (clause 4.3.6.3).
        """
        fragments = list(self.fragments.get(entity_id, ()))
        if own is not None:
            fragments.append(Fragment(own, (0, "")))
        if proxied:
            fragments = [
                Fragment(left, one.rank, one.fills_gaps)
                for one in fragments
                if (left := unclaimed(one, proxied)) is not None
            ]
        return merged(fragments) if fragments else None


def about(registration: Registration, entity: Entity) -> Entity | None:
    """Return what of an entity its source is registered for, None if nothing is."""
    names: set[str] | None = set()
    is_about = False
    for piece in registration.information:
        if piece.is_about(entity):
            is_about = True
            names = None if names is None or piece.attributes is None else names | piece.attributes
    if not is_about:
        return None
    part = select_attributes(entity, None if names is None else frozenset(names))
    return part if registration.datasets is None else _of_datasets(part, registration.datasets, keep=True)


def unclaimed(fragment: Fragment, proxied: list[Registration]) -> Entity | None:
    """Return a fragment without what sources with a stronger claim have; None if that is all of it."""
    left = fragment.entity
    for one in proxied:
        if fragment.rank[0] and fragment.rank[0] <= int(one.mode) + 1:
            continue
        if not may_hold(one, fragment.entity):
            continue
        for piece in one.information:
            if piece.is_about(fragment.entity):
                if one.datasets is not None:
                    claimed = left if piece.attributes is None else select_attributes(left, piece.attributes)
                    rest = _of_datasets(claimed, one.datasets, keep=False)
                    left = replace(left, attributes={**left.attributes, **rest.attributes}, rendered={})
                    gone = claimed.attributes.keys() - rest.attributes.keys()
                    left = select_attributes(left, None, frozenset(gone))
                elif piece.attributes is None:
                    return None
                else:
                    left = select_attributes(left, None, piece.attributes)
    return left


def _of_datasets(entity: Entity, datasets: frozenset[str | None], *, keep: bool) -> Entity:
    """Return the entity with no instances but those of the datasets; with `keep` false, without these."""
    kept = {
        name: some
        for name, instances in entity.attributes.items()
        if (some := [one for one in instances if (dataset_of(one) in datasets) is keep])
    }
    return replace(entity, attributes=kept, rendered={})
