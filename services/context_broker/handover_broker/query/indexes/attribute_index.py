"""Index of the values of one attribute: the entities with a value, or with a number in a range."""

from bisect import bisect_left, bisect_right, insort
from collections.abc import Iterable, Iterator

from handover_broker.model.entity import Entity
from handover_broker.query.indexes.q_index import Condition, Equality, Scalar, scalars

Ids = dict[str, None]
"""Ids of entities, in the order in which they were added."""


class AttributeIndex:
    """The entities by the values of one attribute (an IRI)."""

    def __init__(self, attribute: str, entities: Iterable[Entity]) -> None:
        self._attribute = attribute
        self._ids: dict[Scalar, Ids] = {}
        self._numbers: list[float] | None = None
        for entity in entities:
            self.refile(None, entity)

    def __len__(self) -> int:
        """Return how many values there are."""
        return len(self._ids)

    def refile(self, before: Entity | None, after: Entity | None) -> None:
        """Update the index after a change of an entity."""
        instances_before = () if before is None else before.attributes.get(self._attribute, ())
        instances_after = () if after is None else after.attributes.get(self._attribute, ())
        if instances_before is instances_after:
            return
        old, new = set(scalars(instances_before)), set(scalars(instances_after))
        if old == new:
            return
        for value in old - new:
            ids = self._ids[value]
            del ids[before.id]  # type: ignore[union-attr]  # what is filed was an entity
            if not ids:
                del self._ids[value]
                self._forget_number(value)
        for value in new - old:
            filed = self._ids.get(value)
            if filed is None:
                filed = self._ids[value] = {}
                # True and 1 are the same key; the query checks the entities again.
                if self._numbers is not None and isinstance(value, int | float):
                    insort(self._numbers, value)
            filed[after.id] = None  # type: ignore[union-attr]  # what is to be filed is an entity

    def found(self, condition: Condition) -> list[Ids]:
        """Return the ids that fulfil a condition, by value."""
        if isinstance(condition, Equality):
            return [ids for value in condition.values if (ids := self._ids.get(value))]
        numbers = self._sorted_numbers()
        low, high = bisect_left(numbers, condition.low), bisect_right(numbers, condition.high)
        return [self._ids[number] for number in numbers[low:high]]

    def _sorted_numbers(self) -> list[float]:
        """Return the numbers among the values; sorted at the first use, and kept sorted."""
        if self._numbers is None:
            self._numbers = sorted(value for value in self._ids if isinstance(value, int | float))
        return self._numbers

    def _forget_number(self, value: Scalar) -> None:
        if self._numbers is not None and isinstance(value, int | float):
            del self._numbers[bisect_left(self._numbers, value)]


def ids_of(groups: Iterable[Ids]) -> Iterator[str]:
    """Yield the ids, each once."""
    merged: Ids = {}
    for ids in groups:
        merged.update(ids)
    yield from merged
