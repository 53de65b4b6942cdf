"""Counts of types, their attributes and the kinds of these, updated with every change.

So discovery (clauses 5.7.5 to 5.7.10) costs as much as its result, independent of the number of entities.
Writing an attribute with the same kind as before costs one look-up.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

from handover_broker.model.entity import Attributes, Entity, Instance

Kinds = dict[str, int]
"""Instances of each kind of attribute."""


@dataclass(slots=True)
class _Group:
    """Entities with the same types: there are few groups, so a change is counted in one place."""

    entities: int = 0
    attributes: dict[str, Kinds] = field(default_factory=dict)


class TypeStatistics:
    """Counts of one tenant's entities; types and attributes are IRIs."""

    def __init__(self) -> None:
        self._groups: dict[tuple[str, ...], _Group] = {}

    def note(
        self, before: Entity | None, after: Entity | None, written: frozenset[str] | None = None
    ) -> None:
        """Count a change: the entity before and after, None if it does not exist.

        `written` are the only attributes that may differ; None if that is unknown.
        """
        if before is not None and after is not None and before.types == after.types:
            counts = self._groups[after.types].attributes
            _note_attributes(counts, before.attributes, after.attributes, written)
            return
        if before is not None:
            group = self._groups[before.types]
            group.entities -= 1
            if group.entities:
                for name, instances in before.attributes.items():
                    _drop(group.attributes, name, instances)
            else:
                del self._groups[before.types]
        if after is not None:
            group = self._groups.get(after.types) or self._groups.setdefault(after.types, _Group())
            group.entities += 1
            _add_all(group.attributes, after.attributes)

    def without(self, is_hidden: Callable[[str], bool]) -> "TypeStatistics":
        """Return the present counts without the entities that have a hidden type (an IRI); read-only."""
        visible = TypeStatistics()
        visible._groups = {
            types: group for types, group in self._groups.items() if not any(map(is_hidden, types))
        }
        return visible

    def types(self) -> list[str]:
        """Return the types that entities have."""
        return list(dict.fromkeys(kind for types in self._groups for kind in types))

    def entities_of(self, kind: str) -> int:
        """Return the number of entities of a type."""
        return sum(group.entities for group in self._of(kind))

    def attributes_of(self, kind: str) -> Mapping[str, set[str]]:
        """Return the attributes of the entities of a type, with their kinds."""
        result: dict[str, set[str]] = {}
        for group in self._of(kind):
            for name, kinds in group.attributes.items():
                result.setdefault(name, set()).update(kinds)
        return result

    def attributes(self) -> list[str]:
        """Return the attributes that entities have."""
        return list(dict.fromkeys(name for group in self._groups.values() for name in group.attributes))

    def kinds_of(self, attribute: str) -> Kinds:
        """Return the number of instances of an attribute by kind; empty if no entity has it."""
        kinds: Kinds = {}
        for group in self._groups.values():
            for kind, number in group.attributes.get(attribute, {}).items():
                kinds[kind] = kinds.get(kind, 0) + number
        return kinds

    def types_with(self, attribute: str) -> list[str]:
        """Return the types of the entities that have an attribute."""
        having = (types for types, group in self._groups.items() if attribute in group.attributes)
        return list(dict.fromkeys(kind for types in having for kind in types))

    def _of(self, kind: str) -> Iterator[_Group]:
        return (group for types, group in self._groups.items() if kind in types)


def _note_attributes(
    counts: dict[str, Kinds], old: Attributes, new: Attributes, written: frozenset[str] | None
) -> None:
    alike = old.keys() == new.keys()
    for name in written if alike and written is not None else new:
        instances, was = new[name], old.get(name)
        if was is not instances and (was is None or not _alike(was, instances)):
            if was is not None:
                _drop(counts, name, was)
            _add(counts, name, instances)
    if not alike:
        for name in old.keys() - new.keys():
            _drop(counts, name, old[name])


def _alike(was: list[Instance], now: list[Instance]) -> bool:
    """Return whether instances count the same."""
    if len(was) == len(now) == 1:
        return bool(was[0]["type"] == now[0]["type"])
    return [instance["type"] for instance in was] == [instance["type"] for instance in now]


def _add(counts: dict[str, Kinds], name: str, instances: list[Instance]) -> None:
    kinds = counts.get(name)
    if kinds is None:
        kinds = counts[name] = {}
    for instance in instances:
        kind = instance["type"]
        kinds[kind] = kinds.get(kind, 0) + 1


def _add_all(counts: dict[str, Kinds], attributes: Attributes) -> None:
    for name, instances in attributes.items():
        kinds = counts.get(name)
        if kinds is None or len(instances) != 1:
            _add(counts, name, instances)
        else:  # the usual case, without a call
            kind = instances[0]["type"]
            kinds[kind] = kinds.get(kind, 0) + 1


def _drop(counts: dict[str, Kinds], name: str, instances: list[Instance]) -> None:
    kinds = counts[name]
    for instance in instances:
        kind = instance["type"]
        kinds[kind] -= 1
        if not kinds[kind]:
            del kinds[kind]
    if not kinds:
        del counts[name]
