"""What there is, counted: types, their attributes and of which kinds, kept up with every change.

So discovery (clauses 5.7.5 to 5.7.10) costs what it tells, not what is stored. A change that writes an
attribute anew in the kind it had costs a look-up.
"""

from collections.abc import Mapping

from services.context_broker.entity import Attributes, Entity, Instance

Kinds = dict[str, int]
"""How many instances there are of each kind of attribute."""


class Census:
    """Counts of one tenant's entities; types and attributes are IRIs."""

    def __init__(self) -> None:
        self._entities: dict[str, int] = {}
        self._of_types: dict[str, dict[str, Kinds]] = {}
        self._of_attributes: dict[str, Kinds] = {}

    def note(self, before: Entity | None, after: Entity | None) -> None:
        """Count a change: the entity before and after, None where there is none."""
        if before is not None and after is not None and before.types == after.types:
            self._note_attributes(after.types, before.attributes, after.attributes)
            return
        if before is not None:
            self._count_entity(before, -1)
        if after is not None:
            self._count_entity(after, 1)

    def types(self) -> list[str]:
        """Return the types of which there are entities."""
        return list(self._entities)

    def entities_of(self, kind: str) -> int:
        """Return how many entities of a type there are."""
        return self._entities.get(kind, 0)

    def attributes_of(self, kind: str) -> Mapping[str, Kinds]:
        """Return the attributes that entities of a type have."""
        return self._of_types.get(kind, {})

    def attributes(self) -> list[str]:
        """Return the attributes that entities have."""
        return list(self._of_attributes)

    def kinds_of(self, attribute: str) -> Kinds:
        """Return how many instances of an attribute there are, by kind; none if nobody has it."""
        return self._of_attributes.get(attribute, {})

    def types_with(self, attribute: str) -> list[str]:
        """Return the types of the entities that have an attribute."""
        return [kind for kind, attributes in self._of_types.items() if attribute in attributes]

    def _note_attributes(self, types: tuple[str, ...], old: Attributes, new: Attributes) -> None:
        for name, instances in new.items():
            was = old.get(name)
            if was is not instances and (was is None or not _alike(was, instances)):
                if was is not None:
                    self._count_attribute(types, name, was, -1)
                self._count_attribute(types, name, instances, 1)
        if not old.keys() <= new.keys():
            for name in old.keys() - new.keys():
                self._count_attribute(types, name, old[name], -1)

    def _count_entity(self, entity: Entity, step: int) -> None:
        for kind in entity.types:
            _count(self._entities, kind, step)
        for name, instances in entity.attributes.items():
            self._count_attribute(entity.types, name, instances, step)

    def _count_attribute(
        self, types: tuple[str, ...], name: str, instances: list[Instance], step: int
    ) -> None:
        for instance in instances:
            said = instance["type"]
            _count_in(self._of_attributes, name, said, step)
            for kind in types:
                _count_in(self._of_types.setdefault(kind, {}), name, said, step)
        for kind in types:
            if not self._of_types.get(kind, True):
                del self._of_types[kind]


def _alike(was: list[Instance], now: list[Instance]) -> bool:
    """Say whether instances count as others do."""
    if len(was) == len(now) == 1:
        return bool(was[0]["type"] == now[0]["type"])
    return [one["type"] for one in was] == [one["type"] for one in now]


def _count_in(counts: dict[str, Kinds], name: str, said: str, step: int) -> None:
    kinds = counts.setdefault(name, {})
    _count(kinds, said, step)
    if not kinds:
        del counts[name]


def _count(counts: dict[str, int], name: str, step: int) -> None:
    number = counts.get(name, 0) + step
    if number:
        counts[name] = number
    else:
        del counts[name]
