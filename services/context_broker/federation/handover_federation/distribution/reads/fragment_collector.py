"""Collects the fragments of entities that context sources return for one request (clauses 4.3.6.2, 4.3.6.3).

Only the part of a fragment within the source's registration counts. Attributes of an exclusive or redirect
source are taken from that source only.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

from handover_broker.model.attribute_selection import select_attributes
from handover_broker.model.entity import Entity, dataset_of
from handover_broker.storage.store import Store
from handover_federation.distribution.reads.fragments import Fragment, merged
from handover_federation.registrations.admission import Admission
from handover_federation.registrations.coverage import may_hold
from handover_federation.registrations.registration import Mode, Registration


@dataclass(slots=True)
class FragmentCollector:
    """Fragments by entity id; `admission` decides which count."""

    admission: Admission
    fragments: dict[str, list[Fragment]] = field(default_factory=dict)

    def add(self, registration: Registration, entities: Iterable[Entity]) -> None:
        """Add the entities of a source, as far as its registration covers them."""
        for entity in entities:
            part = about(registration, entity)
            if part is not None and self.admission.admits(registration, entity.id, entity.types):
                rank = (int(registration.mode) + 1, registration.id)
                fills_gaps = registration.mode is Mode.AUXILIARY
                self.fragments.setdefault(entity.id, []).append(Fragment(part, rank, fills_gaps))

    def origins(self, store: Store) -> dict[str, list[str]]:
        """Return the registrations that returned each entity; `@none` is the broker itself (clause
        5.2.39)."""
        return {
            entity_id: ([] if store.get(entity_id) is None else ["@none"])
            + list(dict.fromkeys(fragment.rank[1] for fragment in fragments))
            for entity_id, fragments in self.fragments.items()
        }

    def entity(self, own: Entity | None, entity_id: str, proxied: list[Registration]) -> Entity | None:
        """Return the entity merged from the broker's own fragment and the others, None if there is none.

        Attributes of an exclusive or redirect source are not taken from any other (clause 4.3.6.3).
        """
        fragments = list(self.fragments.get(entity_id, ()))
        if own is not None:
            fragments.append(Fragment(own, (0, "")))
        if own is not None:
            proxied = [
                registration
                for registration in proxied
                if self.admission.admits(registration, own.id, own.types)
            ]
        if proxied:
            fragments = [
                Fragment(left, fragment.rank, fragment.fills_gaps)
                for fragment in fragments
                if (left := unclaimed(fragment, proxied)) is not None
            ]
        return merged(fragments) if fragments else None


def about(registration: Registration, entity: Entity) -> Entity | None:
    """Return the part of an entity within a registration, None if there is none."""
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
    """Return a fragment without the parts that belong to proxied sources of higher priority; None if none
    is left."""
    left = fragment.entity
    for registration in proxied:
        if fragment.rank[0] and fragment.rank[0] <= int(registration.mode) + 1:
            continue
        if not may_hold(registration, fragment.entity):
            continue
        for piece in registration.information:
            if piece.is_about(fragment.entity):
                if registration.datasets is not None:
                    claimed = left if piece.attributes is None else select_attributes(left, piece.attributes)
                    rest = _of_datasets(claimed, registration.datasets, keep=False)
                    left = replace(left, attributes={**left.attributes, **rest.attributes}, rendered={})
                    gone = claimed.attributes.keys() - rest.attributes.keys()
                    left = select_attributes(left, None, frozenset(gone))
                elif piece.attributes is None:
                    return None
                else:
                    left = select_attributes(left, None, piece.attributes)
    return left


def _of_datasets(entity: Entity, datasets: frozenset[str | None], *, keep: bool) -> Entity:
    """Return the entity with the instances of these datasets only; with `keep` false, without them."""
    selected = {
        name: some
        for name, instances in entity.attributes.items()
        if (some := [instance for instance in instances if (dataset_of(instance) in datasets) is keep])
    }
    return replace(entity, attributes=selected, rendered={})
